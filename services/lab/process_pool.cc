#include "services/lab/process_pool.h"

#include <fcntl.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>
#include <map>

namespace rg::lab {
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
    // SIGXCPU at the limit, SIGKILL a second later.
    const rlimit limit{static_cast<rlim_t>(process.cpu_limit_s),
                       static_cast<rlim_t>(process.cpu_limit_s) + 1};
    if (process.cpu_limit_s > 0 && setrlimit(RLIMIT_CPU, &limit) != 0) _exit(126);
    execv(argv[0], argv.data());
    _exit(127);
  }
  close(log);
  if (pid < 0) return ResourceExhaustedError(std::string("cannot start a process: ") + std::strerror(errno));
  return pid;
}

double Seconds(const timeval& t) {
  return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
}

PooledEnd EndOf(const PooledProcess& process, int how, const rusage& used) {
  PooledEnd end;
  end.cpu_s = Seconds(used.ru_utime) + Seconds(used.ru_stime);
  end.code = WIFEXITED(how) ? WEXITSTATUS(how) : 128 + WTERMSIG(how);
  // The kernel's account at the limit and the one it gives here differ by some per cent.
  const bool killed =
      end.code == 128 + SIGXCPU || (end.code == 128 + SIGKILL && end.cpu_s >= process.cpu_limit_s);
  end.out_of_time = process.cpu_limit_s > 0 && killed;
  return end;
}

}  // namespace

Status RunPool(const std::vector<PooledProcess>& processes, int parallel,
               const std::function<void(size_t, const PooledEnd&)>& ended, const CancelToken* cancel) {
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
      rusage used{};
      if (wait4(it->first, &how, WNOHANG, &used) != it->first) {
        ++it;
        continue;
      }
      any = true;
      const size_t index = it->second;
      it = running.erase(it);
      if (!told) ended(index, EndOf(processes[index], how, used));
    }
    if (!any) usleep(20'000);
  }
  if (status.ok() && cancel != nullptr && cancel->cancelled()) return CancelledError("interrupted");
  return status;
}

}  // namespace rg::lab
