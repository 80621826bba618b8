// The worker: joins a coordinator, keeps leases alive, fetches inputs, has executor children run the
// tasks, brings results home. One thread (the process's main thread); transfers run beside it.
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "common/base/clock.h"
#include "common/base/status.h"
#include "common/transport/zmq_socket.h"
#include "realitygrad/v1/worker.pb.h"
#include "worker/artifact_cache.h"
#include "worker/executor.h"
#include "worker/scratch_space.h"
#include "worker/transfers.h"

namespace rg::worker {

struct WorkerOptions {
  std::string coordinator;  // endpoint
  std::string name;         // unique among the workers; empty: host and process
  uint32_t slots = 0;       // 0: one per core
  std::vector<std::string> tags;
  std::vector<std::string> kinds;
  std::string folder;  // cache and scratch; empty: ~/.cache/realitygrad/worker
  uint64_t cache_bytes = uint64_t{8} << 30;
  double drain_timeout_s = 0.0;  // on SIGTERM, for what runs; 0: as long as it takes
  double cancel_grace_s = 5.0;   // for a cancelled task to return before its executor is killed
  std::map<std::string, double, std::less<>> least_grace_s;  // of kinds that need more, whatever is asked for
  double patience_s = 0.0;       // without a coordinator for that long it gives up; 0: never
  double idle_exit_s = 0.0;      // leaves when it had nothing to do for that long; 0: never
  double executor_rest_s = 1.0;  // after one that did not come up; doubles each time, 64 times as long at the most
  bool is_agent = false;         // speaks as the agent beside a robot
  std::function<std::string()> waits_for;  // why nothing may begin here now, asked often; empty: it may. May be none
  std::optional<transport::KeyPair> key;
  std::string server_public_key;
  std::string version = "0.1.0";
  std::vector<std::string> executor_arguments;  // argv of this program, to start it again as executor
};

class Worker {
 public:
  static Result<std::unique_ptr<Worker>> Open(WorkerOptions options, const Clock* clock);
  ~Worker();

  // Until it has drained, may not join, has lost patience, or can start no executor again and again. What runs
  // at most once and has begun is never broken off by any of the latter three: it goes on to its end. `signal_fd` (an
  // eventfd) is written once per SIGTERM or SIGINT: the first drains, the second stops at once.
  Status Run(int signal_fd);

 private:
  enum class Stage { kFetching, kAwaitingGrant, kQueued, kRunning, kUploading, kReporting };
  // A lease at hand, from its assignment to the acknowledged result.
  struct Held {
    realitygrad::v1::TaskAssignment assignment;
    Stage stage = Stage::kFetching;
    bool revoked = false, timed_out = false;
    int open_transfers = 0;
    std::vector<std::string> input_paths;
    Executor* executor = nullptr;
    int64_t queued_ns = 0;     // since when it waits for a slot; 0: it does not
    int64_t deadline_ns = 0;   // of the run; 0: none
    int64_t kill_at_ns = 0;    // after a cancel; 0: not cancelled
    int64_t next_send_ns = 0;  // start request or result, again until answered
    std::string scratch;
    realitygrad::v1::ExecutorFinished finished;
    realitygrad::v1::WorkerMessage report;
  };
  using HeldMap = std::map<uint64_t, Held>;

  Worker(WorkerOptions options, const Clock* clock, std::string instance, ArtifactCache cache,
         ScratchSpace scratch);
  Status Connect();
  Result<std::unique_ptr<transport::RequestClient>> ConnectForTransfers(int thread);
  int64_t now() const { return clock_->SteadyNanos(); }

