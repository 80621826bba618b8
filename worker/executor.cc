#include "worker/executor.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "common/base/utf8.h"

namespace rg::worker {
namespace {

namespace pb = realitygrad::v1;

constexpr size_t kLastLines = 8;
constexpr size_t kMaxLineBytes = 8u << 10;

// After fork: only calls that are safe there, then exec.
[[noreturn]] void BecomeExecutor(const std::vector<char*>& argv, int message_fd, int output_fd,
                                 pid_t parent) {
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  if (getppid() != parent) _exit(1);
  sigset_t none;
  sigemptyset(&none);
  sigprocmask(SIG_SETMASK, &none, nullptr);
  // A Ctrl-C on the terminal or a stop of the whole group is the worker's business: it drains.
  signal(SIGINT, SIG_IGN);
  signal(SIGTERM, SIG_IGN);
  dup2(output_fd, STDOUT_FILENO);
  dup2(output_fd, STDERR_FILENO);
  fcntl(message_fd, F_SETFD, 0);
  execv("/proc/self/exe", argv.data());
  _exit(127);
}

}  // namespace

Result<std::unique_ptr<Executor>> Executor::Start(const std::vector<std::string>& arguments) {
  int message[2], output[2];
  if (socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, message) != 0) {
    return ResourceExhaustedError(std::string("no socket pair for an executor: ") + std::strerror(errno));
  }
  if (pipe2(output, O_CLOEXEC) != 0) {
    close(message[0]), close(message[1]);
    return ResourceExhaustedError(std::string("no pipe for an executor: ") + std::strerror(errno));
  }
  std::vector<std::string> texts = arguments;
  texts.push_back("--executor-fd");
  texts.push_back(std::to_string(message[1]));
  std::vector<char*> argv;
  for (std::string& text : texts) argv.push_back(text.data());
  argv.push_back(nullptr);
  const pid_t parent = getpid();
  const pid_t pid = fork();
  if (pid == 0) BecomeExecutor(argv, message[1], output[1], parent);
  close(message[1]), close(output[1]);
  if (pid < 0) {
    close(message[0]), close(output[0]);
    return ResourceExhaustedError(std::string("no process for an executor: ") + std::strerror(errno));
  }
  fcntl(output[0], F_SETFL, O_NONBLOCK);
  return std::unique_ptr<Executor>(new Executor(pid, message[0], output[0]));
}

Executor::~Executor() {
  Kill();
  if (!reaped_) waitpid(pid_, &wait_status_, 0);
  close(message_fd_);
  close(output_fd_);
}

Status Executor::Run(const pb::RunTask& task) {
  token_ = task.assignment().token();
  last_lines_.clear();
  pb::ToExecutor message;
  *message.mutable_run() = task;
  return WriteFrame(message_fd_, message);
}

void Executor::Cancel() {
  pb::ToExecutor message;
  message.mutable_cancel()->set_token(token_);
  const Status sent = WriteFrame(message_fd_, message);
  (void)sent;  // if it is gone, Read says so
}

void Executor::Kill() {
  if (!reaped_) kill(pid_, SIGKILL);
}

bool Executor::Read(std::vector<pb::FromExecutor>* messages, std::vector<std::string>* lines) {
  ReadOutput(lines);
  bool open = true;
  pollfd ready{message_fd_, POLLIN, 0};
  while (open && poll(&ready, 1, 0) > 0) open = reader_.ReadSome(message_fd_) == FrameReader::State::kOpen;
  std::string frame;
  while (reader_.Next(&frame)) {
    pb::FromExecutor& message = messages->emplace_back();
    const bool good = message.ParseFromString(frame);
    if (good && !message.has_ready()) continue;
    if (good) ready_ = true;
    messages->pop_back();
    if (!good) Kill();  // not one of our programs any more
  }
  if (open) return true;
  if (!reaped_) {
    waitpid(pid_, &wait_status_, 0);
    reaped_ = true;
  }
  ReadOutput(lines);
  return false;
}

void Executor::ReadOutput(std::vector<std::string>* lines) {
  char chunk[1 << 14];
  ssize_t n;
  while ((n = read(output_fd_, chunk, sizeof(chunk))) > 0) {
    partial_line_.append(chunk, static_cast<size_t>(n));
    size_t end;
    while ((end = partial_line_.find('\n')) != std::string::npos || partial_line_.size() > kMaxLineBytes) {
      const bool whole = end != std::string::npos;
      lines->push_back(CleanUtf8(partial_line_.substr(0, whole ? end : kMaxLineBytes), kMaxLineBytes));
      last_lines_.push_back(lines->back());
      if (last_lines_.size() > kLastLines) last_lines_.pop_front();
      partial_line_.erase(0, whole ? end + 1 : kMaxLineBytes);
    }
  }
}

std::string Executor::HowItEnded() {
  std::string text = "its executor ";
  if (WIFSIGNALED(wait_status_)) {
    const int number = WTERMSIG(wait_status_);
    text += "was killed by signal " + std::to_string(number) + " (" + strsignal(number) + ")";
  } else {
    text += "ended with exit code " + std::to_string(WEXITSTATUS(wait_status_));
  }
  if (last_lines_.empty()) return text;
  text += "; its last lines:";
  for (const std::string& line : last_lines_) text += "\n  " + line;
  return text;
}

}  // namespace rg::worker
