// The coordinator's shell. One thread receives a batch of messages, lets the core handle each, writes
// all that follows in one transaction, and only then sends: what anybody can see is durable.
//
// A full disk: the batch that could not be kept is as if it had never come, and whoever sent a part of it is
// told so. The state is read back, workers and leases stay. Until something can be written again, which is
// tried now and then, reads are answered, submits and other changes are refused ("disk full"), and workers
// keep their results. What ends work or frees space is done all the same, from a reserve (disk_reserve.h). Any other failure of a commit (an fsync that fails may have lost what came before),
// or a state that cannot be read back, ends it: RunOnce says why.
//
// What only reads artefacts goes on in threads of its own (read_desk.h). After a stall of this thread, or of
// the whole process, leases are judged only when what waits in the queue was read, and workers had the time
// to speak.
#pragma once

#include <atomic>
#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <unordered_map>
#include <vector>

#include "common/base/clock.h"
#include "common/base/status.h"
#include "common/store/artifact_store.h"
#include "common/store/database.h"
#include "common/store/parameter_store.h"
#include "common/transport/keys.h"
#include "common/transport/socket.h"
#include "coordinator/core/reactor.h"
#include "coordinator/server/artifact_desk.h"
#include "coordinator/server/disk_reserve.h"
#include "coordinator/server/policy.h"
#include "coordinator/server/read_desk.h"
#include "coordinator/server/worker_desk.h"
#include "coordinator/store/job_store.h"
#include "realitygrad/v1/control.pb.h"

namespace rg::coordinator {

struct ServerOptions {
  std::string database_path;
  Options core;
  std::string version = "0.1.0";
  size_t max_batch_messages = 1024;
  size_t max_batch_bytes = 32u << 20;
  uint64_t inline_limit = 256u << 10;  // outputs up to this travel inside TaskFinished
  size_t max_log_line_bytes = 8u << 10;
  size_t max_reply_bytes = 48u << 20;  // a larger one is refused in its place; clients take 64 MiB
  size_t page_bytes = 8u << 20;        // about as much of a long list is in one reply
  Policy policy;
  // Jobs that ended longer ago are archived by themselves; 0: none is.
  int64_t archive_after_ns = int64_t{30} * 86'400 * 1'000'000'000;
  // And the oldest of those that are over, while more tasks of such jobs than this are not archived; 0: any
  // number may be.
  int64_t archive_above_tasks = 2'000'000;
  double check_s = 1.0;  // for a look at the database's pages before anything else
  std::function<void(const pb::JobSummary&)> on_job_end;  // of a client's job, when that is durable; may be none
  std::function<void()> before_messages;  // called when something has come, before it is looked at; may be none
  int64_t reserve_bytes = 16 << 20;  // of its disk, for what ends work or frees space when that is full
  std::string vfs;  // of the database: the seam for fault tests
};

class Server {
 public:
  // Opens, migrates and checks the database (kDataLoss: it is damaged), loads the state. `socket` is a router; `clock` must outlive it.
  static Result<std::unique_ptr<Server>> Open(const ServerOptions& options,
                                              std::unique_ptr<transport::Socket> socket,
                                              transport::Sender self, const Clock* clock);
  ~Server();

  // One batch: waits at most `timeout_ms` for the first message; `wake_fd` (an eventfd, or -1)
  // interrupts the waiting, and is written when the server itself has something to do. An error: the
  // process must end; nothing that was acknowledged is lost.
  Status RunOnce(int64_t timeout_ms, int wake_fd = -1);
  // Who may connect, whenever that changes: the sessions of those who may no longer are over.
  void SetAllowedKeys(const transport::AllowList& allowed);
  // Before a clean stop: writes what waits for the next transaction.
  void Finish();

  const State& state() const { return state_; }
  transport::Socket& socket() { return *socket_; }
  // For fault tests.
  store::Database& database() { return *database_; }

 private:
  struct Watcher {
    transport::Message request;
    pb::GetJobRequest body;
    int64_t earliest_ns;  // so that a busy job does not answer with every step
    int64_t deadline_ns;
  };
  struct Peer {
    std::string routing_id;
    std::string key_name;  // of the key it came with
    pb::Role role = pb::ROLE_UNSPECIFIED;
    int64_t last_seen_ns = 0;
  };
  struct Many {  // a request for many changes, answered when the last of them is
    transport::Message request;
    pb::SubmitManyReply submits;
    pb::ManyJobActionsReply actions;
    int left = 0;
  };
  struct PendingReply {  // of a request whose answer the core gives
    transport::Message request;  // none of its own if it is one of many
    enum class Asked { kAction, kSubmit, kDrain, kHold } asked = Asked::kAction;
    std::shared_ptr<Many> many = {};
    int index = 0;  // among them
  };

