#include "services/sysid/paper_problem.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "common/recordings/command_time.h"
#include "common/recordings/noise.h"
#include "common/recordings/resample.h"
#include "common/recordings/windows.h"
#include "common/sim/holding_command.h"
#include "services/sysid/drive_signal.h"

namespace rg::sysid {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

// What one window asks for.
struct WindowData {
  double start = 0.0, scale = 1.0;  // s; of the residuals
  VectorXd q0, v0;
  std::vector<double> times;
  MatrixXd measured;  // n × times
};

// Joint position errors over the windows, each by one simulation from its measured state.
class WindowResiduals final : public ResidualFunction {
 public:
  WindowResiduals(const sim::Plant& plant, const VectorXd& base, FitSpace space, sim::CommandSignal command,
                  std::vector<WindowData> windows, const sim::SimulatorOptions& options)
      : simulator_(plant, options),
        space_(std::move(space)),
        values_(base),
        command_(std::move(command)),
        windows_(std::move(windows)) {
    request_.parameters = Indices(space_.parameters());
    for (const WindowData& window : windows_) {
      rows_ += static_cast<int>(window.measured.size());
      times_.insert(times_.end(), window.times.begin(), window.times.end());
    }
    Group();
  }

  int num_parameters() const override { return space_.size(); }
  int num_residuals() const override { return rows_; }
  int windows() const { return static_cast<int>(windows_.size()); }
  const std::vector<double>& times() const { return times_; }
  const std::vector<int>& parameters() const { return request_.parameters; }
  const FitSpace& space() const { return space_; }

  bool Evaluate(const VectorXd& p, const StopCondition& stop, VectorXd* r, RowMatrix* dr_dp) override {
    values_ = space_.Values(p, std::move(values_));
    simulator_.SetParameters(values_);
    const sim::SensitivityRequest& request = dr_dp != nullptr ? request_ : none_;
    int row = 0;
    for (size_t first = 0; first < windows_.size(); first += runs_.size()) {
      if (stop.ShouldStop()) return false;
      Simulate(first, request);
      for (size_t k = 0; k < runs_.size(); ++k) {
        if (!outs_[k].outcome.ok()) return false;
        row += Write(windows_[first + k], outs_[k], row, r, dr_dp);
      }
    }
    if (dr_dp != nullptr) space_.PullBack(p, dr_dp);
    return true;
  }

 private:
  // Windows of one length share the lanes of a register; a longer one would leave most of them idle.
  void Group() {
    group_.assign(windows_.size(), 1);
    for (size_t first = 0; first < windows_.size(); first += group_[first]) {
      const auto length = [&](size_t k) { return windows_[k].times.size(); };
      while (first + group_[first] < windows_.size() &&
             2 * length(first + group_[first]) <= 3 * length(first) &&
             2 * length(first) <= 3 * length(first + group_[first]))
        ++group_[first];
    }
  }

  void Simulate(size_t first, const sim::SensitivityRequest& request) {
    runs_.clear();
    for (size_t k = first; k < first + group_[first]; ++k) {
      const WindowData& w = windows_[k];
      runs_.push_back(
          {simulator_.MakeStateFromMeasurement(w.q0, w.v0, w.start, command_), &command_, &w.times});
    }
    if (runs_.size() > 1) return simulator_.SimulateWindows(runs_, request, &outs_);
    outs_.resize(1);
    simulator_.SimulateInto(runs_.front().x0, command_, *runs_.front().times, request, &outs_.front());
  }

  int Write(const WindowData& window, const sim::Trajectory& out, int row, VectorXd* r,
            RowMatrix* dr_dp) const {
    const auto m = static_cast<int>(window.measured.size());
    Eigen::Map<MatrixXd>(r->data() + row, window.measured.rows(), window.measured.cols()) =
        window.scale * (out.position - window.measured);
    if (dr_dp != nullptr) dr_dp->middleRows(row, m) = window.scale * out.dposition;
    return m;
  }

