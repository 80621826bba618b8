#include "services/diagnosis/likelihood/screen.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>

#include "services/diagnosis/likelihood/lineariser.h"
#include "services/sysid/parallel.h"

namespace rg::diagnosis {

namespace {

constexpr double kOtherStep = 2e-4;  // s, see StepRuleResiduals
constexpr int kScreenParts = 16;

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
  const int W = static_cast<int>(data.windows.size());
  std::vector<VectorXd> out(W);
  sysid::ParallelFor(options.threads, W, [&](int worker, int w) {
    const VectorXd x0 = states[w].col(0);
    out[w] = own.Residuals(worker, w, x0) - other.Residuals(worker, w, x0);
    if (!out[w].allFinite()) out[w].setZero();
  });
  return out;
}

namespace {

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
    // Features, then the segments of the force.
    std::vector<int> joint = features.joint;
    MatrixXd phi = C > 0 ? features.phi[w] : MatrixXd(0, std::ssize(data.windows[w].t) - 1);
    const ForceSegments segments = SegmentsOf(force, data.windows[w]);
    const auto S = std::ssize(segments.joint);
    if (S > 0) {
      joint.insert(joint.end(), segments.joint.begin(), segments.joint.end());
      const MatrixXd own = phi;
      phi.resize(own.rows() + segments.phi.rows(), segments.phi.cols());
      phi << own, segments.phi;
    }
    Linear l;
    lin.Run(worker, w, states[w], joint.empty() ? nullptr : &joint, joint.empty() ? nullptr : &phi, false,
            &l);
    if (!l.ok) return;
    const auto M = l.rows.rows();
    rows[w] = static_cast<int>(M), unknowns[w] = S;
    RowMatrixXd all(M, D + S + 1);
    all.leftCols(D - 1) = l.rows.middleCols(l.nx, D - 1);
    all.col(D - 1) = l.r();
    all.middleCols(D, S) = l.rows.middleCols(l.nx + P + C, S);
    if (step_rule.empty()) {
      all.col(D + S).setZero();
    } else {
      all.col(D + S) = step_rule[w];
    }
    ProjectOut(l.J_e(), &all);
    const auto columns = all.leftCols(D + S);
    systematic[w] = columns.leftCols(D - 1).transpose() * all.col(D + S) / options.noise_scale;
    const RowMatrixXd noise = Draws(M + S, null_draws, rng.Split(static_cast<uint64_t>(w)));
    const double whole = 1.0 / options.noise_scale, root = 1.0 / std::sqrt(options.noise_scale);
    if (S == 0) {
      AddGram(columns, whole, sums[part]);
      AddTransposedProduct(columns, noise, root, nulls[part]);
      return;
    }
    RowMatrixXd gram = RowMatrixXd::Zero(D + S, D + S), null = RowMatrixXd::Zero(D + S, null_draws);
    AddGram(columns, whole, gram);
    AddTransposedProduct(columns, noise.topRows(M), root, null);
    null.bottomRows(S) += noise.bottomRows(S);
    sums[part] += gram.topLeftCorner(D, D), nulls[part] += null.topRows(D);
    for (const int on : force.joints) {
      std::vector<long> own;
      for (long i = 0; i < S; ++i) {
        if (segments.joint[i] == on) own.push_back(D + i);
      }
      out.taken[w].push_back(IntegratedOut(own, D, gram, null));
    }
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
  screen.work = ScreenWork(data, options, lin.nx(), D + most, null_draws);
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
