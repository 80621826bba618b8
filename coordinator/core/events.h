// What may happen to the coordinator, and what it may answer. The shell turns messages into events
// and actions into rows and messages; nothing else passes between it and the reactor.
#pragma once

#include <string>
#include <variant>
#include <vector>

#include "coordinator/core/types.h"

namespace rg::coordinator {

// --- events --------------------------------------------------------------------------------------

struct Submit {
  std::string request_id;
  std::shared_ptr<const JobPlan> plan;  // checked by CompileJob
  std::shared_ptr<const TaskSpecs> specs;
  ReplyTo reply_to = 0;
  Token lease = 0;      // under which plan->parent submits it; 0: a client does
  std::string content;  // as JobPlan::content; empty: not compared
  // A job that is over and not in memory had this request id already, and that content.
  JobId known = 0;
  std::string known_content = {};
  JobId unmet = 0;  // of the jobs that it comes after and that are not in memory, one that did not succeed
};
enum class JobCommand { kCancel, kPause, kResume, kRetry, kPriority };
struct CommandJob {
  JobId job = 0;
  JobCommand command = JobCommand::kCancel;
  std::string reason;
  ReplyTo reply_to = 0;
  std::string by = {};   // who wants it, for the events; empty: not known
  int32_t priority = 0;  // kPriority
  // kRetry: of the jobs that it comes after and that are not in memory, one that did not succeed; 0: none.
  JobId unmet = 0;
};
struct DrainWorker {
  std::string worker;
  ReplyTo reply_to = 0;
  std::string by = {}, reason = {};
};

struct HoldRobot {
  std::string robot, reason, by;
  bool release = false;
  ReplyTo reply_to = 0;
};

// `instance` names the process that speaks, new with every start.
// `key` is the name of the key it came with; empty on a local socket.
struct WorkerJoined {
  std::string name;
  std::string instance;
  uint32_t slots = 1;
  std::vector<std::string> tags;
  std::vector<std::string> kinds;
  std::vector<Token> held;
  bool draining = false;
  std::string host;
  int64_t pid = 0;
  std::string version;
  std::string key;
  std::string unable = {};  // as WorkerBeat's
};
struct WorkerBeat {
  std::string instance;
  std::vector<Token> held;
  bool draining = false;
  std::vector<Token> finished = {};  // of those held: no longer run, what they came to is on its way
  std::string unable = {};           // why it can run nothing for now; empty: it can
  NodeState node = {};
};
struct WorkerLeft {
  std::string instance;
};
struct StartRequested {
  std::string instance;
  Token token = 0;
};
struct Progressed {
  std::string instance;
  Token token = 0;
  std::string stage;
  double done = 0.0;
  double total = 0.0;
  std::string note;
};
// All outputs are at hand: the shell has checked that.
struct Finished {
  std::string instance;
  TaskId task = 0;
  Token token = 0;
  double seconds = -1.0;  // that it ran; negative: not said
  Token committed = 0;    // of a task whose job is not in memory: under which lease it was committed
  std::string remark = {};  // what did not go as asked though it finished; empty: nothing
};
struct Failed {
  std::string instance;
  TaskId task = 0;
  Token token = 0;
  Outcome outcome = Outcome::kFailed;
  std::string error;
  bool retryable = true;
  bool of_node = false;  // with kLost: the fault is of the worker's machine
};
// Time has passed: leases may have expired.
struct Tick {};

using Event = std::variant<Submit, CommandJob, DrainWorker, HoldRobot, WorkerJoined, WorkerBeat, WorkerLeft,
                           StartRequested, Progressed, Finished, Failed, Tick>;

// --- actions -------------------------------------------------------------------------------------

using Row = std::variant<InsertJob, UpdateJob, UpdateTask, InsertAttempt, GrantAttempt, FinishAttempt,
                         CommitResult, CloseTasks, ReopenTasks, SetHold, AppendEvent>;

struct Welcome {
  std::string instance;
};
struct RefuseWorker {  // it may not join under this name
  std::string instance;
  std::string reason;
};
struct Assign {
  std::string instance;
  TaskId task = 0;
  Token token = 0;
  uint32_t attempt = 0;
};
struct GrantStart {
  std::string instance;
  Token token = 0;
};
struct Revoke {
  std::string instance;
  Token token = 0;
  std::string reason;
};
struct AnswerResult {
  std::string instance;
  Token token = 0;
  bool accepted = false;
  std::string reason;
};
struct AnswerBeat {
  std::string instance;
  bool known = true;
};
struct TellDrain {
  std::string instance;
};
enum class Verdict { kOk, kNotFound, kFailedPrecondition };
struct AnswerClient {
  ReplyTo reply_to = 0;
  Verdict verdict = Verdict::kOk;
  std::string error;
  JobId job = 0;
  bool already_known = false;
};

using Message = std::variant<Welcome, RefuseWorker, Assign, GrantStart, Revoke, AnswerResult, AnswerBeat,
                             TellDrain, AnswerClient>;

// The rows must be durable before any of the messages leaves.
struct Actions {
  std::vector<Row> rows;
  std::vector<Message> messages;
  void clear() { rows.clear(), messages.clear(); }
};

}  // namespace rg::coordinator
