// One window of a recording linearised node by node, for the fits of lifted_fit.h.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <memory>
#include <numeric>
#include <string>
#include <vector>

#include "common/base/check.h"
#include "common/effects/inference.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/likelihood/lifted_fit.h"
#include "services/diagnosis/likelihood/row_products.h"

namespace rg::diagnosis {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using sim::RowMatrix;

// Robust cost of a residual r [stddev]: c²·log(1 + r²/c²), c = kSoft. About r² near the model; a window that
// diverges does not outweigh the others.
inline constexpr double kSoft = 20.0;
inline constexpr double kBroken = 1e12;     // r² of a simulation that failed
inline constexpr double kSettleTime = 0.5;  // s before a window from which hidden states are simulated
inline constexpr double kLagMemory = 7.0;   // time constants, after which a lag's initial value is forgotten
inline constexpr size_t kFewRuns = 2;       // that are sooner made one by one than side by side
inline constexpr double kAlways = 1e15;     // s, beyond epoch times in seconds

// The plant with a constant torque of size zero on each joint, whose sensitivities are the columns B.
struct Probe {
  sim::Plant plant;
  VectorXd values;
  std::vector<int> torque;  // parameter index per joint, −1: none
};

// Whether it has the effect on that joint, or on the robot as a whole, which excludes further ones.
inline bool HasOn(const sim::Plant& plant, const std::string& id, const std::string& joint) {
  for (const effects::EffectSpec& e : plant.effects()) {
    if (e.id != id) continue;
    if (e.joints.empty() || std::find(e.joints.begin(), e.joints.end(), joint) != e.joints.end()) return true;
  }
  return false;
}

// Without the torque on joints that can take no further effect of either kind.
inline Probe MakeProbe(const FitModel& model, bool with_torque) {
  Probe probe{model.plant, model.values, {}};
  const int n = model.plant.num_joints();
  probe.torque.assign(n, -1);
  if (!with_torque) return probe;
  struct Push {
    effects::EffectSpec spec;
    std::string parameter;
    int joint;
  };
  // A pulse without end, or a ripple of no cycles.
  const std::string &push = effects::LawOf(effects::Regressor::kPulse).id,
                    &wave = effects::LawOf(effects::Regressor::kSine).id;
  std::vector<Push> pushes;
  for (int j = 0; j < n; ++j) {
    const std::string& joint = model.plant.joint_names()[j];
    if (model.plant.IsPrescribed(j)) continue;
    if (!HasOn(model.plant, push, joint)) {
      pushes.push_back(
          {effects::MakeSpec(push, {joint}, {{"start", -kAlways}, {"end", kAlways}, {"torque", 0.0}}),
           push + "." + joint + ".torque", j});
    } else if (!HasOn(model.plant, wave, joint)) {
      pushes.push_back(
          {effects::MakeSpec(wave, {joint}, {{"amplitude", 0.0}, {"cycles_per_rev", 0.0}, {"phase", M_PI_2}}),
           wave + "." + joint + ".amplitude", j});
    }
  }
  const auto with = [&](const std::vector<Push>& some) {
    std::vector<effects::EffectSpec> specs = model.plant.effects();
    for (const Push& push : some) specs.push_back(push.spec);
    return sim::Plant::Create(model.plant.shared_model(), model.plant.options(), specs);
  };
  auto plant = with(pushes);
  if (!plant.ok()) {
    std::erase_if(pushes, [&](const Push& push) { return !with({push}).ok(); });
    plant = with(pushes);
  }
  RG_CHECK(plant.ok()) << plant.status().ToString();
  probe.plant = *plant;
  probe.values = probe.plant.ValuesFrom(model.plant.parameters(), model.values);
  for (const Push& push : pushes) probe.torque[push.joint] = probe.plant.parameters().Find(push.parameter);
  return probe;
}

// Also false where squares overflow.
inline bool AllFinite(const RowMatrixXd& m) { return std::isfinite(m.squaredNorm()); }

// One window, linearised in nx corrections of its start, P parameters and C features: D = nx + P + C + 1
// columns e_0 | δθ | features | what is left at e_0 = 0, δθ = 0.
struct Linear {
  RowMatrixXd rows;  // M × D, whitened; the last column is the residual
  RowMatrixXd E;     // nx rows of every node one below another, or of the last two; the last column is d
  int nx = 0;
  bool ok = true;

