// What produces torques during a rollout. Called in the control cycle: no allocation, no lock, bounded time.
#pragma once

#include <functional>
#include <utility>

namespace rg::robot_agent {

class Controller {
 public:
  virtual ~Controller() = default;
  // t: s since the rollout's start. q, v: n, measured. tau: n, the whole joint torque, gravity
  // included [N·m]. May produce NaN; the safety monitor catches it.
  virtual void Command(double t, const double* q, const double* v, double* tau) = 0;
};

// A controller made of a callback (model predictive control run live, tests).
class FunctionController final : public Controller {
 public:
  using Function = std::function<void(double t, const double* q, const double* v, double* tau)>;
  explicit FunctionController(Function function) : function_(std::move(function)) {}
  void Command(double t, const double* q, const double* v, double* tau) override { function_(t, q, v, tau); }

 private:
  Function function_;
};

}  // namespace rg::robot_agent
