// One turn of the reactor: the state, the time and the list of actions that its steps share.
// Private to coordinator/core; the steps are grouped by file: jobs, tasks, workers, dispatch.
#pragma once

#include <deque>
#include <set>
#include <string>

#include "coordinator/core/events.h"
#include "coordinator/core/state.h"

namespace rg::coordinator {

class Turn {
 public:
  Turn(State& state, Now now, Actions& actions) : s_(state), now_(now), out_(actions) {}

  // reactor_jobs.cc
  void Handle(const Submit& event);
  void Handle(const CommandJob& event);
  // reactor_workers.cc
  void Handle(const DrainWorker& event);
  void Handle(const HoldRobot& event);
  void Handle(const WorkerJoined& event);
  void Handle(const WorkerBeat& event);
  void Handle(const WorkerLeft& event);
  void Handle(const Tick& event);
  // reactor_tasks.cc
  void Handle(const StartRequested& event);
  void Handle(const Progressed& event);
  void Handle(const Finished& event);
  void Handle(const Failed& event);
  // dispatch.cc
  void Dispatch();

 private:
  // --- jobs
  Verdict Cancel(Job& job, const std::string& reason, std::string* error);
  Verdict Pause(Job& job, std::string* error);
  Verdict Resume(Job& job, std::string* error);
  JobId UnmetOf(const JobPlan& plan, JobId not_in_memory) const;
  Verdict Retry(Job& job, JobId unmet, std::string* error);
  void ConsentToUncertain(Job& job);
  // Of this job and, by as much, of those that its tasks have submitted.
  void SetPriority(Job& job, int32_t priority);
  void ShiftPriority(Job& job, int32_t by);
  // Puts what is ready into the queues.
  void EnqueueAll(Job& job);
  // From now on its time limit counts.
  void StartTheClock(Job& job);
  void EndOverdueJobs();
  bool MayYetCount(const Job& job, const Lease& lease) const;
  // Those that come after it may start, or fail.
  void TellJobsAfter(Job& ended);
  // Ends the job and everything of it that is not settled.
  void CloseJob(Job& job, JobPhase phase, const std::string& reason);
  void CloseJobIfSettled(Job& job);
  // Ends what the task has submitted: it is settled itself.
  void CloseJobsOf(TaskId task);
  void SetJobPhase(Job& job, JobPhase phase, const std::string& reason);

  // --- tasks
  void PersistTask(const Job& job, uint32_t index, const std::string& reason = {});
  void NoteSeconds(const Job& job, uint32_t index, double seconds);
  // `remark`, unless it is empty, is the reason of the task and from then on of its job, should it succeed.
  void CommitTask(Job& job, uint32_t index, Token token, const std::string& remark);
  void ReleaseChildren(Job& job, uint32_t index);
  // Returns whether the job is lost with this task.
  bool CancelDescendants(Job& job, uint32_t index);
  // Back to the queue, or given up if the counts say so.
  void Requeue(Job& job, uint32_t index, const std::string& reason);
  // Gives the task up for good; the job fails unless every way on from it is optional.
  void FailTask(Job& job, uint32_t index, const std::string& reason, bool set_aside);
  void RefuseResult(const Finished& event);
  // Removes the lease and closes its attempt.
  void EndLease(Token token, Outcome outcome, const std::string& error);
  // The worker can no longer be trusted to hold this lease.
  void LoseLease(Token token, const std::string& why);
  void AfterFailure(Job& job, uint32_t index, const Failed& event, const Lease& lease);
  // Costs no attempt, but counts as a loss: another worker is asked first.
  void RequeueElsewhere(Job& job, uint32_t index, const std::string& worker, const std::string& error);

  // --- workers
  // Whether this process may have the name now; if it never may, it is told.
  bool MayHaveName(const WorkerJoined& event);
  Worker* HolderOf(const WorkerJoined& event);
  void RemoveWorker(const std::string& name, const std::string& why);
  void RenewOrRevoke(Worker& worker, const std::vector<Token>& held);
  void NoteAbility(Worker& worker, const std::string& unable);
  // Whether the failure is one of many that happen on this worker only, which rests then.
  bool IsOfNode(Worker& worker, const std::string& kind, TaskId task, const std::string& error);
  void EndSuspicions();
  // What was given to agents of the robot and has not begun goes back.
  void TakeBackFrom(const std::string& robot);
  void NoteNamed(const WorkerBeat& beat);
  void LoseLeasesOf(const std::string& name, const std::string& instance_to_keep,
                    const std::vector<Token>& held, const std::string& why);
  void RevokeFrom(const std::string& instance, Token token, const std::string& reason);
  void FindLostWorkers();
  void FindExpiredLeases();

  // --- dispatch
  void FillSlots(bool ahead);
  bool AssignOneTo(Worker& worker, bool ahead);
  bool IsForOthers(const SchedulingClass& cls, TaskId task, const Worker& worker) const;
  std::set<SchedulingClass::Entry>::const_iterator FirstFor(const Worker& worker,
                                                            const SchedulingClass& cls) const;
  // How many of its tasks a worker is given now beyond each of its slots.
  uint32_t AheadNow(const SchedulingClass& cls) const;
  void GiveTo(Worker& worker, Job& job, uint32_t index);

  void Note(const std::string& kind, JobId job, const std::string& task, const std::string& worker,
            const std::string& detail);
  template <class M>
  void Send(M message) {
    out_.messages.emplace_back(std::move(message));
  }
  template <class R>
  void Store(R row) {
    out_.rows.emplace_back(std::move(row));
  }

  State& s_;
  Now now_;
  Actions& out_;
  uint32_t slots_of_all_ = 0;  // of the workers that take work
  std::string by_;             // who wants what happens in this turn; empty: nobody in person
  std::deque<JobId> ended_;    // jobs that others come after, which are still to be told
};

}  // namespace rg::coordinator
