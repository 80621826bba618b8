#include "common/base/file.h"

#include <fcntl.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "common/base/ids.h"

namespace rg {
namespace {

Status ErrnoError(const std::string& path, const char* what) {
  const int error = errno;
  const StatusCode code = error == ENOSPC || error == EDQUOT  ? StatusCode::kResourceExhausted
                          : error == ENOENT                   ? StatusCode::kNotFound
                          : error == EACCES || error == EPERM ? StatusCode::kPermissionDenied
                                                              : StatusCode::kInternal;
  return Status(code, path + ": " + what + ": " + std::strerror(error));
}

Status WriteAll(int fd, std::string_view bytes, const std::string& path) {
  while (!bytes.empty()) {
    const ssize_t n = ::write(fd, bytes.data(), bytes.size());
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return ErrnoError(path, "cannot write");
    bytes.remove_prefix(static_cast<size_t>(n));
  }
  return ::fsync(fd) == 0 ? Status::Ok() : ErrnoError(path, "cannot sync");
}

// Devices and pipes that nobody writes into never end; what a shell hands over as /dev/fd/N does.
Status CheckReadable(const std::string& path) {
  std::error_code error;
  const auto type = std::filesystem::status(path, error).type();
  using std::filesystem::file_type;
  if (type == file_type::directory) return InvalidError(path + ": is a folder, not a file");
  const bool handed_over =
      path.starts_with("/dev/fd/") || path.starts_with("/proc/self/fd/") || path == "/dev/stdin";
  const bool endless = type == file_type::character || type == file_type::block ||
                       type == file_type::socket || (type == file_type::fifo && !handed_over);
  if (endless) return InvalidError(path + ": is a device or a pipe, not a file");
  return Status::Ok();
}

}  // namespace

Result<std::string> ReadFile(const std::string& path) {
  RG_RETURN_IF_ERROR(CheckReadable(path));
  std::ifstream in(path, std::ios::binary);
  if (!in) return NotFoundError(path + ": cannot open: " + std::strerror(errno));
  std::ostringstream bytes;
  bytes << in.rdbuf();
  if (in.bad()) return DataLossError(path + ": cannot read");
  return std::move(bytes).str();
}

Status WriteFileAtomically(const std::string& path, std::string_view bytes) {
  const std::filesystem::path target(path);
  const std::filesystem::path folder = target.has_parent_path() ? target.parent_path() : ".";
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  const std::string temp = path + ".tmp." + RandomHex(4);
  const int fd = ::open(temp.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0644);
  if (fd < 0) return ErrnoError(temp, "cannot create");
  Status written = WriteAll(fd, bytes, temp);
  ::close(fd);
  if (written.ok() && std::filesystem::is_directory(target, error)) {
    written = InvalidError(path + ": is a folder, not a file");
  } else if (written.ok() && ::rename(temp.c_str(), path.c_str()) != 0) {
    written = ErrnoError(path, "cannot rename");
  }
  if (!written.ok()) {
    ::unlink(temp.c_str());
    return written;
  }
  const int folder_fd = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (folder_fd >= 0) {
    ::fsync(folder_fd);
    ::close(folder_fd);
  }
  return Status::Ok();
}

}  // namespace rg
