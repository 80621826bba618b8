// How everything that is not a worker speaks with a coordinator: command line, web page, tests.
//
//   auto client = Client::Connect({.address = "tcp://127.0.0.1:7341"});
//   auto job = client->Submit(spec);
//   auto end = client->WaitForJob(*job, timeout_s, [](const pb::GetJobReply& now) { … });
//
// Blocking, one call at a time, one thread. Every call may be repeated; the client repeats by itself
// when no answer comes. Errors: kUnavailable (coordinator unreachable: exit code 6), kNotFound,
// kInvalid, kFailedPrecondition, kPermissionDenied, kDeadlineExceeded, kCancelled.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.h"
#include "common/transport/zmq_socket.h"
#include "realitygrad/v1/artifact.pb.h"
#include "realitygrad/v1/control.pb.h"
#include "realitygrad/v1/job.pb.h"
#include "realitygrad/v1/parameters.pb.h"

namespace rg::transport {
class RequestClient;
}

namespace rg::coordinator {

namespace pb = realitygrad::v1;

struct ClientOptions {
  std::string address;                    // tcp://host:port, ipc://path
  std::optional<transport::KeyPair> key;  // CURVE, with
  std::string server_public_key;          // the coordinator's, Z85
  bool allow_plain_loopback = true;
  bool read_only = false;             // claims the role viewer instead of `role`
  pb::Role role = pb::ROLE_OPERATOR;  // with a key: must be the key's (NamedKey::role)
  std::string name = "client";
  std::string remark;  // user@host, for events and listings: without keys the only name there is
  uint64_t lease = 0;  // the fencing token of the task that speaks, with role worker or agent
  int64_t connect_timeout_ms = 5'000;
  int64_t attempt_timeout_ms = 10'000;
  int attempts = 3;
};

class Client {
 public:
  // Returns at once; that nobody is there shows in the first call.
  static Result<std::unique_ptr<Client>> Connect(const ClientOptions& options);
  ~Client();

  // From any thread or a signal handler: the call under way and all later ones return kCancelled.
  void Cancel();

  // --- jobs
  // Durable when it returns. The same request id always gives the same job; empty: a random one.
  Result<int64_t> Submit(const pb::JobSpec& job, std::string request_id = {});
  // Many in as few transactions as their sizes allow; one answer each, as Submit would give it.
  Result<pb::SubmitManyReply> SubmitMany(pb::SubmitManyRequest request);
  Result<std::vector<pb::JobSummary>> ListJobs(const pb::ListJobsRequest& request = {});
  // The same, with whether there are more, and by which name the coordinator knows who asks.
  Result<pb::ListJobsReply> ListJobsReply(pb::ListJobsRequest request = {});
  // Page after page, all that match; request.limit counts for nothing.
  Result<std::vector<pb::JobSummary>> ListAllJobs(pb::ListJobsRequest request = {});
  // id 0: the newest job. Fetched in pages, given as one.
  Result<pb::GetJobReply> GetJob(int64_t id, bool with_tasks = true, bool with_attempts = false);
  // Answers when the job changed since `after_revision`, or after `wait_ms`.
  Result<pb::GetJobReply> WatchJob(int64_t id, uint64_t after_revision, uint32_t wait_ms,
                                   bool with_tasks = false);
  // Until the job is over. timeout_s < 0: for ever; else kDeadlineExceeded. Survives a restart of the
  // coordinator for as long as `patience_s`.
  Result<pb::GetJobReply> WaitForJob(int64_t id, double timeout_s = -1.0,
                                     const std::function<void(const pb::GetJobReply&)>& on_change = {},
                                     double patience_s = 60.0);
  Result<pb::JobSummary> Act(int64_t id, pb::JobAction action, const std::string& reason = {});
  // Of all of them in one transaction; errors and jobs are those of the reply, one per id.
  Result<pb::ManyJobActionsReply> ActOnMany(const std::vector<int64_t>& ids, pb::JobAction action,
                                            const std::string& reason = {});
  Result<pb::JobSummary> SetPriority(int64_t id, int32_t priority);
  Result<pb::GetLogsReply> Logs(int64_t job, const std::string& task = {}, uint64_t after_sequence = 0,
                                uint32_t limit = 0);
  // Why does this job, or this task of it, wait?
  Result<pb::ExplainReply> Explain(int64_t job, const std::string& task = {});
  Result<std::vector<pb::EventRecord>> Events(int64_t job = 0, int64_t after_id = 0, uint32_t limit = 0);

