// Small job graphs for tests of the core.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "common/base/rng.h"
#include "coordinator/core/types.h"

namespace rg::coordinator {

inline TaskPlan MakeTask(std::string name, std::vector<ParentEdge> parents = {}, std::string kind = "work") {
  TaskPlan task;
  task.name = std::move(name);
  task.stage = kind;
  task.kind = std::move(kind);
  task.parents = std::move(parents);
  return task;
}

inline std::shared_ptr<const JobPlan> MakePlan(std::vector<TaskPlan> tasks, int32_t priority = 0) {
  auto plan = std::make_shared<JobPlan>();
  plan->kind = "test";
  plan->name = "test";
  plan->submitted_by = "tester";
  plan->priority = priority;
  for (TaskPlan& task : tasks) task.priority += priority;
  plan->tasks = std::move(tasks);
  return plan;
}

// Up to nine tasks with random parents, kinds, limits and options.
inline std::shared_ptr<const JobPlan> RandomPlan(Rng& rng) {
  std::vector<TaskPlan> tasks;
  const uint32_t count = 1 + static_cast<uint32_t>(rng.Index(9));
  for (uint32_t i = 0; i < count; ++i) {
    TaskPlan task = MakeTask("t" + std::to_string(i), {}, rng.Index(4) == 0 ? "other" : "work");
    for (uint32_t p = 0; p < i; ++p) {
      if (rng.Index(3) == 0) task.parents.push_back({p, rng.Index(4) == 0});
    }
    if (rng.Index(5) == 0) task.required_tags = {"robot:one"};
    task.at_most_once = rng.Index(4) == 0;
    task.max_attempts = 1 + static_cast<uint32_t>(rng.Index(3));
    task.crash_limit = 1 + static_cast<uint32_t>(rng.Index(3));
    task.priority = static_cast<int32_t>(rng.Index(3));
    tasks.push_back(std::move(task));
  }
  return MakePlan(std::move(tasks), static_cast<int32_t>(rng.Index(2)));
}

}  // namespace rg::coordinator
