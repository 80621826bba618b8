#include "coordinator/server/demand.h"

#include <algorithm>
#include <vector>

namespace rg::coordinator {

void AddDemand(const State& state, const Policy& policy, realitygrad::v1::StatusReply* reply) {
  std::vector<uint64_t> running(state.classes.size());
  for (const auto& [token, lease] : state.leases) {
    const Job* job = state.FindJob(JobOf(lease.task));
    if (job == nullptr || !state.Holds(lease.task, token)) continue;
    const TaskPlan& plan = job->plan_of(IndexOf(lease.task));
    std::vector<std::string> tags = plan.required_tags;
    std::sort(tags.begin(), tags.end());
    const auto found = state.class_index.find({plan.kind, tags});
    if (found != state.class_index.end()) ++running[found->second];
  }
  for (size_t i = 0; i < state.classes.size(); ++i) {
    const SchedulingClass& cls = state.classes[i];
    if (cls.ready.empty() && running[i] == 0) continue;
    auto* demand = reply->add_demand();
    demand->set_kind(cls.kind);
    for (const std::string& tag : cls.tags) demand->add_tags(tag);
    demand->set_ready(cls.ready.size());
    demand->set_running(running[i]);
    demand->set_robot(policy.robot_kinds.count(cls.kind) > 0);
  }
}

}  // namespace rg::coordinator