  // Jobs that ended longer ago out of the way, in several calls (control.proto).
  Result<pb::ArchiveJobsReply> ArchiveJobs(int64_t older_than_ns, bool dry_run);

  // A copy of the database under this name beside it, made while it is in use.
  Result<pb::BackupReply> Backup(const std::string& name);

  // --- workers, coordinator
  Result<std::vector<pb::WorkerInfo>> Workers();
  Status DrainWorker(const std::string& name, const std::string& reason = {});
  // Nothing moves it until it is released.
  Status HoldRobot(const std::string& robot, const std::string& reason, bool release = false);
  Result<pb::StatusReply> CoordinatorStatus();

  // --- artefacts
  Result<std::vector<pb::ArtifactInfo>> ListArtifacts(const std::string& kind = {}, int64_t job = 0,
                                                      uint32_t limit = 0);
  Result<pb::ArtifactInfo> ShowArtifact(const std::string& sha256_or_prefix);
  // All bytes, checked against the hash.
  Result<std::string> GetArtifact(const std::string& sha256);
  // Kind and metadata from `info`; returns the hash. In pieces; a repeat is harmless.
  Result<std::string> PutArtifact(std::string_view bytes, pb::ArtifactInfo info);
  // The same between the store and a file, a piece at a time in memory; a repeat after a kill of either side
  // goes on where that was (coordinator/client/transfer.h).
  Result<uint64_t> GetArtifactFile(const std::string& sha256, const std::string& path);
  Result<std::string> PutArtifactFile(const std::string& path, pb::ArtifactInfo info);
  Result<pb::ArtifactLineageReply> Lineage(const std::string& sha256, bool ancestors = true,
                                           bool descendants = false);
  Result<pb::VerifyArtifactsReply> VerifyArtifacts(const std::vector<std::string>& sha256s = {});
  // What nothing refers to, in several calls. `forget_ended_ns`: jobs that ended longer ago no longer keep
  // what they refer to; 0: every job does.
  Result<pb::GcArtifactsReply> CollectGarbage(int64_t older_than_ns, bool dry_run,
                                              int64_t forget_ended_ns = 0);
  Status Pin(const std::string& sha256, const std::string& owner, bool unpin = false);

  // --- parameter history
  Result<std::vector<std::string>> Robots();
  Result<std::vector<pb::ParameterVersion>> ParameterHistory(const std::string& robot, uint32_t limit = 0);
  // The same, and which version is current.
  Result<pb::ParameterHistoryReply> ParameterHistoryAndCurrent(const std::string& robot, uint32_t limit = 0);
  // What `--model latest` means: the promoted version, else the latest that is not held back.
  Result<pb::ParameterVersion> CurrentParameters(const std::string& robot);
  // Returns the version that is current then (0: none is). `version` 0: the latest that is not held back, also of
  // those to come.
  Result<uint32_t> PromoteParameters(const std::string& robot, uint32_t version);
  Result<pb::ParameterVersion> Parameters(const std::string& robot, uint32_t version = 0);
  Result<pb::DiffParametersReply> DiffParameters(const std::string& robot, uint32_t from, uint32_t to = 0);

 private:
  Client(std::unique_ptr<transport::Context> context, std::unique_ptr<transport::RequestClient> requests,
         const ClientOptions& options);
  pb::JobActionRequest Action(int64_t id, pb::JobAction action, const std::string& reason) const;
  template <class Reply, class Body>
  Result<Reply> Call(const Body& body);

  std::unique_ptr<transport::Context> context_;
  std::unique_ptr<transport::RequestClient> requests_;
  uint64_t lease_;
  std::string remark_;
};

// The exit code of SERVICE.md for a job that is over: 0 succeeded, 3 failed, 4 cancelled; 1 otherwise.
int ExitCodeOf(pb::JobState state);
// The exit code for an error of a client call: 6 unreachable, 5 wait timed out, 4 cancelled, 2 invalid,
// else 1.
int ExitCodeOf(const Status& status);

}  // namespace rg::coordinator
