// Draws what is hidden in a case: effects, joints, strengths, and the label that says so.
#pragma once

#include <Eigen/Core>
#include <array>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "common/base/rng.h"
#include "services/proof/generator/truth.h"

namespace rg::proof {

// What strengths are measured in.
struct Scales {
  std::vector<std::string> joints, links;
  std::vector<bool> prismatic;
  Eigen::VectorXd torque;           // RMS of the drive torque in the nominal motion, n
  Eigen::VectorXd motion_torque;    // RMS of its part that gravity does not explain, n
  Eigen::VectorXd peak_torque;      // largest drive torque in it, n
  Eigen::VectorXd zero_matters;     // share of the torque that changes with the joint's zero by 0.05 of it, n
  Eigen::VectorXd velocity;         // RMS, n
  Eigen::VectorXd inertia;          // diag M at home, n
  Eigen::VectorXd home, amplitude;  // n
  double tip_low = 0, tip_high = 0;        // heights the last link reaches, m
  std::array<double, 3> tool = {0, 0, 0};  // from the last joint, in its link's frame, m
  double last_mass = 1;                    // of the last link with its payload, kg
  double duration_s = 7;
};

// Ids of EFFECTS.md that the generator can make ("none" and "parameters_only" among them).
const std::vector<std::string>& KnownEffects();

// Strengths at which these effects have figures that robots have, together.
struct StrengthRange {
  double low = 0.01, high = 8;
};
StrengthRange StrengthsOf(const std::vector<std::string>& effects);

// A figure of a label with its unit, which is given for a revolute joint: m for rad, N for N·m and kg for
// kg·m² on a prismatic one.
nlohmann::json UnitValue(double value, std::string unit, bool prismatic);

// Adds effect `id` at `strength` (1: usual) to the truth; same rng, same joints and proportions.
// The returned label entry is as in label.json: id, joints, localisation, parameters, equivalents.
nlohmann::json AddEffect(const std::string& id, double strength, const Scales& scales, Rng rng, Truth* truth);

}  // namespace rg::proof
