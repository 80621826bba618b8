#include "services/diagnosis/likelihood/screen.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numeric>

#include "common/base/parallel.h"
#include "services/diagnosis/likelihood/lineariser.h"

namespace rg::diagnosis {

namespace {

constexpr double kOtherStep = 2e-4;  // s, see StepRuleResiduals
constexpr int kScreenParts = 16;
constexpr long kPanel = 96;  // rows, of which the columns that act by then are told together

// What integrating out a window's segments of a force, N(0, 1) each, takes from the normal equations:
// columnsᵀ·columns from the Gram matrix, columnsᵀ·noise from the null draws. Whitened by 1 + H, H the
// information on the segments.
struct Segments {
  RowMatrixXd columns, noise;             // a row for each segment
  double half_log_det = 0, unknowns = 0;  // of 1 + H; tr H (1 + H)⁻¹
};

// Of the segments at `own`. gram: lower triangle; null: as many rows, of the coefficients' own draws too;
// places: of each of these in the D columns of all windows.
Segments IntegratedOut(const std::vector<long>& own, const std::vector<long>& places, long D,
                       const RowMatrixXd& gram, const RowMatrixXd& null) {
  const auto S = std::ssize(own);
  MatrixXd precision = gram(own, own);
  precision = MatrixXd(precision.selfadjointView<Eigen::Lower>());
  precision.diagonal().array() += 1.0;
  const Eigen::LLT<MatrixXd> factor(precision);
  const long before = std::ranges::lower_bound(places, D) - places.begin();
  const MatrixXd acting = factor.matrixL().solve(MatrixXd(gram(own, Eigen::seqN(0, before))));
  RowMatrixXd columns = RowMatrixXd::Zero(S, D);
  for (long i = 0; i < before; ++i) columns.col(places[i]) = acting.col(i);
  return {std::move(columns), factor.matrixL().solve(MatrixXd(null(own, Eigen::all))), HalfLogDet(factor),
          static_cast<double>(S) - factor.solve(MatrixXd::Identity(S, S)).trace()};
}

RowMatrixXd Draws(Eigen::Index rows, int count, Rng stream) {
  RowMatrixXd out(rows, count);
  for (double& x : out.reshaped()) x = stream.Normal();
  return out;
}

}  // namespace

LiftedOptions OtherStepRule(LiftedOptions options) {
  options.step_s = kOtherStep, options.integrator = sim::Integrator::kSemiImplicitEuler;
  return options;
}

std::vector<VectorXd> StepRuleResiduals(const FitData& data, const FitModel& model, const NodeStates& states,
                                        const LiftedOptions& options) {
  Lineariser other(data, model, false, OtherStepRule(options)), own(data, model, false, options);
  std::vector<int> all(data.windows.size());
  std::iota(all.begin(), all.end(), 0);
  std::vector<VectorXd> out = ResidualsFrom(states, all, options.threads, own);
  const std::vector<VectorXd> by_other = ResidualsFrom(states, all, options.threads, other);
  for (size_t w = 0; w < out.size(); ++w) {
    out[w] -= by_other[w];
    if (!out[w].allFinite()) out[w].setZero();
  }
  return out;
}

namespace {

// Neighbouring columns that act on one joint or on all, as combinations of unit torques there, one for each
// interval between nodes. What torques do is linear: a window's rows, a few for each interval and joint, meet
// the unit torques alone, and the columns, of which there are far more, these.
struct ColumnsOn {
  int joint;        // −1: all
  long at;          // place of the first one
  RowMatrixXd phi;  // intervals (of joint after joint) × columns
};

// The columns of one window. Those that do nothing in it are left out: of a pulse, a piece of a field, a
// surface that is not met here.
class ActingColumns {
 public:
  // Behind the parameters, which have the places 0 … P − 1 in all windows.
  explicit ActingColumns(long parameters) : places_(static_cast<size_t>(parameters)) {
    std::iota(places_.begin(), places_.end(), 0);
  }

  // Columns that act on these joints, of which the first has the place `at` in all windows; phi: columns ×
  // intervals.
  void Append(const std::vector<int>& joint, const MatrixXd& phi, long at) {
    for (size_t first = 0; first < joint.size();) {
      std::vector<Eigen::Index> acting;
      size_t c = first;
      for (; c < joint.size() && joint[c] == joint[first]; ++c) {
        if (!phi.row(static_cast<Eigen::Index>(c)).isZero(0.0)) acting.push_back(static_cast<long>(c));
      }
      Push(joint[first], phi(acting, Eigen::all).transpose(), acting, at);
      first = c;
    }
  }

