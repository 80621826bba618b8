// How a window starts where gears have play: the search over contact of Lineariser.
#include <algorithm>
#include <cmath>
#include <numeric>

#include "services/diagnosis/likelihood/lineariser.h"

namespace rg::diagnosis {

namespace {

constexpr double kEarlyPart = 0.4;  // of a window, on which starts are compared first
constexpr size_t kBestEarly = 8;    // of these starts, simulated to the window's end
constexpr double kFirstMove = 0.1;  // from the best of them: of the gap's half, and of the speed across it
constexpr int kMoves = 8;           // from there

}  // namespace

VectorXd Lineariser::AcrossGap(const Gap& gap, VectorXd x, double ahead, double faster) const {
  const int link = gap.joint, motor = 2 * n_ + gap.motor;
  if (gap.reads_motor) {
    x[link] = x[motor] - ahead, x[n_ + link] = x[motor + 1] - faster;
  } else {
    x[motor] = x[link] + ahead, x[motor + 1] = x[n_ + link] + faster;
  }
  return x;
}

double Lineariser::ChooseFace(int worker, int index, const VectorXd* before, bool closely, double best,
                              MatrixXd* states) {
  const NodeWindow& window = data_.windows[index];
  for (const Gap& g : gaps_) {
    const int motor = 2 * n_ + g.motor;
    // The speed that the drive gives the motor across the gap.
    const double half = 0.5 * probe_.values[g.parameter];
    const auto drive = data_.fine[window.recording].u.row(g.joint);
    const double torque = std::sqrt(drive.squaredNorm() / static_cast<double>(drive.size()));
    const double speed = std::sqrt(4 * half * torque / probe_.values[g.inertia]);
    // Both from the present start and from the recorded state: a start on a wrong face has drifted.
    const VectorXd here = states->col(0);
    VectorXd recorded = here;
    recorded[g.reads_motor ? motor : g.joint] = window.q0(g.joint, 0) - sensor_offsets_[g.joint];
    recorded[g.reads_motor ? motor + 1 : n_ + g.joint] = window.v0(g.joint, 0);
    std::vector<VectorXd> starts;
    for (const VectorXd& x : {here, recorded}) {
      if (!starts.empty() && recorded == here) break;
      if (before != nullptr) {
        const VectorXd& b = *before;
        starts.push_back(AcrossGap(g, x, b[motor] - b[g.joint], b[motor + 1] - b[n_ + g.joint]));
      }
      for (const double side : {-1.0, -0.5, 0.0, 0.5, 1.0}) {
        for (const double rate : {-1.0, -0.4, -0.15, 0.0, 0.15, 0.4, 1.0})
          starts.push_back(AcrossGap(g, x, side * half, rate * speed));
      }
    }
    // The contact shows early in the window: all starts are compared there, the best to its end.
    const std::vector<double> early =
        Simulated(worker, std::vector<int>(starts.size(), index), starts, kEarlyPart);
    std::vector<size_t> order(starts.size());
    std::iota(order.begin(), order.end(), size_t{0});
    std::ranges::stable_sort(order, [&](size_t a, size_t b) { return early[a] < early[b]; });
    std::vector<VectorXd> nearest;
    for (size_t i = 0; i < std::min(kBestEarly, order.size()); ++i) nearest.push_back(starts[order[i]]);
    const std::vector<double> chi2 = Simulated(worker, std::vector<int>(nearest.size(), index), nearest);
    const auto least = std::ranges::min_element(chi2);
    if (*least < best) best = *least, states->col(0) = nearest[static_cast<size_t>(least - chi2.begin())];
    if (closely) best = Descend(worker, index, g, kFirstMove * half, kFirstMove * speed, best, states);
  }
  return best;
}

double Lineariser::Descend(int worker, int index, const Gap& gap, double ahead, double faster, double best,
                           MatrixXd* states) {
  const int motor = 2 * n_ + gap.motor;
  for (int move = 0; move < kMoves; ++move) {
    const VectorXd x = states->col(0);
    const double deflection = x[motor] - x[gap.joint], rate = x[motor + 1] - x[n_ + gap.joint];
    std::vector<VectorXd> around;
    for (const double along : {-1.0, 0.0, 1.0}) {
      for (const double across : {-1.0, 0.0, 1.0}) {
        if (along == 0 && across == 0) continue;
        around.push_back(AcrossGap(gap, x, deflection + along * ahead, rate + across * faster));
      }
    }
    const std::vector<double> chi2 = Simulated(worker, std::vector<int>(around.size(), index), around);
    const auto least = std::ranges::min_element(chi2);
    if (*least < best) {
      best = *least, states->col(0) = around[static_cast<size_t>(least - chi2.begin())];
    } else {
      ahead *= 0.5, faster *= 0.5;
    }
  }
  return best;
}

}  // namespace rg::diagnosis
