#include "tests/support/fault_vfs/fault_vfs.h"

#include <sqlite3.h>

#include <algorithm>
#include <cstring>
#include <fstream>
#include <iterator>
#include <limits>
#include <map>
#include <new>
#include <vector>

#include "common/base/check.h"
#include "common/base/ids.h"

namespace rg::testing_support {
namespace {

constexpr int64_t kNever = std::numeric_limits<int64_t>::max();
constexpr size_t kSector = 512;

// One file: what the disk surely holds, and what was asked of it since.
struct FileImage {
  struct Change {
    int64_t offset = 0;
    std::string bytes;
    bool truncate = false;  // to `offset`
  };
  std::string synced;
  std::vector<Change> pending;

  static void Write(std::string* image, int64_t offset, std::string_view bytes) {
    if (image->size() < static_cast<size_t>(offset) + bytes.size()) image->resize(offset + bytes.size());
    image->replace(offset, bytes.size(), bytes);
  }
  void Sync() {
    for (const Change& change : pending)
      change.truncate ? synced.resize(change.offset) : Write(&synced, change.offset, change.bytes);
    pending.clear();
  }
  // Each sector of each change reaches the disk or does not.
  std::string AfterPowerCut(Rng* rng) const {
    std::string image = synced;
    const double keep = rng->Uniform();
    for (const Change& change : pending) {
      if (change.truncate) {
        if (rng->Uniform() < keep) image.resize(change.offset);
        continue;
      }
      for (size_t at = 0; at < change.bytes.size(); at += kSector)
        if (rng->Uniform() < keep)
          Write(&image, change.offset + static_cast<int64_t>(at),
                std::string_view(change.bytes).substr(at, kSector));
    }
    return image;
  }
};

struct FaultFile {
  sqlite3_file base;
  FaultVfs::Impl* vfs;
  FileImage* image;    // null: not tracked
  sqlite3_file* real;  // lies behind this struct
};

}  // namespace

struct FaultVfs::Impl {
  sqlite3_vfs table{};
  sqlite3_vfs* real = nullptr;
  std::string name;
  std::map<std::string, FileImage> files;
  int64_t operations = 0;
  int64_t fail_from = kNever, fail_until = kNever;
  int fail_code = 0;
  int64_t cut_at = kNever;
  bool off = false;

