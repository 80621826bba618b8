#include "services/diagnosis/likelihood/lineariser.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "common/base/check.h"
#include "common/base/parallel.h"
#include "common/effects/inference.h"
#include "common/model/robot_model.h"

namespace rg::diagnosis {

namespace {

constexpr double kBroken = 1e12;    // r² of a simulation that failed
constexpr double kLagMemory = 7.0;  // time constants, after which a lag's initial value is forgotten
constexpr size_t kFewRuns = 2;      // that are sooner made one by one than side by side

// Also false where squares overflow.
bool AllFinite(const RowMatrixXd& m) { return std::isfinite(m.squaredNorm()); }

// G += A·E in the leading `columns` and the last one: E is zero between them.
void AddThrough(const Rows& A, const Rows& E, long columns, MutableRows G) {
  const long first = columns + 1 < E.cols() ? columns : E.cols();
  AddProduct(A, E.leftCols(first), 1.0, G.leftCols(first));
  if (first < E.cols()) AddProduct(A, E.rightCols(1), 1.0, G.rightCols(1));
}

double Capped(double r) {
  const double square = std::isfinite(r) ? std::min(r * r, kBroken) : kBroken;
  return kSoft * kSoft * std::log1p(square / (kSoft * kSoft));
}

double SoftenedSum(const VectorXd& residuals) {
  double sum = 0;
  for (const double r : residuals) sum += Capped(r);
  return sum;
}

std::vector<int> SensedMotors(const sim::Plant& plant) {
  std::vector<int> out(plant.num_joints(), -1);
  for (const EffectSpec& e : plant.effects()) {
    const auto sensor = e.options.find("sensor");
    if (sensor == e.options.end() || sensor->second != "motor") continue;
    for (const std::string& joint : e.joints) out[plant.model().FindJoint(joint)] = MotorOf(plant, joint);
  }
  return out;
}

// At least three nodes, of which one is measured.
size_t NodesIn(const NodeWindow& window, double part) {
  const size_t all = window.t.size();
  if (part >= 1.0) return all;
  const auto first = std::ranges::find(window.measured, char{1});
  const auto needed = static_cast<size_t>(first - window.measured.begin()) + 1;
  const auto some = static_cast<size_t>(std::lround(part * static_cast<double>(all)));
  return std::min(all, std::max({size_t{3}, needed, some}));
}

// Times of the rows of a window, or of its first part.
void TimesOf(const NodeWindow& window, double part, std::vector<double>* times) {
  const size_t nodes = NodesIn(window, part);
  times->clear();
  for (size_t k = 0; k < nodes; ++k) {
    if (!window.measured[k]) continue;
    times->insert(times->end(), window.before[k].begin(), window.before[k].end());
    times->push_back(window.t[k]);
    times->insert(times->end(), window.after[k].begin(), window.after[k].end());
  }
}

}  // namespace

struct Lineariser::Worker {
  sim::Simulator simulator;
  sim::SensitivityRequest request;
  sim::State x;
  sim::Trajectory out;
  std::vector<double> times;
  // Runs side by side: from every node of a window, or of several windows from their starts.
  std::vector<sim::SimulationWindow> runs;
  std::vector<std::vector<double>> run_times;
  std::vector<sim::Trajectory> outs;
};

Lineariser::Lineariser(const FitData& data, const FitModel& model, bool with_torque,
                       const LiftedOptions& options)
    : data_(data),
      probe_(MakeProbe(model, with_torque)),
      options_(options),
      P_(static_cast<int>(model.parameters.size())),
      nx_(model.plant.num_states()),
      sensed_motors_(SensedMotors(probe_.plant)) {
  ReadSensorOffsets();
  FindGaps();
  FindLags();
  FreeStarts();
  const sim::SimulatorOptions simulator{.integrator = options.integrator, .step_s = options.step_s};
  const sim::SensitivityRequest request{.initial_state = true, .parameters = Columns(model)};
  for (int w = 0; w < std::max(1, options.threads); ++w) {
    workers_.push_back(std::make_unique<Worker>(Worker{sim::Simulator(probe_.plant, simulator), request}));
    workers_.back()->simulator.SetParameters(probe_.values);
  }
}

Lineariser::~Lineariser() = default;

void Lineariser::FindGaps() {
  const auto& parameters = probe_.plant.parameters();
  for (const EffectSpec& e : probe_.plant.effects()) {
    const effects::Inference& own = effects::InferenceOf(e.id);
    if (own.stays.empty()) continue;
    for (const std::string& joint : e.joints) {
      const int at = probe_.plant.model().FindJoint(joint);
      gaps_.push_back({at, parameters.Find(e.id + "." + joint + "." + own.stays),
                       parameters.Find(e.id + "." + joint + ".motor_inertia"), MotorOf(probe_.plant, joint),
                       sensed_motors_[at] >= 0});
    }
  }
}

// And the delays, for a lag follows what comes late.
void Lineariser::FindLags() {
  const auto& internal = probe_.plant.internal_state_names();
  const std::string& lag = effects::LawOf(effects::Regressor::kLagging).id;
  for (size_t i = 0; i < internal.size(); ++i) {
    if (!internal[i].starts_with(kLagState)) continue;
    const std::string joint = internal[i].substr(kLagState.size());
    lags_.push_back(
        {2 * n_ + static_cast<int>(i), probe_.plant.parameters().Find(lag + "." + joint + ".time_constant")});
  }
  const std::string& delay = effects::EffectOf(effects::Role::kCommandDelay).id;
  for (int i = 0; i < probe_.plant.parameters().size(); ++i) {
    if (probe_.plant.parameters()[i].effect == delay) delays_.push_back(i);
  }
}

// Free directions of a window's start. Where hidden states are not free, a motor moves with its link: the
// spring's deflection is known, and the sensor's noise does not change it.
void Lineariser::FreeStarts() {
  starts_ = MatrixXd::Identity(nx_, nx_);
  if (options_.free_hidden) return;
  starts_.rightCols(nx_ - 2 * n_).setZero();
  for (int j = 0; j < n_; ++j) {
    const int motor = MotorOf(probe_.plant, probe_.plant.joint_names()[j]);
    if (motor >= 0) starts_(2 * n_ + motor, j) = starts_(2 * n_ + motor + 1, n_ + j) = 1.0;
  }
}

// The parameters in which it linearises; torques come last.
std::vector<int> Lineariser::Columns(const FitModel& model) {
  std::vector<int> columns;
  for (const auto& p : model.parameters)
    columns.push_back(probe_.plant.parameters().Find(model.plant.parameters()[p.index].name));
  torque_column_.assign(n_, -1);
  for (int j = 0; j < n_; ++j) {
    if (probe_.torque[j] < 0) continue;
    torque_column_[j] = static_cast<int>(columns.size());
    columns.push_back(probe_.torque[j]);
  }
  return columns;
}

int Lineariser::RowsOf(const NodeWindow& w) const {
  return static_cast<int>(std::ranges::count(w.measured, char{1})) * n_ * (data_.use_velocity ? 2 : 1);
}

double Lineariser::Memory() const {
  double slowest = 0;
  for (const Lag& lag : lags_) slowest = std::max(slowest, probe_.values[lag.time_constant]);
  return kLagMemory * slowest <= kSettleTime ? kLagMemory * slowest : 0.0;
}

void Lineariser::SetValues(const FitModel& model, const VectorXd& values) {
  probe_.values = probe_.plant.ValuesFrom(model.plant.parameters(), values);
  ReadSensorOffsets();
  for (auto& w : workers_) w->simulator.SetParameters(probe_.values);
}

void Lineariser::ReadSensorOffsets() {
  const effects::EffectInfo& reads_off = effects::EffectOf(effects::Role::kSensorOffset);
  sensor_offsets_ = VectorXd::Zero(n_);
  for (int j = 0; j < n_; ++j) {
    const int at = probe_.plant.parameters().Find(reads_off.id + "." + probe_.plant.joint_names()[j] + "." +
                                                  reads_off.parameters.front().name);
    if (at >= 0) sensor_offsets_[j] = probe_.values[at];
  }
}

sim::State Lineariser::MakeState(int worker, const VectorXd& q, const VectorXd& v, double t, int recording) {
  return workers_[worker]->simulator.MakeState(q, v, t, data_.recordings[recording].command);
}

void Lineariser::Run(int worker, int index, const MatrixXd& states, const std::vector<int>* joint,
                     const MatrixXd* phi, bool keep, Linear* out) {
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
  // Columns of torques that act up to an interval: others are zero there.
  std::vector<int> acting(static_cast<size_t>(N), 0);
  for (int c = 0; c < C; ++c) {
    int first = 0;
    while (first + 1 < N && (*phi)(c, first) == 0) ++first;
    acting[first] = c + 1;
  }
  for (int k = 1; k < N; ++k) acting[k] = std::max(acting[k], acting[k - 1]);
  int row = 0;
  for (int k = 0; k < N; ++k) {
    const sim::Trajectory& step = w.outs[k];
    if (!step.outcome.ok() || !AllFinite(step.dfinal_state)) {
      out->ok = false;
      return;
    }
    const int output = static_cast<int>(w.run_times[k].size()) - 1;
    if (k == 0 && window.measured[0])
      WriteRows(w, window, 0, 0, 0, out->Node(0), 0, nullptr, nullptr, out, &row);
    if (window.measured[k + 1])
      WriteRows(w, window, k + 1, k, output, out->Node(place(k)), acting[k], joint, phi, out, &row);
    auto next = out->Node(place(k + 1));
    next.setZero();
    next.middleCols(nx_, P_) = step.dfinal_state.middleCols(nx_, P_);
    for (int c = 0; c < acting[k]; ++c) {
      const int t = torque_column_[(*joint)[c]];
      if (t >= 0 && (*phi)(c, k) != 0) next.col(nx_ + P_ + c) = step.dfinal_state.col(nx_ + t) * (*phi)(c, k);
    }
    next.col(D - 1) = step.state.col(output) - states.col(k + 1);
    AddThrough(step.dfinal_state.leftCols(nx_), out->Node(place(k)), nx_ + P_ + acting[k], next);
  }
  RG_CHECK(row == M) << row << " " << M;
  if (window.factor.size() > 0) window.factor.triangularView<Eigen::Lower>().solveInPlace(out->rows);
  out->ok = AllFinite(out->rows);
}

// A lag's state at a window's start follows from the commands before: it depends on the parameters and is
// not free. It stays free where the commands within its memory were not all recorded. E: nx × D.
void Lineariser::TieLags(const NodeWindow& window, const VectorXd& x0, Worker* w, MutableRows E) const {
  const double begin = window.t[0] - Memory();
  double latest = 0;
  for (const int delay : delays_) latest = std::max(latest, probe_.values[delay]);
  if (!(begin < window.t[0]) || !Recorded(window.recording, begin - latest, window.t[0])) return;
  const sim::CommandSignal& command = CommandOf(window);
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
bool Lineariser::Recorded(int recording, double from, double to) const {
  const auto& gaps = data_.fine[recording].gaps;
  return from >= data_.recordings[recording].recording->t[0] &&
         std::ranges::none_of(gaps, [&](const auto& gap) { return gap.first < to && gap.second > from; });
}

// Simulates from every node to the next, with sensitivities; outputs at the rows after a node, the rows
// before the next, and the next.
void Lineariser::RunNodes(const NodeWindow& window, const MatrixXd& states, Worker* w) const {
  const int N = static_cast<int>(window.t.size()) - 1;
  w->runs.resize(N), w->run_times.resize(N);
  for (int k = 0; k < N; ++k) {
    std::vector<double>& times = w->run_times[k];
    times.clear();
    if ((k == 0 && window.measured[0]) || !window.after[k].empty()) times.push_back(window.t[k]);
    times.insert(times.end(), window.after[k].begin(), window.after[k].end());
    times.insert(times.end(), window.before[k + 1].begin(), window.before[k + 1].end());
    times.push_back(window.t[k + 1]);
    w->runs[k].command = &CommandOf(window);
    w->runs[k].times = &w->run_times[k];
    w->runs[k].derivatives_at_end = k > 0;
    SetState(states.col(k), window.t[k], &w->runs[k].x0);
  }
  w->simulator.SimulateWindows(w->runs, w->request, &w->outs);
}

// Mean of a node's outputs minus the output at its own time.
VectorXd Lineariser::MeanBeyond(const Worker& w, const NodeWindow& window, int node, bool speed) const {
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
void Lineariser::WriteRows(const Worker& w, const NodeWindow& window, int node, int run, int output,
                           const Rows& E, int acting, const std::vector<int>* joint, const MatrixXd* phi,
                           Linear* out, int* row) const {
  const sim::Trajectory& step = w.outs[run];
  const int kinds = data_.use_velocity ? 2 : 1;
  for (int kind = 0; kind < kinds; ++kind) {
    const sim::RowMatrix& D = kind == 0 ? step.dposition : step.dvelocity;
    const auto block = D.middleRows(w.runs[run].derivatives_at_end ? 0 : output * n_, n_);
    const VectorXd y = kind == 0 ? window.q.col(node) : window.v.col(node);
    VectorXd h = kind == 0 ? step.position.col(output) : step.velocity.col(output);
    h += MeanBeyond(w, window, node, kind == 1);
    auto rows = out->rows.middleRows(*row, n_);
    rows.setZero();
    rows.middleCols(nx_, P_) = block.middleCols(nx_, P_);
    for (int c = 0; c < acting; ++c) {
      const int t = torque_column_[(*joint)[c]];
      if (t >= 0 && (*phi)(c, node - 1) != 0)
        rows.col(nx_ + P_ + c) = block.col(nx_ + t) * (*phi)(c, node - 1);
    }
    rows.rightCols<1>() = h - y;
    AddThrough(block.leftCols(nx_), E, nx_ + P_ + acting, rows);
    rows.rightCols<1>() *= -1;
    rows.array().colwise() /= (kind == 0 ? window.q_stddev : window.v_stddev).col(node).array();
    *row += n_;
  }
}

VectorXd Lineariser::Residuals(int worker, int index, const VectorXd& x0, double part) {
  Worker& w = *workers_[worker];
  const NodeWindow& window = data_.windows[index];
  TimesOf(window, part, &w.times);
  return Residuals(window, RunFrom(window, x0, w.times, &w), part);
}

std::vector<VectorXd> Lineariser::Residuals(int worker, const std::vector<int>& indices,
                                            const std::vector<VectorXd>& x0, double part) {
  Worker& w = *workers_[worker];
  const size_t count = indices.size();
  std::vector<VectorXd> out(count);
  if (count <= kFewRuns) {
    for (size_t i = 0; i < count; ++i) out[i] = Residuals(worker, indices[i], x0[i], part);
    return out;
  }
  w.runs.resize(count), w.run_times.resize(count);
  for (size_t i = 0; i < count; ++i) {
    const NodeWindow& window = data_.windows[indices[i]];
    TimesOf(window, part, &w.run_times[i]);
    w.runs[i].command = &CommandOf(window);
    w.runs[i].times = &w.run_times[i];
    w.runs[i].derivatives_at_end = false;
    SetState(x0[i], window.t[0], &w.runs[i].x0);
  }
  w.simulator.SimulateWindows(w.runs, {}, &w.outs);
  for (size_t i = 0; i < count; ++i) out[i] = Residuals(data_.windows[indices[i]], w.outs[i], part);
  return out;
}

std::vector<double> Lineariser::Simulated(int worker, const std::vector<int>& indices,
                                          const std::vector<VectorXd>& x0, double part) {
  std::vector<double> sums;
  for (const VectorXd& r : Residuals(worker, indices, x0, part)) sums.push_back(SoftenedSum(r));
  return sums;
}

double Lineariser::WorstChi2(int index) const {
  return RowsOf(data_.windows[index]) * kSoft * kSoft * std::log1p(kBroken / (kSoft * kSoft));
}

VectorXd Lineariser::Residuals(const NodeWindow& window, const sim::Trajectory& simulated,
                               double part) const {
  const size_t nodes = NodesIn(window, part);
  VectorXd residuals(RowsOf(window));
  Eigen::Index row = 0, at = 0;
  for (size_t node = 0; node < nodes; ++node) {
    if (!window.measured[node]) continue;
    const auto k = static_cast<Eigen::Index>(node);
    const auto count = static_cast<Eigen::Index>(1 + window.before[node].size() + window.after[node].size());
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

void Lineariser::TryRecordedStart(int worker, int index, const VectorXd* before, MatrixXd* states,
                                  double* chi2) {
  const NodeWindow& window = data_.windows[index];
  VectorXd speeds = states->col(0);
  if (!speeds.allFinite()) return;
  speeds.segment(n_, n_) = window.v0.col(0);
  std::vector<VectorXd> starts(2, speeds);
  starts[1].head(n_) = window.q0.col(0) - sensor_offsets_;
  if (before != nullptr && before->allFinite() && nx_ > 2 * n_) starts.push_back(*before);
  const std::vector<double> c = Simulated(worker, std::vector<int>(starts.size(), index), starts);
  const auto best = std::ranges::min_element(c);
  if (!(*best < *chi2)) return;
  const VectorXd& start = starts[static_cast<size_t>(best - c.begin())];
  const sim::Trajectory& out = RunFrom(window, start, window.t, workers_[worker].get());
  if (out.outcome.ok() && out.state.allFinite()) *states = out.state, *chi2 = *best;
}

const sim::Trajectory& Lineariser::SimulatedAt(int worker, int index, const VectorXd& x0,
                                               const std::vector<double>& times) {
  return RunFrom(data_.windows[index], x0, times, workers_[worker].get());
}

void Lineariser::Simulate(int worker, int index, MatrixXd* states) {
  const NodeWindow& window = data_.windows[index];
  const sim::Trajectory& out = RunFrom(window, states->col(0), window.t, workers_[worker].get());
  if (out.outcome.ok() && out.state.allFinite()) *states = out.state;
}

void Lineariser::CarryHidden(int worker, const NodeWindow& window, const std::vector<int>& motor,
                             MatrixXd* states) {
  Worker& w = *workers_[worker];
  const int nz = nx_ - 2 * n_;
  for (size_t k = 0; k + 1 < window.t.size(); ++k) {
    SetState(states->col(k), window.t[k], &w.x);
    w.times.assign(1, window.t[k + 1]);
    w.simulator.SimulateInto(w.x, CommandOf(window), w.times, {}, &w.out);
    if (!w.out.outcome.ok()) return;
    states->col(k + 1).tail(nz) = w.out.state.col(0).tail(nz);
    for (int j = 0; j < n_; ++j) {
      if (motor[j] < 0) continue;
      for (const int row : {j, n_ + j}) (*states)(row, k + 1) = w.out.state(row, 0);
      (*states)(2 * n_ + motor[j], k + 1) = window.q0(j, k + 1) - sensor_offsets_[j];
      (*states)(2 * n_ + motor[j] + 1, k + 1) = window.v0(j, k + 1);
    }
  }
}

const sim::CommandSignal& Lineariser::CommandOf(const NodeWindow& window) const {
  return data_.recordings[window.recording].command;
}

void Lineariser::SetState(const Eigen::Ref<const VectorXd>& stacked, double time, sim::State* x) const {
  x->q = stacked.head(n_);
  x->v = stacked.segment(n_, n_);
  x->z = stacked.tail(nx_ - 2 * n_);
  x->time = time;
}

// The window in one run from x_0.
const sim::Trajectory& Lineariser::RunFrom(const NodeWindow& window, const VectorXd& x0,
                                           const std::vector<double>& times, Worker* w) const {
  SetState(x0, window.t[0], &w->x);
  w->simulator.SimulateInto(w->x, CommandOf(window), times, {}, &w->out);
  return w->out;
}

std::vector<VectorXd> ResidualsFrom(const NodeStates& states, const std::vector<int>& windows, int threads,
                                    Lineariser& lin) {
  const size_t count = windows.size();
  std::vector<VectorXd> out(count);
  ParallelFor(threads, static_cast<int>((count + kTogether - 1) / kTogether), [&](int worker, int g) {
    std::vector<int> here;
    std::vector<VectorXd> starts;
    const size_t first = static_cast<size_t>(g) * kTogether;
    for (size_t i = first; i < std::min(count, first + kTogether); ++i)
      here.push_back(windows[i]), starts.push_back(states[windows[i]].col(0));
    std::ranges::move(lin.Residuals(worker, here, starts), out.begin() + static_cast<long>(first));
  });
  return out;
}

}  // namespace rg::diagnosis
