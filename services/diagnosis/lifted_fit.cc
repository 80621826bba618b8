#include "services/diagnosis/lifted_fit.h"

#include <Eigen/Cholesky>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>

#include "common/base/check.h"
#include "common/model/robot_model.h"
#include "services/sysid/boxed_newton_step.h"
#include "services/sysid/parallel.h"

namespace rg::diagnosis {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using sim::RowMatrix;

namespace {

// A residual r [stddev] counts c²·log(1 + r²/c²) when costs are compared: r² where the model holds, and a
// window that explodes does not outvote the others.
constexpr double kSoft = 20.0;
constexpr double kBroken = 1e12;

// A plant that can feel a torque on each joint, for the columns B.
struct Probe {
  sim::Plant plant;
  VectorXd values;
  std::vector<int> torque;  // parameter index per joint, −1: none
};

bool Holds(const sim::Plant& plant, const std::string& id, const std::string& joint) {
  for (const effects::EffectSpec& e : plant.effects()) {
    if (e.id == id && std::find(e.joints.begin(), e.joints.end(), joint) != e.joints.end()) return true;
  }
  return false;
}

Probe MakeProbe(const FitModel& model, bool with_torque) {
  Probe probe{model.plant, model.values, {}};
  const int n = model.plant.num_joints();
  probe.torque.assign(n, -1);
  if (!with_torque) return probe;
  std::vector<effects::EffectSpec> specs = model.plant.effects();
  std::vector<std::string> names(n);
  for (int j = 0; j < n; ++j) {
    const std::string& joint = model.plant.joint_names()[j];
    if (!Holds(model.plant, "external_disturbance", joint)) {
      specs.push_back(effects::MakeSpec("external_disturbance", {joint},
                                        {{"start", -1e9}, {"end", 1e9}, {"torque", 0.0}}));
      names[j] = "external_disturbance." + joint + ".torque";
    } else if (!Holds(model.plant, "torque_ripple", joint)) {
      specs.push_back(effects::MakeSpec("torque_ripple", {joint},
                                        {{"amplitude", 0.0}, {"cycles_per_rev", 0.0}, {"phase", M_PI_2}}));
      names[j] = "torque_ripple." + joint + ".amplitude";
    }
  }
  auto plant = sim::Plant::Create(model.plant.shared_model(), model.plant.options(), specs);
  RG_CHECK(plant.ok()) << plant.status().ToString();
  probe.plant = *plant;
  probe.values = probe.plant.ValuesFrom(model.plant.parameters(), model.values);
  for (int j = 0; j < n; ++j) {
    if (!names[j].empty()) probe.torque[j] = probe.plant.parameters().Find(names[j]);
  }
  return probe;
}

// One window, linearised.
struct Linear {
  MatrixXd J;               // M × (P + C)
  MatrixXd J_e;             // M × nx
  VectorXd r;               // M, whitened residual at e_0 = 0, δθ = 0
  std::vector<MatrixXd> E;  // per node: nx × (1 + P + nx): d, θ, e_0
  bool ok = true;
};

struct Worker {
  sim::Simulator simulator;
  sim::State x;
  sim::Trajectory out;
  sim::SensitivityRequest request;
  std::vector<double> times;
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
    sim::SimulatorOptions simulator;
    simulator.step_s = options.step_s;
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