  Server(const ServerOptions& options, std::unique_ptr<transport::Socket> socket, transport::Sender self,
         const Clock* clock);
  Status OpenStores();
  Status LoadState();

  Now now() const { return {clock_->SteadyNanos(), clock_->WallNanos()}; }
  // --- one batch
  void NoteStall(int64_t waited_ms);
  void ReceiveBatch();
  void Handle(transport::Message message);
  Status CommitBatch();
  // Ok: it goes on, as far as a full disk lets it.
  Status DiscardBatch(const Status& why);
  // Of what was counted in the batch that came to nothing: it will be counted again.
  void UncountBatch(const std::vector<Row>& undone);
  void RefuseBatch(const Status& why);
  void SendBatch();
  void TellEnds();
  void SendReply(transport::Message message);
  void TickIfDue();
  bool MayJudge(int64_t steady_ns) const;
  void TryToRecover();
  // Whether the request is one that is done on a full disk too, which has room for it now.
  bool MayFreeSpace(const transport::Message& message);
  void ReleaseSpace();
  void ForgetSilentPeers(int64_t steady_ns);
  // --- what is over (retention.cc)
  // The job in memory, from its rows if it is over; with its tasks or without. kNotFound.
  Result<Job*> BringBack(JobId id, bool with_tasks);
  void RetireEnded();
  void ArchiveIfDue(int64_t steady_ns);
  Status Apart(const std::function<Status()>& body);
  void HandleArchive(const transport::Message& message);
  Result<pb::ArchiveJobsReply> ArchiveSome(const pb::ArchiveJobsRequest& request);
  bool NeedsCommit() const;
  Status Trouble() const { return ResourceExhaustedError(trouble_); }
  Status EnsureTransaction();
  // --- workers
  void HandleWorker(const transport::Message& message);
  // The message's body if its sender may speak for the instance it names.
  std::optional<pb::WorkerMessage> AdmitWorker(const transport::Message& message);
  void HandleHello(const pb::WorkerMessage& body, const transport::Message& message);
  void TellDatabase(const std::string& instance);
  void PutOff(const pb::WorkerMessage& body, const std::string& instance);
  void RefuseJoining(const std::string& instance, const std::string& why);
  void HandleFinished(const pb::TaskFinished& finished, const std::string& instance);
  void HandleLog(const pb::TaskLogReport& report, const std::string& instance);
  void HandleCheckpoint(const pb::TaskCheckpointReport& report, const std::string& instance);
  void FlushLogs();
  void SendToWorker(const std::string& instance, const pb::CoordinatorMessage& message);
  void Translate(const Welcome& m);
  void Translate(const RefuseWorker& m) { RefuseJoining(m.instance, m.reason); }
  void Translate(const Assign& m);
  void Translate(const GrantStart& m);
  void Translate(const Revoke& m);
  void Translate(const AnswerResult& m);
  void Translate(const AnswerBeat& m);
  void Translate(const TellDrain& m);
  void Translate(const AnswerClient& m);
  // --- clients (server_queries.cc, server_changes.cc)
  void HandleRequest(transport::Message message);
  // Refused: who was is an event, if a right was missing.
  void Refuse(const transport::Message& message, const Status& why);
  void HandleSubmit(const transport::Message& message);
  void HandleManySubmits(const transport::Message& message);
  Result<Submit> ToSubmit(const transport::Message& message, pb::SubmitRequest* body);
  Status CompileInto(const pb::JobSpec& job, TaskId parent, Submit* event);
  // The task under whose lease a worker asks for a change; 0: a client asks.
  Result<TaskId> TaskAsking(const transport::Message& message) const;
  Result<JobId> FindUnmet(const JobPlan& plan);
  std::string KindOf(TaskId task) const;  // empty: of no task
  void HandleAction(const transport::Message& message);
  void HandleManyActions(const transport::Message& message);
  Result<CommandJob> ToCommand(const transport::Message& message, const pb::JobActionRequest& body);
  void AnswerOneOf(Many& many, int index, bool is_submit, const AnswerClient& answer);
  void HandleDrain(const transport::Message& message);
  void HandleHold(const transport::Message& message);
  void HandleWrite(const transport::Message& message);
  void NotePromotion(const transport::Message& message);
  // The job that is meant (0: the newest that a client submitted), in memory or not. kNotFound: none yet.
  Result<JobId> MeantJob(JobId id) const;
  // Puts it into a request of this type. False: it was answered with an error.
  template <class Body>
  bool NameTheJob(transport::Message& message);
  bool IsOfThePast(const transport::Message& message) const;
  // True: a thread answers it.
  bool LeaveToReaders(transport::Message& message);
  void TakeReaderAnswers();
  transport::Message AnswerQuery(const transport::Message& message);
  Result<pb::ListJobsReply> ListJobs(const pb::ListJobsRequest& request, const transport::Credentials& who);
  Result<pb::GetJobReply> GetJob(const pb::GetJobRequest& request);
  const pb::GetJobReply& OverviewOf(const Job& job);
  // With why it waits, if a worker has said so.
  pb::JobSummary LiveSummary(const Job& job, double weight_under_way) const;
  Result<pb::ListWorkersReply> ListWorkers(const pb::ListWorkersRequest& request);
  Result<pb::ExplainReply> ExplainTask(const pb::ExplainRequest& request);
  Result<pb::StatusReply> DescribeSelf(const pb::StatusRequest& request);
  void AnswerWatchers();
  pb::JobSummary Summary(JobId id);
  void Reply(transport::Message reply) { outbox_.push_back(std::move(reply)); }

