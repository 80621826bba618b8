#include "services/sysid/base_parameters.h"

#include <Eigen/LU>
#include <algorithm>
#include <array>
#include <cmath>

#include "common/base/printf.h"
#include "common/model/robot_model.h"

namespace rg::sysid {
namespace {

using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;
using Matrix10 = Eigen::Matrix<double, 10, 10>;
using Vector10 = Eigen::Matrix<double, 10, 1>;

constexpr double kLeastInformation = 0.1;   // of a column in units of its prior: shrinks its stddev by 5 %
constexpr double kRounding = 1e-11;         // of the largest column: what a Cholesky leaves of zero
constexpr double kSlack = 1.05;             // an expression's stddev against the whole combination's
constexpr double kTermShrink = 0.95;        // of a combination that still is one of the data
constexpr double kReluctanceToMass = 0.02;  // literature writes masses of outer links into inner inertias
constexpr double kReluctanceToProduct = 0.5;

constexpr std::array<const char*, 10> kLinearNames = {"mass", "moment_x", "moment_y", "moment_z", "I_xx",
                                                      "I_yy", "I_zz",     "I_xy",     "I_xz",     "I_yz"};
constexpr const char* kMomentUnit = "kg*m";

// (mass, m c, I about the frame's origin) of (mass, c, I about the com).
Vector10 Linear(const Vector10& p) {
  const Vector3d c = p.segment<3>(1);
  Vector10 out = p;
  out.segment<3>(1) = p[0] * c;
  const Matrix3d steiner = p[0] * (c.squaredNorm() * Matrix3d::Identity() - c * c.transpose());
  out[4] += steiner(0, 0);
  out[5] += steiner(1, 1);
  out[6] += steiner(2, 2);
  out[7] += steiner(0, 1);
  out[8] += steiner(0, 2);
  out[9] += steiner(1, 2);
  return out;
}

// Its derivative: Linear is of second degree in c and linear in the others, so differences over one step
// to either side are exact but for rounding.
Matrix10 LinearJacobian(const Vector10& p) {
  Matrix10 J;
  for (int k = 0; k < 10; ++k) {
    Vector10 plus = p, minus = p;
    plus[k] += 1.0;
    minus[k] -= 1.0;
    J.col(k) = 0.5 * (Linear(plus) - Linear(minus));
  }
  return J;
}

// The coordinates x in which combinations are looked for.
struct Coordinates {
  std::vector<std::string> names, units;
  std::vector<double> reluctance;  // factor on a column's information when pivots are chosen
  VectorXd value, nominal;
  MatrixXd dx_dp;
};

// Parameters first … first + 9 are all of one link, in the model's order.
bool IsLink(const std::vector<std::string>& names, size_t first, std::string* link) {
  if (first + 10 > names.size() || !names[first].starts_with("mass.")) return false;
  *link = names[first].substr(4);
  for (size_t k = 0; k < 10; ++k) {
    if (names[first + k] != std::string(model::kLinkParameterNames[k]) + *link) return false;
  }
  return true;
}

double ReluctanceTo(const std::string& name) {
  if (name.starts_with("mass.")) return kReluctanceToMass;
  const bool product = name.starts_with("I_xy") || name.starts_with("I_xz") || name.starts_with("I_yz");
  return product ? kReluctanceToProduct : 1.0;
}

Coordinates LinearCoordinates(const BaseParameterInput& in) {
  const auto P = static_cast<int>(in.names->size());
  Coordinates x{*in.names, *in.units, {}, in.value, in.nominal, MatrixXd::Identity(P, P)};
  std::string link;
  for (int i = 0; i < P; ++i) {
    if (!IsLink(*in.names, i, &link)) continue;
    x.dx_dp.block<10, 10>(i, i) = LinearJacobian(in.value.segment<10>(i));
    x.value.segment<10>(i) = Linear(in.value.segment<10>(i));
    x.nominal.segment<10>(i) = Linear(in.nominal.segment<10>(i));
    for (int k = 0; k < 10; ++k) x.names[i + k] = kLinearNames[k] + link;
    for (int k = 1; k <= 3; ++k) x.units[i + k] = kMomentUnit;
    i += 9;
  }
  for (const std::string& name : x.names) x.reluctance.push_back(ReluctanceTo(name));
  return x;
}

// Pivots and, for the other columns, R1⁻¹ R2.
struct Factor {
  std::vector<int> pivots, others;
  MatrixXd dependence;  // pivots × others
};

Factor PivotedCholesky(const MatrixXd& S, const std::vector<double>& reluctance) {
  const int P = static_cast<int>(S.rows());
  const double least = std::max(kLeastInformation, kRounding * S.diagonal().maxCoeff());
  MatrixXd R(P, P);  // row k: of pivot k, over all columns
  VectorXd left = S.diagonal();
  std::vector<bool> taken(P, false);
  Factor out;
  while (static_cast<int>(out.pivots.size()) < P) {
    int best = -1;
    for (int i = 0; i < P; ++i) {
      if (taken[i] || left[i] < least) continue;
      if (best < 0 || left[i] * reluctance[i] > left[best] * reluctance[best]) best = i;
    }
    if (best < 0) break;
    const int k = static_cast<int>(out.pivots.size());
    R.row(k) = (S.row(best) - R.col(best).head(k).transpose() * R.topRows(k)) / std::sqrt(left[best]);
    left -= R.row(k).cwiseAbs2().transpose();
    taken[best] = true;
    out.pivots.push_back(best);
  }
  for (int i = 0; i < P; ++i) {
    if (!taken[i]) out.others.push_back(i);
  }
  const int K = static_cast<int>(out.pivots.size());
  const MatrixXd R1 = R.topRows(K)(Eigen::all, out.pivots), R2 = R.topRows(K)(Eigen::all, out.others);
  out.dependence = R1.triangularView<Eigen::Upper>().solve(R2);
  return out;
}

std::string Short(double factor) { return Printf("%.4g", std::abs(factor)); }

// Terms of the same factor share it: "moment_y.link_2 - 0.29 (mass.link_3 + mass.link_4)".
std::string Expression(const std::vector<std::pair<std::string, double>>& terms) {
  std::string out = terms.front().first;
  std::vector<bool> written(terms.size(), false);
  for (size_t i = 1; i < terms.size(); ++i) {
    if (written[i]) continue;
    const std::string factor = Short(terms[i].second);
    std::string names;
    int count = 0;
    for (size_t j = i; j < terms.size(); ++j) {
      if (written[j] || Short(terms[j].second) != factor || terms[j].second * terms[i].second < 0.0) continue;
      written[j] = true;
      names += (count++ > 0 ? " + " : "") + terms[j].first;
    }
    out += (terms[i].second < 0.0 ? " - " : " + ") + (factor == "1" ? "" : factor + " ") +
           (count > 1 ? "(" + names + ")" : names);
  }
  return out;
}

class Finder {
 public:
  explicit Finder(const BaseParameterInput& in) : x_(LinearCoordinates(in)) {
    covariance_ = x_.dx_dp * in.covariance * x_.dx_dp.transpose();
    prior_ = x_.dx_dp * in.prior_stddev.cwiseAbs2().asDiagonal() * x_.dx_dp.transpose();
    unit_ = prior_.diagonal().cwiseSqrt();
    const MatrixXd dp_dx = x_.dx_dp.inverse();
    const auto D = unit_.asDiagonal();
    factor_ = PivotedCholesky(D * (dp_dx.transpose() * in.information * dp_dx) * D, x_.reluctance);
  }

