#include "robot_agent/local_socket.h"

#include <fcntl.h>
#include <poll.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstring>

namespace rg::robot_agent {
namespace {

constexpr int kPatienceMs = 500;
constexpr size_t kMaxLine = 256, kMaxAnswer = 1 << 20;

// A path of a socket has at most 107 bytes: the folder is named by an open file instead.
struct Address {
  int folder = -1;
  sockaddr_un name{};
  ~Address() {
    if (folder >= 0) close(folder);
  }
};

Status Name(const std::string& folder, Address* address) {
  address->folder = open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (address->folder < 0)
    return UnavailableError("cannot open the spool folder " + folder + ": " + std::strerror(errno) +
                            (errno == ENOENT ? " (--spool says where the agent has it)" : ""));
  address->name.sun_family = AF_UNIX;
  std::snprintf(address->name.sun_path, sizeof address->name.sun_path, "/proc/self/fd/%d/agent.sock",
                address->folder);
  return Status::Ok();
}

Result<int> NewSocket() {
  const int file = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (file < 0) return UnavailableError(std::string("no local socket: ") + std::strerror(errno));
  return file;
}

bool Ready(int file, short events) {
  pollfd waiting{file, events, 0};
  return poll(&waiting, 1, kPatienceMs) > 0;
}

// Up to the end of the line, or of what is sent.
std::string ReadText(int file, size_t most, char until) {
  std::string text;
  char chunk[4096];
  while (text.size() < most && Ready(file, POLLIN)) {
    const ssize_t count = read(file, chunk, sizeof chunk);
    if (count <= 0) break;
    text.append(chunk, static_cast<size_t>(count));
    if (until != '\0' && text.find(until) != std::string::npos) break;
  }
  return text;
}

void WriteText(int file, const std::string& text) {
  size_t done = 0;
  while (done < text.size() && Ready(file, POLLOUT)) {
    const ssize_t count = send(file, text.data() + done, text.size() - done, MSG_NOSIGNAL);
    if (count <= 0) return;
    done += static_cast<size_t>(count);
  }
}

}  // namespace

Result<LocalSocket> LocalSocket::Listen(const std::string& folder) {
  Address address;
  RG_RETURN_IF_ERROR(Name(folder, &address));
  RG_ASSIGN_OR_RETURN(const int file, NewSocket());
  const std::string path = folder + "/agent.sock";
  unlink(path.c_str());  // of an agent that is gone: the caller has the folder's lock
  const mode_t before = umask(0077);
  const bool listens =
      bind(file, reinterpret_cast<const sockaddr*>(&address.name), sizeof address.name) == 0 &&
      listen(file, 8) == 0;
  const int error = errno;
  umask(before);
  if (listens) return LocalSocket(file, path);
  close(file);
  return UnavailableError("cannot listen at " + path + ": " + std::strerror(error));
}

LocalSocket::~LocalSocket() {
  if (file_ < 0) return;
  close(file_);
  unlink(path_.c_str());
}

void LocalSocket::Serve(const std::function<std::string(const std::string& line)>& answer) const {
  const int caller = accept4(file_, nullptr, nullptr, SOCK_CLOEXEC);
  if (caller < 0) return;
  std::string line = ReadText(caller, kMaxLine, '\n');
  line = line.substr(0, line.find('\n'));
  WriteText(caller, answer(line) + "\n");
  close(caller);
}

Result<std::string> AskLocally(const std::string& folder, const std::string& line) {
  Address address;
  RG_RETURN_IF_ERROR(Name(folder, &address));
  RG_ASSIGN_OR_RETURN(const int file, NewSocket());
  if (connect(file, reinterpret_cast<const sockaddr*>(&address.name), sizeof address.name) != 0) {
    close(file);
    return UnavailableError("no agent runs on the spool " + folder);
  }
  WriteText(file, line + "\n");
  std::string text = ReadText(file, kMaxAnswer, '\0');
  close(file);
  if (text.empty()) return UnavailableError("the agent on the spool " + folder + " does not answer");
  return text;
}

}  // namespace rg::robot_agent
