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

// Takes the last S columns, whose coefficients are N(0, 1), from the others, and a row for each prior below.
// Returns ½ log det(1 + H) of their information H.
double IntegrateOut(long S, double noise_scale, RowMatrixXd* columns) {
  const auto M = columns->rows(), D = columns->cols() - S;
  MatrixXd own = MatrixXd::Zero(M + S, S);
  own.topRows(M) = columns->rightCols(S);
  own.bottomRows(S).diagonal().setConstant(std::sqrt(noise_scale));
  RowMatrixXd rest = RowMatrixXd::Zero(M + S, D);
  rest.topRows(M) = columns->leftCols(D);
  const Eigen::LLT<MatrixXd> factor(own.transpose() * own / noise_scale);
  ProjectOut(RowMatrixXd(own), &rest);
  *columns = rest;
  return HalfLogDet(factor);
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

Screen MakeScreen(const FitData& data, const FitModel& model, const NodeStates& states,
                  const FeatureBlock& features, const LiftedOptions& options,
                  const std::vector<VectorXd>& step_rule, int null_draws, Rng rng, const FreeForce* force) {
  Lineariser lin(data, model, true, options);
  const int P = lin.P(), C = features.size(), W = static_cast<int>(data.windows.size());
  Screen screen;
  screen.parameters = P, screen.features = C;
  // Summed in parts that do not depend on the number of threads, nor does what comes out.
  const int D = P + C + 1, parts = std::min(W, kScreenParts);
  std::vector<RowMatrixXd> sums(parts, RowMatrixXd::Zero(D, D)),
      nulls(parts, RowMatrixXd::Zero(D, null_draws));
  std::vector<VectorXd> systematic(W);
  std::vector<double> log_dets(W, 0);
  std::vector<int> rows(W, 0);
  std::vector<long> unknowns(W, 0);  // of the force
  const auto add = [&](int worker, int part, int w) {
    // Features, then the segments of the force, of which the last columns of `all` are.
    std::vector<int> joint = features.joint;
    MatrixXd phi = C > 0 ? features.phi[w] : MatrixXd(0, std::ssize(data.windows[w].t) - 1);
    if (force != nullptr) {
      const ForceSegments segments = SegmentsOf(*force, data.windows[w]);
      joint.insert(joint.end(), segments.joint.begin(), segments.joint.end());
      const MatrixXd own = phi;
      phi.resize(own.rows() + segments.phi.rows(), segments.phi.cols());
      phi << own, segments.phi;
    }
    Linear l;
    const auto S = std::ssize(joint) - C;
    lin.Run(worker, w, states[w], joint.empty() ? nullptr : &joint, joint.empty() ? nullptr : &phi, false,
            &l);
    if (!l.ok) return;
    const auto M = l.rows.rows();
    rows[w] = static_cast<int>(M), unknowns[w] = S;
    RowMatrixXd all(M, D + 1 + S);
    all.leftCols(D - 1) = l.rows.middleCols(l.nx, D - 1);
    all.col(D - 1) = l.r();
    if (step_rule.empty()) {
      all.col(D).setZero();
    } else {
      all.col(D) = step_rule[w];
    }
    all.rightCols(S) = l.rows.middleCols(l.nx + P + C, S);
    ProjectOut(l.J_e(), &all);
    if (S > 0) log_dets[w] = IntegrateOut(S, options.noise_scale, &all);
    const auto rest = all.leftCols(D);
    systematic[w] = rest.leftCols(D - 1).transpose() * all.col(D) / options.noise_scale;
    AddGram(rest, 1.0 / options.noise_scale, sums[part]);
    RowMatrixXd noise(rest.rows(), null_draws);
    Rng stream = rng.Split(static_cast<uint64_t>(w));
    for (double& x : noise.reshaped()) x = stream.Normal();
    AddTransposedProduct(rest, noise, 1.0 / std::sqrt(options.noise_scale), nulls[part]);
  };
  sysid::ParallelFor(options.threads, parts, [&](int worker, int part) {
    for (int w = part; w < W; w += parts) add(worker, part, w);
  });
  screen.gram = MatrixXd::Zero(D, D);
  for (const RowMatrixXd& sum : sums) screen.gram += sum;
  screen.gram = MatrixXd(screen.gram.selfadjointView<Eigen::Lower>());
  screen.null = MatrixXd::Zero(D - 1, null_draws);
  for (int w = 0; w < W; ++w) screen.force_log_det += log_dets[w], screen.rows += rows[w];
  const long most = unknowns.empty() ? 0 : std::ranges::max(unknowns);
  screen.work = ScreenWork(data, options, lin.nx(), D + most, null_draws);
  screen.step_rule = VectorXd::Zero(D - 1);
  for (const VectorXd& rule : systematic) {
    if (rule.size() > 0) screen.step_rule += rule;
  }
  for (const RowMatrixXd& null : nulls) screen.null += null.topRows(D - 1);
  return screen;
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
