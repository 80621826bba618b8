// What the data determine, what they hardly do, and what is only the prior.
//
// With H the data's information on the parameters (P × P, initial states eliminated, residuals whitened)
// and D = diag(prior stddev), the eigenvalues λ of D·H·D compare data and prior along their directions:
// the data shrink the stddev there to 1/sqrt(1 + λ) of the prior's. λ does not depend on units, and a
// direction that cannot be seen (three links of the Mico² never move anything) has λ = 0 exactly.
//
//   direction: determined  1/sqrt(1+λ) ≤ kDeterminedShrink;  unseen  ≥ kUnseenShrink;  weak between
//   parameter: the same on sqrt(C_ii)/prior_i, C = (H + D⁻²)⁻¹; at_bound comes first
//
// A parameter may be weak although a combination that holds it is determined (mass · com): read both.
#pragma once

#include <Eigen/Core>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>
#include <vector>

#include "services/sysid/base_parameters.h"

namespace rg::sim {
class Plant;
}

namespace rg::sysid {

inline constexpr double kDeterminedShrink = 0.2;
inline constexpr double kUnseenShrink = 0.95;
inline constexpr double kStrongCorrelation = 0.95;

enum class Verdict { kDetermined, kWeak, kUnseen, kAtBound };
Verdict VerdictOfShrink(double shrink);         // of a direction, see above
std::string_view VerdictName(Verdict verdict);  // "determined", "weak", "prior_only", "at_bound"

// All vectors P.
struct IdentifiabilityInput {
  std::vector<std::string> names;
  std::vector<std::string> units;
  Eigen::VectorXd value, nominal;
  Eigen::VectorXd lower, upper;  // ±infinity where there is no bound
  Eigen::VectorXd prior_stddev;  // > 0; where there is no prior, a typical range
  Eigen::MatrixXd information;   // P × P, H above
  // > 0: variance of the whitened residuals (1 when the noise is what was assumed). H is divided by it.
  double residual_variance = 1.0;
};

struct ParameterVerdict {
  std::string name, unit;
  double value = 0.0, nominal = 0.0, prior_stddev = 0.0;
  double stddev = 0.0;  // posterior
  double shrink = 1.0;  // stddev / prior_stddev
  Verdict verdict = Verdict::kUnseen;
};

struct Direction {
  double shrink = 1.0;
  Verdict verdict = Verdict::kUnseen;
  // The largest components, in units of the prior stddev, of unit norm over all parameters.
  std::vector<std::pair<int, double>> loadings;
};

struct Correlation {
  int a = 0, b = 0;
  double value = 0.0;
};

// Mass and inertia (about the com) of one link as fitted.
struct LinkInertia {
  std::string link;
  double mass = 0.0;
  Eigen::Matrix3d inertia;
};

struct IdentifiabilityReport {
  std::vector<ParameterVerdict> parameters;
  std::vector<Direction> directions;         // strongest first, all P
  int determined = 0, weak = 0, unseen = 0;  // directions of each kind
  BaseParameters base;                       // the same as sums that a person can read
  std::vector<Correlation> correlations;     // |ρ| > kStrongCorrelation, strongest first
  Eigen::MatrixXd covariance;                // P × P, posterior
  std::vector<std::string> warnings;
};

IdentifiabilityReport Identify(const IdentifiabilityInput& input);

// H = JᵀJ of a whitened Jacobian (m × P).
Eigen::MatrixXd InformationOf(const Eigen::Ref<const Eigen::MatrixXd>& jacobian);

// One line per link that no body can have: negative mass, a negative principal inertia, or one larger
// than the sum of the other two (beyond 1e-9 of the largest). Links of zero mass and inertia are fine.
std::vector<std::string> ImpossibleInertias(const std::vector<LinkInertia>& links);
// The same of the plant's links at `values` (its whole table); links that the URDF gives no inertia are left
// out.
std::vector<std::string> ImpossibleInertias(const sim::Plant& plant, const Eigen::VectorXd& values);

// A table for a person: one line per parameter, then base parameters, what only the prior says, weak
// combinations, correlations and warnings.
std::string FormatIdentifiability(const IdentifiabilityReport& report);
nlohmann::json IdentifiabilityToJson(const IdentifiabilityReport& report);

}  // namespace rg::sysid
