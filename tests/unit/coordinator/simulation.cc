#include "tests/unit/coordinator/simulation.h"

#include <algorithm>

#include "coordinator/core/invariants.h"
#include "tests/unit/coordinator/plans.h"

namespace rg::coordinator {
namespace {

constexpr int64_t kStepMs = 50;
constexpr int64_t kHeartbeatMs = 1000;
constexpr ReplyTo kCommandBase = 1'000'000;

Options CoreOptions() {
  Options options;
  options.heartbeat_ns = kHeartbeatMs * 1'000'000;
  options.uncertain_ns = 5'000'000'000;
  return options;
}

template <class T>
std::vector<T> TakeDue(std::vector<T>& queue, int64_t now_ms) {
  std::vector<T> due;
  std::erase_if(queue, [&](T& item) {
    if (item.at_ms > now_ms) return false;
    due.push_back(std::move(item));
    return true;
  });
  std::stable_sort(due.begin(), due.end(), [](const T& a, const T& b) { return a.at_ms < b.at_ms; });
  return due;
}

}  // namespace

Simulation::Simulation(uint64_t seed, const SimulationOptions& options) : options_(options), rng_(seed) {
  state_.options = CoreOptions();
  for (int i = 0; i < options.workers; ++i) {
    workers_.emplace_back().name = "w" + std::to_string(i);
    StartWorker(workers_.back());
  }
  for (int i = 0; i < options.jobs; ++i) {
    Client& client = clients_.emplace_back();
    client.request_id = "request" + std::to_string(i);
    client.plan = RandomPlan(rng_);
  }
}

std::vector<std::string> Simulation::Run() {
  while (ms_ < options_.calm_ms && broken_.empty()) {
    Step();
    if (!chaos() && !is_away_ && up_.empty() && down_.empty() && ms_ > options_.chaos_ms + 20'000 && state_.jobs.empty()) {
      break;
    }
  }
  if (broken_.empty()) CheckAtTheEnd();
  return broken_;
}

void Simulation::Step() {
  ms_ += kStepMs;
  if (chaos()) MaybeHarm();
  if (chaos()) MaybeCommand();
  ResubmitUnacknowledged();
  for (SimWorker& worker : workers_) StepWorker(worker);
  DeliverToCoordinator();
  DeliverToPeers();
}

// One batch: every event is handled, then the rows are committed, then the messages leave. A kill
// may come before the commit (nothing happened) or between commit and sending (messages are lost).
void Simulation::DeliverToCoordinator() {
  if (chaos() && ms_ >= stalled_until_ms_ && rng_.Uniform() < options_.stall) {
    stalled_until_ms_ = ms_ + 500 + static_cast<int64_t>(rng_.Index(8000));
    ++facts_.stalls;
  }
  if (ms_ < stalled_until_ms_ || ms_ < away_until_ms_) return;
  if (std::exchange(is_away_, false)) ComeBack();
  Actions actions;
  auto due = TakeDue(up_, ms_);
  // What waited during a stall is read, and workers get an interval to speak, before anything is judged.
  const bool judges = ms_ >= stalled_until_ms_ + kHeartbeatMs;
  for (ToCoordinator& item : due) Handle(item.event, actions);
  if (judges) Judge(actions);
  facts_.refused += state_.counters.results_refused;
  state_.counters.results_refused = 0;
  const bool kill = chaos() && rng_.Uniform() < options_.restart;
  if (kill && rng_.Index(2) == 0) return RestartCoordinator();
  if (chaos() && rng_.Uniform() < options_.disk_full) return LoseTheBatch();
  Commit(actions);
  if (kill) return RestartCoordinator();
  for (Message& message : actions.messages) SendDown(std::move(message));
}

void Simulation::Handle(Event& event, Actions& actions) {
  store_.Complete(event, state_);
  const uint64_t commits = state_.counters.tasks_committed;
  const auto* finished = std::get_if<Finished>(&event);
  const Job* job = finished == nullptr ? nullptr : state_.FindJob(JobOf(finished->task));
  const bool is_overdue = job != nullptr && job->is_overdue;
  React(event, state_, now(), actions);
  facts_.counted_overdue += is_overdue && state_.counters.tasks_committed > commits;
  ++facts_.events;
  CheckNow("after an event");
}

// Leases and time limits. A job goes on past its limit only for what was finished in time, and for as long as
// that, or the word of whoever holds something of it, may take to arrive.
void Simulation::Judge(Actions& actions) {
  constexpr int64_t kLongestWayMs = 30'000;
  const std::set<JobId> owed = FinishedInTime();
  Event tick = Tick{};
  Handle(tick, actions);
  for (const auto& [id, job] : state_.jobs) {
    if (IsFinal(job.record.phase)) {
      if (owed.count(id) > 0 && job.record.reason.rfind("its time limit", 0) == 0)
        Complain("job " + std::to_string(id) + " was ended though something of it was finished in time");
    } else if (job.deadline_ns != 0 && job.deadline_ns < now().steady_ns) {
      if (!job.is_overdue) Complain("job " + std::to_string(id) + " goes on past its time limit");
      if (job.deadline_ns + kLongestWayMs * 1'000'000 < now().steady_ns)
        Complain("job " + std::to_string(id) + " goes on long past its time limit");
    }
  }
}

// Jobs past their limit of which a living worker holds, under a good lease, what it had finished before that.
std::set<JobId> Simulation::FinishedInTime() const {
  std::set<JobId> jobs;
  for (const SimWorker& worker : workers_) {
    if (!worker.alive || options_.delay_max_ms > kHeartbeatMs) continue;
    const Worker* known = const_cast<State&>(state_).FindWorkerByInstance(worker.instance);
    if (known != nullptr && now().steady_ns - known->last_seen_ns > state_.options.lease_ns()) continue;
    for (const auto& [token, held] : worker.held) {
      const auto lease = state_.leases.find(token);
      if (held.state != Held::kFinished || lease == state_.leases.end()) continue;
      if (lease->second.instance != worker.instance || lease->second.deadline_ns < now().steady_ns) continue;
      const Job& job = state_.jobs.at(JobOf(held.task));
      const bool in_time = held.ended_ms * 1'000'000 <= job.deadline_ns;
      if (job.deadline_ns != 0 && job.deadline_ns < now().steady_ns && in_time) jobs.insert(job.id);
    }
  }
  return jobs;
}

void Simulation::Commit(Actions& actions) {
  if (actions.rows.empty()) {  // a job was brought back for nothing
    for (const JobId id : std::exchange(state_.ended, {})) Retire(state_, id);
    return;
  }
  CheckStarts(actions.rows);
  for (const JobId id : std::exchange(state_.ended, {})) Retire(state_, id);
  for (const auto& [task, count] : store_.commits) {
    if (count > 1) Complain("task " + std::to_string(task) + " was committed twice");
  }
  for (const Row& row : actions.rows) facts_.commits += std::holds_alternative<CommitResult>(row);
  constexpr uint64_t kCompareEvery = 2;  // the comparison is what costs; every history makes hundreds
  if (++commits_made_ % kCompareEvery != 0) return;
  for (const std::string& difference :
       Differences(Describe(state_), Describe(Restore(store_.Load(), state_.options, now())))) {
    Complain("a restart would change: " + difference);
  }
}

// Applies them, and looks at what starts: everything that its job comes after must have succeeded.
void Simulation::CheckStarts(const std::vector<Row>& rows) {
  for (const Row& row : rows) {
    store_.Apply({row});
    facts_.overdue += std::holds_alternative<UpdateJob>(row) &&
                      std::get<UpdateJob>(row).record.reason.rfind("its time limit", 0) == 0;
    const auto* attempt = std::get_if<InsertAttempt>(&row);
    if (attempt == nullptr) continue;
    for (const JobId before : store_.Find(JobOf(attempt->task))->plan->after_jobs) {
      if (store_.Find(before)->record.phase != JobPhase::kSucceeded)
        Complain("a task started before job " + std::to_string(before) + ", which its job comes after");
    }
  }
}

// At once, or after a while.
void Simulation::RestartCoordinator() {
  ++facts_.restarts;
  is_away_ = true;
  state_ = State{};
  if (rng_.Index(2) == 0) return ComeBack();
  constexpr uint64_t kLongestMs = 12'000;
  away_until_ms_ = ms_ + static_cast<int64_t>(rng_.Index(kLongestMs));
}

void Simulation::ComeBack() {
  is_away_ = false;
  state_ = Restore(store_.Load(), CoreOptions(), now());
  CheckNow("after a restart");
  for (const Client& client : clients_) {
    if (client.acknowledged && store_.Find(client.job) == nullptr)
      Complain("an acknowledged submit was lost");
  }
}

// The commit failed: as if the batch had never come, but the workers are still there.
void Simulation::LoseTheBatch() {
  ++facts_.lost_batches;
  State fresh = Restore(store_.Load(), CoreOptions(), now());
  KeepWorkers(state_, fresh, now());
  state_ = std::move(fresh);
  CheckNow("after a full disk");
}

void Simulation::DeliverToPeers() {
  for (ToPeer& item : TakeDue(down_, ms_)) {
    std::visit([this](const auto& m) { Receive(m); }, item.message);
  }
}

void Simulation::SendUp(Event event) {
  if (chaos() && rng_.Uniform() < options_.drop) return;
  const int copies = chaos() && rng_.Uniform() < options_.repeat ? 2 : 1;
  for (int i = 0; i < copies; ++i) {
    up_.push_back(
        {ms_ + static_cast<int64_t>(rng_.Index(static_cast<uint64_t>(options_.delay_max_ms))), event});
  }
}

void Simulation::SendDown(Message message) {
  if (chaos() && rng_.Uniform() < options_.drop) return;
  const int copies = chaos() && rng_.Uniform() < options_.repeat ? 2 : 1;
  for (int i = 0; i < copies; ++i) {
    down_.push_back(
        {ms_ + static_cast<int64_t>(rng_.Index(static_cast<uint64_t>(options_.delay_max_ms))), message});
  }
}

// --- harm ----------------------------------------------------------------------------------------

void Simulation::MaybeHarm() {
  if (rng_.Uniform() < options_.clock_jump) {
    constexpr int64_t kHourNs = 3'600'000'000'000;
    wall_offset_ns_ += static_cast<int64_t>(rng_.Index(48)) * kHourNs - 24 * kHourNs;
    ++facts_.clock_jumps;
  }
  for (SimWorker& worker : workers_) {
    if (worker.alive && rng_.Uniform() < options_.worker_death) {
      worker.alive = false;
      worker.held.clear();
      worker.wake_ms = ms_ + 500 + static_cast<int64_t>(rng_.Index(5000));
      ++facts_.deaths;
    } else if (worker.alive && ms_ >= worker.wake_ms && rng_.Uniform() < options_.worker_freeze) {
      worker.wake_ms = ms_ + 500 + static_cast<int64_t>(rng_.Index(8000));
      ++facts_.freezes;
    } else if (rng_.Uniform() < options_.worker_unable) {
      worker.unable_until_ms = ms_ + 500 + static_cast<int64_t>(rng_.Index(5000));
    }
  }
}

void Simulation::MaybeCommand() {
  if (rng_.Uniform() >= options_.command) return;
  const Client& client = clients_[rng_.Index(clients_.size())];
  if (!client.acknowledged) return;
  const auto commands = {JobCommand::kPause, JobCommand::kResume, JobCommand::kResume,
                         JobCommand::kRetry, JobCommand::kRetry,  JobCommand::kCancel,
                         JobCommand::kPriority};
  const JobCommand command = *(commands.begin() + static_cast<long>(rng_.Index(commands.size())));
  if (command == JobCommand::kRetry) ++retries_[client.job];
  const ReplyTo reply = command == JobCommand::kCancel ? kCommandBase + static_cast<ReplyTo>(client.job) : 0;
  CommandJob event{client.job, command, "chaos", reply};
  event.priority = static_cast<int32_t>(rng_.Index(11)) - 5;
  facts_.reprioritised += command == JobCommand::kPriority;
  SendUp(event);
}

void Simulation::ResubmitUnacknowledged() {
  for (size_t i = 0; i < clients_.size(); ++i) {
    Client& client = clients_[i];
    const bool due = ms_ % 1000 == 0 && ms_ > static_cast<int64_t>(i) * 3000;
    if (!client.acknowledged && due) ChooseTerms(client);
    if (!client.acknowledged && due) SendUp(Submit{client.request_id, client.plan, nullptr, i + 1});
    // What was paused in the chaos is resumed after it.
    if (client.acknowledged && !chaos() && due) SendUp(CommandJob{client.job, JobCommand::kResume, "", 0});
  }
}

// When it asks for the first time: a time limit, and jobs that it knows of to come after.
void Simulation::ChooseTerms(Client& client) {
  if (std::exchange(client.has_terms, true)) return;
  auto plan = std::make_shared<JobPlan>(*client.plan);
  constexpr int64_t kLeastNs = 3'000'000'000, kMostMs = 20'000;
  if (rng_.Index(5) == 0)
    plan->time_limit_ns = kLeastNs + static_cast<int64_t>(rng_.Index(kMostMs)) * 1'000'000;
  for (const Client& other : clients_) {
    if (other.acknowledged && rng_.Index(3) == 0) plan->after_jobs.push_back(other.job);
  }
  std::sort(plan->after_jobs.begin(), plan->after_jobs.end());
  facts_.after_others += !plan->after_jobs.empty();
  client.plan = plan;
}

// --- workers ---------------------------------------------------------------------------------------

void Simulation::StartWorker(SimWorker& worker) {
  worker.instance = worker.name + "#" + std::to_string(++instances_);
  worker.alive = true;
  worker.joined = false;
  worker.held.clear();
  worker.finished_before.clear();
  worker.wake_ms = worker.next_beat_ms = ms_;
}

void Simulation::StepWorker(SimWorker& worker) {
  if (ms_ < worker.wake_ms) return;
  if (!worker.alive) StartWorker(worker);
  Progress(worker);
  if (ms_ < worker.next_beat_ms) return;
  worker.next_beat_ms = ms_ + kHeartbeatMs / 2;
  if (!worker.joined) {
    const bool has_robot = worker.name == "w0";
    SendUp(WorkerJoined{worker.name,
                        worker.instance,
                        2,
                        has_robot ? std::vector<std::string>{"robot:one"} : std::vector<std::string>{},
                        {"work", "other"},
                        HeldTokens(worker),
                        false,
                        "host",
                        1,
                        "test",
                        ""});
  } else {
    WorkerBeat beat{worker.instance, HeldTokens(worker), false};
    if (ms_ < worker.unable_until_ms) beat.unable = "chaos";
    for (const auto& [token, held] : worker.held) {
      if (held.state != Held::kRunning) beat.finished.push_back(token);
    }
    SendUp(std::move(beat));
  }
  for (const auto& [token, held] : worker.held) {  // again, until it is answered
    if (held.at_most_once && !held.started && held.state == Held::kRunning) SendUp(StartRequested{worker.instance, token});
    if (held.state == Held::kFinished) SendUp(Finished{worker.instance, held.task, token});
    if (held.state == Held::kFailed)
      SendUp(Failed{worker.instance, held.task, token, held.outcome, "chaos", true});
  }
}

void Simulation::Progress(SimWorker& worker) {
  for (auto& [token, held] : worker.held) {
    if (held.state != Held::kRunning || !held.started) continue;
    SubmitParts(token, held);
    if (ms_ < held.done_at_ms) continue;
    const double dice = rng_.Uniform();
    const double crash = options_.task_failure + options_.task_crash;
    const double given_back = crash + options_.task_given_back;
    held.state = dice < given_back ? Held::kFailed : Held::kFinished;
    held.ended_ms = ms_;
    held.outcome = dice < options_.task_failure      ? Outcome::kFailed
                   : dice < crash                    ? Outcome::kCrashed
                   : dice < (crash + given_back) / 2 ? Outcome::kLost
                                                     : Outcome::kCancelled;
    // As if it had been so short that others of its kind are given ahead, or so while there are many, or not.
    const double seconds = 0.001 * static_cast<double>(rng_.Index(rng_.Index(2) == 0 ? 30 : 1500));
    if (held.state == Held::kFinished) SendUp(Finished{worker.instance, held.task, token, seconds});
    if (held.state == Held::kFailed)
      SendUp(Failed{worker.instance, held.task, token, held.outcome, "chaos", true});
  }
}

// Now and then a task of a client's job submits one of its own, with every attempt the same one.
void Simulation::SubmitParts(Token token, Held& held) {
  const StoredJob* job = store_.Find(JobOf(held.task));
  if (held.asked_for_parts || job == nullptr || job->plan->parent != 0) return;
  held.asked_for_parts = true;
  if (rng_.Index(3) != 0) return;
  auto plan = std::make_shared<JobPlan>(*RandomPlan(rng_));
  plan->parent = held.task;
  SendUp(Submit{"parts of " + std::to_string(held.task), plan, nullptr, 0, token});
}

std::vector<Token> Simulation::HeldTokens(const SimWorker& worker) const {
  std::vector<Token> tokens;
  for (const auto& [token, held] : worker.held) tokens.push_back(token);
  return tokens;
}

Simulation::SimWorker* Simulation::FindInstance(const std::string& instance) {
  for (SimWorker& worker : workers_) {
    if (worker.alive && worker.instance == instance && ms_ >= worker.wake_ms) return &worker;
  }
  return nullptr;
}

void Simulation::Begin(SimWorker& worker, Token, Held& held) {
  held.started = true;
  held.done_at_ms = ms_ + 100 + static_cast<int64_t>(rng_.Index(3000));
  (void)worker;
  if (held.at_most_once && ++starts_[held.task] > 1 + retries_[JobOf(held.task)]) {
    Complain("at-most-once task " + std::to_string(held.task) + " ran again without consent");
  }
}

void Simulation::Receive(const Assign& m) {
  SimWorker* worker = FindInstance(m.instance);
  if (worker == nullptr || worker->held.count(m.token) || worker->finished_before.count(m.token)) return;
  Held& held = worker->held[m.token];
  held.task = m.task;
  held.at_most_once = store_.Find(JobOf(m.task))->plan->tasks[IndexOf(m.task)].at_most_once;
  if (ms_ < worker->unable_until_ms) {
    held.state = Held::kFailed;
    held.outcome = Outcome::kLost;
    held.ended_ms = ms_;
    ++facts_.unable;
    SendUp(Failed{worker->instance, held.task, m.token, held.outcome, "chaos", true});
  } else if (held.at_most_once) {
    SendUp(StartRequested{worker->instance, m.token});
  } else {
    Begin(*worker, m.token, held);
  }
}

void Simulation::Receive(const GrantStart& m) {
  SimWorker* worker = FindInstance(m.instance);
  if (worker == nullptr || !worker->held.count(m.token)) return;
  Held& held = worker->held[m.token];
  if (!held.started && held.state == Held::kRunning) Begin(*worker, m.token, held);
}

void Simulation::Receive(const Revoke& m) {
  SimWorker* worker = FindInstance(m.instance);
  if (worker == nullptr) return;
  worker->held.erase(m.token);
  worker->finished_before.insert(m.token);
}

void Simulation::Receive(const AnswerResult& m) {
  SimWorker* worker = FindInstance(m.instance);
  if (worker == nullptr) return;
  worker->held.erase(m.token);
  worker->finished_before.insert(m.token);
}

void Simulation::Receive(const AnswerBeat& m) {
  SimWorker* worker = FindInstance(m.instance);
  if (worker == nullptr || m.known) return;
  worker->joined = false;
  worker->next_beat_ms = ms_;
}

void Simulation::Receive(const Welcome& m) {
  if (SimWorker* worker = FindInstance(m.instance)) worker->joined = true;
}

void Simulation::Receive(const RefuseWorker& m) {
  SimWorker* worker = FindInstance(m.instance);
  if (worker == nullptr) return;
  worker->alive = false;  // it leaves with an error, and is started again
  worker->held.clear();
  worker->wake_ms = ms_ + 1000;
}

void Simulation::Receive(const AnswerClient& m) {
  if (m.reply_to >= kCommandBase) {
    if (m.verdict != Verdict::kOk || !cancelled_.insert(m.job).second) return;
    for (const auto& [task, count] : store_.commits) {
      if (JobOf(task) == m.job) commits_at_cancel_[m.job][task] = count;
    }
    return;
  }
  if (m.reply_to == 0) return;
  Client& client = clients_[m.reply_to - 1];
  if (m.verdict != Verdict::kOk) {  // what it was to come after did not succeed: then without
    auto plan = std::make_shared<JobPlan>(*client.plan);
    plan->after_jobs.clear();
    client.plan = plan;
    return;
  }
  if (client.acknowledged && client.job != m.job) Complain("a repeated submit made a second job");
  client.acknowledged = true;
  client.job = m.job;
}

// --- promises --------------------------------------------------------------------------------------

void Simulation::CheckNow(const char* when) {
  for (const std::string& line : BrokenInvariants(state_)) Complain(std::string(when) + ": " + line);
}

void Simulation::CheckAtTheEnd() {
  for (const Client& client : clients_) {
    if (!client.acknowledged) Complain("a submit was never acknowledged");
  }
  for (const auto& [id, job] : store_.jobs()) {
    const JobPhase phase = job.record.phase;
    if (!IsFinal(phase)) Complain("job " + std::to_string(id) + " never ended");
    if (cancelled_.count(id) && phase != JobPhase::kCancelled) Complain("a cancelled job came back");
    facts_.of_tasks += job.plan->parent != 0 ? 1 : 0;
    (phase == JobPhase::kSucceeded ? facts_.succeeded
     : phase == JobPhase::kFailed  ? facts_.failed
                                   : facts_.cancelled)++;
    for (uint32_t i = 0; i < job.tasks.size(); ++i) {
      const bool succeeded = job.tasks[i].phase == TaskPhase::kSucceeded;
      const auto commits = store_.commits.find(MakeTaskId(id, i));
      if (succeeded != (commits != store_.commits.end())) Complain("success and committed result disagree");
    }
    for (const auto& [task, count] : store_.commits) {
      if (JobOf(task) == id && cancelled_.count(id) && !commits_at_cancel_[id].count(task)) {
        Complain("a result was committed after the job was cancelled");
      }
    }
  }
  if (!state_.leases.empty()) Complain("a lease is left over");
  if (!state_.jobs.empty() || !state_.job_by_request.empty() || !state_.jobs_of_task.empty() ||
      !state_.class_index.empty())
    Complain("something of jobs that are over is left in memory");
  for (const auto& [kind, count] : store_.notes) facts_.uncertain += kind == "task.found" ? count : 0;
}

void Simulation::Complain(const std::string& what) {
  broken_.push_back("t=" + std::to_string(ms_) + " ms: " + what);
}

}  // namespace rg::coordinator
