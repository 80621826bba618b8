// The reactor with its store in memory; after each event the promises are checked, and that a restart would
// change nothing.
#pragma once

#include <gtest/gtest.h>

#include <string>
#include <utility>
#include <vector>

#include "coordinator/core/explain.h"
#include "coordinator/core/invariants.h"
#include "coordinator/core/reactor.h"
#include "tests/unit/coordinator/memory_store.h"
#include "tests/unit/coordinator/plans.h"

namespace rg::coordinator {

class ReactorTest : public ::testing::Test {
 protected:
  Actions Do(const Event& event) {
    Actions actions = On(event, state_, {ns_, 1'000 + ns_});
    store_.Apply(actions.rows);
    for (const std::string& line : BrokenInvariants(state_)) ADD_FAILURE() << line;
    for (const std::string& line :
         Differences(Describe(state_), Describe(Restore(store_.Load(), state_.options, {})))) {
      ADD_FAILURE() << "a restart would change: " << line;
    }
    return actions;
  }
  void Pass(double heartbeats) {
    ns_ += static_cast<int64_t>(heartbeats * static_cast<double>(state_.options.heartbeat_ns));
  }
  void Join(const std::string& name, uint32_t slots = 1, std::vector<Token> held = {},
            std::vector<std::string> tags = {}) {
    last_ = Do(WorkerJoined{name,
                            name + "#1",
                            slots,
                            std::move(tags),
                            {"work", "other"},
                            std::move(held),
                            false,
                            "h",
                            1,
                            "v",
                            ""});
  }
  JobId SubmitJob(std::vector<TaskPlan> tasks, int32_t priority = 0) {
    last_ = Do(Submit{"r" + std::to_string(++requests_), MakePlan(std::move(tasks), priority), nullptr, 1});
    return state_.last_job;
  }
  template <class M>
  std::vector<M> Sent(const Actions& actions) {
    std::vector<M> found;
    for (const Message& message : actions.messages) {
      if (const auto* m = std::get_if<M>(&message)) found.push_back(*m);
    }
    return found;
  }
  TaskPhase Phase(JobId job, uint32_t index) { return PhaseOf(state_.jobs.at(job).tasks[index].status); }
  JobPhase Phase(JobId job) { return state_.jobs.at(job).record.phase; }

  State state_;
  MemoryStore store_;
  Actions last_;
  int64_t ns_ = 1'000'000'000'000;
  int requests_ = 0;
};

}  // namespace rg::coordinator
