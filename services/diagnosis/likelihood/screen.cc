#include "services/diagnosis/likelihood/screen.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <numeric>

#include "services/diagnosis/likelihood/lineariser.h"
#include "services/sysid/parallel.h"

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

// Of the segments at `own` behind D columns. gram: lower triangle; null: as many rows, of the coefficients'
// own draws too.
Segments IntegratedOut(const std::vector<long>& own, long D, const RowMatrixXd& gram,
                       const RowMatrixXd& null) {
  const auto S = std::ssize(own);
  MatrixXd precision = gram(own, own);
  precision = MatrixXd(precision.selfadjointView<Eigen::Lower>());
  precision.diagonal().array() += 1.0;
  const Eigen::LLT<MatrixXd> factor(precision);
  return {factor.matrixL().solve(MatrixXd(gram(own, Eigen::seqN(0, D)))),
          factor.matrixL().solve(MatrixXd(null(own, Eigen::all))), HalfLogDet(factor),
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

// Columns that act on these joints; phi: columns × intervals. `at`: place of the first one.
void Append(const std::vector<int>& joint, const MatrixXd& phi, long at, std::vector<ColumnsOn>* out) {
  for (auto first = joint.begin(); first != joint.end();) {
    const auto last = std::find_if(first, joint.end(), [&](int j) { return j != *first; });
    const long c = first - joint.begin();
    out->push_back({*first, at + c, phi.middleRows(c, last - first).transpose()});
    first = last;
  }
}

// One window linearised in parameters and unit torques, its start eliminated from what it returns.
class UnitResponses {
 public:
  UnitResponses(long parameters, long intervals, int joints, const std::vector<ColumnsOn>& columns)
      : P_(parameters), N_(intervals), columns_(columns) {
    const auto acts = [&](int j) {
      return std::ranges::any_of(columns, [&](const ColumnsOn& c) { return c.joint == j || c.joint < 0; });
    };
    for (int j = 0; j < joints; ++j) {
      if (acts(j)) joints_.push_back(j);
    }
  }

  // False where it cannot be simulated.
  bool Run(Lineariser& lin, int worker, int window, const MatrixXd& states) {
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
  void AddGramTo(double s, RowMatrixXd* gram) const {
    const RowMatrixXd own = Gram(s);
    gram->topLeftCorner(P_, P_) += own.topLeftCorner(P_, P_);
    for (const ColumnsOn& c : columns_) {
      const long C = c.phi.cols();
      RowMatrixXd half = RowMatrixXd::Zero(own.rows(), C);
      AddProduct(own.middleCols(UnitsOf(c), c.phi.rows()), c.phi, 1.0, half);
      gram->block(c.at, 0, C, P_) += half.topRows(P_).transpose();
      for (const ColumnsOn& d : columns_) {
        // Those on all joints meet the others by the units of one joint.
        const bool mine = c.joint < 0 || (d.joint >= 0 && d.at >= c.at);
        if (!mine) continue;
        const auto at_units = half.middleRows(UnitsOf(d), d.phi.rows());
        if (d.at < c.at) {
          AddTransposedProduct(at_units, d.phi, 1.0, gram->block(c.at, d.at, C, d.phi.cols()));
        } else {
          AddTransposedProduct(d.phi, at_units, 1.0, gram->block(d.at, c.at, d.phi.cols(), C));
        }
      }
    }
  }

  // What parameters and columns say of `rows`, which are projected already: `size` × their number.
  RowMatrixXd Times(const RowMatrixXd& rows, long size) const {
    RowMatrixXd by_time = RowMatrixXd::Zero(std::ssize(order_), rows.cols()), own = by_time;
    ForEachPanel([&](long first, long count, long acting) {
      AddTransposedProduct(linear_.J().block(first, 0, count, acting), rows.middleRows(first, count), 1.0,
                           by_time.topRows(acting));
    });
    for (long i = 0; i < own.rows(); ++i) own.row(order_[i]) = by_time.row(i);
    RowMatrixXd out = RowMatrixXd::Zero(size, rows.cols());
    out.topRows(P_) = own.topRows(P_);
    for (const ColumnsOn& c : columns_)
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
  RowMatrixXd Gram(double s) const {
    const long B = std::ssize(order_);
    RowMatrixXd by_time = RowMatrixXd::Zero(B, B), along = RowMatrixXd::Zero(start_.cols(), B), own(B, B);
    ForEachPanel([&](long first, long count, long acting) {
      AddGram(linear_.J().block(first, 0, count, acting), s, by_time.topLeftCorner(acting, acting));
    });
    AddTransposedProduct(start_, linear_.J(), 1.0, along);
    AddGram(along, -s, by_time);
    for (long i = 0; i < B; ++i) {
      for (long j = 0; j <= i; ++j) own(order_[i], order_[j]) = own(order_[j], order_[i]) = by_time(i, j);
    }
    return own;
  }

  const long P_, N_;
  const std::vector<ColumnsOn>& columns_;
  std::vector<int> joints_;
  Linear linear_;
  RowMatrixXd start_;        // basis of what the start makes
  std::vector<long> order_;  // place of each column, joint after joint
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
  const auto add = [&](int worker, int part, int w) {
    const NodeWindow& window = data.windows[w];
    // Parameters, features, the residual, the segments of the force, joint after joint.
    std::vector<ColumnsOn> columns;
    if (!features.joint.empty()) Append(features.joint, features.phi[w], P, &columns);
    if (!features.on_robot.empty() && features.on_robot[w].cols() > 0)
      columns.push_back({-1, P + std::ssize(features.joint), features.on_robot[w]});
    std::vector<std::vector<long>> segments;  // places, by joint
    long S = 0;
    for (const int on : force.joints) {
      const ForceSegments own = SegmentsOf({{on}, force.prior, force.segment_s}, window);
      Append(own.joint, own.phi, D + S, &columns);
      segments.emplace_back(own.joint.size());
      std::iota(segments.back().begin(), segments.back().end(), D + S);
      S += std::ssize(own.joint);
    }
    UnitResponses units(P, std::ssize(window.t) - 1, data.n, columns);
    if (!units.Run(lin, worker, w, states[w])) return;
    const long M = units.rows();
    rows[w] = static_cast<int>(M), unknowns[w] = S;
    const RowMatrixXd noise = Draws(M + S, null_draws, rng.Split(static_cast<uint64_t>(w)));
    RowMatrixXd right = RowMatrixXd::Zero(M, null_draws + 2);  // residual, another step rule's, noise
    right.col(0) = units.residual(), right.rightCols(null_draws) = noise.topRows(M);
    if (!step_rule.empty()) right.col(1) = step_rule[w];
    units.Project(&right);
    const RowMatrixXd said = units.Times(right, D + S);
    const double whole = 1.0 / options.noise_scale, root = 1.0 / std::sqrt(options.noise_scale);
    systematic[w] = whole * said.col(1).head(D - 1);
    RowMatrixXd own_gram, own_null;
    if (S > 0) own_gram.setZero(D + S, D + S), own_null.setZero(D + S, null_draws);
    RowMatrixXd& gram = S > 0 ? own_gram : sums[part];
    RowMatrixXd& null = S > 0 ? own_null : nulls[part];
    units.AddGramTo(whole, &gram);
    gram.row(D - 1).head(D - 1) += whole * said.col(0).head(D - 1).transpose();
    gram.col(D - 1).tail(S) += whole * said.col(0).tail(S);
    gram(D - 1, D - 1) += whole * right.col(0).squaredNorm();
    null += root * said.rightCols(null_draws);
    if (S == 0) return;
    null.bottomRows(S) += noise.bottomRows(S);
    sums[part] += gram.topLeftCorner(D, D), nulls[part] += null.topRows(D);
    for (const std::vector<long>& own : segments) out.taken[w].push_back(IntegratedOut(own, D, gram, null));
  };
  sysid::ParallelFor(options.threads, parts, [&](int worker, int part) {
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