  // Columns that act on all joints; phi: intervals of joint after joint × columns.
  void AppendOnAll(const MatrixXd& phi, long at) {
    std::vector<Eigen::Index> acting;
    for (Eigen::Index c = 0; c < phi.cols(); ++c) {
      if (!phi.col(c).isZero(0.0)) acting.push_back(c);
    }
    Push(-1, phi(Eigen::all, acting), acting, at);
  }

  // A column that has no torques.
  void Skip(long at) { places_.push_back(at); }

  const std::vector<ColumnsOn>& columns() const { return columns_; }
  // In all windows, of each here.
  const std::vector<long>& places() const { return places_; }
  long size() const { return std::ssize(places_); }

 private:
  void Push(int joint, RowMatrixXd phi, const std::vector<Eigen::Index>& acting, long at) {
    if (acting.empty()) return;
    columns_.push_back({joint, size(), std::move(phi)});
    for (const Eigen::Index c : acting) places_.push_back(at + c);
  }

  std::vector<ColumnsOn> columns_;
  std::vector<long> places_;
};

// A window linearised in parameters and unit torques, its start eliminated from what it returns. Made once
// for many windows, whose memory it keeps.
class UnitResponses {
 public:
  UnitResponses(long parameters, int joints) : P_(parameters), all_joints_(joints) {}

  // False where it cannot be simulated.
  bool Run(Lineariser& lin, int worker, int window, const MatrixXd& states,
           const std::vector<ColumnsOn>& columns) {
    N_ = states.cols() - 1;
    joints_.clear();
    for (int j = 0; j < all_joints_; ++j) {
      if (std::ranges::any_of(columns, [&](const ColumnsOn& c) { return c.joint == j || c.joint < 0; }))
        joints_.push_back(j);
    }
    // In the order of time, in which they begin to act.
    const long J = std::ssize(joints_);
    std::vector<int> joint;
    MatrixXd phi = MatrixXd::Zero(N_ * J, N_);
    for (long k = 0; k < N_; ++k) {
      joint.insert(joint.end(), joints_.begin(), joints_.end());
      phi.block(k * J, k, J, 1).setOnes();
    }
    lin.Run(worker, window, states, J > 0 ? &joint : nullptr, J > 0 ? &phi : nullptr, false, &linear_);
    if (!linear_.ok) return false;
    start_ = BasisOf(linear_.J_e());
    order_.resize(P_ + N_ * J);
    std::iota(order_.begin(), order_.end(), 0);
    for (long k = 0; k < N_; ++k) {
      for (long j = 0; j < J; ++j) order_[P_ + k * J + j] = P_ + j * N_ + k;
    }
    return true;
  }

  long rows() const { return linear_.rows.rows(); }
  VectorXd residual() const { return linear_.r(); }

  // Takes from these what a start can make.
  void Project(RowMatrixXd* of) const { TakeOut(start_, of); }

  // Adds the lower triangle of the Gram matrix of parameters and columns, times s.
  void AddGramTo(double s, const std::vector<ColumnsOn>& columns, RowMatrixXd* gram) {
    MakeGram(s);
    gram->topLeftCorner(P_, P_) += own_.topLeftCorner(P_, P_);
    for (const ColumnsOn& c : columns) {
      const long C = c.phi.cols();
      half_.setZero(own_.rows(), C);
      AddProduct(own_.middleCols(UnitsOf(c), c.phi.rows()), c.phi, 1.0, half_);
      gram->block(c.at, 0, C, P_) += half_.topRows(P_).transpose();
      for (const ColumnsOn& d : columns) {
        // Those on all joints meet the others by the units of one joint.
        const bool mine = c.joint < 0 || (d.joint >= 0 && d.at >= c.at);
        if (!mine) continue;
        const auto at_units = half_.middleRows(UnitsOf(d), d.phi.rows());
        if (d.at < c.at) {
          AddTransposedProduct(at_units, d.phi, 1.0, gram->block(c.at, d.at, C, d.phi.cols()));
        } else {
          AddTransposedProduct(d.phi, at_units, 1.0, gram->block(d.at, c.at, d.phi.cols(), C));
        }
      }
    }
  }

  // What parameters and columns say of `rows`, which are projected already: `size` × their number.
  RowMatrixXd Times(const RowMatrixXd& rows, const std::vector<ColumnsOn>& columns, long size) const {
    RowMatrixXd by_time = RowMatrixXd::Zero(std::ssize(order_), rows.cols()), own = by_time;
    ForEachPanel([&](long first, long count, long acting) {
      AddTransposedProduct(linear_.J().block(first, 0, count, acting), rows.middleRows(first, count), 1.0,
                           by_time.topRows(acting));
    });
    for (long i = 0; i < own.rows(); ++i) own.row(order_[i]) = by_time.row(i);
    RowMatrixXd out = RowMatrixXd::Zero(size, rows.cols());
    out.topRows(P_) = own.topRows(P_);
    for (const ColumnsOn& c : columns)
      AddTransposedProduct(c.phi, own.middleRows(UnitsOf(c), c.phi.rows()), 1.0,
                           out.middleRows(c.at, c.phi.cols()));
    return out;
  }

