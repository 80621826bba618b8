#include "tests/support/slurm/mini_slurm.h"

#include <arpa/inet.h>
#include <pwd.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <thread>

#include "common/base/check.h"
#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/ids.h"

namespace rg::testing {
namespace {

// Free now; somebody else could take it before we do, which would fail the test, not mislead it.
int FreePort() {
  const int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof address;
  RG_CHECK(bind(fd, reinterpret_cast<sockaddr*>(&address), size) == 0) << "bind";
  RG_CHECK(getsockname(fd, reinterpret_cast<sockaddr*>(&address), &size) == 0) << "getsockname";
  close(fd);
  return ntohs(address.sin_port);
}

std::string OutputOf(const std::string& command) {
  FILE* pipe = popen(command.c_str(), "r");
  RG_CHECK(pipe != nullptr) << command;
  std::string text;
  char piece[4096];
  for (size_t n; (n = fread(piece, 1, sizeof piece, pipe)) > 0;) text.append(piece, n);
  pclose(pipe);
  return text;
}

}  // namespace

std::string MiniSlurm::Missing() {
  for (const char* program :
       {"/usr/sbin/munged", "/usr/sbin/slurmctld", "/usr/sbin/slurmd", "/usr/bin/sbatch"}) {
    if (access(program, X_OK) != 0)
      return std::string(program) + " is not installed (packages slurm-wlm, munge)";
  }
  if (geteuid() != 0) return "slurmd starts jobs as root only";
  return {};
}

void MiniSlurm::WriteConfiguration() const {
  const passwd* user = getpwuid(geteuid());
  const std::string d = folder_, name = user->pw_name;
  const std::string text =
      "ClusterName=mini\nSlurmctldHost=localhost(127.0.0.1)\nSlurmctldPort=" + std::to_string(FreePort()) +
      "\nSlurmdPort=" + std::to_string(FreePort()) + "\nSlurmUser=" + name + "\nSlurmdUser=" + name +
      "\nAuthType=auth/munge\nAuthInfo=socket=" + d +
      "/munge.sock\nCredType=cred/munge\nStateSaveLocation=" + d + "/state\nSlurmdSpoolDir=" + d +
      "/spool\nSlurmctldPidFile=" + d + "/slurmctld.pid\nSlurmdPidFile=" + d +
      "/slurmd.pid\nSlurmctldLogFile=" + d + "/slurmctld.log\nSlurmdLogFile=" + d +
      "/slurmd.log\nProctrackType=proctrack/linuxproc\nTaskPlugin=task/"
      "none\nJobAcctGatherType=jobacct_gather/none\n"
      "AccountingStorageType=accounting_storage/none\nJobCompType=jobcomp/none\nSwitchType=switch/"
      "none\nMpiDefault=none\n"
      "SelectType=select/cons_tres\nSelectTypeParameters=CR_CPU\nSchedulerType=sched/backfill\n"
      "SchedulerParameters=batch_sched_delay=0,sched_interval=1,bf_interval=1,sched_min_interval=1000\n"
      "ReturnToService=2\nSlurmctldTimeout=30\nSlurmdTimeout=30\nKillWait=5\nMinJobAge=300\nMessageTimeout="
      "5\n"
      "MailProg=/bin/true\nSlurmdParameters=config_overrides\nNodeName=localhost NodeAddr=127.0.0.1 CPUs=4 "
      "State=UNKNOWN\n"
      "PartitionName=main Nodes=localhost Default=YES MaxTime=INFINITE State=UP\n";
  RG_CHECK(WriteFileAtomically(d + "/slurm.conf", text).ok()) << d;
}

MiniSlurm::MiniSlurm(const std::string& folder) : folder_(folder) {
  for (const char* part : {"", "/state", "/spool", "/munge"})
    std::filesystem::create_directories(folder_ + part);
  chmod((folder_ + "/munge").c_str(), 0700);
  constexpr int kKeyBytes = 512;
  RG_CHECK(WriteFileAtomically(folder_ + "/munge/key", RandomHex(kKeyBytes)).ok()) << folder_;
  chmod((folder_ + "/munge/key").c_str(), 0400);
  WriteConfiguration();
  setenv("SLURM_CONF", (folder_ + "/slurm.conf").c_str(), 1);
  munged_ = std::make_unique<Process>(
      std::vector<std::string>{"/usr/sbin/munged", "--foreground", "--key-file=" + folder_ + "/munge/key",
                               "--socket=" + folder_ + "/munge.sock", "--pid-file=" + folder_ + "/munge/pid",
                               "--log-file=" + folder_ + "/munge/log",
                               "--seed-file=" + folder_ + "/munge/seed"},
      folder_ + "/munged.log");
  const double end = RealClock().SteadySeconds() + 30.0;
  while (!std::filesystem::exists(folder_ + "/munge.sock") && RealClock().SteadySeconds() < end)
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  StartController();
  node_ = std::make_unique<Process>(std::vector<std::string>{"/usr/sbin/slurmd", "-D", "-c", "-N",
                                                             "localhost", "-f", folder_ + "/slurm.conf"},
                                    folder_ + "/slurmd.out");
}

MiniSlurm::~MiniSlurm() {
  // What still runs ends with the jobs; slurmd alone would leave them behind.
  [[maybe_unused]] const int ignored = std::system("timeout 10 scancel --user=$(id -un) 2>/dev/null");
  const double end = RealClock().SteadySeconds() + 15.0;
  while (!Queue("").empty() && RealClock().SteadySeconds() < end)
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
  node_.reset(), controller_.reset(), munged_.reset();
  unsetenv("SLURM_CONF");
}

void MiniSlurm::KillController() { controller_->KillNow(); }

void MiniSlurm::StartController() {
  std::vector<std::string> words = {"/usr/sbin/slurmctld", "-D", "-f", folder_ + "/slurm.conf"};
  if (controller_ == nullptr) words.push_back("-c");
  controller_ = std::make_unique<Process>(words, folder_ + "/slurmctld.out");
}

bool MiniSlurm::WaitUntilIdle(double timeout_s) {
  const double end = RealClock().SteadySeconds() + timeout_s;
  while (RealClock().SteadySeconds() < end) {
    if (OutputOf("timeout 10 sinfo -h -o %t 2>/dev/null") == "idle\n") return true;
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
  }
  return false;
}

std::string MiniSlurm::Queue(const std::string& arguments) const {
  return OutputOf("timeout 10 squeue --noheader " + arguments + " 2>/dev/null");
}

std::string MiniSlurm::Logs() const {
  std::string text;
  for (const char* log : {"/munged.log", "/slurmctld.out", "/slurmctld.log", "/slurmd.out", "/slurmd.log"}) {
    const auto file = ReadFile(folder_ + log);
    if (file.ok())
      text += std::string("--- ") + log + "\n" +
              file->substr(file->size() - std::min<size_t>(file->size(), 3000));
  }
  return text;
}

}  // namespace rg::testing
