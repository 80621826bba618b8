// Linearises a fitted plant in candidate forces beside its parameters, for tests that need no fit of their
// own.
//
// δτ of lifted_fit.h are features: candidate forces as functions of the motion. Their columns beside
// those of the parameters let all hypotheses be tested with one linearisation.
#pragma once

#include <Eigen/Core>
#include <vector>

#include "common/base/rng.h"
#include "services/diagnosis/likelihood/free_force.h"
#include "services/diagnosis/likelihood/lifted_fit.h"

namespace rg::diagnosis {

// Forces per unit coefficient: of C columns on one joint each, and after these of R on all joints at once.
struct FeatureBlock {
  std::vector<int> joint;          // C
  std::vector<MatrixXd> phi;       // C × N (per window, feature, interval)
  std::vector<MatrixXd> on_robot;  // n·N × R, intervals of joint after joint; empty: none
  int size() const {
    return static_cast<int>(joint.size()) + (on_robot.empty() ? 0 : static_cast<int>(on_robot[0].cols()));
  }
};

// Normal equations in (θ, features, residual), e_0 eliminated, whitened and divided by the noise scale:
// gram is (P + C + 1)², its last row and column belong to the residual.
struct Screen {
  MatrixXd gram;
  MatrixXd null;       // (P + C) × draws: right-hand sides if the residual were the sensors' noise alone
  VectorXd step_rule;  // P + C: the right-hand side that another step rule makes
  // Of the force that was integrated out: ½ log det(1 + H), H the information on its segments, and
  // tr H (1 + H)⁻¹, rows that it fits whatever they are.
  double force_log_det = 0, force_unknowns = 0;
  int parameters = 0, features = 0;
  int rows = 0;  // of the windows that could be linearised
  double work = 0;
};

// Another step rule stands for what nobody knows of an engine or of a robot's timing: what the whitened
// outputs of every window change by when it is simulated by semi-implicit Euler at 0.2 ms, as careful users
// of the field's simulators do. An effect that explains no more than that is none.
LiftedOptions OtherStepRule(LiftedOptions options);
std::vector<VectorXd> StepRuleResiduals(const FitData& data, const FitModel& model, const NodeStates& states,
                                        const LiftedOptions& options);
// Nats that the model's free parameters would gain from another step rule alone.
double StepRuleGain(const FitData& data, const FitModel& model, const NodeStates& states,
                    const LiftedOptions& options);
// `step_rule`: StepRuleResiduals; empty: none.
Screen MakeScreen(const FitData& data, const FitModel& model, const NodeStates& states,
                  const FeatureBlock& features, const LiftedOptions& options,
                  const std::vector<VectorXd>& step_rule, int null_draws, Rng rng);
// One for each joint of `force`, with the force there alone integrated out, from one linearisation; the first
// has the work of all.
std::vector<Screen> MakeScreens(const FreeForce& force, const FitData& data, const FitModel& model,
                                const NodeStates& states, const FeatureBlock& features,
                                const LiftedOptions& options, int null_draws, Rng rng);

}  // namespace rg::diagnosis
