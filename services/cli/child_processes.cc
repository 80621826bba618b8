#include "services/cli/child_processes.h"

#include <fcntl.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cstring>

#include "common/base/clock.h"
#include "common/base/file.h"

namespace rg::cli {

std::string LastLine(const std::string& file) {
  const auto read = ReadFile(file);
  std::string text = read.ok() ? *read : "";
  while (!text.empty() && std::isspace(static_cast<unsigned char>(text.back()))) text.pop_back();
  return text.substr(text.find_last_of("\r\n") + 1);
}

namespace {

[[noreturn]] void Become(const std::vector<std::string>& command, int log_fd, pid_t parent) {
  setpgid(0, 0);
  prctl(PR_SET_PDEATHSIG, SIGTERM);
  if (getppid() != parent) _exit(1);
  dup2(open("/dev/null", O_RDONLY), STDIN_FILENO);
  dup2(log_fd, STDOUT_FILENO);
  dup2(log_fd, STDERR_FILENO);
  std::vector<char*> argv;
  for (const std::string& word : command) argv.push_back(const_cast<char*>(word.c_str()));
  argv.push_back(nullptr);
  execv(argv[0], argv.data());
  dprintf(STDERR_FILENO, "cannot start %s: %s\n", argv[0], strerror(errno));
  _exit(127);
}

}  // namespace

Status ChildProcesses::Begin(Child* child) {
  const int log_fd = open(child->log_file.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
  if (log_fd < 0) return InternalError(child->log_file + ": cannot open: " + std::strerror(errno));
  const pid_t parent = getpid();
  child->pid = fork();
  if (child->pid == 0) Become(child->command, log_fd, parent);
  close(log_fd);
  if (child->pid < 0) return ResourceExhaustedError("cannot start " + child->name + ": " + std::strerror(errno));
  return Status::Ok();
}

Status ChildProcesses::Start(const std::string& name, const std::vector<std::string>& command,
                             const std::string& log_file) {
  Child child{name, command, log_file};
  RG_RETURN_IF_ERROR(Begin(&child));
  children_.push_back(std::move(child));
  return Status::Ok();
}

Status ChildProcesses::Check(std::string* ended) {
  for (Child& child : children_) {
    int how = 0;
    if (child.pid < 0 || waitpid(child.pid, &how, WNOHANG) != child.pid) continue;
    child.pid = -1;
    if (ended != nullptr) *ended = child.name;
    const std::string end = WIFSIGNALED(how) ? "was ended by signal " + std::to_string(WTERMSIG(how))
                                             : "ended with code " + std::to_string(WEXITSTATUS(how)) + ": " +
                                                   LastLine(child.log_file);
    return InternalError("the " + child.name + " " + end + " (log: " + child.log_file + ")");
  }
  return Status::Ok();
}

Status ChildProcesses::StartAgain(const std::string& name) {
  for (Child& child : children_)
    if (child.name == name && child.pid < 0) return Begin(&child);
  return NotFoundError("no " + name + " that has ended");
}

void ChildProcesses::StopAll(double grace_s) {
  const double deadline = RealClock().SteadySeconds() + grace_s;
  const size_t first = children_.empty() ? 0 : 1;
  for (size_t i = children_.size(); i > first; --i) Terminate(children_[i - 1]);
  for (size_t i = children_.size(); i > first; --i) AwaitEnd(&children_[i - 1], deadline);
  if (first == 1) {
    Terminate(children_.front());
    AwaitEnd(&children_.front(), std::max(deadline, RealClock().SteadySeconds() + 1.0));
  }
  children_.clear();
}

void ChildProcesses::Terminate(const Child& child) {
  if (child.pid > 0) kill(child.pid, SIGTERM);
}

void ChildProcesses::AwaitEnd(Child* child, double deadline) {
  while (child->pid > 0) {
    if (waitpid(child->pid, nullptr, WNOHANG) == child->pid) {
      child->pid = -1;
    } else if (RealClock().SteadySeconds() > deadline) {
      kill(-child->pid, SIGKILL);
      kill(child->pid, SIGKILL);
      waitpid(child->pid, nullptr, 0);
      child->pid = -1;
    } else {
      usleep(10'000);
    }
  }
}

}  // namespace rg::cli