  // SQLITE_OK, or why this operation fails.
  int Operation() {
    if (off) return SQLITE_IOERR;
    ++operations;
    if (operations >= cut_at) {
      off = true;
      return SQLITE_IOERR;
    }
    return operations >= fail_from && operations < fail_until ? fail_code : SQLITE_OK;
  }
};

namespace {

FaultFile* Self(sqlite3_file* file) { return reinterpret_cast<FaultFile*>(file); }
sqlite3_file* Real(sqlite3_file* file) { return Self(file)->real; }
FaultVfs::Impl* Vfs(sqlite3_vfs* vfs) { return static_cast<FaultVfs::Impl*>(vfs->pAppData); }

int Close(sqlite3_file* f) { return Real(f)->pMethods->xClose(Real(f)); }

int Read(sqlite3_file* f, void* to, int n, sqlite3_int64 at) {
  if (Self(f)->vfs->off) return SQLITE_IOERR_READ;
  return Real(f)->pMethods->xRead(Real(f), to, n, at);
}

int Write(sqlite3_file* f, const void* from, int n, sqlite3_int64 at) {
  if (const int code = Self(f)->vfs->Operation(); code != SQLITE_OK) return code;
  if (FileImage* image = Self(f)->image)
    image->pending.push_back(
        {at, std::string(static_cast<const char*>(from), static_cast<size_t>(n)), false});
  return Real(f)->pMethods->xWrite(Real(f), from, n, at);
}

int Truncate(sqlite3_file* f, sqlite3_int64 size) {
  if (const int code = Self(f)->vfs->Operation(); code != SQLITE_OK) return code;
  if (FileImage* image = Self(f)->image) image->pending.push_back({size, {}, true});
  return Real(f)->pMethods->xTruncate(Real(f), size);
}

int Sync(sqlite3_file* f, int) {
  if (const int code = Self(f)->vfs->Operation(); code != SQLITE_OK) return code;
  if (FileImage* image = Self(f)->image) image->Sync();
  return SQLITE_OK;
}

int FileSize(sqlite3_file* f, sqlite3_int64* size) { return Real(f)->pMethods->xFileSize(Real(f), size); }
int Lock(sqlite3_file* f, int level) { return Real(f)->pMethods->xLock(Real(f), level); }
int Unlock(sqlite3_file* f, int level) { return Real(f)->pMethods->xUnlock(Real(f), level); }
int CheckReserved(sqlite3_file* f, int* out) { return Real(f)->pMethods->xCheckReservedLock(Real(f), out); }
int FileControl(sqlite3_file* f, int op, void* arg) {
  return Real(f)->pMethods->xFileControl(Real(f), op, arg);
}
int SectorSize(sqlite3_file* f) { return Real(f)->pMethods->xSectorSize(Real(f)); }
int Characteristics(sqlite3_file* f) { return Real(f)->pMethods->xDeviceCharacteristics(Real(f)); }
int ShmMap(sqlite3_file* f, int page, int size, int extend, void volatile** out) {
  return Real(f)->pMethods->xShmMap(Real(f), page, size, extend, out);
}
int ShmLock(sqlite3_file* f, int offset, int n, int flags) {
  return Real(f)->pMethods->xShmLock(Real(f), offset, n, flags);
}
void ShmBarrier(sqlite3_file* f) { Real(f)->pMethods->xShmBarrier(Real(f)); }
int ShmUnmap(sqlite3_file* f, int remove) { return Real(f)->pMethods->xShmUnmap(Real(f), remove); }

// Version 2: shared memory for the WAL, no memory-mapped reading past us.
const sqlite3_io_methods kMethods = {
    2,        Close,         Read,        Write,      Truncate,        Sync,   FileSize, Lock,
    Unlock,   CheckReserved, FileControl, SectorSize, Characteristics, ShmMap, ShmLock,  ShmBarrier,
    ShmUnmap, nullptr,       nullptr};

std::string Content(const std::string& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

int Open(sqlite3_vfs* vfs, sqlite3_filename path, sqlite3_file* f, int flags, int* out_flags) {
  FaultVfs::Impl* impl = Vfs(vfs);
  auto* file = new (f) FaultFile();
  file->vfs = impl;
  file->real = reinterpret_cast<sqlite3_file*>(file + 1);
  if (path != nullptr) {
    const auto [found, is_new] = impl->files.try_emplace(path);
    if (is_new) found->second.synced = Content(path);
    file->image = &found->second;
  }
  const int code = impl->real->xOpen(impl->real, path, file->real, flags, out_flags);
  file->base.pMethods = code == SQLITE_OK ? &kMethods : nullptr;
  return code;
}

int Delete(sqlite3_vfs* vfs, const char* path, int sync) {
  FaultVfs::Impl* impl = Vfs(vfs);
  if (impl->off) return SQLITE_IOERR_DELETE;
  impl->files.erase(path);
  return impl->real->xDelete(impl->real, path, sync);
}

}  // namespace

FaultVfs::FaultVfs() : impl_(std::make_unique<Impl>()) {
  impl_->real = sqlite3_vfs_find(nullptr);
  RG_CHECK(impl_->real != nullptr);
  impl_->name = "fault-" + RandomHex(6);
  impl_->table = *impl_->real;
  impl_->table.pNext = nullptr;
  impl_->table.zName = impl_->name.c_str();
  impl_->table.pAppData = impl_.get();
  impl_->table.szOsFile = static_cast<int>(sizeof(FaultFile)) + impl_->real->szOsFile;
  impl_->table.xOpen = Open;
  impl_->table.xDelete = Delete;
  // The remaining entries belong to the unix layer, which finds its own data through them.
  impl_->table.xAccess = [](sqlite3_vfs* v, const char* p, int f, int* o) {
    return Vfs(v)->real->xAccess(Vfs(v)->real, p, f, o);
  };
  impl_->table.xFullPathname = [](sqlite3_vfs* v, const char* p, int n, char* o) {
    return Vfs(v)->real->xFullPathname(Vfs(v)->real, p, n, o);
  };
  RG_CHECK(sqlite3_vfs_register(&impl_->table, /*makeDflt=*/0) == SQLITE_OK);
}

FaultVfs::~FaultVfs() { sqlite3_vfs_unregister(&impl_->table); }

const std::string& FaultVfs::name() const { return impl_->name; }
int64_t FaultVfs::operations() const { return impl_->operations; }
bool FaultVfs::power_is_off() const { return impl_->off; }
void FaultVfs::CutPowerAt(int64_t nth) { impl_->cut_at = impl_->operations + nth; }

void FaultVfs::FailAt(int64_t nth, int code, int64_t count) {
  impl_->fail_from = impl_->operations + nth;
  impl_->fail_until = impl_->fail_from + count;
  impl_->fail_code = code;
}

void FaultVfs::LeaveWhatTheDiskHolds(Rng* rng) {
  for (const auto& [path, image] : impl_->files) {
    const std::string content = image.AfterPowerCut(rng);
    std::ofstream(path, std::ios::binary | std::ios::trunc) << content;
  }
  impl_->files.clear();
  impl_->off = false;
  impl_->cut_at = kNever;
}

}  // namespace rg::testing_support
