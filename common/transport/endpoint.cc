#include "common/transport/endpoint.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <cstring>
#include <filesystem>

namespace rg::transport {
namespace {

bool StartsWith(const std::string& text, const char* prefix) { return text.rfind(prefix, 0) == 0; }

// Addresses are parsed: a name may begin as one does and be another host's ("127.evil.com").
bool IsLoopbackHost(const std::string& host) {
  if (host == "localhost" || host == "lo") return true;
  in_addr v4;
  constexpr unsigned kLoopbackNet = 127;
  if (::inet_pton(AF_INET, host.c_str(), &v4) == 1) return (ntohl(v4.s_addr) >> 24) == kLoopbackNet;
  const bool bracketed = host.size() > 2 && host.front() == '[' && host.back() == ']';
  in6_addr v6;
  return ::inet_pton(AF_INET6, (bracketed ? host.substr(1, host.size() - 2) : host).c_str(), &v6) == 1 &&
         IN6_IS_ADDR_LOOPBACK(&v6);
}

bool SomebodyListens(const std::string& path) {
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::memcpy(address.sun_path, path.data(), path.size());
  const int fd = ::socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (fd < 0) return false;
  const bool answered = ::connect(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
  ::close(fd);
  return answered;
}

}  // namespace

Result<EndpointKind> ClassifyEndpoint(const std::string& endpoint) {
  if (StartsWith(endpoint, "inproc://") && endpoint.size() > 9) return EndpointKind::kLocal;
  if (StartsWith(endpoint, "ipc://") && endpoint.size() > 6) return EndpointKind::kLocal;
  const size_t colon = endpoint.rfind(':');
  if (StartsWith(endpoint, "tcp://") && colon > 6 && colon + 1 < endpoint.size()) {
    std::string host = endpoint.substr(6, colon - 6);
    // "source;destination": what counts is where the connection goes.
    if (const size_t semicolon = host.rfind(';'); semicolon != std::string::npos)
      host.erase(0, semicolon + 1);
    return IsLoopbackHost(host) ? EndpointKind::kLoopback : EndpointKind::kPublic;
  }
  return InvalidError("endpoint \"" + endpoint.substr(0, 200) +
                      "\": must be tcp://address:port, ipc://path or inproc://name");
}

Status CheckEncryption(const std::string& endpoint, bool encrypted, bool allow_plain_loopback) {
  RG_ASSIGN_OR_RETURN(const EndpointKind kind, ClassifyEndpoint(endpoint));
  if (!encrypted && StartsWith(endpoint, "ipc://@"))
    return FailedPreconditionError(endpoint +
                                   ": everybody on this machine may use it (its name is in no folder): take a path");
  if (encrypted || kind == EndpointKind::kLocal) return Status::Ok();
  if (kind == EndpointKind::kLoopback && allow_plain_loopback) return Status::Ok();
  return FailedPreconditionError(endpoint +
                                 ": tcp needs keys (realitygrad keys); without them only ipc:// is open");
}

Status PrepareIpcPath(const std::string& endpoint) {
  if (!StartsWith(endpoint, "ipc://")) return Status::Ok();
  const std::string path = endpoint.substr(6);
  if (path[0] == '@' || path == "*") return Status::Ok();
  if (path.size() >= sizeof(sockaddr_un::sun_path))
    return InvalidError(endpoint + ": path of " + std::to_string(path.size()) +
                        " characters, a socket's may have " +
                        std::to_string(sizeof(sockaddr_un::sun_path) - 1));
  const std::filesystem::path folder = std::filesystem::path(path).parent_path();
  std::error_code error;
  if (!folder.empty() && std::filesystem::create_directories(folder, error)) ::chmod(folder.c_str(), 0700);
  if (SomebodyListens(path)) return UnavailableError(endpoint + ": another process listens there");
  return Status::Ok();
}

}  // namespace rg::transport
