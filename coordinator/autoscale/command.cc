#include "coordinator/autoscale/command.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "common/base/clock.h"

extern char** environ;

namespace rg::coordinator::autoscale {
namespace {

struct Pipe {
  int read = -1, write = -1;
  bool Open() {
    int ends[2];
    if (pipe2(ends, O_CLOEXEC) != 0) return false;
    read = ends[0], write = ends[1];
    return true;
  }
  void CloseRead() { Close(read); }
  void CloseWrite() { Close(write); }
  static void Close(int& fd) {
    if (fd >= 0) close(fd);
    fd = -1;
  }
  ~Pipe() { CloseRead(), CloseWrite(); }
};

// 0, or an errno.
int Spawn(const std::vector<std::string>& words, const Pipe& in, const Pipe& out, const Pipe& err,
          pid_t* pid) {
  std::vector<char*> argv;
  for (const std::string& word : words) argv.push_back(const_cast<char*>(word.c_str()));
  argv.push_back(nullptr);
  posix_spawn_file_actions_t files;
  posix_spawn_file_actions_init(&files);
  posix_spawn_file_actions_adddup2(&files, in.read, STDIN_FILENO);
  posix_spawn_file_actions_adddup2(&files, out.write, STDOUT_FILENO);
  posix_spawn_file_actions_adddup2(&files, err.write, STDERR_FILENO);
  const int failure = posix_spawnp(pid, argv[0], &files, nullptr, argv.data(), environ);
  posix_spawn_file_actions_destroy(&files);
  return failure;
}

// False: nothing more will come.
bool ReadSome(int fd, std::string* text) {
  char piece[4096];
  const ssize_t n = read(fd, piece, sizeof piece);
  constexpr size_t kMaxBytes = 16u << 20;
  if (n > 0 && text->size() < kMaxBytes) text->append(piece, static_cast<size_t>(n));
  return n > 0 || (n < 0 && errno == EINTR);
}

}  // namespace

std::string ShellQuoted(const std::string& word) {
  std::string out = "'";
  for (const char c : word) out += c == '\'' ? "'\\''" : std::string(1, c);
  return out + "'";
}

Result<CommandResult> RunCommand(const std::vector<std::string>& words, const std::string& input,
                                 double timeout_s) {
  Pipe in, out, err;
  if (!in.Open() || !out.Open() || !err.Open())
    return UnavailableError(std::string("pipe: ") + std::strerror(errno));
  pid_t pid = -1;
  const int failure = Spawn(words, in, out, err, &pid);
  if (failure != 0) return UnavailableError(words[0] + ": " + std::strerror(failure));
  in.CloseRead(), out.CloseWrite(), err.CloseWrite();
  // Fits into the pipe; a program that does not read it is no error.
  [[maybe_unused]] const ssize_t written = write(in.write, input.data(), input.size());
  in.CloseWrite();

  CommandResult result;
  const double end = RealClock().SteadySeconds() + timeout_s;
  bool is_late = false;
  while (!is_late && (out.read >= 0 || err.read >= 0)) {
    pollfd ready[2] = {{out.read, POLLIN, 0}, {err.read, POLLIN, 0}};
    const double left = end - RealClock().SteadySeconds();
    is_late = left <= 0;
    if (is_late || poll(ready, 2, static_cast<int>(1000 * left) + 1) <= 0) continue;
    if (ready[0].revents != 0 && !ReadSome(out.read, &result.out)) out.CloseRead();
    if (ready[1].revents != 0 && !ReadSome(err.read, &result.err)) err.CloseRead();
  }
  if (is_late) kill(pid, SIGKILL);
  int status = 0;
  while (waitpid(pid, &status, 0) < 0 && errno == EINTR) {
  }
  if (is_late) return DeadlineExceededError(words[0] + " did not end within its time");
  result.code = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  return result;
}

}  // namespace rg::coordinator::autoscale
