#include "coordinator/web/gate.h"

#include <arpa/inet.h>
#include <fcntl.h>
#include <sodium.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <cstring>

#include "common/base/file.h"
#include "common/base/ids.h"

namespace rg::coordinator::web {
namespace {

constexpr char kCookieName[] = "rg_token";
constexpr size_t kMinTokenChars = 16;

bool IsLoopback(const std::string& host) {
  in_addr v4{};
  if (inet_pton(AF_INET, host.c_str(), &v4) == 1) return (ntohl(v4.s_addr) >> 24) == 127;
  in6_addr v6{};
  return inet_pton(AF_INET6, host.c_str(), &v6) == 1 && IN6_IS_ADDR_LOOPBACK(&v6);
}

bool IsNumeric(const std::string& host) {
  in6_addr any{};
  return inet_pton(AF_INET, host.c_str(), &any) == 1 || inet_pton(AF_INET6, host.c_str(), &any) == 1;
}

// "[::1]:80" -> "::1", "localhost:80" -> "localhost".
std::string WithoutPort(const std::string& text) {
  if (!text.empty() && text.front() == '[') return text.substr(1, text.find(']') - 1);
  return text.substr(0, text.find(':'));
}

std::string CookieValue(const std::string& header) {
  const std::string wanted = std::string(kCookieName) + "=";
  for (size_t at = 0; at < header.size();) {
    const size_t end = std::min(header.find(';', at), header.size());
    const size_t begin = header.find_first_not_of(' ', at);
    if (begin < end && header.compare(begin, wanted.size(), wanted) == 0)
      return header.substr(begin + wanted.size(), end - begin - wanted.size());
    at = end + 1;
  }
  return {};
}

}  // namespace

Result<ListenAddress> ParseListenAddress(const std::string& text) {
  ListenAddress out;
  const size_t colon = text.rfind(':');
  const auto wrong = [&] {
    return InvalidError("--web '" + text + "': must be ADDRESS:PORT, e.g. 127.0.0.1:7342, or off");
  };
  if (colon == std::string::npos || colon == 0) return wrong();
  out.host = text.substr(0, colon);
  if (out.host.front() == '[' && out.host.back() == ']') out.host = out.host.substr(1, out.host.size() - 2);
  if (out.host == "localhost") out.host = "127.0.0.1";
  const char* end = text.data() + text.size();
  const auto [rest, error] = std::from_chars(text.data() + colon + 1, end, out.port);
  if (error != std::errc() || rest != end || out.port < 0 || out.port > 65535 || !IsNumeric(out.host))
    return wrong();
  out.loopback = IsLoopback(out.host);
  return out;
}

Result<std::string> LoadOrMakeToken(const std::string& path) {
  const int fd = open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
  if (fd >= 0) {
    constexpr int kBytes = 32;
    const std::string token = RandomHex(kBytes);
    const std::string line = token + "\n";
    const bool written =
        write(fd, line.data(), line.size()) == static_cast<ssize_t>(line.size()) && fsync(fd) == 0;
    close(fd);
    if (written) return token;
    unlink(path.c_str());
    return UnavailableError(path + ": " + std::strerror(errno));
  }
  if (errno != EEXIST) return UnavailableError(path + ": " + std::strerror(errno));
  struct stat info {};
  if (stat(path.c_str(), &info) == 0 && (info.st_mode & 077) != 0)
    return PermissionDeniedError(path + ": others may read this token; chmod 600 it");
  RG_ASSIGN_OR_RETURN(std::string token, ReadFile(path));
  while (!token.empty() && std::isspace(static_cast<unsigned char>(token.back()))) token.pop_back();
  if (token.size() < kMinTokenChars || token.find_first_of(" ;,\n\t") != std::string::npos)
    return InvalidError(path + ": a token is a line of at least 16 characters without blanks");
  return token;
}

bool Gate::IsToken(const std::string& text) const {
  return text.size() == token_.size() && sodium_memcmp(text.data(), token_.data(), token_.size()) == 0;
}

bool Gate::Admits(const Credentials& who) const {
  constexpr char kBearer[] = "Bearer ";
  if (needs_token()) {
    return (who.authorization.rfind(kBearer, 0) == 0 &&
            IsToken(who.authorization.substr(sizeof kBearer - 1))) ||
           IsToken(CookieValue(who.cookie));
  }
  const std::string host = WithoutPort(who.host);
  return host == "localhost" || host == address_.host || IsLoopback(host);
}

std::string Gate::Cookie() const {
  return std::string(kCookieName) + "=" + token_ + "; HttpOnly; SameSite=Strict; Path=/; Max-Age=31536000";
}

}  // namespace rg::coordinator::web