 private:
  // Place of the first unit torque on that joint or on all, joint after joint.
  long UnitsOf(const ColumnsOn& c) const {
    return c.joint < 0 ? P_ : P_ + N_ * (std::ranges::find(joints_, c.joint) - joints_.begin());
  }

  // Calls fn(first row, rows, columns that act by then).
  template <class Fn>
  void ForEachPanel(const Fn& fn) const {
    const auto J = linear_.J();
    for (long first = 0; first < J.rows(); first += kPanel) {
      const long count = std::min(kPanel, J.rows() - first);
      long acting = P_;
      for (long row = first; row < first + count; ++row) {
        long last = J.cols();
        while (last > acting && J(row, last - 1) == 0) --last;
        acting = last;
      }
      fn(first, count, acting);
    }
  }

  // Of parameters and unit torques, joint after joint, times s.
  void MakeGram(double s) {
    const long B = std::ssize(order_);
    by_time_.setZero(B, B), along_.setZero(start_.cols(), B), own_.resize(B, B);
    ForEachPanel([&](long first, long count, long acting) {
      AddGram(linear_.J().block(first, 0, count, acting), s, by_time_.topLeftCorner(acting, acting));
    });
    AddTransposedProduct(start_, linear_.J(), 1.0, along_);
    AddGram(along_, -s, by_time_);
    for (long i = 0; i < B; ++i) {
      for (long j = 0; j <= i; ++j) own_(order_[i], order_[j]) = own_(order_[j], order_[i]) = by_time_(i, j);
    }
  }

