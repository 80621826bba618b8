#include "services/cli/local_service.h"

#include <signal.h>
#include <stdlib.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <thread>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "coordinator/client/client.h"
#include "realitygrad/v1/control.pb.h"
#include "services/cli/context.h"
#include "services/cli/job_view.h"
#include "services/cli/ros_stand_in.h"
#include "services/jobs/job_graphs.h"
#include "services/jobs/kinds.h"

namespace rg::cli {
namespace {

namespace pb = ::realitygrad::v1;
namespace fs = std::filesystem;
using nlohmann::json;

std::atomic<coordinator::Client*> interrupted_client{nullptr};
std::atomic<bool> interrupted{false};
void CancelJobOnSignal(int) {
  interrupted = true;
  if (auto* client = interrupted_client.load()) client->Cancel();
}

// Seconds between the first start and the last end of a stage (and its numbered rounds).
double StageSeconds(const pb::GetJobReply& job, const std::string& stage) {
  int64_t start = 0, end = 0;
  for (const pb::StageInfo& s : job.stages()) {
    if (s.name().rfind(stage, 0) != 0 || s.started_ns() == 0) continue;
    start = start == 0 ? s.started_ns() : std::min(start, s.started_ns());
    end = std::max(end, s.finished_ns());
  }
  return end > start ? 1e-9 * static_cast<double>(end - start) : std::nan("");
}

constexpr char kWorker[] = "worker-";
constexpr int kStartAgain = 3;  // times, of each worker
constexpr double kGrace = 15.0;  // s, to stop in
constexpr auto kLook = std::chrono::milliseconds(100);

// What a killed program has left (an agent's worker ends its rollout) has become this process's. It holds locks that
// whoever goes on with the folder needs.
void AwaitOrphans(double deadline) {
  while (RealClock().SteadySeconds() < deadline) {
    const pid_t ended = waitpid(-1, nullptr, WNOHANG);
    if (ended < 0) return;
    if (ended == 0) std::this_thread::sleep_for(kLook);
  }
}

}  // namespace

void InstallInterruptHandlers() {
  struct sigaction action {};
  action.sa_handler = CancelJobOnSignal;
  sigemptyset(&action.sa_mask);
  sigaction(SIGINT, &action, nullptr);
  sigaction(SIGTERM, &action, nullptr);
}

bool Interrupted() { return interrupted; }

LocalService::LocalService() = default;

LocalService::~LocalService() {
  interrupted_client = nullptr;
  {
    const std::lock_guard lock(mutex_);
    end_ = true;
  }
  wake_.notify_all();
  if (watcher_.joinable()) watcher_.join();
  const double deadline = RealClock().SteadySeconds() + kGrace;
  children_.StopAll(kGrace);  // a rollout under way is finished, recorded and handed in
  arm_.StopAll(5.0);
  AwaitOrphans(deadline);
  std::error_code error;
  if (!address_file_.empty()) fs::remove(address_file_, error);
  if (!socket_folder_.empty()) fs::remove_all(socket_folder_, error);
}

Status LocalService::Check() {
  const std::lock_guard lock(mutex_);
  return trouble_;
}

Status LocalService::LookAfterChildren() {
  std::string name;
  const Status ended = children_.Check(&name);
  if (ended.ok()) return arm_.Check();
  if (name.rfind(kWorker, 0) != 0 || started_again_[name] >= kStartAgain) return ended;
  const std::string count = std::to_string(++started_again_[name]) + " of " + std::to_string(kStartAgain);
  if (!quiet_) PrintNote(ended.message() + ": started again, " + count);
  return children_.StartAgain(name);
}

void LocalService::Watch() {
  std::unique_lock lock(mutex_);
  while (!wake_.wait_for(lock, kLook, [this] { return end_; })) {
    lock.unlock();
    const Status looked = LookAfterChildren();
    lock.lock();
    if (looked.ok()) continue;
    trouble_ = looked;
    client_->Cancel();
    return;
  }
}

Status LocalService::StartPrograms(const LocalServiceOptions& options) {
  const auto file = [&](const std::string& name) { return options.folder + "/" + name; };
  RG_RETURN_IF_ERROR(children_.Start("coordinator",
                                     {SiblingProgram("realitygrad-coordinator"), "--listen", address_,
                                      "--uncertain-s", "2", "--db", file("realitygrad.db")},
                                     file("logs/coordinator.log")));
  for (int w = 1; w <= options.workers; ++w) {
    const std::string name = kWorker + std::to_string(w);
    RG_RETURN_IF_ERROR(children_.Start(
        name,
        {SiblingProgram("realitygrad-worker"), "--patience", "30", "--coordinator", address_, "--name", name,
         "--slots", "1", "--drain-timeout", "0.5", "--folder", file("cache/" + name)},
        file("logs/" + name + ".log")));
  }
  std::vector<std::string> agent = {SiblingProgram("realitygrad-agent"),
                                    "--coordinator",
                                    address_,
                                    "--config",
                                    options.agent_config,
                                    "--spool",
                                    file("spool"),
                                    "--folder",
                                    file("cache/agent")};
  // It is simulated, or a stand-in.
  agent.push_back("--arm");
  agent.push_back("--trusted");
  if (options.lock_step) agent.push_back("--lock-step");
  return children_.Start("agent", agent, file("logs/agent.log"));
}

Status LocalService::AwaitWorkers(size_t count) {
  const double deadline = RealClock().SteadySeconds() + 20.0;
  size_t seen = 0;
  while (RealClock().SteadySeconds() < deadline && !interrupted) {
    RG_RETURN_IF_ERROR(Check());
    const auto workers = client_->Workers();
    seen = 0;
    if (workers.ok()) {
      for (const auto& worker : *workers) seen += worker.connected();
      if (seen >= count) return Status::Ok();
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }
  if (interrupted) return CancelledError("interrupted");
  return UnavailableError("only " + std::to_string(seen) + " of " + std::to_string(count) +
                          " programs joined the coordinator within 20 s");
}

Status LocalService::Start(const LocalServiceOptions& options) {
  char folder[] = "/tmp/realitygrad-XXXXXX";
  if (mkdtemp(folder) == nullptr) return InternalError("/tmp: cannot make a folder for the socket");
  socket_folder_ = folder;
  address_ = "ipc://" + socket_folder_ + "/coordinator.sock";
  std::error_code error;
  fs::create_directories(options.folder + "/logs", error);
  if (error) return InternalError(options.folder + "/logs: cannot create: " + error.message());
  quiet_ = options.quiet;
  prctl(PR_SET_CHILD_SUBREAPER, 1);
  if (!options.stand_in.empty())
    RG_RETURN_IF_ERROR(StartRosStandIn({options.folder, options.stand_in, options.seed}, &arm_));
  RG_RETURN_IF_ERROR(StartPrograms(options));
  coordinator::ClientOptions client;
  client.address = address_;
  RG_ASSIGN_OR_RETURN(client_, coordinator::Client::Connect(client));
  interrupted_client = client_.get();
  address_file_ = options.folder + "/address";  // other commands find the coordinator through it
  RG_RETURN_IF_ERROR(WriteFileAtomically(address_file_, address_));
  watcher_ = std::thread([this] { Watch(); });
  return AwaitWorkers(static_cast<size_t>(options.workers) + 1);
}

const pb::TaskOutput* FindOutput(const pb::GetJobReply& job, const std::string& kind) {
  const pb::TaskOutput* found = nullptr;
  for (const pb::TaskInfo& task : job.tasks()) {
    for (const pb::TaskOutput& output : task.outputs()) {
      if (output.kind() == kind) found = &output;
    }
  }
  return found;
}

Result<json> FetchResult(coordinator::Client& client, const pb::GetJobReply& job) {
  const pb::TaskOutput* output = FindOutput(job, jobs::kArtifactResult);
  const pb::TaskOutput* model = FindOutput(job, jobs::kArtifactModel);
  if (output == nullptr || model == nullptr)
    return InternalError("job " + std::to_string(job.job().id()) + " left no result");
  RG_ASSIGN_OR_RETURN(const std::string bytes, client.GetArtifact(output->sha256()));
  json result = json::parse(bytes, nullptr, false);
  if (!result.is_object())
    return DataLossError("the result of job " + std::to_string(job.job().id()) + " is no JSON");
  for (const std::string& stage : jobs::IterationStages())
    result["seconds"][stage] = StageSeconds(job, stage);
  result["seconds"]["iteration"] =
      1e-9 * static_cast<double>(job.job().finished_ns() - job.job().started_ns());
  result["job"] = job.job().id();
  result["model"] = model->sha256();
  return result;
}

Result<pb::GetJobReply> RunJob(coordinator::Client& client, pb::JobSpec job, const std::string& request_id,
                               bool quiet) {
  const int64_t now_ns = RealClock().WallNanos();
  RG_ASSIGN_OR_RETURN(const int64_t id, client.Submit(job, request_id));
  RG_ASSIGN_OR_RETURN(const pb::GetJobReply known, client.GetJob(id, false, false));
  RG_ASSIGN_OR_RETURN(pb::GetJobReply end, FollowJob(client, id, -1, quiet));
  // Known from before: what failed then, or was cut off by the stop (a rollout whose end nobody saw), is
  // tried again once. To go on is the consent that a rollout needs; its recording is used if there is one.
  if (known.job().submitted_ns() < now_ns && end.job().state() == pb::JOB_STATE_FAILED) {
    RG_RETURN_IF_ERROR(client.Act(id, pb::JOB_ACTION_RETRY, "run --resume").status());
    RG_ASSIGN_OR_RETURN(end, FollowJob(client, id, -1, quiet));
  }
  if (end.job().state() == pb::JOB_STATE_CANCELLED)
    return CancelledError("job " + std::to_string(id) + " was cancelled");
  if (end.job().state() != pb::JOB_STATE_SUCCEEDED)
    return AbortedError("job " + std::to_string(id) + " failed: " + end.job().reason());
  return client.GetJob(id, true, false);
}

}  // namespace rg::cli
