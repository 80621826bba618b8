#include "services/proof/generator/comparison.h"

#include <algorithm>
#include <cmath>

namespace rg::proof {
namespace {

constexpr double kCap = 1e6;

double Square(const Engine& model, const Track& track, int row) {
  return std::min(kCap, (model.SensedPosition() - track.true_q.col(row)).squaredNorm() /
                            static_cast<double>(track.q.rows()));
}

}  // namespace

double Rms(const std::vector<double>& squares) {
  double sum = 0;
  for (double s : squares) sum += s;
  return squares.empty() ? 0.0 : std::sqrt(sum / static_cast<double>(squares.size()));
}

int Comparison::LastRow(const Track& track) const {
  const int rate = static_cast<int>(rate_hz_), rows = static_cast<int>(track.q.cols());
  return (rows - 1) / rate * rate;
}

void Comparison::Run(const Truth& truth, const Track& track, const std::vector<Rival>& rivals,
                     const std::function<void(const Engines&, int)>& visit) const {
  Engine real(bodies_, joints_, truth, dt_);
  Engines models;
  models.push_back(std::make_unique<Engine>(bodies_, joints_, truth, dt_));
  for (const Rival& r : rivals) models.push_back(std::make_unique<Engine>(r.bodies, joints_, r.truth, dt_));
  const int rate = static_cast<int>(rate_hz_), last = LastRow(track);
  real.Reset(track.true_q.col(0), track.true_v.col(0), track.u.col(0), 0.0);
  models[0]->Reset(track.q.col(0), track.v.col(0), track.u.col(0), 0.0);
  long fine = 0;
  for (int k = 0; k <= last; ++k) {
    if (k > 0) visit(models, k);
    if (k % rate == 0) {
      models[0]->ResetLike(real, track.q.col(k), track.v.col(k));
      for (size_t r = 0; r < rivals.size(); ++r) {
        const bool exact = rivals[r].start == Start::kTrue;
        Eigen::VectorXd q = exact ? track.true_q.col(k) : track.q.col(k),
                        v = exact ? track.true_v.col(k) : track.v.col(k);
        if (const Eigen::Index at = rivals[r].beside; at >= 0)
          (at < q.size() ? q[at] : v[at - q.size()]) += kBeside;
        if (rivals[r].start == Start::kRow) {
          models[r + 1]->Reset(q, v, track.u.col(k), k / rate_hz_);
        } else {
          models[r + 1]->ResetLike(real, q, v);
        }
      }
    }
    if (k == last) break;
    for (const long end = std::lround((k + 1) / (rate_hz_ * dt_)); fine < end; ++fine) {
      real.Step(track.u.col(k));
      for (auto& model : models) model->Step(track.u.col(k));
    }
  }
}

void Comparison::Add(const Truth& truth, const Track& track, const std::vector<Rival>& rivals,
                     WindowSquares* squares) const {
  squares->rivals.resize(rivals.size());
  Run(truth, track, rivals, [&](const Engines& models, int k) {
    squares->oracle.push_back(Square(*models[0], track, k));
    for (size_t r = 0; r < rivals.size(); ++r) squares->rivals[r].push_back(Square(*models[r + 1], track, k));
  });
}

Eigen::MatrixXd Comparison::Deviations(const Truth& truth, const Track& track,
                                       const std::vector<Rival>& rivals) const {
  const Eigen::Index count = static_cast<Eigen::Index>(rivals.size()), n = track.q.rows();
  Eigen::MatrixXd out(count, n * LastRow(track));
  Run(truth, track, rivals, [&](const Engines& models, int k) {
    for (Eigen::Index r = 0; r < count; ++r)
      out.row(r).segment((k - 1) * n, n) =
          models[static_cast<size_t>(r) + 1]->SensedPosition() - track.true_q.col(k);
  });
  return out;
}

}  // namespace rg::proof