  auto J_e() const { return rows.leftCols(nx); }
  auto J() const { return rows.middleCols(nx, rows.cols() - nx - 1); }
  auto r() const { return rows.rightCols<1>(); }
  auto Node(long k) { return E.middleRows(k * nx, nx); }
  auto Node(long k) const { return E.middleRows(k * nx, nx); }
  long nodes() const { return E.rows() / nx; }
};

// Takes from the columns what lies in those of J_e. Returns the rank of J_e.
int ProjectOut(const Rows& J_e, RowMatrixXd* columns);

struct Worker {
  sim::Simulator simulator;
  sim::State x;
  sim::Trajectory out;
  sim::SensitivityRequest request;
  std::vector<double> times;
  // Runs side by side: from every node of a window, or of several windows from their starts.
  std::vector<sim::SimulationWindow> runs;
  std::vector<std::vector<double>> run_times;
  std::vector<sim::Trajectory> outs;
  Worker(const sim::Plant& plant, const sim::SimulatorOptions& options, const VectorXd& values,
         std::vector<int> parameters)
      : simulator(plant, options) {
    simulator.SetParameters(values);
    request = {.initial_state = true, .parameters = std::move(parameters)};
  }
};

class Lineariser {
 public:
  Lineariser(const FitData& data, const FitModel& model, bool with_torque, const LiftedOptions& options)
      : data_(data), probe_(MakeProbe(model, with_torque)), options_(options) {
    n_ = data.n;
    P_ = static_cast<int>(model.parameters.size());
    nx_ = model.plant.num_states();
    std::vector<int> columns;
    for (const auto& p : model.parameters) {
      columns.push_back(probe_.plant.parameters().Find(model.plant.parameters()[p.index].name));
    }
    torque_column_.assign(n_, -1);
    for (int j = 0; j < n_; ++j) {
      if (probe_.torque[j] < 0) continue;
      torque_column_[j] = static_cast<int>(columns.size());
      columns.push_back(probe_.torque[j]);
    }
    columns_ = columns;
    const auto& internal = probe_.plant.internal_state_names();
    for (const effects::EffectSpec& e : probe_.plant.effects()) {
      const effects::Inference& own = effects::InferenceOf(e.id);
      if (own.stays.empty()) continue;
      for (const std::string& joint : e.joints) {
        const auto at = std::find(internal.begin(), internal.end(), "motor_position." + joint);
        gaps_.push_back({probe_.plant.model().FindJoint(joint),
                         probe_.plant.parameters().Find(e.id + "." + joint + "." + own.stays),
                         probe_.plant.parameters().Find(e.id + "." + joint + ".motor_inertia"),
                         static_cast<int>(at - internal.begin())});
      }
    }
    const std::string& lag = effects::LawOf(effects::Regressor::kLagging).id;
    for (size_t i = 0; i < internal.size(); ++i) {
      if (!internal[i].starts_with(kLagState)) continue;
      const std::string joint = internal[i].substr(kLagState.size());
      lags_.push_back({2 * n_ + static_cast<int>(i),
                       probe_.plant.parameters().Find(lag + "." + joint + ".time_constant")});
    }
    const std::string& delay = effects::EffectOf(effects::Role::kCommandDelay).id;
    for (int i = 0; i < probe_.plant.parameters().size(); ++i) {
      if (probe_.plant.parameters()[i].effect == delay) delays_.push_back(i);
    }
    FreeStarts(internal);
    sim::SimulatorOptions simulator;
    simulator.step_s = options.step_s;
    simulator.integrator = options.integrator;
    for (int w = 0; w < std::max(1, options.threads); ++w) {
      workers_.push_back(std::make_unique<Worker>(probe_.plant, simulator, probe_.values, columns));
    }
  }

