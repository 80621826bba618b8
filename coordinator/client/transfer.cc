#include "coordinator/client/transfer.h"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <functional>

#include "common/base/hash.h"
#include "common/base/ids.h"

namespace rg::coordinator {
namespace {

namespace fs = std::filesystem;
namespace pb = realitygrad::v1;

constexpr size_t kPieceBytes = 4 << 20;

// Of this machine's disk. Never kUnavailable, which would be a coordinator that is away.
Status LocalError(const std::string& what, int error) {
  const std::string why = what + ": " + std::strerror(error);
  return error == ENOSPC || error == EDQUOT ? ResourceExhaustedError(why) : InternalError(why);
}

class File {
 public:
  File() = default;
  File(const std::string& path, int flags) : fd_(::open(path.c_str(), flags | O_CLOEXEC, 0644)) {}
  File(File&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  File& operator=(File&& other) noexcept {
    std::swap(fd_, other.fd_);
    return *this;
  }
  ~File() {
    if (fd_ >= 0) ::close(fd_);
  }
  bool is_open() const { return fd_ >= 0; }
  int fd() const { return fd_; }

  // Up to `limit` bytes, fewer only at the end.
  Result<std::string> ReadAt(uint64_t offset, size_t limit) const {
    std::string bytes(limit, '\0');
    size_t have = 0;
    while (have < limit) {
      const ssize_t n = ::pread(fd_, bytes.data() + have, limit - have, static_cast<off_t>(offset + have));
      if (n < 0 && errno == EINTR) continue;
      if (n < 0) return LocalError("read", errno);
      if (n == 0) break;
      have += static_cast<size_t>(n);
    }
    bytes.resize(have);
    return bytes;
  }
  Status WriteAt(uint64_t offset, std::string_view bytes) const {
    while (!bytes.empty()) {
      const ssize_t n = ::pwrite(fd_, bytes.data(), bytes.size(), static_cast<off_t>(offset));
      if (n < 0 && errno == EINTR) continue;
      if (n < 0) return LocalError("write", errno);
      bytes.remove_prefix(static_cast<size_t>(n));
      offset += static_cast<uint64_t>(n);
    }
    return Status::Ok();
  }

 private:
  int fd_ = -1;
};

Status SyncFolder(const std::string& path) {
  const File folder(path.empty() ? "." : path, O_RDONLY | O_DIRECTORY);
  return folder.is_open() && ::fsync(folder.fd()) == 0
             ? Status::Ok()
             : LocalError(path + ": cannot be synced", errno);
}

// The next piece, and how large the artefact is.
Result<std::string> FetchPiece(transport::RequestClient& requests, const std::string& sha256, uint64_t offset,
                               uint64_t* total) {
  pb::GetArtifactRequest request;
  request.set_sha256(sha256);
  request.set_limit_bytes(kPieceBytes);
  request.set_offset(offset);
  RG_ASSIGN_OR_RETURN(auto message, requests.Call(transport::MakeRequest(requests.self(), request)));
  RG_ASSIGN_OR_RETURN(const auto reply, transport::Unpack<pb::GetArtifactReply>(message));
  *total = reply.size_bytes();
  if (reply.offset() != offset || (message.attachment.empty() && offset < *total))
    return DataLossError("artefact " + sha256 + ": a piece at " + std::to_string(offset) + " did not come");
  return std::move(message.attachment);
}

// What an earlier call left, if nobody else is at it; otherwise a file of our own.
Result<File> OpenPart(const std::string& path, std::string* part) {
  *part = path + ".part";
  File file(*part, O_RDWR | O_CREAT);
  if (file.is_open() && ::flock(file.fd(), LOCK_EX | LOCK_NB) == 0) {
    struct stat here {
    }, there{};  // it may have been renamed between open and lock
    if (::fstat(file.fd(), &here) == 0 && ::stat(part->c_str(), &there) == 0 && here.st_ino == there.st_ino)
      return file;
  }
  *part = path + ".part-" + RandomHex(6);
  File own(*part, O_RDWR | O_CREAT | O_EXCL);
  if (own.is_open()) return own;
  return LocalError(*part + ": cannot be made", errno);
}

Status FetchInto(transport::RequestClient& requests, const std::string& sha256, const File& file,
                 uint64_t* size) {
  Sha256 hash;
  uint64_t offset = 0, total = 0;
  while (true) {  // what is there already
    RG_ASSIGN_OR_RETURN(const std::string piece, file.ReadAt(offset, kPieceBytes));
    if (piece.empty()) break;
    hash.Update(piece);
    offset += piece.size();
  }
  do {
    auto piece = FetchPiece(requests, sha256, offset, &total);
    if (!piece.ok()) return piece.status();
    if (offset > total || piece->size() > total - offset)
      return DataLossError("artefact " + sha256 + ": more bytes came than it has");
    RG_RETURN_IF_ERROR(file.WriteAt(offset, *piece));
    hash.Update(*piece);
    offset += piece->size();
  } while (offset < total);
  if (hash.FinishHex() != sha256)
    return DataLossError("artefact " + sha256 + ": the bytes do not match the hash");
  *size = total;
  return ::fsync(file.fd()) == 0 ? Status::Ok()
                                 : LocalError("fsync", errno);
}

using ReadPiece = std::function<Result<std::string>(uint64_t offset, size_t limit)>;

Status Upload(transport::RequestClient& requests, const pb::ArtifactInfo& info, const ReadPiece& read) {
  constexpr int kMaxRestarts = 5;
  const uint64_t size = info.size_bytes();
  int restarts = 0;
  uint64_t offset = 0;
  while (true) {
    pb::PutArtifactRequest request;
    request.set_upload_id(info.sha256());  // the same for whoever takes it up
    request.set_offset(offset);
    RG_ASSIGN_OR_RETURN(std::string piece, read(offset, std::min<uint64_t>(kPieceBytes, size - offset)));
    request.set_last(offset + piece.size() == size);
    if (offset == 0 || request.last()) *request.mutable_info() = info;
    transport::Message message = transport::MakeRequest(requests.self(), request);
    message.attachment = std::move(piece);
    RG_ASSIGN_OR_RETURN(const auto answer, requests.Call(std::move(message)));
    RG_ASSIGN_OR_RETURN(const auto reply, transport::Unpack<pb::PutArtifactReply>(answer));
    if (reply.committed()) return Status::Ok();
    if (reply.next_offset() > size) return InternalError("coordinator asks for bytes past the end");
    if (reply.next_offset() <= offset && ++restarts > kMaxRestarts) {
      return UnavailableError("upload of " + info.sha256() + " does not get on");
    }
    offset = reply.next_offset();
  }
}

}  // namespace

Result<std::string> FetchArtifact(transport::RequestClient& requests, const std::string& sha256) {
  std::string bytes;
  uint64_t total = 0;
  do {
    RG_ASSIGN_OR_RETURN(const std::string piece, FetchPiece(requests, sha256, bytes.size(), &total));
    bytes += piece;
  } while (bytes.size() < total);
  if (Sha256Hex(bytes) != sha256)
    return DataLossError("artefact " + sha256 + ": the bytes do not match the hash");
  return bytes;
}

Result<uint64_t> FetchArtifactToFile(transport::RequestClient& requests, const std::string& sha256,
                                     const std::string& path) {
  std::error_code error;
  const std::string folder = fs::path(path).parent_path().string();
  if (!folder.empty()) fs::create_directories(folder, error);
  if (error) return LocalError(folder + ": cannot be made", error.value());
  std::string part;
  RG_ASSIGN_OR_RETURN(const File file, OpenPart(path, &part));
  uint64_t size = 0;
  const bool goes_on = ::lseek(file.fd(), 0, SEEK_END) > 0;
  Status fetched = FetchInto(requests, sha256, file, &size);
  if (goes_on && fetched.code() == StatusCode::kDataLoss) {  // what was there was of another artefact
    if (::ftruncate(file.fd(), 0) == 0) fetched = FetchInto(requests, sha256, file, &size);
  }
  if (!fetched.ok()) {
    const bool can_go_on = fetched.code() == StatusCode::kUnavailable ||
                           fetched.code() == StatusCode::kCancelled ||
                           fetched.code() == StatusCode::kDeadlineExceeded;
    if (!can_go_on || part != path + ".part") fs::remove(part, error);
    return fetched;
  }
  fs::rename(part, path, error);
  if (error) return LocalError(path, error.value());
  RG_RETURN_IF_ERROR(SyncFolder(folder));
  return size;
}

Status UploadArtifact(transport::RequestClient& requests, std::string_view bytes,
                      const pb::ArtifactInfo& info) {
  pb::ArtifactInfo sized = info;
  sized.set_size_bytes(bytes.size());
  return Upload(requests, sized, [bytes](uint64_t offset, size_t limit) -> Result<std::string> {
    return std::string(bytes.substr(offset, limit));
  });
}

Status UploadArtifactFile(transport::RequestClient& requests, const std::string& path,
                          const pb::ArtifactInfo& info) {
  const File file(path, O_RDONLY);
  if (!file.is_open()) return NotFoundError(path + ": " + std::strerror(errno));
  return Upload(requests, info, [&](uint64_t offset, size_t limit) -> Result<std::string> {
    RG_ASSIGN_OR_RETURN(std::string piece, file.ReadAt(offset, limit));
    if (piece.size() != limit) return DataLossError(path + ": became shorter while it was uploaded");
    return piece;
  });
}

Result<std::string> Sha256OfFile(const std::string& path, uint64_t* size) {
  const File file(path, O_RDONLY);
  if (!file.is_open()) return NotFoundError(path + ": " + std::strerror(errno));
  Sha256 hash;
  for (*size = 0;;) {
    RG_ASSIGN_OR_RETURN(const std::string piece, file.ReadAt(*size, kPieceBytes));
    if (piece.empty()) return hash.FinishHex();
    hash.Update(piece);
    *size += piece.size();
  }
}

}  // namespace rg::coordinator
