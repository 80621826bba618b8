#include "coordinator/core/explain.h"

#include <algorithm>

namespace rg::coordinator {
namespace {

std::string Join(const std::vector<std::string>& items) {
  std::string text;
  for (const std::string& item : items) text += (text.empty() ? "" : ", ") + item;
  return text;
}

void ExplainParents(const Job& job, uint32_t index, Explanation* out) {
  constexpr size_t kNamed = 3;
  std::vector<std::string> open;
  for (const ParentEdge& edge : job.plan_of(index).parents) {
    const TaskPhase phase = PhaseOf(job.tasks[edge.parent].status);
    if (phase == TaskPhase::kSucceeded) continue;
    open.push_back(job.plan_of(edge.parent).name);
  }
  std::string names = Join({open.begin(), open.begin() + static_cast<long>(std::min(open.size(), kNamed))});
  if (open.size() > kNamed) names += " and " + std::to_string(open.size() - kNamed) + " more";
  out->reasons.push_back("it waits for " + std::to_string(open.size()) + " of its parents: " + names);
}

void ExplainJobsBefore(const Job& job, Explanation* out) {
  constexpr size_t kNamed = 3;
  std::vector<std::string> names;
  for (const JobId id : job.waits_for) {
    if (names.size() < kNamed) names.push_back(std::to_string(id));
  }
  std::string text = "its job comes after " + Join(names);
  if (job.waits_for.size() > kNamed)
    text += " and " + std::to_string(job.waits_for.size() - kNamed) + " more";
  out->reasons.push_back(text + (job.waits_for.size() == 1 ? ", which is" : ", which are") + " not over");
}

void ExplainPlacement(const State& state, const Job& job, uint32_t index, Explanation* out) {
  const SchedulingClass& cls = state.classes[job.tasks[index].scheduling_class];
  uint32_t connected = 0, able = 0, draining = 0, unable = 0, busy = 0;
  std::string why;  // the last of these is
  for (const auto& [name, worker] : state.workers) {
    connected += worker.connected;
    if (!worker.connected || !CanRun(worker, cls)) continue;
    ++able;
    draining += worker.draining;
    busy += worker.takes_tasks() && worker.busy() >= worker.slots;
    if (worker.draining || worker.why_unable().empty()) continue;
    ++unable;
    why = name + ": " + worker.why_unable();
  }
  out->placeable = able > draining;
  if (connected == 0) {
    out->reasons.push_back("no worker is connected");
  } else if (able == 0) {
    const std::string tags = cls.tags.empty() ? "" : " with the tags " + Join(cls.tags);
    out->reasons.push_back("none of the " + std::to_string(connected) + " connected workers runs kind '" +
                           cls.kind + "'" + tags);
  } else if (able == draining) {
    out->reasons.push_back("every worker that could run it is draining");
  } else if (able == draining + unable) {
    out->reasons.push_back("no worker that knows its kind can run anything for now (" + why + ")");
  } else {
    size_t ahead = 0;
    for (const auto& entry : cls.ready) {
      if (entry.task == MakeTaskId(job.id, index)) break;
      ++ahead;
    }
    out->reasons.push_back("all " + std::to_string(busy) + " workers that could run it are busy; " +
                           std::to_string(ahead) + " tasks of its kind are ahead of it");
  }
}

}  // namespace

Explanation Explain(const State& state, const Job& job, uint32_t index) {
  Explanation out;
  const Task& task = job.tasks[index];
  if (job.record.phase == JobPhase::kPaused) out.reasons.push_back("its job is paused");
  if (job.is_overdue) out.reasons.push_back("the time limit of its job is over");
  if (!job.waits_for.empty()) ExplainJobsBefore(job, &out);
  switch (PhaseOf(task.status)) {
    case TaskPhase::kWaiting:
      ExplainParents(job, index, &out);
      break;
    case TaskPhase::kReady: {
      Explanation placement;
      ExplainPlacement(state, job, index, &placement);
      out.placeable = placement.placeable;
      const auto failed = job.failed_on.find(index);
      if (failed != job.failed_on.end() && out.placeable)
        out.reasons.push_back("it failed on " + failed->second +
                              ", which gets it again only while no other can run it");
      if (!job.is_held())  // else who is busy is not why
        out.reasons.insert(out.reasons.end(), placement.reasons.begin(), placement.reasons.end());
      break;
    }
    case TaskPhase::kLeased: {
      const Lease& lease = state.leases.at(std::get<TaskLeased>(task.status).token);
      out.reasons.push_back("it runs on " + lease.worker + ", attempt " + std::to_string(lease.attempt));
      break;
    }
    case TaskPhase::kUncertain: {
      const Lease& lease = state.leases.at(std::get<TaskUncertain>(task.status).token);
      out.reasons.push_back("it may have run on " + lease.worker +
                            ", which was lost; it runs at most once: `retry` lets it run again");
      break;
    }
    case TaskPhase::kSucceeded:
      out.reasons.push_back("it is done");
      break;
    case TaskPhase::kFailed:
      out.reasons.push_back("it failed" +
                            std::string(job.record.reason.empty() ? "" : ": " + job.record.reason));
      break;
    case TaskPhase::kCancelled:
      out.reasons.push_back("it was cancelled" +
                            std::string(job.record.reason.empty() ? "" : ": " + job.record.reason));
      break;
  }
  return out;
}

std::string WhyItWaits(const State& state, const Job& job) {
  if (IsFinal(job.record.phase) || job.is_held()) return "";
  for (const Task& task : job.tasks) {
    if (const auto* leased = std::get_if<TaskLeased>(&task.status)) {
      const Lease& lease = state.leases.at(leased->token);
      return lease.progress_stage == kWaitingStage ? lease.progress_note : "";
    }
    if (!std::holds_alternative<TaskReady>(task.status)) continue;
    std::string why;
    for (const auto& [name, worker] : state.workers) {
      if (!worker.connected || worker.draining || !CanRun(worker, state.classes[task.scheduling_class])) continue;
      if (worker.why_unable().empty()) return "";
      why = worker.name + ": " + worker.why_unable();
    }
    return why;
  }
  return "";
}

}  // namespace rg::coordinator
