#include "services/diagnosis/data/prepare_data.h"

#include <algorithm>
#include <memory>
#include <utility>
#include <vector>

#include "common/base/parallel.h"
#include "common/recordings/prescribed.h"
#include "common/sim/simulator.h"
#include "services/diagnosis/data/motion_survey.h"
#include "services/sysid/drive_signal.h"

namespace rg::diagnosis {

using recordings::PrescribedDoubt;
using recordings::Recording;
using recordings::SmoothMotionRows;
using recordings::WaysToDiffer;

namespace {

constexpr double kNodesPerRow = 20.0;  // at most: from 5 Hz on nodes are 10 ms apart

// Uncertainty of the motion of prescribed joints, as noise of the other joints' residuals that is correlated
// over a window:
//
//   residual = ν + S·c,   ν: the sensors', white;   c ~ N(0, 1): one for each way in which a joint may differ
//
// S by the model as given, along the recorded motion, from node to node as in lifted_fit.h.

// Rows of a recording around a window, and one more on either side, where nothing differs.
struct Around {
  int first, last;
};
Around RowsAround(const Recording& rec, const NodeWindow& window) {
  const double* begin = rec.t.data();
  const double* end = begin + rec.rows();
  const auto first = std::upper_bound(begin, end, window.t.front()) - begin - 1;
  const auto last = std::lower_bound(begin, end, window.t.back()) - begin;
  return {std::max(0, static_cast<int>(first)), std::min(rec.rows() - 1, static_cast<int>(last))};
}

// The command with the smooth motion, joint `i` moved in one way.
sim::CommandSignal Differing(const sim::CommandSignal& command, const Recording& rec,
                             const SmoothMotionRows& smooth, const Around& rows, size_t i,
                             const WaysToDiffer& ways, Eigen::Index way) {
  const int from = std::max(0, rows.first - 1), to = std::min(rec.rows() - 1, rows.last + 1);
  const int count = to - from + 1;
  MatrixXd q = smooth.q.middleCols(from, count), v = smooth.v.middleCols(from, count),
           a = smooth.a.middleCols(from, count);
  const auto joint = static_cast<Eigen::Index>(i);
  const Eigen::Index at = rows.first - from, differing = rows.last - rows.first + 1;
  q.row(joint).segment(at, differing) += ways.q.col(way).transpose();
  v.row(joint).segment(at, differing) += ways.v.col(way).transpose();
  a.row(joint).segment(at, differing) += ways.a.col(way).transpose();
  auto motion = sim::GivenMotion::Create(rec.prescribed, {rec.t.data() + from, rec.t.data() + to + 1},
                                         std::move(q), std::move(v), std::move(a));
  RG_CHECK(motion.ok()) << motion.status().ToString();
  return command.WithMotion(std::make_shared<const sim::GivenMotion>(std::move(motion).value()));
}

// One run from every node of a window to the next, from where the motion was recorded.
class FromNodeToNode {
 public:
  FromNodeToNode(sim::Simulator& simulator, const NodeWindow& window, const sim::CommandSignal& command)
      : simulator_(simulator), times_(window.t.size() - 1), runs_(window.t.size() - 1) {
    for (size_t k = 0; k < runs_.size(); ++k) {
      times_[k] = {window.t[k + 1]};
      const auto node = static_cast<Eigen::Index>(k);
      runs_[k].x0 = simulator.MakeState(window.q0.col(node), window.v0.col(node), window.t[k], command);
      runs_[k].times = &times_[k];
    }
  }
  // False if a simulation fails.
  bool Run(const sim::CommandSignal& command, const sim::SensitivityRequest& request,
           std::vector<sim::Trajectory>* out) {
    for (sim::SimulationWindow& run : runs_) run.command = &command;
    simulator_.SimulateWindows(runs_, request, out);
    return std::ranges::all_of(
        *out, [](const sim::Trajectory& t) { return t.outcome.ok() && t.state.allFinite(); });
  }