  int nx() const { return nx_; }
  int P() const { return P_; }

  int RowsOf(const NodeWindow& w) const {
    int nodes = 0;
    for (const char m : w.measured) nodes += m;
    return nodes * n_ * (data_.use_velocity ? 2 : 1);
  }

  // phi: C × N or null. `keep`: the sensitivities of all nodes.
  void Run(int worker, int index, const MatrixXd& states, const std::vector<int>* joint, const MatrixXd* phi,
           bool keep, Linear* out) {
    Worker& w = *workers_[worker];
    const NodeWindow& window = data_.windows[index];
    const int N = static_cast<int>(window.t.size()) - 1, M = RowsOf(window);
    const int C = joint == nullptr ? 0 : static_cast<int>(joint->size());
    const int D = nx_ + P_ + C + 1;
    out->nx = nx_;
    out->rows.resize(M, D);
    out->E.resize((keep ? N + 1 : 2) * nx_, D);
    out->Node(0).setZero();
    out->ok = true;
    const auto place = [&](int k) { return keep ? k : k % 2; };
    out->Node(0).leftCols(nx_) = starts_;
    TieLags(window, states.col(0), &w, out->Node(0));
    RunNodes(window, states, &w);
    int row = 0;
    for (int k = 0; k < N; ++k) {
      const sim::Trajectory& step = w.outs[k];
      if (!step.outcome.ok() || !AllFinite(step.dfinal_state)) {
        out->ok = false;
        return;
      }
      const int output = static_cast<int>(w.run_times[k].size()) - 1;
      if (k == 0 && window.measured[0])
        WriteRows(w, window, 0, 0, 0, out->Node(0), nullptr, nullptr, out, &row);
      if (window.measured[k + 1])
        WriteRows(w, window, k + 1, k, output, out->Node(place(k)), joint, phi, out, &row);
      auto next = out->Node(place(k + 1));
      next.setZero();
      next.middleCols(nx_, P_) = step.dfinal_state.middleCols(nx_, P_);
      for (int c = 0; c < C; ++c) {
        const int t = torque_column_[(*joint)[c]];
        if (t >= 0) next.col(nx_ + P_ + c) = step.dfinal_state.col(nx_ + t) * (*phi)(c, k);
      }
      next.col(D - 1) = step.state.col(output) - states.col(k + 1);
      AddProduct(step.dfinal_state.leftCols(nx_), out->Node(place(k)), 1.0, next);
    }
    RG_CHECK(row == M) << row << " " << M;
    if (window.factor.size() > 0) window.factor.triangularView<Eigen::Lower>().solveInPlace(out->rows);
    out->ok = AllFinite(out->rows);
  }

  // χ² of a window whose simulation broke at once.
  double WorstChi2(int index) const {
    return RowsOf(data_.windows[index]) * kSoft * kSoft * std::log1p(kBroken / (kSoft * kSoft));
  }

  // Σ ((y − ŷ)/σ)² of the window simulated from x_0 in one go, far residuals softened.
  double Simulated(int worker, int index, const VectorXd& x0) {
    double sum = 0;
    for (const double r : Residuals(worker, index, x0)) sum += Capped(r);
    return sum;
  }