  BaseParameters Run() const {
    BaseParameters out;
    std::vector<bool> named(x_.names.size(), false);
    for (size_t k = 0; k < factor_.pivots.size(); ++k) {
      std::vector<int> columns;
      BaseParameter base = Describe(static_cast<int>(k), &columns);
      if (base.shrink >= kTermShrink) continue;
      for (const int column : columns) named[column] = true;
      out.parameters.push_back(std::move(base));
    }
    for (size_t i = 0; i < named.size(); ++i) {
      if (!named[i]) out.prior_only.push_back(x_.names[i]);
    }
    std::stable_sort(out.parameters.begin(), out.parameters.end(),
                     [](const auto& a, const auto& b) { return a.shrink < b.shrink; });
    return out;
  }

 private:
  double Spread(const MatrixXd& covariance, const VectorXd& c) const {
    return std::sqrt(std::max(0.0, c.dot(covariance * c)));
  }

  // Terms by their weight until the expression is as certain as the whole combination.
  BaseParameter Describe(int k, std::vector<int>* columns) const {
    const int pivot = factor_.pivots[k];
    std::vector<std::pair<double, int>> weights;  // |weight|, position among the others
    VectorXd whole = VectorXd::Zero(unit_.size());
    whole[pivot] = 1.0;
    for (size_t j = 0; j < factor_.others.size(); ++j) {
      const int column = factor_.others[j];
      whole[column] = factor_.dependence(k, j) * unit_[pivot] / unit_[column];
      weights.emplace_back(std::abs(factor_.dependence(k, j)), column);
    }
    std::sort(weights.rbegin(), weights.rend());
    const double best = Spread(covariance_, whole);
    VectorXd c = VectorXd::Zero(unit_.size());
    c[pivot] = 1.0;
    BaseParameter out;
    out.terms.emplace_back(x_.names[pivot], 1.0);
    columns->push_back(pivot);
    for (const auto& [weight, column] : weights) {
      if (Spread(covariance_, c) <= kSlack * best) break;
      c[column] = whole[column];
      out.terms.emplace_back(x_.names[column], whole[column]);
      columns->push_back(column);
    }
    out.expression = Expression(out.terms);
    out.unit = x_.units[pivot];
    out.value = c.dot(x_.value);
    out.nominal = c.dot(x_.nominal);
    out.stddev = Spread(covariance_, c);
    out.prior_stddev = Spread(prior_, c);
    out.shrink = out.stddev / out.prior_stddev;
    return out;
  }

  Coordinates x_;
  MatrixXd covariance_, prior_;
  VectorXd unit_;  // marginal prior stddev of x
  Factor factor_;
};

}  // namespace

BaseParameters FindBaseParameters(const BaseParameterInput& input) {
  if (input.names->empty()) return {};
  return Finder(input).Run();
}

}  // namespace rg::sysid
