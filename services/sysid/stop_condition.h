// When long numerical work must end early: a time budget on a clock that is an argument, a cancel
// token, or both. Solvers ask between and inside evaluations, so that a budget is kept to within the
// time of one evaluation.
#pragma once

#include "common/base/clock.h"
#include "common/base/progress.h"

namespace rg::sysid {

class StopCondition {
 public:
  StopCondition() = default;  // never stops
  // Stops `seconds` after now on `clock`, or when `cancel` (may be null) is set.
  StopCondition(const Clock& clock, double seconds, const CancelToken* cancel = nullptr)
      : clock_(&clock), deadline_s_(clock.SteadySeconds() + seconds), cancel_(cancel) {}
  explicit StopCondition(const CancelToken* cancel) : cancel_(cancel) {}

  bool ShouldStop() const {
    if (cancel_ != nullptr && cancel_->cancelled()) return true;
    return clock_ != nullptr && clock_->SteadySeconds() >= deadline_s_;
  }

 private:
  const Clock* clock_ = nullptr;
  double deadline_s_ = 0.0;
  const CancelToken* cancel_ = nullptr;
};

}  // namespace rg::sysid
