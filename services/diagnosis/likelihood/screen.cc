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

// Normal equations in (θ, features, residual) and right-hand sides of null draws, summed over windows.
struct Sums {
  RowMatrixXd gram, null;
  double force_log_det = 0;  // ½ log det(1 + H) of the information H on the force's segments
};

// Adds a window's sums when the coefficients at `segments`, N(0, 1) each, are integrated out. gram: lower
// triangle; null: as many rows, of the coefficients' own draws too.
void AddWithout(const std::vector<long>& segments, const RowMatrixXd& gram, const RowMatrixXd& null,
                Sums* sums) {
  const long D = sums->gram.rows();
  MatrixXd own = gram(segments, segments);
  own = MatrixXd(own.selfadjointView<Eigen::Lower>());
  own.diagonal().array() += 1.0;
  const Eigen::LLT<MatrixXd> factor(own);
  const MatrixXd cross = factor.matrixL().solve(MatrixXd(gram(segments, Eigen::seqN(0, D))));
  const MatrixXd noise = factor.matrixL().solve(MatrixXd(null(segments, Eigen::all)));
  sums->gram += gram.topLeftCorner(D, D) - cross.transpose() * cross;
  sums->null += null.topRows(D) - cross.transpose() * noise;
  sums->force_log_det += HalfLogDet(factor);
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

std::vector<Screen> MakeScreens(const FitData& data, const FitModel& model, const NodeStates& states,
                                const FeatureBlock& features, const LiftedOptions& options,
                                const std::vector<VectorXd>& step_rule, int null_draws, Rng rng,
                                const FreeForce& force) {
  Lineariser lin(data, model, true, options);
  const int P = lin.P(), C = features.size(), W = static_cast<int>(data.windows.size());
  // Summed in parts that do not depend on the number of threads, nor does what comes out.
  const int D = P + C + 1, parts = std::min(W, kScreenParts);
  const Sums none{RowMatrixXd::Zero(D, D), RowMatrixXd::Zero(D, null_draws)};
  std::vector<std::vector<Sums>> sums(std::max<size_t>(1, force.joints.size()),
                                      std::vector<Sums>(parts, none));
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
      AddGram(columns, whole, sums[0][part].gram);
      AddTransposedProduct(columns, noise, root, sums[0][part].null);
      return;
    }
    RowMatrixXd gram = RowMatrixXd::Zero(D + S, D + S), null = RowMatrixXd::Zero(D + S, null_draws);
    AddGram(columns, whole, gram);
    AddTransposedProduct(columns, noise.topRows(M), root, null);
    null.bottomRows(S) += noise.bottomRows(S);
    for (size_t j = 0; j < force.joints.size(); ++j) {
      std::vector<long> own;
      for (long i = 0; i < S; ++i) {
        if (segments.joint[i] == force.joints[j]) own.push_back(D + i);
      }
      AddWithout(own, gram, null, &sums[j][part]);
    }
  };
  sysid::ParallelFor(options.threads, parts, [&](int worker, int part) {
    for (int w = part; w < W; w += parts) add(worker, part, w);
  });
  Screen all;
  all.parameters = P, all.features = C;
  all.gram = MatrixXd::Zero(D, D), all.null = MatrixXd::Zero(D - 1, null_draws);
  all.step_rule = VectorXd::Zero(D - 1);
  for (const VectorXd& rule : systematic) {
    if (rule.size() > 0) all.step_rule += rule;
  }
  for (const int r : rows) all.rows += r;
  std::vector<Screen> out(sums.size(), all);
  for (size_t j = 0; j < sums.size(); ++j) {
    for (const Sums& sum : sums[j]) {
      out[j].gram += sum.gram, out[j].null += sum.null.topRows(D - 1);
      out[j].force_log_det += sum.force_log_det;
    }
    out[j].gram = MatrixXd(out[j].gram.selfadjointView<Eigen::Lower>());
  }
  const long most = unknowns.empty() ? 0 : std::ranges::max(unknowns);
  out.front().work = ScreenWork(data, options, lin.nx(), D + most, null_draws);
  return out;
}

Screen MakeScreen(const FitData& data, const FitModel& model, const NodeStates& states,
                  const FeatureBlock& features, const LiftedOptions& options,
                  const std::vector<VectorXd>& step_rule, int null_draws, Rng rng) {
  return MakeScreens(data, model, states, features, options, step_rule, null_draws, rng, {}).front();
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
