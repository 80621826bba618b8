// Which parameters a fit may move, between which bounds, and what is believed beforehand.
//
// Inertial parameters are chosen once per moving body: of the links lumped into it, the heaviest one is
// fitted; its rigidly attached neighbours stay as the URDF has them, since only the sum can be seen.
// Base links move nothing and are left out. The paper's own choice (71 raw parameters, every link) is
// PaperParameters, see paper_problem.h.
//
// Prior stddev, from what URDFs of real arms are wrong by:
//   mass      0.25 · m             bounds 0.1 m … 4 m
//   com       0.25 · r + 5 mm      r: radius of gyration sqrt(tr I / 2m); bounds ± 6 stddev
//   inertia   0.5 · max(I_ii) + m·(1 cm)²; bounds of the diagonal ≥ 0.02 of nominal
//   effects and the URDF's damping and friction: the catalogue's prior and physical bounds
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "common/sim/plant.h"

namespace rg::sysid {

struct FitParameter {
  int index = 0;  // into the plant's ParameterTable
  std::string name;
  std::string unit;
  double nominal = 0.0;
  double lower = 0.0, upper = 0.0;
  double prior_stddev = 1.0;  // > 0
};

// Mass, com and inertia of the heaviest link of each moving body.
std::vector<FitParameter> InertialFitParameters(const sim::Plant& plant);
// damping.<joint> (and friction.<joint> where the URDF declares any) of every joint.
std::vector<FitParameter> DeclaredJointFitParameters(const sim::Plant& plant);
// armature.<joint> where the links bring no inertia, around their nominal values, which are positive
// (rotor_start.h).
std::vector<FitParameter> RotorFitParameters(const sim::Plant& plant);
// All parameters of all effects.
std::vector<FitParameter> EffectFitParameters(const sim::Plant& plant);
// By their places in the plant's table.
std::vector<FitParameter> FitParametersAt(const sim::Plant& plant, const std::vector<int>& indices);
// By name. Error: the closest existing name.
Result<std::vector<FitParameter>> NamedFitParameters(const sim::Plant& plant,
                                                     const std::vector<std::string>& names);

Eigen::VectorXd PriorStddevs(const std::vector<FitParameter>& parameters);
std::vector<int> Indices(const std::vector<FitParameter>& parameters);
// `values` of the whole table with the fitted ones replaced by theta.
Eigen::VectorXd WithFitted(const std::vector<FitParameter>& parameters, Eigen::VectorXd values,
                           const Eigen::VectorXd& theta);

}  // namespace rg::sysid
