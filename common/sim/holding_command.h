// What a drive was told before a recording begins, which it still follows where it is late or a motor sits
// behind a spring: a robot that rests in the first row was held there.
#pragma once

#include <Eigen/Core>

#include "common/sim/command_signal.h"
#include "common/sim/simulator.h"

namespace rg::sim {

// n: the command nearest to `u` (along the Newton steps towards it) under which the simulator's model stays
// at rest at q, but for what friction lets it creep; `u` itself where that holds it, or where none is found.
// What the drive adds by itself, its own gravity compensation, counts as part of it.
Eigen::VectorXd HoldingCommand(Simulator& simulator, const Eigen::VectorXd& q, const Eigen::VectorXd& u);

// `command` with `held` in force before it begins. Of a command that is interpolated between rows: as it is.
CommandSignal HeldBefore(const CommandSignal& command, const Eigen::VectorXd& held);

}  // namespace rg::sim