  // The same of several windows side by side, each from its own x_0, or of the first `part` of their nodes.
  std::vector<double> Simulated(int worker, const std::vector<int>& indices, const std::vector<VectorXd>& x0,
                                double part = 1.0) {
    Worker& w = *workers_[worker];
    const size_t count = indices.size();
    w.runs.resize(count), w.run_times.resize(count);
    for (size_t i = 0; i < count; ++i) StartWindow(indices[i], x0[i], &w.runs[i], &w.run_times[i], part);
    if (count <= kFewRuns) {
      w.outs.resize(count);
      for (size_t i = 0; i < count; ++i)
        w.simulator.SimulateInto(w.runs[i].x0, *w.runs[i].command, w.run_times[i], {}, &w.outs[i]);
    } else {
      w.simulator.SimulateWindows(w.runs, {}, &w.outs);
    }
    std::vector<double> sums(count, 0.0);
    for (size_t i = 0; i < count; ++i) {
      for (const double r : Residuals(indices[i], w.outs[i], part)) sums[i] += Capped(r);
    }
    return sums;
  }

  // (y − ŷ)/σ of a window simulated from x_0, rows in the order of Run; where the motion of prescribed joints
  // is in doubt, what is left of it when rows are made independent.
  VectorXd Residuals(int worker, int index, const VectorXd& x0) {
    Worker& w = *workers_[worker];
    w.runs.resize(1), w.run_times.resize(1);
    StartWindow(index, x0, &w.runs[0], &w.run_times[0]);
    w.simulator.SimulateInto(w.runs[0].x0, *w.runs[0].command, w.run_times[0], {}, &w.out);
    return Residuals(index, w.out);
  }

  // Restarts a window at the recorded state, or at the recorded velocities, if its χ² is less from there;
  // writes the simulated states, nx × (N + 1).
  void TryRecordedStart(int worker, int index, MatrixXd* states, double* chi2) {
    const NodeWindow& window = data_.windows[index];
    VectorXd speeds = states->col(0);
    if (!speeds.allFinite()) return;
    speeds.segment(n_, n_) = window.v0.col(0);
    VectorXd all = speeds;
    all.head(n_) = window.q0.col(0);
    const std::vector<double> c = Simulated(worker, {index, index}, {speeds, all});
    const double best = std::min(c[0], c[1]);
    if (!(best < *chi2)) return;
    Worker& w = *workers_[worker];
    SetState(c[1] < c[0] ? all : speeds, window.t[0], &w.x);
    w.simulator.SimulateInto(w.x, data_.recordings[window.recording].command, window.t, {}, &w.out);
    if (!w.out.outcome.ok() || !w.out.state.allFinite()) return;
    *states = w.out.state, *chi2 = best;
  }

  // Replaces a window's states by a simulation from its start; unchanged where that fails.
  void Simulate(int worker, int index, MatrixXd* states) {
    Worker& w = *workers_[worker];
    const NodeWindow& window = data_.windows[index];
    SetState(states->col(0), window.t[0], &w.x);
    w.simulator.SimulateInto(w.x, data_.recordings[window.recording].command, window.t, {}, &w.out);
    if (w.out.outcome.ok() && w.out.state.allFinite()) *states = w.out.state;
  }

