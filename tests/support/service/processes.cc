#include "tests/support/service/processes.h"

#include <fcntl.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <thread>

#include "common/base/check.h"
#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/ids.h"

namespace rg::testing {
namespace {

bool WaitUntil(double timeout_s, const std::function<bool()>& holds) {
  const double end = RealClock().SteadySeconds() + timeout_s;
  while (!holds()) {
    if (RealClock().SteadySeconds() > end) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  return true;
}

}  // namespace

std::string BinFolder() {
  const char* folder = std::getenv("RG_BIN_DIR");
  if (folder != nullptr) return folder;
  return std::filesystem::read_symlink("/proc/self/exe").parent_path().string();
}

Process::Process(const std::vector<std::string>& arguments, const std::string& log_path) {
  std::vector<char*> argv;
  for (const std::string& text : arguments) argv.push_back(const_cast<char*>(text.c_str()));
  argv.push_back(nullptr);
  pid_ = fork();
  RG_CHECK(pid_ >= 0) << "fork";
  if (pid_ > 0) return;
  const int log = open(log_path.c_str(), O_WRONLY | O_CREAT | O_APPEND, 0644);
  dup2(log, STDOUT_FILENO);
  dup2(log, STDERR_FILENO);
  execvp(argv[0], argv.data());
  _exit(127);
}

Process::~Process() { KillNow(); }

void Process::Signal(int number) const { kill(pid_, number); }

int Process::WaitForExit(double timeout_s) {
  WaitUntil(timeout_s, [this] {
    int status = 0;
    if (!ended_ && waitpid(pid_, &status, WNOHANG) == pid_) {
      ended_ = true;
      exit_code_ = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
    }
    return ended_;
  });
  return ended_ ? exit_code_ : -1;
}

void Process::KillNow() {
  if (ended_) return;
  Signal(SIGKILL);
  waitpid(pid_, nullptr, 0);
  ended_ = true;
}

Service::Service(int heartbeat_ms, std::vector<std::string> more)
    : heartbeat_ms_(heartbeat_ms), more_(std::move(more)) {
  folder_ = "/tmp/rg-service-" + RandomHex(6);
  std::filesystem::create_directories(folder_);
  StartCoordinator();
  client_ = NewClient();
}

Service::~Service() {
  client_.reset();
  workers_.clear();
  coordinator_.reset();
  std::error_code ignored;
  std::filesystem::remove_all(folder_, ignored);
}

void Service::StartCoordinator() { RG_CHECK(TryStartCoordinator()) << Logs(); }

bool Service::TryStartCoordinator() {
  const std::string address_file = folder_ + "/address" + std::to_string(++starts_);
  std::vector<std::string> arguments = {BinFolder() + "/realitygrad-coordinator",
                                        "--listen",
                                        endpoint(),
                                        "--db",
                                        database(),
                                        "--heartbeat-ms",
                                        std::to_string(heartbeat_ms_),
                                        "--address-file",
                                        address_file,
                                        "--may-submit",
                                        "lead:sleep",
                                        "--may-submit",
                                        "sleep:sleep"};
  arguments.insert(arguments.end(), more_.begin(), more_.end());
  if (std::find(more_.begin(), more_.end(), "--uncertain-s") == more_.end())
    arguments.insert(arguments.end(), {"--uncertain-s", "3"});
  coordinator_ = std::make_unique<Process>(arguments, folder_ + "/coordinator.log");
  const auto listens = [&] { return std::filesystem::exists(address_file); };
  WaitUntil(60.0, [&] { return listens() || coordinator_->WaitForExit(0.0) >= 0; });
  return listens();
}

void Service::KillCoordinator() {
  coordinator_->KillNow();
  coordinator_.reset();
}

Process& Service::StartWorker(const std::string& name, int slots, const std::vector<std::string>& more) {
  std::vector<std::string> flags = {"--slots", std::to_string(slots)};
  flags.insert(flags.end(), more.begin(), more.end());
  return StartProgram(name, flags);
}

Process& Service::StartAgent(const std::string& name, const std::vector<std::string>& more) {
  std::vector<std::string> flags = {"--robot", "one"};
  flags.insert(flags.end(), more.begin(), more.end());
  return StartProgram(name, flags);
}

Process& Service::StartProgram(const std::string& name, const std::vector<std::string>& flags) {
  std::vector<std::string> arguments = {
      BinFolder() + "/synthetic_worker", "--coordinator",  endpoint(), "--name", name, "--folder",
      folder_ + "/worker-" + name,       "--cancel-grace", "0.3"};
  arguments.insert(arguments.end(), flags.begin(), flags.end());
  workers_[name] = std::make_unique<Process>(arguments, folder_ + "/" + name + ".log");
  return *workers_[name];
}

std::unique_ptr<coordinator::Client> Service::NewClient() const {
  coordinator::ClientOptions options;
  options.address = endpoint();
  options.attempt_timeout_ms = 2'000;
  options.attempts = 10;
  auto client = coordinator::Client::Connect(options);
  RG_CHECK(client.ok()) << client.status().ToString();
  return *std::move(client);
}

double Service::Counter(const std::string& name) {
  const auto status = client_->CoordinatorStatus();
  if (!status.ok()) return -1.0;
  const auto found = status->counters().find(name);
  return found == status->counters().end() ? -1.0 : found->second;
}

bool Service::WaitForWorkers(uint32_t workers, double timeout_s) {
  return WaitUntil(timeout_s, [&] {
    const auto status = client_->CoordinatorStatus();
    return status.ok() && status->workers() == workers;
  });
}

bool Service::WaitForTask(int64_t job, const std::string& task, pb::TaskState state, double timeout_s) {
  return WaitUntil(timeout_s, [&] {
    const auto reply = client_->GetJob(job);
    const pb::TaskInfo* info = reply.ok() ? FindTask(*reply, task) : nullptr;
    return info != nullptr && info->state() == state;
  });
}

bool Service::WaitForProgress(int64_t job, const std::string& task, double timeout_s) {
  return WaitUntil(timeout_s, [&] {
    const auto reply = client_->GetJob(job);
    const pb::TaskInfo* info = reply.ok() ? FindTask(*reply, task) : nullptr;
    return info != nullptr && info->state() == pb::TASK_STATE_LEASED && info->progress().total() > 0;
  });
}

std::string Service::Logs() const {
  std::string text;
  std::error_code ignored;
  for (const auto& entry : std::filesystem::directory_iterator(folder_, ignored)) {
    if (entry.path().extension() != ".log") continue;
    const auto log = ReadFile(entry.path().string());
    if (log.ok())
      text += "--- " + entry.path().filename().string() + "\n" +
              log->substr(log->size() - std::min<size_t>(log->size(), 4000));
  }
  return text;
}

pb::TaskSpec* AddTask(pb::JobSpec* job, const std::string& name, const std::string& kind,
                      const std::string& payload_json) {
  pb::TaskSpec* task = job->add_tasks();
  task->set_name(name);
  task->set_kind(kind);
  task->set_payload(payload_json);
  return task;
}

void AddInput(pb::TaskSpec* task, const std::string& name, const std::string& from_task, bool optional) {
  pb::InputSpec* input = task->add_inputs();
  input->set_name(name);
  input->mutable_task_output()->set_task(from_task);
  input->mutable_task_output()->set_output("out");
  input->set_optional(optional);
}

void AddStageInput(pb::TaskSpec* task, const std::string& name, const std::string& stage) {
  pb::InputSpec* input = task->add_inputs();
  input->set_name(name);
  input->mutable_stage_outputs()->set_stage(stage);
}

const pb::TaskInfo* FindTask(const pb::GetJobReply& reply, const std::string& name) {
  for (const pb::TaskInfo& task : reply.tasks()) {
    if (task.name() == name) return &task;
  }
  return nullptr;
}

}  // namespace rg::testing
