// One joint's angle without turns: the arm counts them (440° after a way of more than one turn) or, after
// its own restart, does not; limits, models and policies know one branch.
//
// The first raw angle is taken to the branch nearest to `reference`; later ones stay on it, and a jump of
// the raw angle by (nearly) whole turns, which no joint can make, is taken back. No clock. One thread.
#pragma once

#include "robot_agent/drivers/kinova/units.h"

namespace rg::robot_agent::kinova {

class Unwrapper {
 public:
  // `continuous`: the joint can turn for ever. One that cannot has raw angles inside its limits, and
  // nothing is done to them.
  Unwrapper(bool continuous, Radians reference) : continuous_(continuous), reference_(reference) {}

  // The angle on the branch of `reference`, continuous from call to call.
  Radians Unwrap(Radians raw);
  // The raw angle that the arm has to be asked for to come to `angle` without an extra turn; after Unwrap.
  Radians Raw(Radians angle) const { return {angle.value + turns_ * kTurn}; }
  // How many turns the raw angle is ahead.
  int turns() const { return turns_; }
  // Forget the branch (after an outage): the next angle chooses anew, near `reference`.
  void Restart(Radians reference) { reference_ = reference; }

 private:
  static constexpr double kTurn = 2.0 * kPi;

  const bool continuous_;
  Radians reference_;
  int turns_ = 0;
};

}  // namespace rg::robot_agent::kinova