  // Simulates hidden states node by node along the recorded motion, in place. With the encoder on the motor
  // the link is the hidden one.
  void CarryHidden(int worker, const NodeWindow& window, const std::vector<int>& motor, MatrixXd* states) {
    Worker& w = *workers_[worker];
    const int nz = nx_ - 2 * n_;
    for (size_t k = 0; k + 1 < window.t.size(); ++k) {
      w.x.q = states->col(k).head(n_);
      w.x.v = states->col(k).segment(n_, n_);
      w.x.z = states->col(k).tail(nz);
      w.x.time = window.t[k];
      w.times.assign(1, window.t[k + 1]);
      w.simulator.SimulateInto(w.x, data_.recordings[window.recording].command, w.times, {}, &w.out);
      if (!w.out.outcome.ok()) return;
      states->col(k + 1).tail(nz) = w.out.state.col(0).tail(nz);
      for (int j = 0; j < n_; ++j) {
        if (motor[j] < 0) continue;
        for (const int row : {j, n_ + j}) (*states)(row, k + 1) = w.out.state(row, 0);
        (*states)(2 * n_ + motor[j], k + 1) = window.q0(j, k + 1);
        (*states)(2 * n_ + motor[j] + 1, k + 1) = window.v0(j, k + 1);
      }
    }
  }
  // s before a window from which its lags are simulated; 0: they are free states.
  double Memory() const {
    double slowest = 0;
    for (const Lag& lag : lags_) slowest = std::max(slowest, probe_.values[lag.time_constant]);
    return kLagMemory * slowest <= kSettleTime ? kLagMemory * slowest : 0.0;
  }
  bool has_gaps() const { return !gaps_.empty(); }
  // Multi-start over the contact of a gear with play: the link lies on either face or between them, at rest
  // against the motor or moving, and no gradient leads from one to the other. Takes the start with the least
  // χ² if that is below `best`, the χ² of the present start; returns the χ². `before`: end state of the
  // window before, or null. `closely`: also between the starts of the grid.
  double ChooseFace(int worker, int index, const std::vector<int>& sensed, const VectorXd* before,
                    bool closely, double best, MatrixXd* states);
  sim::State MakeState(int worker, const VectorXd& q, const VectorXd& v, double t, int recording) {
    return workers_[worker]->simulator.MakeState(q, v, t, data_.recordings[recording].command);
  }
  void SetValues(const FitModel& model, const VectorXd& values) {
    probe_.values = probe_.plant.ValuesFrom(model.plant.parameters(), values);
    for (auto& w : workers_) w->simulator.SetParameters(probe_.values);
  }

 private:
  struct Gap {
    int joint, parameter, inertia, motor;  // place of the motor's position among the internal states
  };
  // A window's start `x` with the motor `ahead` of its link, and `faster`; what the sensor reads stays.
  VectorXd AcrossGap(const Gap& gap, bool reads_motor, VectorXd x, double ahead, double faster) const;
  // From a window's start by steps across the gap (`ahead`, `faster`), halved where none is better; χ².
  double Descend(int worker, int index, const Gap& gap, bool reads_motor, double ahead, double faster,
                 double best, MatrixXd* states);

  static double Capped(double r) {
    const double square = std::isfinite(r) ? std::min(r * r, kBroken) : kBroken;
    return kSoft * kSoft * std::log1p(square / (kSoft * kSoft));
  }

  // Free directions of a window's start. Where hidden states are not free, a motor moves with its link: the
  // spring's deflection is known, and the sensor's noise does not change it.
  void FreeStarts(const std::vector<std::string>& internal) {
    starts_ = MatrixXd::Identity(nx_, nx_);
    if (options_.free_hidden) return;
    starts_.rightCols(nx_ - 2 * n_).setZero();
    for (int j = 0; j < n_; ++j) {
      const std::string& joint = probe_.plant.joint_names()[j];
      const auto at = std::find(internal.begin(), internal.end(), "motor_position." + joint);
      if (at == internal.end()) continue;
      const auto motor = 2 * n_ + (at - internal.begin());
      starts_(motor, j) = starts_(motor + 1, n_ + j) = 1.0;
    }
  }

  // A lag's state at a window's start follows from the commands before: it depends on the parameters and is
  // not free. It stays free where the commands within its memory were not all recorded. E: nx × D.
  void TieLags(const NodeWindow& window, const VectorXd& x0, Worker* w, MutableRows E) const {
    const double begin = window.t[0] - Memory();
    double latest = 0;
    for (const int delay : delays_) latest = std::max(latest, probe_.values[delay]);
    if (!(begin < window.t[0]) || !Recorded(window.recording, begin - latest, window.t[0])) return;
    const sim::CommandSignal& command = data_.recordings[window.recording].command;
    const sim::State before = w->simulator.MakeState(window.q0.col(0), window.v0.col(0), begin, command);
    w->times.assign(1, window.t[0]);
    w->simulator.SimulateInto(before, command, w->times, w->request, &w->out);
    if (!w->out.outcome.ok() || !w->out.dfinal_state.allFinite()) return;
    for (const Lag& lag : lags_) {
      auto row = E.row(lag.state);
      row.setZero();
      row[E.cols() - 1] = w->out.state(lag.state, 0) - x0[lag.state];
      row.segment(nx_, P_) = w->out.dfinal_state.row(lag.state).segment(nx_, P_);
    }
  }
  // Whether no rows are missing in the interval.
  bool Recorded(int recording, double from, double to) const {
    const auto& gaps = data_.fine[recording].gaps;
    return from >= data_.recordings[recording].recording->t[0] &&
           std::none_of(gaps.begin(), gaps.end(),
                        [&](const auto& gap) { return gap.first < to && gap.second > from; });
  }