  // phi: C × N or null.
  void Run(int worker, int index, const MatrixXd& states, const std::vector<int>* joint, const MatrixXd* phi,
           bool keep, Linear* out) {
    Worker& w = *workers_[worker];
    const NodeWindow& window = data_.windows[index];
    const int N = static_cast<int>(window.t.size()) - 1, M = RowsOf(window);
    const int C = joint == nullptr ? 0 : static_cast<int>(joint->size());
    out->J.resize(M, P_ + C), out->J_e.resize(M, nx_), out->r.resize(M);
    out->E.clear();
    out->ok = true;
    MatrixXd E = MatrixXd::Zero(nx_, 1 + P_ + nx_), Ef = MatrixXd::Zero(nx_, C), next;
    E.rightCols(nx_).setIdentity();
    if (keep) out->E.push_back(E);
    int row = 0;
    for (int k = 0; k < N; ++k) {
      w.x.q = states.col(k).head(n_);
      w.x.v = states.col(k).segment(n_, n_);
      w.x.z = states.col(k).tail(nx_ - 2 * n_);
      w.x.time = window.t[k];
      w.times.clear();
      if (k == 0 && window.measured[0]) w.times.push_back(window.t[0]);
      w.times.push_back(window.t[k + 1]);
      w.simulator.SimulateInto(w.x, data_.recordings[window.recording].command, w.times, w.request, &w.out);
      if (!w.out.outcome.ok() || !w.out.dfinal_state.allFinite()) {
        out->ok = false;
        return;
      }
      int output = 0;
      if (k == 0 && window.measured[0]) WriteRows(w, window, 0, output++, E, Ef, nullptr, nullptr, out, &row);
      if (window.measured[k + 1]) WriteRows(w, window, k + 1, output, E, Ef, joint, phi, out, &row);
      const auto A = w.out.dfinal_state.leftCols(nx_);
      next.noalias() = A * E;
      next.col(0) += w.out.state.col(output) - states.col(k + 1);
      next.middleCols(1, P_) += w.out.dfinal_state.middleCols(nx_, P_);
      E.swap(next);
      if (C > 0) {
        Ef = A * Ef;
        for (int c = 0; c < C; ++c) {
          const int t = torque_column_[(*joint)[c]];
          if (t >= 0) Ef.col(c) += w.out.dfinal_state.col(nx_ + t) * (*phi)(c, k);
        }
      }
      if (keep) out->E.push_back(E);
    }
    RG_CHECK(row == M) << row << " " << M;
    if (!out->J.allFinite() || !out->J_e.allFinite() || !out->r.allFinite()) out->ok = false;
  }

  // Σ ((y − ŷ)/σ)² of the window simulated from x_0 in one go.
  double Simulated(int worker, int index, const VectorXd& x0) {
    Worker& w = *workers_[worker];
    const NodeWindow& window = data_.windows[index];
    w.x.q = x0.head(n_);
    w.x.v = x0.segment(n_, n_);
    w.x.z = x0.tail(nx_ - 2 * n_);
    w.x.time = window.t[0];
    w.times.clear();
    std::vector<int> nodes;
    for (size_t k = 0; k < window.t.size(); ++k) {
      if (!window.measured[k]) continue;
      w.times.push_back(window.t[k]);
      nodes.push_back(static_cast<int>(k));
    }
    w.simulator.SimulateInto(w.x, data_.recordings[window.recording].command, w.times, {}, &w.out);
    double sum = 0;
    for (size_t i = 0; i < nodes.size(); ++i) {
      const int k = nodes[i];
      const double s = std::sqrt(static_cast<double>(window.rows[k]));
      for (int j = 0; j < n_; ++j) {
        sum += Capped((window.q(j, k) - w.out.position(j, i)) / data_.noise.position_stddev[j] * s);
        if (!data_.use_velocity) continue;
        sum += Capped((window.v(j, k) - w.out.velocity(j, i)) / data_.noise.velocity_stddev[j] * s);
      }
    }
    return sum;
  }

