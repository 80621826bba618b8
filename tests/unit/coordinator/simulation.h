// A whole service in memory, under a seed: the reactor with its store, workers that die, freeze and
// come back, a network that drops, repeats, delays and reorders, clients that repeat themselves, a
// coordinator that is killed before or after it committed and is away for a while, stalls, or finds its disk
// full, a wall clock that jumps. Same seed, same history.
#pragma once

#include <map>
#include <set>
#include <string>
#include <vector>

#include "common/base/rng.h"
#include "coordinator/core/reactor.h"
#include "tests/unit/coordinator/memory_store.h"

namespace rg::coordinator {

struct SimulationOptions {
  int workers = 3;
  int jobs = 3;
  int64_t chaos_ms = 30'000;  // then everything heals
  int64_t calm_ms = 150'000;  // by the end of which every job must be over
  double drop = 0.05, repeat = 0.05;
  int64_t delay_max_ms = 300;
  double worker_death = 0.006, worker_freeze = 0.006, restart = 0.01;    // per worker (coordinator) and step
  double worker_unable = 0.004;  // per worker and step: it can run nothing for a while
  double command = 0.02;                                                 // per step
  double disk_full = 0.004;                                              // per step: one batch is lost
  double stall = 0.004;                                                  // of the coordinator, per step
  double clock_jump = 0.002;                                             // of the wall clock, per step
  double task_failure = 0.1, task_crash = 0.05, task_given_back = 0.03;  // per attempt
};

class Simulation {
 public:
  Simulation(uint64_t seed, const SimulationOptions& options);
  // Plays the history; one line per broken promise.
  std::vector<std::string> Run();

  struct Facts {
    uint64_t events = 0, restarts = 0, deaths = 0, freezes = 0, refused = 0, commits = 0, uncertain = 0;
    uint64_t lost_batches = 0, stalls = 0, clock_jumps = 0;
    uint64_t succeeded = 0, failed = 0, cancelled = 0;
    uint64_t of_tasks = 0;  // jobs that tasks submitted
    uint64_t after_others = 0, overdue = 0, reprioritised = 0;
    uint64_t counted_overdue = 0;  // results that came after the limit of their job
    uint64_t unable = 0;           // tasks given back by a worker that could run none
    static constexpr uint64_t Facts::* kAll[] = {
        &Facts::events,        &Facts::restarts, &Facts::deaths,        &Facts::freezes,
        &Facts::refused,       &Facts::commits,  &Facts::uncertain,     &Facts::lost_batches,
        &Facts::stalls,        &Facts::clock_jumps, &Facts::succeeded,  &Facts::failed,
        &Facts::cancelled,     &Facts::of_tasks, &Facts::after_others,  &Facts::overdue,
        &Facts::reprioritised, &Facts::counted_overdue, &Facts::unable};
  };
  const Facts& facts() const { return facts_; }

 private:
  struct Held {
    TaskId task = 0;
    bool at_most_once = false, started = false, revoked = false, asked_for_parts = false;
    int64_t done_at_ms = 0, ended_ms = 0;
    enum { kRunning, kFinished, kFailed } state = kRunning;
    Outcome outcome = Outcome::kSucceeded;
  };
  struct SimWorker {
    std::string name, instance;
    bool alive = false, joined = false;
    int64_t wake_ms = 0, next_beat_ms = 0, unable_until_ms = 0;
    std::map<Token, Held> held;
    std::set<Token> finished_before;  // tokens it must not take again
  };
  struct ToCoordinator {
    int64_t at_ms;
    Event event;
  };
  struct ToPeer {
    int64_t at_ms;
    Message message;
  };
  struct Client {
    std::string request_id;
    std::shared_ptr<const JobPlan> plan;
    bool has_terms = false, acknowledged = false;
    JobId job = 0;
  };

  void Step();
  void DeliverToCoordinator();
  void Commit(Actions& actions);
  void Handle(Event& event, Actions& actions);
  void Judge(Actions& actions);
  std::set<JobId> FinishedInTime() const;
  void RestartCoordinator();
  void ComeBack();
  void LoseTheBatch();
  void DeliverToPeers();
  void StepWorker(SimWorker& worker);
  void StartWorker(SimWorker& worker);
  void Progress(SimWorker& worker);
  void SubmitParts(Token token, Held& held);
  void MaybeHarm();
  void MaybeCommand();
  void ResubmitUnacknowledged();
  void ChooseTerms(Client& client);
  void CheckStarts(const std::vector<Row>& rows);
  void Receive(const Assign& m);
  void Receive(const GrantStart& m);
  void Receive(const Revoke& m);
  void Receive(const AnswerResult& m);
  void Receive(const AnswerBeat& m);
  void Receive(const AnswerClient& m);
  void Receive(const Welcome& m);
  void Receive(const RefuseWorker& m);
  void Receive(const TellDrain&) {}
  SimWorker* FindInstance(const std::string& instance);
  std::vector<Token> HeldTokens(const SimWorker& worker) const;
  void Begin(SimWorker& worker, Token token, Held& held);
  void SendUp(Event event);
  void SendDown(Message message);
  void CheckNow(const char* when);
  void CheckAtTheEnd();
  void Complain(const std::string& what);
  Now now() const { return {ms_ * 1'000'000, kWallStartNs + wall_offset_ns_ + ms_ * 1'000'000}; }
  bool chaos() const { return ms_ < options_.chaos_ms; }

  static constexpr int64_t kWallStartNs = 1'700'000'000'000'000'000;

  SimulationOptions options_;
  Rng rng_;
  int64_t ms_ = 0;
  int64_t stalled_until_ms_ = 0, away_until_ms_ = 0, wall_offset_ns_ = 0;
  bool is_away_ = false;
  State state_;
  MemoryStore store_;
  std::vector<SimWorker> workers_;
  std::vector<Client> clients_;
  std::vector<ToCoordinator> up_;
  std::vector<ToPeer> down_;
  std::map<TaskId, int> starts_;  // of at-most-once tasks, by a worker that was allowed to
  std::map<JobId, int> retries_;  // acknowledged or not: consents that may have taken effect
  std::set<JobId> cancelled_;     // acknowledged
  std::map<JobId, std::map<TaskId, int>> commits_at_cancel_;
  int instances_ = 0;
  uint64_t commits_made_ = 0;
  Facts facts_;
  std::vector<std::string> broken_;
};

}  // namespace rg::coordinator