  sim::Simulator simulator_;
  FitSpace space_;
  sim::SensitivityRequest request_;
  const sim::SensitivityRequest none_;
  VectorXd values_;
  sim::CommandSignal command_;
  std::vector<WindowData> windows_;
  std::vector<size_t> group_;  // at the first window of each: how many go together
  std::vector<sim::SimulationWindow> runs_;
  std::vector<sim::Trajectory> outs_;
  std::vector<double> times_;
  int rows_ = 0;
};

// A bound of ± share around the nominal value; zero nominal gives the interval [0, 0].
void RelativeBound(double nominal, double share, double* lower, double* upper) {
  *lower = nominal - share * std::abs(nominal);
  *upper = nominal + share * std::abs(nominal);
}

bool IsInertial(const sim::Parameter& p) {
  return p.kind == sim::ParameterKind::kMass || p.kind == sim::ParameterKind::kInertia;
}

std::vector<FitParameter> ParametersToFit(const sim::Plant& plant, const PaperOptions& options) {
  std::vector<int> paper = PaperParameters(plant);
  if (options.consistent_inertias)
    std::erase_if(paper, [&](int i) { return IsInertial(plant.parameters()[i]); });
  std::vector<FitParameter> out = FitParametersAt(plant, paper);
  const auto add = [&](const std::vector<FitParameter>& more) { out.insert(out.end(), more.begin(), more.end()); };
  if (options.consistent_inertias) add(InertialFitParameters(plant));
  add(FitParametersAt(plant, options.extra_parameters));
  return out;
}

// Of a parameter that stands for itself.
void SetOwnBounds(const sim::Parameter& p, const PaperOptions& options, int i, LeastSquaresProblem* problem) {
  double& lower = problem->lower[i];
  double& upper = problem->upper[i];
  switch (p.kind) {
    case sim::ParameterKind::kDamping:
      lower = 0.0;
      upper = options.damping_upper;
      problem->scale[i] = 1.0;
      break;
    case sim::ParameterKind::kForceGain:
      lower = -options.gain_bound;
      upper = options.gain_bound;
      problem->scale[i] = 0.2;
      break;
    case sim::ParameterKind::kEffect:
      lower = p.lower;
      upper = std::isfinite(p.upper) ? p.upper : p.nominal + 10.0 * p.prior_stddev;
      problem->scale[i] = p.prior_stddev;
      break;
    default:
      RelativeBound(p.nominal, options.relative_bound, &lower, &upper);
      problem->scale[i] = p.nominal != 0.0 ? options.relative_bound * std::abs(p.nominal) : p.prior_stddev;
  }
}

// Of a body's coordinate: the share by which its mass and, at that mass, its second moments may be off.
void SetBodyBounds(const PaperOptions& options, const FitSpace& space, int i, LeastSquaresProblem* problem) {
  const FitSpace::Coordinate coordinate = space.CoordinateOf(i);
  problem->scale[i] = space.prior_stddev()[i];
  if (coordinate == FitSpace::Coordinate::kMass || coordinate == FitSpace::Coordinate::kStretch) {
    problem->lower[i] = 0.5 * std::log1p(-options.relative_bound);
    problem->upper[i] = 0.5 * std::log1p(options.relative_bound);
  } else {
    problem->lower[i] = problem->upper[i] = problem->initial[i];
  }
}

void SetBounds(const sim::Plant& plant, const PaperOptions& options, const FitSpace& space,
               LeastSquaresProblem* problem) {
  for (int i = 0; i < space.size(); ++i) {
    if (space.IsItself(i)) {
      SetOwnBounds(plant.parameters()[space.parameters()[i].index], options, i, problem);
    } else {
      SetBodyBounds(options, space, i, problem);
    }
    problem->search_lower[i] = problem->lower[i];
    problem->search_upper[i] = problem->upper[i];
    problem->alpha[i] = options.alpha / (problem->scale[i] * problem->scale[i]);
  }
}

struct WindowRows {
  int first = 0, last = 0;
};

Result<WindowRows> FindRows(const recordings::Recording& recording, const PaperWindow& window) {
  const double t0 = recording.t[0] + window.start_s;
  WindowRows rows;
  const double tolerance = 0.5 * recording.SamplePeriod();
  while (rows.first < recording.rows() && recording.t[rows.first] < t0 - tolerance) ++rows.first;
  rows.last = rows.first;
  if (rows.first < recording.rows()) {
    const double end = recording.t[rows.first] + window.length_s + tolerance;
    while (rows.last + 1 < recording.rows() && recording.t[rows.last + 1] < end) ++rows.last;
  }
  if (rows.last <= rows.first) {
    return InvalidError(recording.name + ": a window of " + std::to_string(window.length_s) + " s from " +
                        std::to_string(window.start_s) + " s holds fewer than two rows");
  }
  return rows;
}

// The simulator's step grid from begin (exclusive) to the last row, or the rows' times.
std::vector<double> ResidualTimes(const recordings::Recording& recording, const WindowRows& rows, double begin,
                                  const PaperOptions& options) {
  std::vector<double> times;
  const double end = recording.t[rows.last];
  if (options.interpolate) {
    const int steps =
        std::max(1, static_cast<int>(std::ceil((end - begin) / options.simulator.step_s - 1e-9)));
    for (int k = 1; k <= steps; ++k) times.push_back(begin + (end - begin) * k / steps);
  } else {
    for (int k = rows.first + 1; k <= rows.last; ++k)
      if (recording.t[k] > begin) times.push_back(recording.t[k]);
  }
  return times;
}

// A robot that rests in the first row was held there until the first command came.
sim::CommandSignal CommandOf(const recordings::Recording& recording, sim::Simulator& simulator) {
  const sim::CommandSignal command = DriveSignal(recording);
  if (!recordings::StartsAtRest(recording)) return command;
  return sim::HeldBefore(command,
                         sim::HoldingCommand(simulator, recording.q.col(0), recording.drive_effort().col(0)));
}

Result<WindowData> ReadWindow(const recordings::Recording& recording, const MatrixXd& velocity,
                              const PaperWindow& window, const PaperOptions& options) {
  RG_ASSIGN_OR_RETURN(const WindowRows rows, FindRows(recording, window));
  // What held it depends on the parameters, that it rested does not.
  const double begin = rows.first == 0 ? recordings::MotionBegin(recording) : recording.t[rows.first];
  const bool rests = recording.t[rows.first] < begin && begin < recording.t[rows.last];
  WindowData out;
  out.start = rests ? begin : recording.t[rows.first];
  out.scale = std::sqrt(window.weight);
  out.q0 = recording.q.col(rows.first);
  out.v0 = velocity.col(rows.first);
  if (rests) out.v0.setZero();
  out.times = ResidualTimes(recording, rows, out.start, options);
  out.measured = recordings::InterpolateLinear(
      recording.t, recording.q,
      Eigen::Map<const VectorXd>(out.times.data(), static_cast<int>(out.times.size())));
  return out;
}

}  // namespace

