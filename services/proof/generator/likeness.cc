#include "services/proof/generator/likeness.h"

#include <Eigen/Cholesky>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>

#include "services/proof/generator/tuning.h"

namespace rg::proof {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr int kRounds = 10;
constexpr double kFurthest = 3;        // priors
constexpr double kFurthestStep = 0.5;  // prior, in one round
constexpr double kDampingPrior = 1.0;  // N·m·s/rad or N·s/m
constexpr double kStep = 1e-3;         // of a prior: for the differences
constexpr double kDone = 0.01;         // of the misfit, that another round would gain
constexpr double kFarOff = 4.0;        // times the noise at best, by the tangent: no third round

Truth With(const Truth& without, const std::vector<std::string>& links, const VectorXd& theta) {
  Truth out = without;
  for (size_t l = 0; l < links.size(); ++l)
    out.links[links[l]] = Changed(out.links[links[l]], ChangeOf(theta, l));
  const auto n = static_cast<Eigen::Index>(out.joint.size());
  for (Eigen::Index i = 0; i < n; ++i) out.joint[static_cast<size_t>(i)].viscous += theta.tail(n)[i];
  return out;
}

// Deviations of a model and of others beside it (as of Comparison), without what other starts would make of
// them in each window of `columns`: the last 2n rows say what these make.
MatrixXd WithoutStarts(const MatrixXd& off, Eigen::Index n, Eigen::Index columns) {
  const Eigen::Index kept = off.rows() - 2 * n;
  MatrixXd out = off.topRows(kept);
  for (Eigen::Index first = 0; first + columns <= off.cols(); first += columns) {
    const auto window = off.middleCols(first, columns);
    const MatrixXd starts = (window.bottomRows(2 * n).rowwise() - window.row(0)).transpose();
    const MatrixXd left = window.topRows(kept).transpose();
    out.middleCols(first, columns) = (left - starts * starts.colPivHouseholderQr().solve(left)).transpose();
  }
  return out;
}

}  // namespace

double LeftByNearestBodies(const Comparison& compared, const Truth& truth, const std::vector<Track>& tracks,
                           const Truth& without, const std::vector<std::string>& links, double noise) {
  const auto n = static_cast<Eigen::Index>(without.joint.size());
  VectorXd prior(LinkPriors(links.size()).size() + n);
  prior << LinkPriors(links.size()), VectorXd::Constant(n, kDampingPrior);
  VectorXd theta = VectorXd::Zero(prior.size());
  double least = 1e300;
  for (int round = 0; round < kRounds; ++round) {
    std::vector<Rival> rivals = {{compared.bodies(), With(without, links, theta), Start::kTrue}};
    for (Eigen::Index k = 0; k < prior.size(); ++k) {
      VectorXd beside = theta;
      beside[k] += kStep * prior[k];
      rivals.push_back({compared.bodies(), With(without, links, beside), Start::kTrue});
    }
    for (int i = 0; i < 2 * static_cast<int>(n); ++i)
      rivals.push_back({compared.bodies(), With(without, links, theta), Start::kTrue, i});
    MatrixXd normal = prior.cwiseAbs2().cwiseInverse().asDiagonal();
    VectorXd gradient = theta.cwiseQuotient(prior.cwiseAbs2());
    double misfit = 0, count = 0, seconds = 0;
    for (const Track& track : tracks) {
      const MatrixXd off = WithoutStarts(compared.Deviations(truth, track, rivals) / noise, n,
                                         n * static_cast<Eigen::Index>(compared.rate_hz()));
      const Eigen::RowVectorXd r = off.row(0);
      const MatrixXd slope =
          (kStep * prior).cwiseInverse().asDiagonal() * (off.bottomRows(prior.size()).rowwise() - r);
      normal += slope * slope.transpose();
      gradient += slope * r.transpose();
      misfit += r.squaredNorm(), count += static_cast<double>(r.size());
      seconds += static_cast<double>(r.size()) / (static_cast<double>(n) * compared.rate_hz());
    }
    if (!std::isfinite(misfit)) break;  // these bodies ran away
    least = std::min(least, misfit / seconds);
    const VectorXd step = normal.ldlt().solve(gradient);
    const double gained = gradient.dot(step);
    // The first tangent says little of what is far off.
    const bool far = round > 0 && misfit - gained > kFarOff * kFarOff * count;
    if (gained <= kDone * misfit || far) break;
    // Mass, centre and inertia trade places along a curve.
    theta -= std::min(1.0, kFurthestStep / step.cwiseQuotient(prior).cwiseAbs().maxCoeff()) * step;
    theta = theta.cwiseMin(kFurthest * prior).cwiseMax(-kFurthest * prior);
  }
  return least;
}

}  // namespace rg::proof
