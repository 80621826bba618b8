#include "coordinator/client/client.h"

#include <algorithm>
#include <cstdio>
#include <thread>

#include "common/base/hash.h"
#include "common/base/ids.h"
#include "common/transport/request_client.h"
#include "coordinator/client/transfer.h"

namespace rg::coordinator {
namespace {

template <class Repeated>
auto ToVector(const Repeated& items) {
  return std::vector(items.begin(), items.end());
}

bool IsOver(pb::JobState state) {
  return state == pb::JOB_STATE_SUCCEEDED || state == pb::JOB_STATE_FAILED ||
         state == pb::JOB_STATE_CANCELLED;
}

}  // namespace

Client::Client(std::unique_ptr<transport::Context> context,
               std::unique_ptr<transport::RequestClient> requests, const ClientOptions& options)
    : context_(std::move(context)), requests_(std::move(requests)), lease_(options.lease), remark_(options.remark) {}

Client::~Client() = default;

void Client::Cancel() { requests_->Cancel(); }

Result<std::unique_ptr<Client>> Client::Connect(const ClientOptions& options) {
  auto context = std::make_unique<transport::Context>();
  transport::Sender self;
  self.id = options.name + "-" + RandomHex(6);
  self.role = options.read_only ? pb::ROLE_VIEWER : options.role;
  transport::DealerOptions dealer;
  dealer.key = options.key;
  dealer.server_public_key = options.server_public_key;
  dealer.allow_plain_loopback = options.allow_plain_loopback;
  dealer.limits.max_message_bytes = 64u << 20;
  RG_ASSIGN_OR_RETURN(auto socket, transport::ConnectDealer(*context, options.address, dealer));
  transport::RequestOptions request;
  request.connect_timeout_ms = options.connect_timeout_ms;
  request.attempt_timeout_ms = options.attempt_timeout_ms;
  request.attempts = options.attempts;
  auto requests = std::make_unique<transport::RequestClient>(
      std::move(socket), self, "coordinator at " + options.address, RealClock(), request);
  return std::unique_ptr<Client>(new Client(std::move(context), std::move(requests), options));
}

template <class Reply, class Body>
Result<Reply> Client::Call(const Body& body) {
  transport::Message request = transport::MakeRequest(requests_->self(), body);
  request.envelope.set_fencing_token(lease_);
  RG_ASSIGN_OR_RETURN(const transport::Message reply, requests_->Call(std::move(request)));
  return transport::Unpack<Reply>(reply);
}

// --- jobs

Result<int64_t> Client::Submit(const pb::JobSpec& job, std::string request_id) {
  pb::SubmitRequest request;
  request.set_request_id(request_id.empty() ? RandomHex(16) : std::move(request_id));
  *request.mutable_job() = job;
  if (job.submitted_by().empty()) request.mutable_job()->set_submitted_by(remark_);
  RG_ASSIGN_OR_RETURN(const auto reply, Call<pb::SubmitReply>(request));
  return reply.job();
}

Result<pb::SubmitManyReply> Client::SubmitMany(pb::SubmitManyRequest request) {
  constexpr int kMostAtOnce = 2'000;
  constexpr size_t kBytesAtOnce = 8u << 20;
  pb::SubmitManyReply all;
  for (int first = 0; first < request.submits_size();) {
    pb::SubmitManyRequest part;
    size_t bytes = 0;
    for (; first < request.submits_size() && part.submits_size() < kMostAtOnce && bytes < kBytesAtOnce; ++first) {
      pb::SubmitRequest& submit = *request.mutable_submits(first);
      if (submit.request_id().empty()) submit.set_request_id(RandomHex(16));
      if (submit.job().submitted_by().empty()) submit.mutable_job()->set_submitted_by(remark_);
      bytes += submit.ByteSizeLong();
      *part.add_submits() = std::move(submit);
    }
    RG_ASSIGN_OR_RETURN(const auto reply, Call<pb::SubmitManyReply>(part));
    all.MergeFrom(reply);
  }
  return all;
}

Result<std::vector<pb::JobSummary>> Client::ListJobs(const pb::ListJobsRequest& request) {
  RG_ASSIGN_OR_RETURN(const auto reply, ListJobsReply(request));
  return ToVector(reply.jobs());
}

Result<pb::ListJobsReply> Client::ListJobsReply(pb::ListJobsRequest request) {
  if (request.mine()) request.set_by(remark_);
  return Call<pb::ListJobsReply>(request);
}

Result<std::vector<pb::JobSummary>> Client::ListAllJobs(pb::ListJobsRequest request) {
  constexpr uint32_t kPage = 1'000;
  std::vector<pb::JobSummary> all;
  request.set_limit(kPage);
  while (true) {
    RG_ASSIGN_OR_RETURN(const auto reply, ListJobsReply(request));
    all.insert(all.end(), reply.jobs().begin(), reply.jobs().end());
    if (!reply.more() || reply.jobs().empty()) return all;
    request.set_before_id(all.back().id());
  }
}

Result<pb::GetJobReply> Client::GetJob(int64_t id, bool with_tasks, bool with_attempts) {
  pb::GetJobRequest request;
  request.set_job(id);
  request.set_with_tasks(with_tasks);
  request.set_with_attempts(with_attempts);
  RG_ASSIGN_OR_RETURN(pb::GetJobReply all, Call<pb::GetJobReply>(request));
  request.set_job(all.job().id());  // the newest may be another one by now
  while (all.next_task() > 0) {
    request.set_first_task(all.next_task());
    RG_ASSIGN_OR_RETURN(pb::GetJobReply page, Call<pb::GetJobReply>(request));
    for (pb::TaskInfo& task : *page.mutable_tasks()) *all.add_tasks() = std::move(task);
    all.set_next_task(page.next_task());
  }
  return all;
}

Result<pb::GetJobReply> Client::WatchJob(int64_t id, uint64_t after_revision, uint32_t wait_ms,
                                         bool with_tasks) {
  pb::GetJobRequest request;
  request.set_job(id);
  request.set_after_revision(after_revision);
  request.set_wait_ms(wait_ms);
  request.set_with_tasks(with_tasks);
  return Call<pb::GetJobReply>(request);
}

Result<pb::GetJobReply> Client::WaitForJob(int64_t id, double timeout_s,
                                           const std::function<void(const pb::GetJobReply&)>& on_change,
                                           double patience_s) {
  constexpr double kWaitSeconds = 2.0;
  const Clock& clock = RealClock();
  const double begin = clock.SteadySeconds();
  double last_answer = begin;
  uint64_t revision = 0;
  while (true) {
    const double left = timeout_s < 0.0 ? kWaitSeconds : timeout_s - (clock.SteadySeconds() - begin);
    const auto wait_ms = static_cast<uint32_t>(1000.0 * std::clamp(left, 0.0, kWaitSeconds));
    auto reply = WatchJob(id, revision, wait_ms);
    if (reply.ok()) {
      last_answer = clock.SteadySeconds();
      if (on_change && (reply->job().revision() != revision || revision == 0)) on_change(*reply);
      revision = reply->job().revision();
      if (IsOver(reply->job().state())) return reply;
    } else if (reply.status().code() != StatusCode::kUnavailable ||
               clock.SteadySeconds() - last_answer > patience_s) {
      return reply;
    } else {
      revision = 0;  // a restarted coordinator counts anew
      std::this_thread::sleep_for(std::chrono::milliseconds(200));
    }
    if (left <= 0.0) {
      char seconds[32];
      std::snprintf(seconds, sizeof seconds, "%g s", timeout_s);
      return DeadlineExceededError("job " + std::to_string(id) + " was not over after " + seconds);
    }
  }
}

pb::JobActionRequest Client::Action(int64_t id, pb::JobAction action, const std::string& reason) const {
  pb::JobActionRequest request;
  request.set_job(id);
  request.set_action(action);
  request.set_reason(reason);
  request.set_by(remark_);
  return request;
}

Result<pb::JobSummary> Client::Act(int64_t id, pb::JobAction action, const std::string& reason) {
  RG_ASSIGN_OR_RETURN(const auto reply, Call<pb::JobActionReply>(Action(id, action, reason)));
  return reply.job();
}

Result<pb::ManyJobActionsReply> Client::ActOnMany(const std::vector<int64_t>& ids, pb::JobAction action,
                                                  const std::string& reason) {
  constexpr size_t kAtOnce = 10'000;
  pb::ManyJobActionsReply all;
  for (size_t first = 0; first < ids.size(); first += kAtOnce) {
    pb::ManyJobActionsRequest request;
    for (size_t i = first; i < std::min(ids.size(), first + kAtOnce); ++i)
      *request.add_actions() = Action(ids[i], action, reason);
    RG_ASSIGN_OR_RETURN(const auto reply, Call<pb::ManyJobActionsReply>(request));
    all.MergeFrom(reply);
  }
  return all;
}

Result<pb::JobSummary> Client::SetPriority(int64_t id, int32_t priority) {
  pb::JobActionRequest request = Action(id, pb::JOB_ACTION_PRIORITY, "");
  request.set_priority(priority);
  RG_ASSIGN_OR_RETURN(const auto reply, Call<pb::JobActionReply>(request));
  return reply.job();
}

Result<pb::GetLogsReply> Client::Logs(int64_t job, const std::string& task, uint64_t after_sequence,
                                      uint32_t limit) {
  pb::GetLogsRequest request;
  request.set_job(job);
  request.set_task(task);
  request.set_after_sequence(after_sequence);
  request.set_limit(limit);
  return Call<pb::GetLogsReply>(request);
}

Result<pb::ExplainReply> Client::Explain(int64_t job, const std::string& task) {
  pb::ExplainRequest request;
  request.set_job(job);
  request.set_task(task);
  return Call<pb::ExplainReply>(request);
}

Result<std::vector<pb::EventRecord>> Client::Events(int64_t job, int64_t after_id, uint32_t limit) {
  pb::ListEventsRequest request;
  request.set_job(job);
  request.set_after_id(after_id);
  request.set_limit(limit);
  RG_ASSIGN_OR_RETURN(const auto reply, Call<pb::ListEventsReply>(request));
  return ToVector(reply.events());
}

Result<pb::BackupReply> Client::Backup(const std::string& name) {
  pb::BackupRequest request;
  request.set_name(name);
  return Call<pb::BackupReply>(request);
}

// --- workers, coordinator

Result<std::vector<pb::WorkerInfo>> Client::Workers() {
  RG_ASSIGN_OR_RETURN(const auto reply, Call<pb::ListWorkersReply>(pb::ListWorkersRequest()));
  return ToVector(reply.workers());
}

Status Client::DrainWorker(const std::string& name, const std::string& reason) {
  pb::DrainWorkerRequest request;
  request.set_worker(name);
  request.set_reason(reason);
  return Call<pb::DrainWorkerReply>(request).status();
}

Status Client::HoldRobot(const std::string& robot, const std::string& reason, bool release) {
  pb::HoldRobotRequest request;
  request.set_robot(robot);
  request.set_reason(reason);
  request.set_release(release);
  request.set_by(remark_);
  return Call<pb::HoldRobotReply>(request).status();
}

Result<pb::StatusReply> Client::CoordinatorStatus() { return Call<pb::StatusReply>(pb::StatusRequest()); }

// --- artefacts

Result<std::vector<pb::ArtifactInfo>> Client::ListArtifacts(const std::string& kind, int64_t job,
                                                            uint32_t limit) {
  pb::ListArtifactsRequest request;
  request.set_kind(kind);
  if (job > 0) request.set_job_id(std::to_string(job));
  std::vector<pb::ArtifactInfo> all;
  while (true) {
    request.set_limit(limit == 0 ? 0 : limit - static_cast<uint32_t>(all.size()));
    RG_ASSIGN_OR_RETURN(const auto reply, Call<pb::ListArtifactsReply>(request));
    all.insert(all.end(), reply.artifacts().begin(), reply.artifacts().end());
    if (!reply.more() || reply.artifacts().empty() || all.size() == limit) return all;
    request.set_before_sha256(all.back().sha256());
  }
}

Result<pb::ArtifactInfo> Client::ShowArtifact(const std::string& sha256_or_prefix) {
  pb::ShowArtifactRequest request;
  request.set_sha256(sha256_or_prefix);
  RG_ASSIGN_OR_RETURN(const auto reply, Call<pb::ShowArtifactReply>(request));
  return reply.info();
}

Result<std::string> Client::GetArtifact(const std::string& sha256) {
  return FetchArtifact(*requests_, sha256);
}

Result<std::string> Client::PutArtifact(std::string_view bytes, pb::ArtifactInfo info) {
  info.set_sha256(Sha256Hex(bytes));
  info.set_size_bytes(bytes.size());
  RG_RETURN_IF_ERROR(UploadArtifact(*requests_, bytes, info));
  return info.sha256();
}

Result<uint64_t> Client::GetArtifactFile(const std::string& sha256, const std::string& path) {
  return FetchArtifactToFile(*requests_, sha256, path);
}

Result<std::string> Client::PutArtifactFile(const std::string& path, pb::ArtifactInfo info) {
  uint64_t size = 0;
  RG_ASSIGN_OR_RETURN(const std::string sha256, Sha256OfFile(path, &size));
  info.set_sha256(sha256);
  info.set_size_bytes(size);
  RG_RETURN_IF_ERROR(UploadArtifactFile(*requests_, path, info));
  return sha256;
}

Result<pb::ArtifactLineageReply> Client::Lineage(const std::string& sha256, bool ancestors,
                                                 bool descendants) {
  pb::ArtifactLineageRequest request;
  request.set_sha256(sha256);
  request.set_ancestors(ancestors);
  request.set_descendants(descendants);
  return Call<pb::ArtifactLineageReply>(request);
}

Result<pb::VerifyArtifactsReply> Client::VerifyArtifacts(const std::vector<std::string>& sha256s) {
  pb::VerifyArtifactsRequest request;
  for (const std::string& sha256 : sha256s) request.add_sha256(sha256);
  return Call<pb::VerifyArtifactsReply>(request);
}

Result<pb::GcArtifactsReply> Client::CollectGarbage(int64_t older_than_ns, bool dry_run,
                                                    int64_t forget_ended_ns) {
  pb::GcArtifactsRequest request;
  request.set_older_than_ns(older_than_ns);
  request.set_dry_run(dry_run);
  request.set_forget_ended_ns(forget_ended_ns);
  pb::GcArtifactsReply all;
  while (true) {
    RG_ASSIGN_OR_RETURN(pb::GcArtifactsReply part, Call<pb::GcArtifactsReply>(request));
    for (pb::ArtifactInfo& info : *part.mutable_removed()) *all.add_removed() = std::move(info);
    all.set_bytes(all.bytes() + part.bytes());
    all.set_more(part.more());
    if (dry_run || !part.more()) return all;
  }
}

Result<pb::ArchiveJobsReply> Client::ArchiveJobs(int64_t older_than_ns, bool dry_run) {
  pb::ArchiveJobsRequest request;
  request.set_older_than_ns(older_than_ns);
  request.set_dry_run(dry_run);
  pb::ArchiveJobsReply all;
  while (true) {
    RG_ASSIGN_OR_RETURN(const auto part, Call<pb::ArchiveJobsReply>(request));
    all.mutable_jobs()->MergeFrom(part.jobs());
    all.set_tasks(all.tasks() + part.tasks());
    all.set_more(part.more());
    if (dry_run || !part.more()) return all;
  }
}

Status Client::Pin(const std::string& sha256, const std::string& owner, bool unpin) {
  pb::PinArtifactRequest request;
  request.set_sha256(sha256);
  request.set_owner(owner);
  request.set_unpin(unpin);
  return Call<pb::PinArtifactReply>(request).status();
}

// --- parameter history

Result<std::vector<std::string>> Client::Robots() {
  RG_ASSIGN_OR_RETURN(const auto reply, Call<pb::ListRobotsReply>(pb::ListRobotsRequest()));
  return ToVector(reply.robots());
}

Result<std::vector<pb::ParameterVersion>> Client::ParameterHistory(const std::string& robot, uint32_t limit) {
  pb::ParameterHistoryRequest request;
  request.set_robot(robot);
  request.set_limit(limit);
  RG_ASSIGN_OR_RETURN(const auto reply, Call<pb::ParameterHistoryReply>(request));
  return ToVector(reply.versions());
}

Result<pb::ParameterVersion> Client::Parameters(const std::string& robot, uint32_t version) {
  pb::ShowParametersRequest request;
  request.set_robot(robot);
  request.set_version(version);
  RG_ASSIGN_OR_RETURN(const auto reply, Call<pb::ShowParametersReply>(request));
  return reply.version();
}

Result<pb::ParameterHistoryReply> Client::ParameterHistoryAndCurrent(const std::string& robot,
                                                                     uint32_t limit) {
  pb::ParameterHistoryRequest request;
  request.set_robot(robot);
  request.set_limit(limit);
  return Call<pb::ParameterHistoryReply>(request);
}

Result<pb::ParameterVersion> Client::CurrentParameters(const std::string& robot) {
  pb::ShowParametersRequest request;
  request.set_robot(robot);
  request.set_current(true);
  RG_ASSIGN_OR_RETURN(const auto reply, Call<pb::ShowParametersReply>(request));
  return reply.version();
}

Result<uint32_t> Client::PromoteParameters(const std::string& robot, uint32_t version) {
  pb::PromoteParametersRequest request;
  request.set_robot(robot);
  request.set_by(remark_);
  request.set_version(version);
  RG_ASSIGN_OR_RETURN(const auto reply, Call<pb::PromoteParametersReply>(request));
  return reply.current();
}

Result<pb::DiffParametersReply> Client::DiffParameters(const std::string& robot, uint32_t from, uint32_t to) {
  pb::DiffParametersRequest request;
  request.set_robot(robot);
  request.set_from_version(from);
  request.set_to_version(to);
  return Call<pb::DiffParametersReply>(request);
}

int ExitCodeOf(pb::JobState state) {
  switch (state) {
    case pb::JOB_STATE_SUCCEEDED:
      return 0;
    case pb::JOB_STATE_FAILED:
      return 3;
    case pb::JOB_STATE_CANCELLED:
      return 4;
    default:
      return 1;
  }
}

int ExitCodeOf(const Status& status) {
  switch (status.code()) {
    case StatusCode::kOk:
      return 0;
    case StatusCode::kInvalid:
      return 2;
    case StatusCode::kCancelled:
      return 4;
    case StatusCode::kDeadlineExceeded:
      return 5;
    case StatusCode::kUnavailable:
      return 6;
    default:
      return 1;
  }
}

}  // namespace rg::coordinator
