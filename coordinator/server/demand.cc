#include "coordinator/server/demand.h"

#include <algorithm>
#include <filesystem>
#include <system_error>
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

void AddSeconds(const State& state, realitygrad::v1::StatusReply* reply) {
  for (const auto& [name, kind] : state.kinds) {
    if (kind.finished == 0) continue;
    auto* seconds = reply->add_seconds();
    seconds->set_kind(name);
    for (size_t i = 0; i < kind.at_most.size(); ++i) {
      seconds->add_at_most(KindSeconds::kAtMost[i]);
      seconds->add_count(kind.at_most[i]);
    }
    seconds->add_count(kind.finished);
    seconds->set_sum(kind.sum);
  }
}

void AddRoom(const std::string& database_path, realitygrad::v1::StatusReply* reply) {
  std::error_code error;
  const auto bytes = std::filesystem::file_size(database_path, error);
  if (error) return;
  reply->set_database_bytes(bytes);
  const auto disk = std::filesystem::space(database_path, error);
  if (!error) reply->set_disk_free_bytes(disk.available);
}

double OldestReadySeconds(const State& state, int64_t wall_ns) {
  int64_t oldest_ns = wall_ns;
  for (const SchedulingClass& cls : state.classes) {
    for (const auto& entry : cls.ready) oldest_ns = std::min(oldest_ns, state.FindJob(JobOf(entry.task))->record.submitted_ns);
  }
  return 1e-9 * static_cast<double>(wall_ns - oldest_ns);
}

}  // namespace rg::coordinator
