#include "services/jobs/identify_problem.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "realitygrad/v1/payloads.pb.h"

namespace rg::jobs {

namespace pb = ::realitygrad::v1;
using Eigen::VectorXd;

// The windows' residuals one below the other; the parameters are shared.
class IdentifyProblem::Stacked final : public sysid::ResidualFunction {
 public:
  explicit Stacked(const std::vector<sysid::PaperProblem>& windows) {
    for (const auto& window : windows) parts_.push_back(window.problem().residuals);
    problem_ = windows.front().problem();
    problem_.residuals = this;
    for (const auto* part : parts_) rows_ += part->num_residuals();
  }

  int num_parameters() const override { return parts_.front()->num_parameters(); }
  int num_residuals() const override { return rows_; }
  bool Evaluate(const VectorXd& p, const sysid::StopCondition& stop, VectorXd* r,
                sysid::RowMatrix* dr_dp) override {
    int row = 0;
    for (sysid::ResidualFunction* part : parts_) {
      const int m = part->num_residuals();
      part_r_.resize(m);
      if (dr_dp) part_jacobian_.resize(m, num_parameters());
      if (!part->Evaluate(p, stop, &part_r_, dr_dp ? &part_jacobian_ : nullptr)) return false;
      r->segment(row, m) = part_r_;
      if (dr_dp) dr_dp->middleRows(row, m) = part_jacobian_;
      row += m;
    }
    return true;
  }

  sysid::LeastSquaresProblem& problem() { return problem_; }

 private:
  std::vector<sysid::ResidualFunction*> parts_;
  sysid::LeastSquaresProblem problem_;
  int rows_ = 0;
  VectorXd part_r_;
  sysid::RowMatrix part_jacobian_;
};

IdentifyProblem::IdentifyProblem(std::vector<sysid::PaperProblem> windows, std::unique_ptr<Stacked> stacked)
    : windows_(std::move(windows)), stacked_(std::move(stacked)) {}
IdentifyProblem::~IdentifyProblem() = default;
IdentifyProblem::IdentifyProblem(IdentifyProblem&&) noexcept = default;
const sysid::LeastSquaresProblem& IdentifyProblem::problem() const { return stacked_->problem(); }

namespace {

struct Interval {
  double lower, upper;
};

Interval PhysicalBounds(const sim::Parameter& parameter, double initial) {
  switch (parameter.kind) {
    case sim::ParameterKind::kGravity:
      return {initial - 2.0, initial + 2.0};
    case sim::ParameterKind::kMass:
      return {0.3 * parameter.nominal, 3.0 * parameter.nominal};
    case sim::ParameterKind::kInertia:
      return {0.0, parameter.nominal > 0 ? std::max(0.5, 3.0 * parameter.nominal) : 0.0};
    case sim::ParameterKind::kDamping:
      return {0.0, 30.0};
    case sim::ParameterKind::kForceGain:
      return {0.3, 1.5};
    default:
      return {parameter.lower, parameter.upper};
  }
}

// Bounds, search ranges and units of the 71 for BoundsKind::kPhysical.
void SetPhysicalBounds(const sim::Plant& plant, const std::vector<int>& parameters,
                       sysid::LeastSquaresProblem* problem) {
  for (size_t i = 0; i < parameters.size(); ++i) {
    const auto e = static_cast<Eigen::Index>(i);
    const Interval box = PhysicalBounds(plant.parameters()[parameters[i]], problem->initial[e]);
    problem->lower[e] = std::min(box.lower, problem->initial[e]);
    problem->upper[e] = std::max(box.upper, problem->initial[e]);
    problem->search_lower[e] = std::max(problem->search_lower[e], problem->lower[e]);
    problem->search_upper[e] = std::min(problem->search_upper[e], problem->upper[e]);
  }
}

std::vector<double> WindowStarts(const recordings::Recording& recording,
                                 const IdentifyProblemOptions& options) {
  if (!options.whole_recording) return {options.window_start_s};
  std::vector<double> starts;
  const double length = recording.t[recording.rows() - 1] - recording.t[0];
  const int count = std::max(1, static_cast<int>(std::floor(length / options.window_s + 1e-6)));
  for (int w = 0; w < count; ++w) starts.push_back(w * options.window_s);
  return starts;
}

}  // namespace

Result<IdentifyProblem> IdentifyProblem::Create(const sim::Plant& plant, const VectorXd& initial,
                                                const recordings::Recording& recording,
                                                const IdentifyProblemOptions& options) {
  if (recording.rows() < 2) return InvalidError(recording.name + ": too few rows to identify anything");
  std::vector<sysid::PaperProblem> windows;
  for (const double start : WindowStarts(recording, options)) {
    sysid::PaperOptions paper;
    paper.window_start_s = start;
    paper.window_s = options.window_s;
    paper.alpha = options.alpha;
    paper.interpolate = !options.whole_recording;
    paper.simulator = options.simulator;
    RG_ASSIGN_OR_RETURN(auto window, sysid::PaperProblem::Create(plant, initial, recording, paper));
    windows.push_back(std::move(window));
  }
  auto stacked = std::make_unique<Stacked>(windows);
  if (options.bounds == BoundsKind::kPhysical)
    SetPhysicalBounds(plant, windows.front().parameters(), &stacked->problem());
  return IdentifyProblem(std::move(windows), std::move(stacked));
}

IdentifyProblemOptions OptionsOf(const pb::IdentifyPayload& payload) {
  IdentifyProblemOptions options;
  options.whole_recording = payload.window() != pb::IDENTIFY_WINDOW_SINGLE;
  if (!options.whole_recording) options.window_s = 0.2;
  if (payload.window_s() > 0) options.window_s = payload.window_s();
  options.window_start_s = payload.window_start_s();
  options.alpha = payload.alpha();
  options.bounds = payload.bounds() == pb::IDENTIFY_BOUNDS_PAPER  ? BoundsKind::kPaper
                   : payload.bounds() == pb::IDENTIFY_BOUNDS_NONE ? BoundsKind::kNone
                                                                  : BoundsKind::kPhysical;
  options.simulator.step_s = 0.002;
  return options;
}

sysid::Solver SolverOf(const pb::IdentifyPayload& payload) {
  return payload.solver() == pb::IDENTIFY_SOLVER_LBFGS ? sysid::Solver::kUnboundedLbfgs
                                                       : sysid::Solver::kBoundedLevenbergMarquardt;
}

}  // namespace rg::jobs
