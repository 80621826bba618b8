#include "services/diagnosis/balance/balance_fit.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <utility>

namespace rg::diagnosis {

namespace {

// Prior stddevs of a load, in those of the last link's own mass and of its other parameters.
constexpr double kLoad = 10.0, kLoadsPlace = 3.0;

}  // namespace

BalanceFit::BalanceFit(const TorqueBalance& balance)
    : balance_(balance),
      base_(balance.tilt + 2),
      variance_(VectorXd::Ones(balance.n)),
      correlation_(VectorXd::Ones(balance.n)) {
  y_.resize(balance.n);
  gram_.assign(balance.blocks, std::vector<Gram>(balance.n));
  for (int j = 0; j < balance.n; ++j) {
    FillColumns(j);
    const BalanceRows& rows = balance.joints[j];
    SetResponse(j, rows.rigid - rows.effort);
    const VectorXd y = Moving(y_[j], j);
    variance_[j] = std::max(1e-300, y.squaredNorm() / std::max<double>(1.0, static_cast<double>(y.size())));
  }
}

MatrixXd BalanceFit::DriveOn(int joint) const {
  if (joint != drive_.joint && joint != drive_.other)
    return MatrixXd::Zero(std::ssize(balance_.joints[joint].t), BalanceDrive::kColumns);
  return joint == drive_.joint ? drive_.columns : MatrixXd(drive_.ratio * drive_.columns);
}

bool BalanceFit::Still(int joint, size_t row) const {
  return balance_.joints[joint].still[row] ||
         ((joint == drive_.joint || joint == drive_.other) && drive_.still[row]);
}

void BalanceFit::FillColumns(int j) {
  const BalanceRows& rows = balance_.joints[j];
  MatrixXd X(rows.base.rows(), rows.base.cols() + rows.features.cols() + BalanceDrive::kColumns);
  X << rows.base, rows.features, DriveOn(j);
  for (int b = 0; b < balance_.blocks; ++b) {
    Gram& g = gram_[b][j];
    g.xx.setZero(X.cols(), X.cols()), g.xy.setZero(X.cols());
    std::vector<int> members;
    for (size_t k = 0; k < rows.block.size(); ++k) {
      if (rows.block[k] == b && !Still(j, k)) members.push_back(static_cast<int>(k));
    }
    g.rows = static_cast<double>(members.size());
    if (!members.empty()) g.xx = X(members, Eigen::all).transpose() * X(members, Eigen::all);
  }
}

void BalanceFit::TakeColumns(int joint) {
  FillColumns(joint);
  FillResponse(joint);
}

void BalanceFit::SetResponse(int joint, const VectorXd& y) {
  y_[joint] = y;
  FillResponse(joint);
}

void BalanceFit::FillResponse(int joint) {
  const BalanceRows& rows = balance_.joints[joint];
  const VectorXd& y = y_[joint];
  const MatrixXd drive = DriveOn(joint);
  for (auto& blocks : gram_) blocks[joint].xy.setZero(), blocks[joint].yy = 0;
  for (size_t k = 0; k < rows.block.size(); ++k) {
    if (Still(joint, k)) continue;
    Gram& g = gram_[rows.block[k]][joint];
    const auto row = static_cast<long>(k);
    g.xy.head(base_) += y[row] * rows.base.row(row).transpose();
    g.xy.segment(base_, rows.features.cols()) += y[row] * rows.features.row(row).transpose();
    g.xy.tail(drive.cols()) += y[row] * drive.row(row).transpose();
    g.yy += y[row] * y[row];
  }
}

double BalanceFit::PriorPrecision(const BalanceModel& model, int base) const {
  if (!model.payload) return 1.0;
  for (size_t i = 0; i < balance_.last_link.size(); ++i) {
    if (balance_.last_link[i] == base) return std::pow(i == 0 ? kLoad : kLoadsPlace, -2);
  }
  return 1.0;
}

double BalanceFit::PriorCost(const BalanceModel& model) const {
  const BalanceSolution s = Solve(model);
  double cost = 0;
  for (int i = 0; i < base_; ++i) cost += 0.5 * PriorPrecision(model, i) * s.base[i] * s.base[i];
  return cost;
}

void BalanceFit::SetDrive(BalanceDrive drive) {
  std::set<int> joints = {drive_.joint, drive_.other, drive.joint, drive.other};
  joints.erase(-1);
  drive_ = std::move(drive);
  for (const int j : joints) FillColumns(j), FillResponse(j);
}

VectorXd BalanceFit::Stacked(const BalanceSolution& s, int joint) const {
  VectorXd x(base_ + s.features[joint].size() + s.drive.size());
  x << s.base, s.features[joint], s.drive;
  return x;
}

double BalanceFit::Cost(const Gram& g, const VectorXd& x) const {
  return std::max(0.0, g.yy - 2.0 * x.dot(g.xy) + x.dot(g.xx * x));
}

BalanceSolution BalanceFit::Solve(const BalanceModel& model, int without_block) const {
  std::vector<std::pair<int, int>> unknowns;  // joint (−1: base, −2: the drive), column
  for (int i = 0; i < base_; ++i) {
    const bool carried = model.payload && balance_.IsOfLastLink(i);
    if (i < balance_.tilt ? model.base || carried : model.tilt) unknowns.push_back({-1, i});
  }
  for (int j = 0; j < balance_.n; ++j) {
    for (const int c : model.features[j]) unknowns.push_back({j, c});
  }
  for (const int c : model.drive) unknowns.push_back({-2, c});
  const int U = static_cast<int>(unknowns.size());
  MatrixXd H = MatrixXd::Identity(U, U);
  for (int u = 0; u < U; ++u) {
    if (unknowns[u].first == -1) H(u, u) = PriorPrecision(model, unknowns[u].second);
  }
  VectorXd g = VectorXd::Zero(U);
  for (int j = 0; j < balance_.n; ++j) {
    Gram sum;
    const int features = static_cast<int>(balance_.columns[j].size());
    const long columns = base_ + features + BalanceDrive::kColumns;
    sum.xx.setZero(columns, columns), sum.xy.setZero(columns);
    for (int b = 0; b < balance_.blocks; ++b) {
      if (b != without_block) sum.xx += gram_[b][j].xx, sum.xy += gram_[b][j].xy;
    }
    const double weight = 1.0 / (variance_[j] * correlation_[j]);
    std::vector<int> mine, place;
    for (int u = 0; u < U; ++u) {
      if (unknowns[u].first == -1) mine.push_back(u), place.push_back(unknowns[u].second);
      if (unknowns[u].first == j) mine.push_back(u), place.push_back(base_ + unknowns[u].second);
      if (unknowns[u].first == -2 && (j == drive_.joint || j == drive_.other))
        mine.push_back(u), place.push_back(base_ + features + unknowns[u].second);
    }
    g(mine) += weight * sum.xy(place);
    H(mine, mine) += weight * sum.xx(place, place);
  }
  const VectorXd x = U > 0 ? VectorXd(H.ldlt().solve(g)) : VectorXd();
  BalanceSolution s;
  s.base.setZero(base_);
  for (int j = 0; j < balance_.n; ++j)
    s.features.push_back(VectorXd::Zero(static_cast<long>(balance_.columns[j].size())));
  s.drive.setZero(BalanceDrive::kColumns);
  for (int u = 0; u < U; ++u) {
    const auto [of, column] = unknowns[u];
    (of == -1 ? s.base : of == -2 ? s.drive : s.features[of])[column] = x[u];
  }
  s.energy.setZero(balance_.n);
  for (int j = 0; j < balance_.n; ++j) {
    double sum = 0, rows = 0;
    const VectorXd stacked = Stacked(s, j);
    for (int b = 0; b < balance_.blocks; ++b) {
      if (b != without_block) sum += Cost(gram_[b][j], stacked), rows += gram_[b][j].rows;
    }
    s.energy[j] = sum / std::max(1.0, rows);
  }
  return s;
}

BlockCosts BalanceFit::LeaveOut(const BalanceModel& model) const {
  BlockCosts out = BlockCosts::Zero(balance_.blocks, balance_.n);
  for (int b = 0; b < balance_.blocks; ++b) {
    const BalanceSolution s = Solve(model, b);
    for (int j = 0; j < balance_.n; ++j)
      out(b, j) = 0.5 * Cost(gram_[b][j], Stacked(s, j)) / (variance_[j] * correlation_[j]);
  }
  return out;
}

VectorXd BalanceFit::Residual(const BalanceSolution& s, int joint) const {
  const BalanceRows& rows = balance_.joints[joint];
  return y_[joint] - rows.base * s.base - rows.features * s.features[joint] - DriveOn(joint) * s.drive;
}

VectorXd BalanceFit::Moving(const VectorXd& x, int joint) const {
  std::vector<double> out;
  for (long k = 0; k < x.size(); ++k) {
    if (!Still(joint, static_cast<size_t>(k))) out.push_back(x[k]);
  }
  return Eigen::Map<const VectorXd>(out.data(), static_cast<long>(out.size()));
}

void BalanceFit::SetNoiseFrom(const BalanceModel& model) {
  // The solution depends on the variance: two passes.
  for (int pass = 0; pass < 2; ++pass) {
    const BalanceSolution s = Solve(model);
    for (int j = 0; j < balance_.n; ++j) {
      const VectorXd r = Moving(Residual(s, j), j);
      if (r.size() < 8) continue;
      const double mean = r.squaredNorm() / static_cast<double>(r.size());
      variance_[j] = std::max(1e-300, mean);
      double sum = 1.0;
      for (long lag = 1; lag < std::min<long>(100, r.size() / 4); ++lag) {
        const long count = r.size() - lag;
        const double rho = r.head(count).dot(r.tail(count)) / static_cast<double>(count) / variance_[j];
        if (rho < 0.05) break;
        sum += 2.0 * rho;
      }
      correlation_[j] = sum;
    }
  }
}

BalanceSolution BalanceFit::Jackknife(const BalanceModel& model) const {
  BalanceSolution all = Solve(model), spread = all;
  for (VectorXd* x : spread.Coefficients()) x->setZero();
  for (int b = 0; b < balance_.blocks; ++b) {
    BalanceSolution without = Solve(model, b);
    for (size_t i = 0; i < all.Coefficients().size(); ++i)
      *spread.Coefficients()[i] += (*without.Coefficients()[i] - *all.Coefficients()[i]).cwiseAbs2();
  }
  const double factor = (balance_.blocks - 1.0) / std::max(1, balance_.blocks);
  for (VectorXd* x : spread.Coefficients()) *x = (factor * *x).cwiseSqrt();
  return spread;
}

int BalanceFit::EffectiveRows() const {
  double sum = 0;
  for (int j = 0; j < balance_.n; ++j) sum += static_cast<double>(Moving(y_[j], j).size()) / correlation_[j];
  return static_cast<int>(sum);
}

Gain GainOf(const BlockCosts& before, const BlockCosts& after, int joint) {
  const MatrixXd d = before - after;
  const VectorXd each = joint < 0 ? VectorXd(d.rowwise().sum()) : VectorXd(d.col(joint));
  const double B = static_cast<double>(each.size());
  Gain gain{each.sum(), 0};
  const double mean = gain.nats / B;
  gain.stddev = std::sqrt(B * (each.array() - mean).square().sum() / std::max(1.0, B - 1.0));
  return gain;
}

}  // namespace rg::diagnosis
