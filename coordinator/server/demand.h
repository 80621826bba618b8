// What there is to do for workers, class by class: the one figure by which they are added and taken away.
#pragma once

#include "coordinator/core/state.h"
#include "coordinator/server/policy.h"
#include "realitygrad/v1/control.pb.h"

namespace rg::coordinator {

// As many steps as there are classes and leases.
void AddDemand(const State& state, const Policy& policy, realitygrad::v1::StatusReply* reply);

// How long tasks ran, by kind.
void AddSeconds(const State& state, realitygrad::v1::StatusReply* reply);
// The database's size and what is left of its disk; nothing of one in memory.
void AddRoom(const std::string& database_path, realitygrad::v1::StatusReply* reply);
double OldestReadySeconds(const State& state, int64_t wall_ns);

}  // namespace rg::coordinator