  // States of a window simulated node by node from x_0, in place: what is recorded stays as recorded, what is
  // hidden is carried on. Behind an encoder on the motor the link is the hidden one.
  void CarryHidden(int worker, int index, const std::vector<int>& motor, MatrixXd* states) {
    Worker& w = *workers_[worker];
    const NodeWindow& window = data_.windows[index];
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
  sim::State MakeState(int worker, const VectorXd& q, const VectorXd& v, double t, int recording) {
    return workers_[worker]->simulator.MakeState(q, v, t, data_.recordings[recording].command);
  }
  void SetValues(const FitModel& model, const VectorXd& values) {
    probe_.values = probe_.plant.ValuesFrom(model.plant.parameters(), values);
    for (auto& w : workers_) w->simulator.SetParameters(probe_.values);
  }

 private:
  static double Capped(double r) {
    const double square = std::isfinite(r) ? std::min(r * r, kBroken) : kBroken;
    return kSoft * kSoft * std::log1p(square / (kSoft * kSoft));
  }

  void WriteRows(const Worker& w, const NodeWindow& window, int node, int output, const MatrixXd& E,
                 const MatrixXd& Ef, const std::vector<int>* joint, const MatrixXd* phi, Linear* out,
                 int* row) {
    const double s = std::sqrt(static_cast<double>(window.rows[node]));
    const int kinds = data_.use_velocity ? 2 : 1;
    for (int kind = 0; kind < kinds; ++kind) {
      const RowMatrix& D = kind == 0 ? w.out.dposition : w.out.dvelocity;
      const VectorXd& sigma = kind == 0 ? data_.noise.position_stddev : data_.noise.velocity_stddev;
      const auto block = D.middleRows(output * n_, n_);
      VectorXd weight = s * sigma.cwiseInverse();
      const MatrixXd H = weight.asDiagonal() * block.leftCols(nx_);
      const VectorXd y = kind == 0 ? window.q.col(node) : window.v.col(node);
      const VectorXd h = kind == 0 ? w.out.position.col(output) : w.out.velocity.col(output);
      out->r.segment(*row, n_) = weight.cwiseProduct(y - h) - H * E.col(0);
      auto J = out->J.middleRows(*row, n_);
      J.leftCols(P_).noalias() = H * E.middleCols(1, P_);
      J.leftCols(P_) += weight.asDiagonal() * block.middleCols(nx_, P_);
      out->J_e.middleRows(*row, n_).noalias() = H * E.rightCols(nx_);
      const int C = static_cast<int>(Ef.cols());
      if (C > 0) {
        J.rightCols(C).noalias() = H * Ef;
        for (int c = 0; c < C && phi != nullptr; ++c) {
          const int t = torque_column_[(*joint)[c]];
          if (t >= 0) {
            J.col(P_ + c) += weight.cwiseProduct(block.col(nx_ + t)) * (*phi)(c, node - 1);
          }
        }
      }
      *row += n_;
    }
  }

  const FitData& data_;
  Probe probe_;
  LiftedOptions options_;
  int n_ = 0, P_ = 0, nx_ = 0;
  std::vector<int> columns_, torque_column_;
  std::vector<std::unique_ptr<Worker>> workers_;
};

// Rows of [J | r] orthogonal to J_e; also the factorisation to find e_0 later.
struct Projected {
  MatrixXd rest;  // (M − rank) × (D + 1)
};

MatrixXd ProjectOut(const MatrixXd& J_e, const MatrixXd& J, const VectorXd& r) {
  MatrixXd stacked(J.rows(), J.cols() + 1);
  stacked << J, r;
  // Columns of very different size (a state that is forgotten at once) are scaled first.
  MatrixXd scaled = J_e;
  for (int c = 0; c < scaled.cols(); ++c) {
    const double norm = scaled.col(c).norm();
    if (norm > 0) scaled.col(c) /= norm;
  }
  const Eigen::ColPivHouseholderQR<MatrixXd> qr(scaled);
  stacked.applyOnTheLeft(qr.householderQ().adjoint());
  const int rank = static_cast<int>(qr.rank());
  return stacked.bottomRows(stacked.rows() - rank);
}

}  // namespace

int FitData::Rows() const {
  int rows = 0;
  for (const NodeWindow& w : windows) {
    for (const char m : w.measured) rows += m * n * (use_velocity ? 2 : 1);
  }
  return rows;
}

namespace {

// Per joint: place of the motor's position among the internal states where the encoder sits on the motor.
std::vector<int> SensedMotors(const sim::Plant& plant) {
  std::vector<int> out(plant.num_joints(), -1);
  const auto& names = plant.internal_state_names();
  for (const effects::EffectSpec& e : plant.effects()) {
    const auto sensor = e.options.find("sensor");
    if (sensor == e.options.end() || sensor->second != "motor") continue;
    for (const std::string& joint : e.joints) {
      const auto at = std::find(names.begin(), names.end(), "motor_position." + joint);
      if (at != names.end()) out[plant.model().FindJoint(joint)] = static_cast<int>(at - names.begin());
    }
  }
  return out;
}

}  // namespace

NodeStates InitialStates(const FitData& data, const FitModel& model, const LiftedOptions& options) {
  Lineariser lin(data, model, false, options);
  const std::vector<int> motor = SensedMotors(model.plant);
  const int nx = lin.nx(), n = data.n;
  NodeStates states(data.windows.size());
  sysid::ParallelFor(options.threads, static_cast<int>(data.windows.size()), [&](int worker, int w) {
    const NodeWindow& window = data.windows[w];
    const int N = static_cast<int>(window.t.size());
    states[w].setZero(nx, N);
    states[w].topRows(n) = window.q0;
    states[w].middleRows(n, n) = window.v0;
    if (nx == 2 * n) return;
    // Hidden states: settled a little before, then carried along the recorded motion.
    const sim::State x =
        lin.MakeState(worker, window.q0.col(0), window.v0.col(0), window.t[0], window.recording);
    states[w].col(0).tail(nx - 2 * n) = x.z;
    for (int j = 0; j < n; ++j) {
      if (motor[j] < 0) continue;
      states[w](j, 0) -= x.z[motor[j]] - window.q0(j, 0);
      states[w](2 * n + motor[j], 0) = window.q0(j, 0);
    }
    lin.CarryHidden(worker, w, motor, &states[w]);
  });
  return states;
}

FitResult Fit(const FitData& data, const FitModel& model, const LiftedOptions& options) {
  const int P = static_cast<int>(model.parameters.size()), n = data.n;
  const int W = static_cast<int>(data.windows.size());
  Lineariser lin(data, model, false, options);
  const int nx = lin.nx();
  FitResult result;
  VectorXd theta(P), theta0(P), prior(P), lower(P), upper(P), sigma(P);
  for (int i = 0; i < P; ++i) {
    const auto& p = model.parameters[i];
    theta[i] = model.values[p.index];
    theta0[i] = p.nominal;
    sigma[i] = p.prior_stddev;
    prior[i] = 1.0 / (p.prior_stddev * p.prior_stddev);
    lower[i] = p.lower, upper[i] = p.upper;
  }
  theta = theta.cwiseMax(lower).cwiseMin(upper);
  VectorXd values = sysid::WithFitted(model.parameters, model.values, theta);
  lin.SetValues(model, values);
  FitModel start{model.plant, values, model.parameters};
  NodeStates states = InitialStates(data, start, options);
  const double inverse_scale = 1.0 / options.noise_scale;

  double best = std::numeric_limits<double>::infinity();
  double trust = 1.0;
  std::vector<Linear> linear(W);
  std::vector<MatrixXd> grams(W);
  for (int it = 0; it <= options.iterations; ++it) {
    sysid::ParallelFor(options.threads, W, [&](int worker, int w) {
      lin.Run(worker, w, states[w], nullptr, nullptr, true, &linear[w]);
      if (!linear[w].ok) return;
      const MatrixXd rest = ProjectOut(linear[w].J_e, linear[w].J, linear[w].r);
      grams[w].setZero(P + 1, P + 1);
      grams[w].selfadjointView<Eigen::Lower>().rankUpdate(rest.transpose(), inverse_scale);
    });
    MatrixXd gram = MatrixXd::Zero(P + 1, P + 1);
    for (int w = 0; w < W; ++w) {
      if (linear[w].ok) gram += grams[w];
    }
    gram = MatrixXd(gram.selfadjointView<Eigen::Lower>());
    MatrixXd H = gram.topLeftCorner(P, P);
    const MatrixXd information = H;
    VectorXd step = VectorXd::Zero(P);
    if (P > 0) {
      H.diagonal() += prior;
      const VectorXd g = -gram.col(P).head(P) + prior.cwiseProduct(theta - theta0);
      const VectorXd limit = (trust * sigma).cwiseMax(trust * 0.5 * theta.cwiseAbs());
      step = sysid::BoxedNewtonStep(H, g, (lower - theta).cwiseMax(-limit).cwiseMin(0.0),
                                    (upper - theta).cwiseMin(limit).cwiseMax(0.0));
    }
    // States follow.
    const VectorXd trial = (theta + step).cwiseMax(lower).cwiseMin(upper);
    NodeStates trial_states = states;
    std::vector<double> chi2(W);
    const VectorXd trial_values = sysid::WithFitted(model.parameters, model.values, trial);
    lin.SetValues(model, trial_values);
    sysid::ParallelFor(options.threads, W, [&](int worker, int w) {
      const Linear& l = linear[w];
      if (!l.ok) {
        chi2[w] = lin.RowsOf(data.windows[w]) * kSoft * kSoft * std::log1p(kBroken / (kSoft * kSoft));
        return;
      }
      MatrixXd JJ = l.J_e.transpose() * l.J_e;
      JJ.diagonal().array() += 1e-9 * JJ.diagonal().maxCoeff() + 1e-12;
      VectorXd scale = JJ.diagonal().cwiseSqrt().cwiseInverse();
      MatrixXd S = scale.asDiagonal() * JJ * scale.asDiagonal();
      S.diagonal().array() += 1e-10;
      const VectorXd b = scale.cwiseProduct(l.J_e.transpose() * (l.r - l.J * step));
      const VectorXd e0 = scale.cwiseProduct(S.ldlt().solve(b));
      for (size_t k = 0; k < l.E.size(); ++k) {
        trial_states[w].col(k) += l.E[k].col(0) + l.E[k].middleCols(1, P) * step + l.E[k].rightCols(nx) * e0;
      }
      chi2[w] = lin.Simulated(worker, w, trial_states[w].col(0));
    });
    double total = 0;
    for (const double c : chi2) total += c;
    const double cost = total * inverse_scale + prior.dot((trial - theta0).cwiseAbs2());
    const double gain = best - cost;
    if (cost < best) {
      best = cost;
      result.values = trial_values;
      result.theta = trial;
      result.chi2 = total;
      result.window_chi2 = chi2;
      result.prior_cost = prior.dot((trial - theta0).cwiseAbs2());
      result.states = trial_states;
      result.information = information;
      result.ok = true;
      trust = std::min(1.0, 2 * trust);
    } else {
      trust *= 0.5;
    }
    result.iterations = it + 1;
    theta = trial;
    // Far from the data only where the model holds it: a node that strays goes back to the record.
    for (int w = 0; w < W; ++w) {
      const NodeWindow& window = data.windows[w];
      for (int k = 0; k < trial_states[w].cols(); ++k) {
        const bool strayed = !trial_states[w].col(k).allFinite() ||
                             (trial_states[w].col(k).head(n) - window.q0.col(k)).cwiseAbs().maxCoeff() > 0.3;
        if (!strayed) continue;
        trial_states[w].col(k).head(n) = window.q0.col(k);
        trial_states[w].col(k).segment(n, n) = window.v0.col(k);
        if (!trial_states[w].col(k).allFinite())
          trial_states[w].col(k).tail(nx - 2 * n) = states[w].col(k).tail(nx - 2 * n);
      }
    }
    states = std::move(trial_states);
    if (it > 0 && std::abs(gain) < 0.02) break;
  }
  result.rows = data.Rows();
  if (!result.ok) return result;
  result.stddev.resize(P);
  double log_det = 0;
  if (P > 0) {
    const MatrixXd scaled = sigma.asDiagonal() * result.information * sigma.asDiagonal();
    const Eigen::LLT<MatrixXd> llt(MatrixXd::Identity(P, P) + scaled);
    for (int i = 0; i < P; ++i) log_det += 2.0 * std::log(llt.matrixL()(i, i));
    const MatrixXd covariance = llt.solve(MatrixXd::Identity(P, P));
    for (int i = 0; i < P; ++i) result.stddev[i] = sigma[i] * std::sqrt(std::max(0.0, covariance(i, i)));
  }
  result.evidence = -0.5 * result.chi2 * inverse_scale - 0.5 * result.prior_cost - 0.5 * log_det;
  return result;
}

Screen MakeScreen(const FitData& data, const FitModel& model, const NodeStates& states,
                  const FeatureBlock& features, const LiftedOptions& options, int null_draws, Rng rng) {
  Lineariser lin(data, model, true, options);
  const int P = lin.P(), C = features.size(), W = static_cast<int>(data.windows.size());
  Screen screen;
  screen.parameters = P, screen.features = C;
  const int D = P + C + 1, threads = std::max(1, options.threads);
  std::vector<MatrixXd> sums(threads, MatrixXd::Zero(D, D));
  std::vector<MatrixXd> nulls(W);
  std::vector<int> rows(threads, 0), eliminated(threads, 0);
  sysid::ParallelFor(threads, W, [&](int worker, int w) {
    Linear l;
    lin.Run(worker, w, states[w], &features.joint, &features.phi[w], false, &l);
    if (!l.ok) return;
    const MatrixXd rest = ProjectOut(l.J_e, l.J, l.r);
    sums[worker].selfadjointView<Eigen::Lower>().rankUpdate(rest.transpose(), 1.0 / options.noise_scale);
    MatrixXd noise(rest.rows(), null_draws);
    Rng stream = rng.Split(static_cast<uint64_t>(w));
    for (double& x : noise.reshaped()) x = stream.Normal();
    nulls[w] = rest.leftCols(D - 1).transpose() * noise / std::sqrt(options.noise_scale);
    rows[worker] += static_cast<int>(l.r.size());
    eliminated[worker] += static_cast<int>(l.r.size() - rest.rows());
  });
  screen.gram = MatrixXd::Zero(D, D);
  for (int k = 0; k < threads; ++k) {
    screen.gram += sums[k];
    screen.rows += rows[k], screen.eliminated += eliminated[k];
  }
  screen.gram = MatrixXd(screen.gram.selfadjointView<Eigen::Lower>());
  screen.null = MatrixXd::Zero(D - 1, null_draws);
  for (const MatrixXd& m : nulls) {
    if (m.size() > 0) screen.null += m;
  }
  return screen;
}

MissingForce EstimateMissingForce(const FitData& data, const FitModel& model, const NodeStates& states,
                                  const VectorXd& prior, double segment_s, const LiftedOptions& options) {
  FitModel fixed{model.plant, model.values, {}};
  Lineariser lin(data, fixed, true, options);
  const int W = static_cast<int>(data.windows.size()), n = data.n;
  MissingForce out;
  out.force.resize(W), out.stddev.resize(W), out.t.resize(W);
  std::vector<double> chi2(W, 0), unknowns(W, 0);
  sysid::ParallelFor(options.threads, W, [&](int worker, int w) {
    const NodeWindow& window = data.windows[w];
    const int N = static_cast<int>(window.t.size()) - 1;
    const double span = window.t[N] - window.t[0];
    const int S = std::max(1, static_cast<int>(std::lround(span / segment_s)));
    std::vector<int> joint;
    MatrixXd phi = MatrixXd::Zero(S * n, N);
    for (int s = 0; s < S; ++s) {
      out.t[w].push_back(window.t[0] + span * (s + 0.5) / S);
      for (int j = 0; j < n; ++j) {
        joint.push_back(j);
        for (int k = 0; k < N; ++k) {
          const double middle = 0.5 * (window.t[k] + window.t[k + 1]);
          const int at = std::min(S - 1, static_cast<int>((middle - window.t[0]) / span * S));
          if (at == s) phi(s * n + j, k) = prior[j];
        }
      }
    }
    Linear l;
    lin.Run(worker, w, states[w], &joint, &phi, false, &l);
    out.force[w] = MatrixXd::Zero(n, S), out.stddev[w] = MatrixXd::Zero(n, S);
    if (!l.ok) return;
    const MatrixXd rest = ProjectOut(l.J_e, l.J, l.r) / std::sqrt(options.noise_scale);
    const int C = S * n;
    MatrixXd H = rest.leftCols(C).transpose() * rest.leftCols(C);
    const MatrixXd data_H = H;
    H.diagonal().array() += 1.0;
    const Eigen::LLT<MatrixXd> llt(H);
    const VectorXd c = llt.solve(rest.leftCols(C).transpose() * rest.col(C));
    const MatrixXd cov = llt.solve(MatrixXd::Identity(C, C));
    for (int s = 0; s < S; ++s) {
      for (int j = 0; j < n; ++j) {
        out.force[w](j, s) = prior[j] * c[s * n + j];
        out.stddev[w](j, s) = prior[j] * std::sqrt(std::max(0.0, cov(s * n + j, s * n + j)));
      }
    }
    chi2[w] = (rest.col(C) - rest.leftCols(C) * c).squaredNorm();
    unknowns[w] = static_cast<double>(l.r.size() - rest.rows()) + (data_H * cov).trace();
  });
  for (int w = 0; w < W; ++w) out.chi2 += chi2[w], out.unknowns += unknowns[w];
  out.rows = data.Rows();
  return out;
}

}  // namespace rg::diagnosis