  ServerOptions options_;
  std::unique_ptr<transport::Socket> socket_;
  transport::Sender self_;
  const Clock* clock_;
  std::unique_ptr<store::Database> database_;
  std::unique_ptr<store::ArtifactStore> artifacts_;
  std::unique_ptr<store::ParameterStore> parameters_;
  std::unique_ptr<JobStore> jobs_;
  std::unique_ptr<ArtifactDesk> artifact_desk_;
  std::unique_ptr<WorkerDesk> worker_desk_;
  std::unique_ptr<ReadDesk> short_reads_, long_reads_;  // none for a database in memory
  State state_;
  int64_t started_ns_ = 0;

  // Of the batch under way:
  Actions actions_;
  ResultsByToken results_;
  std::vector<transport::Message> queries_;  // answered after the commit
  std::vector<transport::Message> outbox_;
  std::map<JobId, pb::GetJobReply> overviews_;
  std::vector<transport::Message> promises_;  // replies that may leave only when the batch is durable
  std::optional<store::Transaction> transaction_;
  Status poison_;  // not Ok: a write of this batch failed outside a result
  bool space_was_freed_ = false;

  // While the disk is full:
  std::string trouble_;  // "disk full: …"; empty: all is well
  std::optional<DiskReserve> reserve_;
  bool frees_space_ = false;  // from the reserve, in this batch
  int64_t next_try_ns_ = 0, try_interval_ns_ = 0, well_since_ns_ = 0;

  std::vector<Event> deferred_;  // found out while sending; handled with the next batch
  std::vector<LogRow> logs_;     // not written yet
  int64_t logs_due_ns_ = 0, tick_due_ns_ = 0, peers_due_ns_ = 0;
  int64_t last_turn_ns_ = 0;         // steady time of the last batch
  int64_t judge_after_ns_ = 0;       // leases are not judged before
  int64_t last_grace_ns_ = -1;       // when a stall last gave the workers time; -1: never
  int64_t undrained_since_ns_ = -1;  // the socket has had more than was read since; -1: it has not
  bool freed_pages_wait_ = false;    // the file can be made shorter
  int64_t archive_due_ns_ = 0;
  std::atomic<int> wake_fd_ = -1;
  std::unordered_map<std::string, Peer> peer_by_instance_;
  std::map<ReplyTo, PendingReply> pending_;
  std::map<std::string, int64_t> refusal_noted_ns_;  // by key
  ReplyTo last_reply_ = 0;
  std::vector<Watcher> watchers_;
  Counters durable_counters_;  // as of the last commit
  uint64_t batches_ = 0, commits_ = 0, failed_commits_ = 0, ignored_messages_ = 0, log_lines_dropped_ = 0,
           stalls_ = 0;
};

}  // namespace rg::coordinator