struct PaperProblem::Impl {
  std::unique_ptr<WindowResiduals> residuals;
  LeastSquaresProblem problem;
  VectorXd base;
};

PaperProblem::PaperProblem(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
PaperProblem::~PaperProblem() = default;
PaperProblem::PaperProblem(PaperProblem&&) noexcept = default;
PaperProblem& PaperProblem::operator=(PaperProblem&&) noexcept = default;

Result<PaperProblem> PaperProblem::Create(const sim::Plant& plant, const VectorXd& initial,
                                          const recordings::Recording& recording,
                                          const PaperOptions& options) {
  if (recording.n() != plant.num_joints()) {
    return InvalidError(recording.name + ": " + std::to_string(recording.n()) + " joints, the model has " +
                        std::to_string(plant.num_joints()));
  }
  if (recording.rows() < 2) return InvalidError(recording.name + ": fewer than two rows");
  if (recording.drive_effort().size() == 0) return InvalidError(recording.name + ": no effort");
  RG_CHECK(initial.size() == plant.parameters().size());
  RG_CHECK(!options.windows.empty());
  const MatrixXd velocity = recordings::VelocityOrEstimate(recording);
  std::vector<WindowData> windows;
  for (const PaperWindow& window : options.windows) {
    RG_ASSIGN_OR_RETURN(WindowData data, ReadWindow(recording, velocity, window, options));
    windows.push_back(std::move(data));
  }

  sim::Simulator simulator(plant, options.simulator);
  simulator.SetParameters(initial);
  auto impl = std::make_unique<Impl>();
  const FitSpace space(ParametersToFit(plant, options), options.consistent_inertias);
  impl->base = initial;
  impl->residuals = std::make_unique<WindowResiduals>(plant, initial, space, CommandOf(recording, simulator),
                                                      std::move(windows), options.simulator);
  LeastSquaresProblem& problem = impl->problem;
  problem.residuals = impl->residuals.get();
  problem.initial = space.At(initial);
  for (VectorXd* v : {&problem.lower, &problem.upper, &problem.alpha, &problem.scale, &problem.search_lower,
                      &problem.search_upper}) {
    v->resize(space.size());
  }
  SetBounds(plant, options, space, &problem);
  CheckProblem(problem);
  return PaperProblem(std::move(impl));
}

const LeastSquaresProblem& PaperProblem::problem() const { return impl_->problem; }
const std::vector<int>& PaperProblem::parameters() const { return impl_->residuals->parameters(); }
const FitSpace& PaperProblem::space() const { return impl_->residuals->space(); }
int PaperProblem::windows() const { return impl_->residuals->windows(); }
const std::vector<double>& PaperProblem::times() const { return impl_->residuals->times(); }

VectorXd PaperProblem::FullValues(const VectorXd& p) const { return space().Values(p, impl_->base); }

}  // namespace rg::sysid