  const long P_;
  const int all_joints_;
  long N_ = 0;               // intervals
  std::vector<int> joints_;  // on which a column acts
  Linear linear_;
  RowMatrixXd start_;        // basis of what the start makes
  std::vector<long> order_;  // place of each column, joint after joint
  RowMatrixXd own_, by_time_, along_, half_;
};

// The screen without a force, and what a force on each joint of `force` takes from it, window by window.
struct Screened {
  Screen without;
  std::vector<std::vector<Segments>> taken;  // by window and joint
};

Screened LinearisedOnce(const FitData& data, const FitModel& model, const NodeStates& states,
                        const FeatureBlock& features, const LiftedOptions& options,
                        const std::vector<VectorXd>& step_rule, int null_draws, Rng rng,
                        const FreeForce& force) {
  Lineariser lin(data, model, true, options);
  const int P = lin.P(), C = features.size(), W = static_cast<int>(data.windows.size());
  Screened out;
  Screen& screen = out.without;
  screen.parameters = P, screen.features = C;
  out.taken.resize(W);
  // Summed in parts that do not depend on the number of threads, nor does what comes out.
  const int D = P + C + 1, parts = std::min(W, kScreenParts);
  std::vector<RowMatrixXd> sums(parts, RowMatrixXd::Zero(D, D)),
      nulls(parts, RowMatrixXd::Zero(D, null_draws));
  std::vector<VectorXd> systematic(W);
  std::vector<int> rows(W, 0);
  std::vector<long> unknowns(W, 0);  // of the force
  const int workers = std::max(1, options.threads);
  std::vector<UnitResponses> responses(workers, UnitResponses(P, data.n));
  std::vector<RowMatrixXd> grams(workers);
  const auto add = [&](int worker, int part, int w) {
    const NodeWindow& window = data.windows[w];
    // Parameters, features, the residual, the segments of the force, joint after joint.
    ActingColumns acting(P);
    if (!features.joint.empty()) acting.Append(features.joint, features.phi[w], P);
    if (!features.on_robot.empty()) acting.AppendOnAll(features.on_robot[w], P + std::ssize(features.joint));
    acting.Skip(D - 1);
    const long A = acting.size();
    std::vector<std::vector<long>> segments;  // places in this window, by joint
    for (const int on : force.joints) {
      const ForceSegments own = SegmentsOf({{on}, force.prior, force.segment_s}, window);
      const long first = acting.size();
      acting.Append(own.joint, own.phi, D + first - A);
      std::vector<long>& places = segments.emplace_back(acting.size() - first);
      std::iota(places.begin(), places.end(), first);
    }
    const long S = acting.size() - A;
    UnitResponses& units = responses[worker];
    if (!units.Run(lin, worker, w, states[w], acting.columns())) return;
    const long M = units.rows();
    rows[w] = static_cast<int>(M), unknowns[w] = S;
    const RowMatrixXd noise = Draws(M + S, null_draws, rng.Split(static_cast<uint64_t>(w)));
    RowMatrixXd right = RowMatrixXd::Zero(M, null_draws + 2);  // residual, another step rule's, noise
    right.col(0) = units.residual(), right.rightCols(null_draws) = noise.topRows(M);
    if (!step_rule.empty()) right.col(1) = step_rule[w];
    units.Project(&right);
    const RowMatrixXd said = units.Times(right, acting.columns(), A + S);
    const double whole = 1.0 / options.noise_scale, root = 1.0 / std::sqrt(options.noise_scale);
    RowMatrixXd& gram = grams[worker];
    gram.setZero(A + S, A + S);
    units.AddGramTo(whole, acting.columns(), &gram);
    gram.row(A - 1).head(A - 1) += whole * said.col(0).head(A - 1).transpose();
    gram.col(A - 1).tail(S) += whole * said.col(0).tail(S);
    gram(A - 1, A - 1) += whole * right.col(0).squaredNorm();
    RowMatrixXd null = root * said.rightCols(null_draws);
    null.bottomRows(S) += noise.bottomRows(S);
    const std::vector<long>& places = acting.places();
    systematic[w].setZero(D - 1);
    for (long i = 0; i < A; ++i) {
      const long at = places[i];
      if (i < A - 1) systematic[w][at] = whole * said(i, 1);
      for (long j = 0; j <= i; ++j) sums[part](at, places[j]) += gram(i, j);
      nulls[part].row(at) += null.row(i);
    }
    for (const std::vector<long>& own : segments)
      out.taken[w].push_back(IntegratedOut(own, places, D, gram, null));
  };
  ParallelFor(options.threads, parts, [&](int worker, int part) {
    for (int w = part; w < W; w += parts) add(worker, part, w);
  });
  screen.gram = MatrixXd::Zero(D, D);
  for (const RowMatrixXd& sum : sums) screen.gram += sum;
  screen.gram = MatrixXd(screen.gram.selfadjointView<Eigen::Lower>());
  screen.null = MatrixXd::Zero(D - 1, null_draws);
  for (const int r : rows) screen.rows += r;
  const long most = unknowns.empty() ? 0 : std::ranges::max(unknowns);
  screen.work = ScreenWork(data, options, lin.nx(), P, C + most, null_draws);
  screen.step_rule = VectorXd::Zero(D - 1);
  for (const VectorXd& rule : systematic) {
    if (rule.size() > 0) screen.step_rule += rule;
  }
  for (const RowMatrixXd& null : nulls) screen.null += null.topRows(D - 1);
  return out;
}

}  // namespace

Screen MakeScreen(const FitData& data, const FitModel& model, const NodeStates& states,
                  const FeatureBlock& features, const LiftedOptions& options,
                  const std::vector<VectorXd>& step_rule, int null_draws, Rng rng) {
  return LinearisedOnce(data, model, states, features, options, step_rule, null_draws, rng, {}).without;
}

std::vector<Screen> MakeScreens(const FreeForce& force, const FitData& data, const FitModel& model,
                                const NodeStates& states, const FeatureBlock& features,
                                const LiftedOptions& options, int null_draws, Rng rng) {
  const Screened screened =
      LinearisedOnce(data, model, states, features, options, {}, null_draws, rng, force);
  std::vector<Screen> out;
  for (size_t j = 0; j < force.joints.size(); ++j) {
    Screen& screen = out.emplace_back(screened.without);
    if (j > 0) screen.work = 0;
    RowMatrixXd taken = RowMatrixXd::Zero(screen.gram.rows(), screen.gram.cols());
    RowMatrixXd noise = RowMatrixXd::Zero(taken.rows(), null_draws);
    for (const std::vector<Segments>& window : screened.taken) {
      if (window.empty()) continue;
      AddGram(window[j].columns, 1.0, taken);
      AddTransposedProduct(window[j].columns, window[j].noise, 1.0, noise);
      screen.force_log_det += window[j].half_log_det, screen.force_unknowns += window[j].unknowns;
    }
    screen.gram -= MatrixXd(MatrixXd(taken).selfadjointView<Eigen::Lower>());
    screen.null -= noise.topRows(screen.null.rows());
  }
  return out;
}

double StepRuleGain(const FitData& data, const FitModel& model, const NodeStates& states,
                    const LiftedOptions& options) {
  const Screen screen = MakeScreen(data, model, states, {}, options,
                                   StepRuleResiduals(data, model, states, options), 0, Rng(1));
  const int P = screen.parameters;
  const VectorXd unit = sysid::PriorStddevs(model.parameters);
  MatrixXd H = screen.gram.topLeftCorner(P, P);
  H = unit.asDiagonal() * H * unit.asDiagonal();
  H.diagonal().array() += 1.0;
  const VectorXd g = unit.cwiseProduct(screen.step_rule);
  return 0.5 * g.dot(H.ldlt().solve(g));
}

}  // namespace rg::diagnosis