  // Simulates from every node to the next, with sensitivities; outputs at the rows after a node, the rows
  // before the next, and the next.
  void RunNodes(const NodeWindow& window, const MatrixXd& states, Worker* w) const {
    const int N = static_cast<int>(window.t.size()) - 1;
    w->runs.resize(N), w->run_times.resize(N);
    for (int k = 0; k < N; ++k) {
      std::vector<double>& times = w->run_times[k];
      times.clear();
      if ((k == 0 && window.measured[0]) || !window.after[k].empty()) times.push_back(window.t[k]);
      times.insert(times.end(), window.after[k].begin(), window.after[k].end());
      times.insert(times.end(), window.before[k + 1].begin(), window.before[k + 1].end());
      times.push_back(window.t[k + 1]);
      w->runs[k].command = &data_.recordings[window.recording].command;
      w->runs[k].times = &w->run_times[k];
      w->runs[k].derivatives_at_end = k > 0;
      SetState(states.col(k), window.t[k], &w->runs[k].x0);
    }
    w->simulator.SimulateWindows(w->runs, w->request, &w->outs);
  }
  // At least three nodes, of which one is measured.
  static size_t NodesOf(const NodeWindow& window, double part) {
    const size_t all = window.t.size();
    if (part >= 1.0) return all;
    const auto first = std::find(window.measured.begin(), window.measured.end(), char{1});
    const auto needed = static_cast<size_t>(first - window.measured.begin()) + 1;
    const auto some = static_cast<size_t>(std::lround(part * static_cast<double>(all)));
    return std::min(all, std::max({size_t{3}, needed, some}));
  }
  // The whole window in one run, or its first part.
  void StartWindow(int index, const VectorXd& x0, sim::SimulationWindow* run, std::vector<double>* times,
                   double part = 1.0) const {
    const NodeWindow& window = data_.windows[index];
    const size_t nodes = NodesOf(window, part);
    times->clear();
    for (size_t k = 0; k < nodes; ++k) {
      if (!window.measured[k]) continue;
      times->insert(times->end(), window.before[k].begin(), window.before[k].end());
      times->push_back(window.t[k]);
      times->insert(times->end(), window.after[k].begin(), window.after[k].end());
    }
    run->command = &data_.recordings[window.recording].command;
    run->times = times;
    run->derivatives_at_end = false;
    SetState(x0, window.t[0], &run->x0);
  }
  VectorXd Residuals(int index, const sim::Trajectory& simulated, double part = 1.0) const {
    const NodeWindow& window = data_.windows[index];
    const size_t nodes = NodesOf(window, part);
    VectorXd residuals(RowsOf(window));
    Eigen::Index row = 0, at = 0;
    for (size_t node = 0; node < nodes; ++node) {
      if (!window.measured[node]) continue;
      const auto k = static_cast<Eigen::Index>(node);
      const auto count =
          static_cast<Eigen::Index>(1 + window.before[node].size() + window.after[node].size());
      const auto mean = [&](const MatrixXd& of) -> VectorXd {
        return of.middleCols(at, count).rowwise().mean();
      };
      residuals.segment(row, n_) =
          (window.q.col(k) - mean(simulated.position)).cwiseQuotient(window.q_stddev.col(k));
      row += n_;
      if (data_.use_velocity) {
        residuals.segment(row, n_) =
            (window.v.col(k) - mean(simulated.velocity)).cwiseQuotient(window.v_stddev.col(k));
        row += n_;
      }
      at += count;
    }
    residuals.conservativeResize(row);
    if (window.factor.size() > 0)
      window.factor.topLeftCorner(row, row).triangularView<Eigen::Lower>().solveInPlace(residuals);
    return residuals;
  }
  void SetState(const VectorXd& stacked, double time, sim::State* x) const {
    x->q = stacked.head(n_);
    x->v = stacked.segment(n_, n_);
    x->z = stacked.tail(nx_ - 2 * n_);
    x->time = time;
  }

