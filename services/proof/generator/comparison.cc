#include "services/proof/generator/comparison.h"

#include <algorithm>
#include <cmath>
#include <memory>

#include "services/proof/generator/engine.h"

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

void Comparison::Add(const Truth& truth, const Track& track, const std::vector<Rival>& rivals,
                     WindowSquares* squares) const {
  Engine real(bodies, joints, truth, dt), model(bodies, joints, truth, dt);
  std::vector<std::unique_ptr<Engine>> others;
  for (const Rival& r : rivals) others.push_back(std::make_unique<Engine>(r.bodies, joints, r.truth, dt));
  squares->rivals.resize(rivals.size());
  const int rate = static_cast<int>(rate_hz), rows = static_cast<int>(track.q.cols());
  real.Reset(track.true_q.col(0), track.true_v.col(0), track.u.col(0), 0.0);
  model.Reset(track.q.col(0), track.v.col(0), track.u.col(0), 0.0);
  long fine = 0;
  const int last = (rows - 1) / rate * rate;
  for (int k = 0; k <= last; ++k) {
    if (k > 0) {
      squares->oracle.push_back(Square(model, track, k));
      for (size_t r = 0; r < others.size(); ++r) squares->rivals[r].push_back(Square(*others[r], track, k));
    }
    if (k % rate == 0) {
      model.ResetLike(real, track.q.col(k), track.v.col(k));
      for (size_t r = 0; r < others.size(); ++r) {
        const bool exact = rivals[r].start == Start::kTrue;
        const Eigen::VectorXd q = exact ? track.true_q.col(k) : track.q.col(k),
                              v = exact ? track.true_v.col(k) : track.v.col(k);
        if (rivals[r].start == Start::kRow) {
          others[r]->Reset(q, v, track.u.col(k), k / rate_hz);
        } else {
          others[r]->ResetLike(real, q, v);
        }
      }
    }
    if (k == last) break;
    for (const long end = std::lround((k + 1) / (rate_hz * dt)); fine < end; ++fine) {
      real.Step(track.u.col(k)), model.Step(track.u.col(k));
      for (auto& other : others) other->Step(track.u.col(k));
    }
  }
}

}  // namespace rg::proof