 private:
  sim::Simulator& simulator_;
  std::vector<std::vector<double>> times_;
  std::vector<sim::SimulationWindow> runs_;
};

// Computes a window's doubts; false if it cannot be simulated.
bool AddDoubt(sim::Simulator& simulator, const FitData& data, const SmoothMotionRows& smooth,
              const PrescribedDoubt& doubt, NodeWindow* window) {
  const sysid::FitRecording& fit = data.recordings[static_cast<size_t>(window->recording)];
  const Recording& rec = *fit.recording;
  const Eigen::Index n = data.n, nodes = std::ssize(window->t);
  FromNodeToNode steps(simulator, *window, fit.command);
  std::vector<sim::Trajectory> plain, moved;
  if (!steps.Run(fit.command, {.initial_state = true}, &plain)) return false;
  const Around rows = RowsAround(rec, *window);
  std::vector<VectorXd> ends;  // of all nodes, for each way: (q, v) of one node after another
  for (size_t i = 0; i < rec.prescribed.size(); ++i) {
    const WaysToDiffer ways = doubt.Ways(static_cast<int>(i), rows.first, rows.last);
    for (Eigen::Index way = 0; way < ways.a.cols(); ++way) {
      if (!steps.Run(Differing(fit.command, rec, smooth, rows, i, ways, way), {}, &moved)) return false;
      VectorXd all = VectorXd::Zero(2 * n * nodes), e = VectorXd::Zero(plain[0].state.rows());
      for (Eigen::Index k = 0; k + 1 < nodes; ++k) {
        const auto step = static_cast<size_t>(k);
        e = (plain[step].dfinal_state.leftCols(e.size()) * e + moved[step].state.col(0) -
             plain[step].state.col(0))
                .eval();
        all.segment(2 * n * (k + 1), 2 * n) = e.head(2 * n);
      }
      if (!all.allFinite()) return false;
      ends.push_back(std::move(all));
    }
  }
  window->q_doubt.setZero(n * nodes, std::ssize(ends));
  if (data.use_velocity) window->v_doubt.setZero(n * nodes, std::ssize(ends));
  for (Eigen::Index way = 0; way < std::ssize(ends); ++way) {
    for (Eigen::Index k = 0; k < nodes; ++k) {
      const auto at = ends[way].segment(2 * n * k, 2 * n);
      window->q_doubt.col(way).segment(n * k, n) = at.head(n);
      if (data.use_velocity) window->v_doubt.col(way).segment(n * k, n) = at.tail(n);
    }
  }
  SetFactor(window);
  return true;
}

// Fills the doubts and factors of all windows (motion.h); nothing where no joint is prescribed, or in a
// window that the plant cannot simulate.
void AddPrescribedDoubt(const sim::Plant& plant, int threads, FitData* data) {
  if (data->prescribed.empty()) return;
  std::vector<PrescribedDoubt> doubts;
  std::vector<SmoothMotionRows> smooth;
  for (const sysid::FitRecording& fit : data->recordings) {
    doubts.emplace_back(*fit.recording);
    smooth.push_back(recordings::SmoothPrescribed(*fit.recording));
  }
  std::vector<std::unique_ptr<sim::Simulator>> simulators(static_cast<size_t>(std::max(1, threads)));
  for (auto& simulator : simulators) simulator = std::make_unique<sim::Simulator>(plant);
  ParallelFor(threads, static_cast<int>(data->windows.size()), [&](int worker, int w) {
    NodeWindow& window = data->windows[w];
    const auto r = static_cast<size_t>(window.recording);
    AddDoubt(*simulators[worker], *data, smooth[r], doubts[r], &window);
  });
}

// Three windows at least.
Result<FitData> Prepared(const recordings::RecordingSet& set, const std::vector<const Recording*>& recordings,
                         const sim::Plant& nominal, const DiagnosisOptions& options) {
  FitData data;
  data.n = nominal.num_joints();
  data.prescribed = nominal.prescribed();
  data.noise = WorkingNoise(recordings::EstimateSensorNoise(set), set.noise);
  const VectorXd values = nominal.parameters().Nominal();
  for (const Recording* rec : recordings) {
    if (rec->drive_effort().size() == 0) return InvalidError(rec->name + ": no effort drives the model");
    if (rec->rows() < 10) return InvalidError(rec->name + ": fewer than 10 rows, too little to fit");
    data.use_velocity = data.use_velocity && rec->has_velocity();
    data.places.push_back(static_cast<uint32_t>(rec - set.recordings.data()));
    data.recordings.push_back({rec, set.effort_excludes_gravity
                                        ? sysid::DriveSignalWithGravity(*rec, nominal, values)
                                        : sysid::DriveSignal(*rec)});
  }
  data.nodes.window_s = options.fit_window_s;
  // More nodes between rows that are far apart would cost memory for nothing.
  for (const sysid::FitRecording& r : data.recordings)
    data.nodes.interval_s = std::max(data.nodes.interval_s, r.recording->SamplePeriod() / kNodesPerRow);
  for (size_t r = 0; r < data.recordings.size(); ++r) {
    data.motions.emplace_back(*data.recordings[r].recording, data.noise);
    auto windows = CutIntoNodes(*data.recordings[r].recording, static_cast<int>(r), data.motions[r],
                                data.RowNoise(), data.nodes);
    data.windows.insert(data.windows.end(), windows.begin(), windows.end());
    data.fine.push_back(
        FineMotionOf(*data.recordings[r].recording, data.recordings[r].command, data.motions[r], data.nodes));
    // An effort recorded for an undriven joint has no effect.
    for (int j = 0; j < data.n; ++j) {
      if (nominal.IsPassive(j)) data.fine.back().u.row(j).setZero();
    }
  }
  if (data.windows.size() < 3)
    return InvalidError("less than three windows of motion: too little to say anything");
  AddPrescribedDoubt(nominal, options.threads, &data);
  return data;
}

}  // namespace

Result<FitData> PrepareData(const recordings::RecordingSet& set, const sim::Plant& nominal,
                            const DiagnosisOptions& options) {
  if (set.Fit().empty()) return InvalidError("no recording of the split \"fit\"");
  return Prepared(set, set.Fit(), nominal, options);
}

std::shared_ptr<const FitData> PrepareHeldOut(const recordings::RecordingSet& set, const FitData& fitted,
                                              const sim::Plant& nominal, const DiagnosisOptions& options) {
  if (set.Holdout().empty()) return nullptr;
  auto data = Prepared(set, set.Holdout(), nominal, options);
  if (!data.ok() || data->use_velocity != fitted.use_velocity) return nullptr;
  return std::make_shared<const FitData>(*std::move(data));
}

}  // namespace rg::diagnosis
