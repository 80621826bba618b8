#include <algorithm>
#include <vector>

#include "coordinator/core/turn.h"

namespace rg::coordinator {
namespace {

bool Holds(const std::vector<Token>& held, Token token) {
  return std::find(held.begin(), held.end(), token) != held.end();
}

}  // namespace

void Turn::Handle(const DrainWorker& event) {
  by_ = event.by;
  const auto found = s_.workers.find(event.worker);
  if (found == s_.workers.end() || !found->second.connected) {
    Send(AnswerClient{event.reply_to, Verdict::kNotFound, "there is no worker '" + event.worker + "'", 0,
                      false});
    return;
  }
  found->second.draining = true;
  found->second.drain_reason = event.reason;
  Note("worker.draining", 0, "", event.worker, event.reason);
  Send(TellDrain{found->second.instance});
  Send(AnswerClient{event.reply_to, Verdict::kOk, "", 0, false});
}

void Turn::Handle(const HoldRobot& event) {
  by_ = event.by;
  if (event.release && s_.holds.erase(event.robot) == 0) {
    Send(AnswerClient{event.reply_to, Verdict::kFailedPrecondition, "the robot '" + event.robot + "' is not held", 0, false});
    return;
  }
  const RobotHold hold{event.reason, event.by, now_.wall_ns};
  if (!event.release) s_.holds[event.robot] = hold;
  Store(SetHold{event.robot, hold, event.release});
  Note(event.release ? "robot.released" : "robot.held", 0, "", "",
       event.robot + (event.reason.empty() ? "" : ": " + event.reason));
  for (auto& [name, worker] : s_.workers) MarkHeld(s_, worker);
  if (!event.release) TakeBackFrom(event.robot);
  s_.dispatch_needed = true;
  Send(AnswerClient{event.reply_to, Verdict::kOk, "", 0, false});
}

void Turn::TakeBackFrom(const std::string& robot) {
  std::vector<Token> not_begun;
  for (const auto& [token, lease] : s_.leases) {
    const auto worker = s_.workers.find(lease.worker);
    if (!lease.granted && worker != s_.workers.end() && worker->second.tags.count(kRobotTag + robot) > 0)
      not_begun.push_back(token);
  }
  std::sort(not_begun.begin(), not_begun.end());
  for (const Token token : not_begun) {
    const Lease& lease = s_.leases.at(token);
    Job& job = *s_.FindJob(JobOf(lease.task));
    const uint32_t index = IndexOf(lease.task);
    RevokeFrom(lease.instance, token, "the robot is held");
    EndLease(token, Outcome::kLost, "the robot is held");
    Requeue(job, index, "the robot is held");
  }
}

// Who is connected under its name or, an agent, beside its robot: two would move one arm.
Worker* Turn::HolderOf(const WorkerJoined& event) {
  const auto has_its_robot = [&](const Worker& other) {
    return std::any_of(event.tags.begin(), event.tags.end(), [&](const std::string& tag) {
      return tag.rfind(kRobotTag, 0) == 0 && other.tags.count(tag) > 0;
    });
  };
  for (auto& [name, worker] : s_.workers) {
    if (worker.connected && worker.instance != event.instance && (name == event.name || has_its_robot(worker)))
      return &worker;
  }
  return nullptr;
}

// A process that was killed and started again comes as another instance while the first is not yet known
// to be lost: it waits. Two that live would evict each other for ever: the second is told to go.
bool Turn::MayHaveName(const WorkerJoined& event) {
  const auto refuse = [&](const std::string& why) {
    Send(RefuseWorker{event.instance, why});
    return false;
  };
  const std::string its_name = "the worker name '" + event.name + "' ";
  for (const auto& [token, lease] : s_.leases) {
    if (lease.worker == event.name && lease.key != event.key)
      return refuse(its_name + "belongs to another key, '" + lease.key + "'");
  }
  const auto found = s_.workers.find(event.name);
  if (found != s_.workers.end() && found->second.key != event.key)
    return refuse(its_name + "belongs to another key, '" + found->second.key + "'");
  Worker* other = HolderOf(event);
  if (other == nullptr) return true;
  Worker& holder = *other;
  constexpr size_t kMaxRivals = 16;
  if (holder.rivals.size() >= kMaxRivals && holder.rivals.count(event.instance) == 0) return false;
  const int64_t since = holder.rivals.emplace(event.instance, now_.steady_ns).first->second;
  // Later by a whole interval: a last word of a dead process may still have been on its way.
  if (holder.last_seen_ns < since + s_.options.heartbeat_ns) return false;
  holder.rivals.erase(event.instance);
  const std::string who = "(host " + holder.host + ", pid " + std::to_string(holder.pid) + ")";
  if (holder.name != event.name)
    return refuse("another agent, '" + holder.name + "', is beside this robot " + who + ": one robot has one agent");
  return refuse(its_name + "is taken by a process that is at work " + who + ": give this one another --name");
}

void Turn::Handle(const WorkerJoined& event) {
  if (!MayHaveName(event)) return;
  const auto other_name = s_.worker_by_instance.find(event.instance);
  if (other_name != s_.worker_by_instance.end() && other_name->second != event.name) {
    RemoveWorker(other_name->second, "joined again as " + event.name);
  }
  const bool is_new = s_.workers.count(event.name) == 0 || !s_.workers[event.name].connected;
  Worker& worker = s_.workers[event.name];
  const bool was_draining = !is_new && worker.draining;
  worker.name = event.name;
  worker.instance = event.instance;
  worker.key = event.key;
  worker.rivals.clear();
  worker.host = event.host;
  worker.pid = event.pid;
  worker.version = event.version;
  worker.slots = std::max(1u, event.slots);
  worker.tags = {event.tags.begin(), event.tags.end()};
  worker.kinds = {event.kinds.begin(), event.kinds.end()};
  worker.draining = event.draining || was_draining;
  if (!was_draining) worker.drain_reason.clear();
  worker.unable = event.unable;
  if (is_new) worker.failing.clear(), worker.suspect.clear(), worker.suspicions = 0;
  worker.connected = true;
  worker.last_seen_ns = now_.steady_ns;
  if (is_new) worker.since_wall_ns = now_.wall_ns;
  MarkHeld(s_, worker);
  worker.classes.clear();
  for (uint32_t c = 0; c < s_.classes.size(); ++c) {
    if (CanRun(worker, s_.classes[c])) worker.classes.push_back(c);
  }
  s_.worker_by_instance[event.instance] = event.name;
  if (is_new)
    Note("worker.joined", 0, "", event.name, std::to_string(worker.slots) + " slots on " + event.host);
  LoseLeasesOf(event.name, event.instance, event.held, "its worker came back without it");
  worker.winding_down.clear();
  RenewOrRevoke(worker, event.held);
  Send(Welcome{event.instance});
  if (was_draining && !event.draining) Send(TellDrain{event.instance});
  s_.dispatch_needed = true;
}

// Leases of the worker's name that the process which now speaks cannot be holding: those of an
// earlier process, and those from before our restart that it does not name.
void Turn::LoseLeasesOf(const std::string& name, const std::string& instance_to_keep,
                        const std::vector<Token>& held, const std::string& why) {
  std::vector<Token> lost;
  for (const auto& [token, lease] : s_.leases) {
    if (lease.worker != name) continue;
    const bool same_process = lease.instance == instance_to_keep;
    if (!same_process || (lease.restored && !Holds(held, token))) lost.push_back(token);
  }
  std::sort(lost.begin(), lost.end());
  for (const Token token : lost) {
    if (s_.leases.count(token) > 0) LoseLease(token, why);  // one loss may close the whole job
  }
}

// What a worker says it holds is either leased to it, and renewed, or to be dropped. A lease in doubt
// (TaskUncertain) whose worker returns with it is a lease again.
void Turn::RenewOrRevoke(Worker& worker, const std::vector<Token>& held) {
  for (const Token token : held) {
    Lease* lease = s_.FindLease(token, worker.instance);
    if (lease == nullptr) {
      RevokeFrom(worker.instance, token, "the lease is no longer valid");
      continue;
    }
    Job& job = *s_.FindJob(JobOf(lease->task));
    const uint32_t index = IndexOf(lease->task);
    if (std::holds_alternative<TaskUncertain>(job.tasks[index].status)) {
      SetStatus(s_, job, index, TaskLeased{token});
      PersistTask(job, index, "its worker came back");
      Note("task.found", job.id, job.plan_of(index).name, worker.name, "its worker came back with it");
    }
    worker.leases.insert(token);
    lease->deadline_ns = now_.steady_ns + s_.options.lease_ns();
    lease->restored = false;
  }
}

void Turn::Handle(const WorkerBeat& event) {
  Worker* worker = s_.FindWorkerByInstance(event.instance);
  if (worker == nullptr) {
    Send(AnswerBeat{event.instance, false});
    return;
  }
  worker->last_seen_ns = now_.steady_ns;
  worker->draining = worker->draining || event.draining;
  const size_t before = worker->winding_down.size();
  std::erase_if(worker->winding_down, [&](Token token) { return !Holds(event.held, token); });
  if (worker->winding_down.size() != before) s_.dispatch_needed = true;
  NoteAbility(*worker, event.unable);
  worker->node = event.node;
  RenewOrRevoke(*worker, event.held);
  NoteNamed(event);
  Send(AnswerBeat{event.instance, true});
}

// While it can run nothing it is given nothing, and what it gives back goes to others.
void Turn::NoteAbility(Worker& worker, const std::string& unable) {
  if (worker.unable.empty() != unable.empty()) {
    Note(unable.empty() ? "worker.able" : "worker.unable", 0, "", worker.name, unable);
    s_.dispatch_needed = true;
  }
  worker.unable = unable;
}

// Tasks that fail wherever they run fail on others too: those finish none of the kind meanwhile.
bool Turn::IsOfNode(Worker& worker, const std::string& kind, TaskId task, const std::string& error) {
  constexpr size_t kInARow = 3;
  constexpr uint32_t kLongestShift = 6;
  Worker::Failing& failing = worker.failing[kind];
  const uint64_t finished = s_.kinds[kind].finished;
  if (failing.tasks.empty()) failing.finished_before = finished;
  if (failing.tasks.size() < kInARow) failing.tasks.insert(task);
  if (failing.tasks.size() < kInARow || finished == failing.finished_before) return false;
  if (!worker.suspect.empty()) return true;
  worker.suspect_until_ns = now_.steady_ns + (s_.options.suspect_ns << std::min(worker.suspicions, kLongestShift));
  ++worker.suspicions;
  worker.suspect = "fails tasks that others finish: " + error;
  Note("worker.unable", 0, "", worker.name, worker.suspect);
  s_.dispatch_needed = true;
  return true;
}

// The next task tells.
void Turn::EndSuspicions() {
  for (auto& [name, worker] : s_.workers) {
    if (worker.suspect.empty() || now_.steady_ns < worker.suspect_until_ns) continue;
    worker.suspect.clear();
    Note("worker.able", 0, "", name, "it is tried again");
    s_.dispatch_needed = true;
  }
}

// What the worker says of its leases besides that they live.
void Turn::NoteNamed(const WorkerBeat& beat) {
  for (const Token token : beat.held) {
    if (Lease* lease = s_.FindLease(token, beat.instance)) lease->named_ns = now_.steady_ns;
  }
  for (const Token token : beat.finished) {
    if (Lease* lease = s_.FindLease(token, beat.instance)) lease->finished = true;
  }
}

void Turn::Handle(const WorkerLeft& event) {
  const auto name = s_.worker_by_instance.find(event.instance);
  if (name == s_.worker_by_instance.end()) return;
  const std::string copy = name->second;
  Note("worker.left", 0, "", copy, "");
  RemoveWorker(copy, "its worker left");
  s_.workers.erase(copy);
}

void Turn::Handle(const Tick&) {
  FindLostWorkers();
  EndSuspicions();
  FindExpiredLeases();
  EndOverdueJobs();
}

void Turn::FindLostWorkers() {
  std::vector<std::string> lost, forgotten;
  for (const auto& [name, worker] : s_.workers) {
    if (worker.connected && now_.steady_ns - worker.last_seen_ns > s_.options.lease_ns())
      lost.push_back(name);
    if (!worker.connected && now_.steady_ns - worker.last_seen_ns > s_.options.forget_worker_ns) {
      forgotten.push_back(name);
    }
  }
  for (const std::string& name : lost) {
    ++s_.counters.workers_lost;
    Note("worker.lost", 0, "", name, "no heartbeat");
    RemoveWorker(name, "no heartbeat from its worker");
  }
  for (const std::string& name : forgotten) s_.workers.erase(name);
}

void Turn::FindExpiredLeases() {
  std::vector<Token> expired;
  for (const auto& [token, lease] : s_.leases) {
    if (lease.deadline_ns < now_.steady_ns) expired.push_back(token);
  }
  std::sort(expired.begin(), expired.end());
  for (const Token token : expired) {
    const auto found = s_.leases.find(token);
    if (found == s_.leases.end()) continue;
    const std::string worker = found->second.worker;
    Job& job = *s_.FindJob(JobOf(found->second.task));
    const uint32_t index = IndexOf(found->second.task);
    RevokeFrom(found->second.instance, token, "the lease has expired");
    if (std::holds_alternative<TaskUncertain>(job.tasks[index].status)) {
      EndLease(token, Outcome::kLost, "its worker did not come back");
      FailTask(job, index, "may have run on " + worker + ", which was lost: `retry` lets it run again",
               false);
    } else {
      LoseLease(token, "the lease has expired");
    }
  }
}

// Disconnects a worker's process; it stays in the listing.
void Turn::RemoveWorker(const std::string& name, const std::string& why) {
  Worker& worker = s_.workers[name];
  worker.connected = false;
  s_.worker_by_instance.erase(worker.instance);
  std::vector<Token> lost(worker.leases.begin(), worker.leases.end());
  worker.leases.clear();
  worker.winding_down.clear();
  for (const Token token : lost) {
    if (s_.leases.count(token) > 0) LoseLease(token, why);
  }
}

// Tells the process to stop; its slot counts as taken until it says that it has.
void Turn::RevokeFrom(const std::string& instance, Token token, const std::string& reason) {
  if (Worker* worker = s_.FindWorkerByInstance(instance)) worker->winding_down.insert(token);
  Send(Revoke{instance, token, reason});
}

}  // namespace rg::coordinator