  // Mean of a node's outputs minus the output at its own time.
  VectorXd MeanBeyond(const Worker& w, const NodeWindow& window, int node, bool speed) const {
    const auto of = [&](int run) -> const MatrixXd& {
      return speed ? w.outs[run].velocity : w.outs[run].position;
    };
    const auto before = static_cast<Eigen::Index>(window.before[node].size());
    const auto after = static_cast<Eigen::Index>(window.after[node].size());
    VectorXd sum = VectorXd::Zero(n_);
    if (before > 0) {
      const MatrixXd& y = of(node - 1);
      const Eigen::Index end = static_cast<Eigen::Index>(w.run_times[node - 1].size()) - 1;
      for (Eigen::Index i = end - before; i < end; ++i) sum += y.col(i) - y.col(end);
    }
    if (after > 0 && w.outs[node].outcome.ok()) {
      const MatrixXd& y = of(node);
      for (Eigen::Index i = 1; i <= after; ++i) sum += y.col(i) - y.col(0);
    }
    return sum / static_cast<double>(1 + before + after);
  }

  // The derivatives of a node's mean are approximated by those at its own time. E: sensitivities of the node
  // that `run` starts from.
  void WriteRows(const Worker& w, const NodeWindow& window, int node, int run, int output, const Rows& E,
                 const std::vector<int>* joint, const MatrixXd* phi, Linear* out, int* row) {
    const sim::Trajectory& step = w.outs[run];
    const int kinds = data_.use_velocity ? 2 : 1;
    for (int kind = 0; kind < kinds; ++kind) {
      const RowMatrix& D = kind == 0 ? step.dposition : step.dvelocity;
      const auto block = D.middleRows(w.runs[run].derivatives_at_end ? 0 : output * n_, n_);
      const VectorXd y = kind == 0 ? window.q.col(node) : window.v.col(node);
      VectorXd h = kind == 0 ? step.position.col(output) : step.velocity.col(output);
      h += MeanBeyond(w, window, node, kind == 1);
      auto rows = out->rows.middleRows(*row, n_);
      rows.setZero();
      rows.middleCols(nx_, P_) = block.middleCols(nx_, P_);
      for (long c = 0; phi != nullptr && c < phi->rows(); ++c) {
        const int t = torque_column_[(*joint)[c]];
        if (t >= 0) rows.col(nx_ + P_ + c) = block.col(nx_ + t) * (*phi)(c, node - 1);
      }
      rows.rightCols<1>() = h - y;
      AddProduct(block.leftCols(nx_), E, 1.0, rows);
      rows.rightCols<1>() *= -1;
      rows.array().colwise() /= (kind == 0 ? window.q_stddev : window.v_stddev).col(node).array();
      *row += n_;
    }
  }

  const FitData& data_;
  Probe probe_;
  LiftedOptions options_;
  int n_ = 0, P_ = 0, nx_ = 0;
  std::vector<int> columns_, torque_column_;
  MatrixXd starts_;  // nx × nx
  std::vector<Gap> gaps_;
  struct Lag {
    int state, time_constant;  // row of the state, place among the parameters
  };
  std::vector<Lag> lags_;
  std::vector<int> delays_;  // of commands, places among the parameters
  std::vector<std::unique_ptr<Worker>> workers_;
};

}  // namespace rg::diagnosis