  // --- the loop
  void WaitForSomething(int signal_fd);
  void ReadSignal(int signal_fd);
  bool MustStop();
  Status WhyLeave();
  Status CheckPatience();
  bool RunsAtMostOnce() const;
  // --- messages
  void ReceiveMessages();
  void Handle(const realitygrad::v1::CoordinatorMessage& message);
  void Take(const realitygrad::v1::TaskAssignment& assignment);
  void HandleReply(const realitygrad::v1::TaskResultReply& reply);
  void NoteTrouble(const std::string& trouble);
  void Revoke(uint64_t token, const std::string& why);
  void MoveTo(const std::string& database);
  void Send(realitygrad::v1::WorkerMessage& message);
  void SendHello();
  void SendBeatIfDue();
  void LookAtNode();
  void Describe(realitygrad::v1::WorkerHeartbeat* beat);
  std::string DiskTrouble();
  void SayIfAway();
  void SendReportsIfDue();
  void FlushLogs();
  // --- tasks
  void TakeTransferResults();
  void InputsAreHere(uint64_t token, Held& held);
  void StartQueued();
  void Start(uint64_t token, Held& held);
  Executor* IdleExecutor();
  void RestFromStarting(const std::string& why);
  void RestFromTrouble(Held& held, const std::string& why);
  void Rest(const std::string& why, int times_before);
  void GiveBackWhatHasNotBegun(const std::string& why);
  void GiveBackForNode(Held& held, const std::string& why);
  const std::string& WhyUnable() const { return node_trouble_.empty() ? unable_ : node_trouble_; }
  void ReadExecutors();
  void HandleExecutorMessage(realitygrad::v1::FromExecutor& message);
  void HandleExecutorFinished(uint64_t token, Held& held, realitygrad::v1::ExecutorFinished finished);
  void HandleExecutorFailed(Held& held, const realitygrad::v1::ExecutorFailed& failed);
  void HandleExecutorEnd(Executor& executor);
  void Upload(uint64_t token, Held& held, const std::vector<std::string>& only = {});
  void ReportFinished(Held& held);
  void ReportFailure(Held& held, realitygrad::v1::AttemptOutcome outcome, const std::string& error,
                     bool retryable);
  void Interrupt(Held& held);
  void EnforceDeadlines();
  void GiveBackWhatWaits();
  void GiveBackEverything(const std::string& why);
  void Forget(uint64_t token);
  void AddLog(uint64_t token, const std::string& text, int64_t wall_ns);

  WorkerOptions options_;
  const Clock* clock_;
  ArtifactCache cache_;
  ScratchSpace scratch_;
  std::string instance_;
  transport::Sender self_;
  std::unique_ptr<transport::Context> context_;
  std::unique_ptr<transport::ZmqSocket> socket_;
  int transfer_fd_ = -1;
  std::unique_ptr<Transfers> transfers_;

  bool joined_ = false, draining_ = false, stop_now_ = false;
  std::string refused_;   // empty again once it was welcomed after all
  std::string unable_;    // why it rests, as it said last
  std::string node_trouble_;  // why nothing may begin here, as it was at the last heartbeat
  int starts_in_vain_ = 0;  // executors, since the last one that came up
  int troubles_ = 0;        // tasks that this machine had no room for, since the last one that was done
  int64_t rest_until_ns_ = 0;
  std::string trouble_;  // of the coordinator, as it said last
  int signals_ = 0;
  int64_t next_complaint_ns_ = 0;
  int64_t drain_since_ns_ = 0, last_word_ns_ = 0, last_busy_ns_ = 0, next_beat_ns_ = 0, logs_due_ns_ = 0;
  int64_t heartbeat_ns_ = 2'000'000'000;
  uint64_t inline_limit_ = 256u << 10;
  HeldMap held_;
  std::string database_;  // identity of the coordinator's, whose tokens these are; empty: it has said none yet
  std::set<uint64_t> done_tokens_;  // recent ones, so that a repeated assignment is known
  std::deque<uint64_t> done_order_;
  std::vector<std::unique_ptr<Executor>> executors_;
  std::map<uint64_t, std::vector<realitygrad::v1::TaskLogLine>> logs_;
};

}  // namespace rg::worker
