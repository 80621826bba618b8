#include "services/cli/process_pool.h"

#include <fcntl.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <map>

namespace rg::cli {
namespace {

Result<pid_t> Spawn(const PooledProcess& process) {
  const int log = open(process.log_file.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644);
  if (log < 0) return InternalError(process.log_file + ": cannot open: " + std::strerror(errno));
  std::vector<char*> argv;
  for (const std::string& word : process.command) argv.push_back(const_cast<char*>(word.c_str()));
  argv.push_back(nullptr);
  const pid_t parent = getpid(), pid = fork();
  if (pid == 0) {
    setpgid(0, 0);
    prctl(PR_SET_PDEATHSIG, SIGTERM);
    if (getppid() != parent) _exit(1);
    dup2(open("/dev/null", O_RDONLY), STDIN_FILENO);
    dup2(log, STDOUT_FILENO);
    dup2(log, STDERR_FILENO);
    execv(argv[0], argv.data());
    _exit(127);
  }
  close(log);
  if (pid < 0) return ResourceExhaustedError(std::string("cannot start a process: ") + std::strerror(errno));
  return pid;
}

}  // namespace

Status RunPool(const std::vector<PooledProcess>& processes, int parallel,
               const std::function<void(size_t, int)>& ended, const CancelToken* cancel) {
  std::map<pid_t, size_t> running;
  Status status;
  size_t next = 0;
  bool told = false;
  while (next < processes.size() || !running.empty()) {
    const bool stop = !status.ok() || (cancel != nullptr && cancel->cancelled());
    if (stop && !told) {
      for (const auto& [pid, index] : running) kill(pid, SIGTERM);
      told = true;
    }
    if (stop && running.empty()) break;
    while (!stop && next < processes.size() && static_cast<int>(running.size()) < parallel) {
      const auto pid = Spawn(processes[next]);
      if (!pid.ok()) {
        status = pid.status();
        break;
      }
      running[*pid] = next++;
    }
    bool any = false;
    for (auto it = running.begin(); it != running.end();) {
      int how = 0;
      if (waitpid(it->first, &how, WNOHANG) != it->first) {
        ++it;
        continue;
      }
      any = true;
      const size_t index = it->second;
      it = running.erase(it);
      ended(index, WIFEXITED(how) ? WEXITSTATUS(how) : 128 + WTERMSIG(how));
    }
    if (!any) usleep(20'000);
  }
  if (status.ok() && cancel != nullptr && cancel->cancelled()) return CancelledError("interrupted");
  return status;
}

}  // namespace rg::cli
