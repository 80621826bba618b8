#include "coordinator/server/end_hook.h"

#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <cstring>
#include <map>
#include <nlohmann/json.hpp>

#include "common/base/clock.h"
#include "common/base/log.h"

namespace rg::coordinator {
namespace {

namespace pb = realitygrad::v1;
using nlohmann::json;

// The words of the command line's listings.
std::string StateOf(const pb::JobSummary& job) {
  std::string name = pb::JobState_Name(job.state()).substr(sizeof "JOB_STATE_" - 1);
  for (char& c : name) c = static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
  return name;
}

std::string JsonOf(const pb::JobSummary& job) {
  const json value = {{"format", "realitygrad.job-ended/1"},
                      {"id", job.id()},
                      {"kind", job.kind()},
                      {"name", job.name()},
                      {"state", StateOf(job)},
                      {"reason", job.reason()},
                      {"submitted_by", job.submitted_by()},
                      {"labels", std::map<std::string, std::string>(job.labels().begin(), job.labels().end())},
                      {"submitted_ns", job.submitted_ns()},
                      {"started_ns", job.started_ns()},
                      {"finished_ns", job.finished_ns()},
                      {"tasks", {{"total", job.tasks_total()}, {"done", job.tasks_done()}, {"failed", job.tasks_failed()}}}};
  return value.dump(-1, ' ', false, json::error_handler_t::replace) + "\n";
}

// -1: it could not be started. Its stdin is the other end of `input`.
pid_t Start(const std::string& command, int input) {
  posix_spawn_file_actions_t files;
  posix_spawn_file_actions_init(&files);
  posix_spawn_file_actions_adddup2(&files, input, STDIN_FILENO);
  posix_spawnattr_t attributes;
  posix_spawnattr_init(&attributes);
  posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETPGROUP);  // so that all of it is killed
  const char* const words[] = {"/bin/sh", "-c", command.c_str(), nullptr};
  pid_t pid = -1;
  const int failed = posix_spawn(&pid, words[0], &files, &attributes, const_cast<char* const*>(words), environ);
  posix_spawn_file_actions_destroy(&files);
  posix_spawnattr_destroy(&attributes);
  return failed == 0 ? pid : -1;
}

}  // namespace

EndHook::EndHook(std::string command, double most_s) : command_(std::move(command)), most_s_(most_s) {
  if (!command_.empty()) thread_ = std::thread([this] { Work(); });
}

EndHook::~EndHook() {
  {
    const std::lock_guard lock(mutex_);
    stop_ = true;
  }
  wake_.notify_all();
  if (thread_.joinable()) thread_.join();
}

void EndHook::JobEnded(const pb::JobSummary& job) {
  constexpr size_t kMostWaiting = 10'000;
  if (command_.empty()) return;
  const std::lock_guard lock(mutex_);
  if (waiting_.size() >= kMostWaiting) return spdlog::warn("--on-end: too many jobs ended at once, {} is not told", job.id());
  waiting_.push_back(JsonOf(job));
  wake_.notify_all();
}

void EndHook::Work() {
  while (true) {
    std::string input;
    {
      std::unique_lock lock(mutex_);
      wake_.wait(lock, [this] { return stop_ || !waiting_.empty(); });
      if (stop_) return;
      input = std::move(waiting_.front());
      waiting_.pop_front();
    }
    RunOnce(input);
  }
}

bool EndHook::Stopped() {
  const std::lock_guard lock(mutex_);
  return stop_;
}

void EndHook::RunOnce(const std::string& input) {
  int ends[2];
  if (::pipe2(ends, O_CLOEXEC) != 0) return spdlog::error("--on-end: {}", std::strerror(errno));
  const pid_t pid = Start(command_, ends[0]);
  ::close(ends[0]);
  // A job's summary is less than a pipe holds: this does not wait.
  ::fcntl(ends[1], F_SETFL, O_NONBLOCK);
  [[maybe_unused]] const ssize_t written = ::write(ends[1], input.data(), input.size());
  ::close(ends[1]);
  if (pid < 0) return spdlog::error("--on-end: /bin/sh cannot be started");
  const double until = RealClock().SteadySeconds() + most_s_;
  int how = 0;
  while (::waitpid(pid, &how, WNOHANG) == 0) {
    if (RealClock().SteadySeconds() > until || Stopped()) {
      ::kill(-pid, SIGKILL);
      ::waitpid(pid, &how, 0);
      return spdlog::error("--on-end: '{}' took more than {} s", command_, most_s_);
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  if (how != 0) spdlog::warn("--on-end: '{}' ended with {}", command_, WIFEXITED(how) ? WEXITSTATUS(how) : 128 + WTERMSIG(how));
}

}  // namespace rg::coordinator
