// Base parameters: the combinations that the data determine, by name (Gautier & Khalil 1990).
//
// Few of a robot's inertial parameters can be found one by one, sums of them can: link 1 of a planar arm
// turns with I_yy.link_1 + L² mass.link_2, whatever the terms are. Here they are taken from the data's
// own information matrix, so that what this motion and these sensors leave open is open here too:
//
//   columns in units of the prior, pivoted Cholesky S = Π (Rᵀ R) Πᵀ, stopped where a further column brings
//   less information than its prior has;  base parameter k:  x_k + Σ_j (R1⁻¹ R2)_kj (d_k / d_j) x_j
//
// over the columns j that are no pivots. The ten parameters of a link are first taken to those in which
// dynamics is linear: mass, first moments mass·com, inertia about the origin of the link's frame.
// Terms that do not matter beside the combination's own uncertainty are left out.
#pragma once

#include <Eigen/Core>
#include <string>
#include <utility>
#include <vector>

namespace rg::sysid {

struct BaseParameter {
  // "I_yy.upper_arm + 0.1225 mass.forearm"; the first term's factor is 1.
  std::string expression;
  std::string unit;  // of the first term
  double value = 0.0, nominal = 0.0;
  double stddev = 0.0;        // posterior, of the expression as written
  double prior_stddev = 0.0;  // the same before the data
  double shrink = 1.0;        // stddev / prior_stddev
  std::vector<std::pair<std::string, double>> terms;
};

struct BaseParameters {
  std::vector<BaseParameter> parameters;  // best determined first
  // Coordinates that appear in none of them: the prior alone says what they are.
  std::vector<std::string> prior_only;
};

// All vectors P; matrices P × P.
struct BaseParameterInput {
  const std::vector<std::string>* names = nullptr;
  const std::vector<std::string>* units = nullptr;
  Eigen::VectorXd value, nominal, prior_stddev;
  Eigen::MatrixXd information;  // of the data alone
  Eigen::MatrixXd covariance;   // posterior
};

BaseParameters FindBaseParameters(const BaseParameterInput& input);

}  // namespace rg::sysid
