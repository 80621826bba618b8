#include "services/diagnosis/likelihood/lifted_fit.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "services/diagnosis/likelihood/arrival_cost.h"
#include "services/diagnosis/likelihood/lineariser.h"
#include "services/diagnosis/likelihood/row_products.h"
#include "services/sysid/boxed_newton_step.h"
#include "services/sysid/parallel.h"

namespace rg::diagnosis {

namespace {

constexpr double kParts[] = {1.0, 0.3, 0.1, 0.03, 0.0};  // of the trust region, tried one after another
constexpr double kThrown = 1.1;        // times its χ² so far, at which a window's start was moved too far
constexpr double kAsExpected = 1.3;    // times what the linear model says, which a step may cost
constexpr double kLeastTaken = 0.1;    // of a trust region, for the next one
constexpr size_t kStalled = 3;         // iterations, over which a fit stalls that gains less than
constexpr double kFarFromNoise = 2.0;  // times what noise leaves
constexpr double kStalledGain = 0.1;   // of what its cost is above noise
constexpr double kStandsOut = 4.0;     // times the median of all windows' χ², or what noise leaves
constexpr int kPatience = 3;           // iterations before windows are taken for lost
constexpr double kUnusual = 1.5;       // times the middle χ² of windows, from where they start anew
constexpr double kMostlyMet = 2.0;     // χ² per row of the middle window, below which only starts are amiss
constexpr int kFaces = 20;             // what that costs, in simulations of all windows
constexpr int kTogether = 8;           // windows that are simulated side by side

}  // namespace

NodeStates InitialStates(const FitData& data, const FitModel& model, const LiftedOptions& options) {
  Lineariser lin(data, model, false, options);
  const std::vector<int>& motor = lin.sensed_motors();
  const int nx = lin.nx(), n = data.n;
  NodeStates states(data.windows.size());
  sysid::ParallelFor(options.threads, static_cast<int>(data.windows.size()), [&](int worker, int w) {
    const NodeWindow& window = data.windows[w];
    const int N = static_cast<int>(window.t.size());
    states[w].setZero(nx, N);
    states[w].topRows(n) = window.q0;
    states[w].middleRows(n, n) = window.v0;
    if (nx == 2 * n) return;
    // Hidden states: settled some time before, then carried along the recorded motion.
    const double t0 = window.t[0] - kSettleTime;
    const FineMotion& fine = data.fine[window.recording];
    const double dt = fine.t[1] - fine.t[0];
    const int first = std::max(0, static_cast<int>(std::ceil((t0 - fine.t[0]) / dt)));
    const int stride = std::max(1, data.nodes.fine_per_interval);
    NodeWindow before;
    before.recording = window.recording;
    for (int k = first; fine.t[k] < window.t[0] - 1e-9; k += stride) before.t.push_back(fine.t[k]);
    const int B = static_cast<int>(before.t.size());
    before.t.push_back(window.t[0]);
    before.q0.resize(n, B + 1), before.v0.resize(n, B + 1);
    for (int k = 0; k < B; ++k) {
      before.q0.col(k) = fine.q.col(first + k * stride);
      before.v0.col(k) = fine.v.col(first + k * stride);
    }
    before.q0.col(B) = window.q0.col(0), before.v0.col(B) = window.v0.col(0);
    MatrixXd earlier = MatrixXd::Zero(nx, B + 1);
    earlier.topRows(n) = before.q0, earlier.middleRows(n, n) = before.v0;
    const sim::State x =
        lin.MakeState(worker, before.q0.col(0), before.v0.col(0), before.t[0], window.recording);
    earlier.col(0).tail(nx - 2 * n) = x.z;
    for (int j = 0; j < n; ++j) {
      if (motor[j] < 0) continue;
      earlier(j, 0) -= x.z[motor[j]] - before.q0(j, 0);
      earlier(2 * n + motor[j], 0) = before.q0(j, 0);
    }
    lin.CarryHidden(worker, before, motor, &earlier);
    states[w].col(0) = earlier.col(B);
    if (lin.has_gaps()) {
      const double carried = lin.Simulated(worker, w, VectorXd(states[w].col(0)));
      lin.ChooseFace(worker, w, nullptr, false, carried, &states[w]);
    }
    lin.CarryHidden(worker, window, motor, &states[w]);
  });
  return states;
}

namespace {

// What the free starts of hidden states cost: they follow noise, each by up to a nat, where the data know
// them better than their own spread over the windows says.
double HiddenCost(const std::vector<Linear>& linear, const NodeStates& states, int n, double inverse_scale) {
  const int nx = static_cast<int>(states[0].rows()), nz = nx - 2 * n;
  if (nz == 0) return 0;
  VectorXd mean = VectorXd::Zero(nz), square = VectorXd::Zero(nz);
  for (const MatrixXd& s : states) mean += s.col(0).tail(nz) / static_cast<double>(states.size());
  for (const MatrixXd& s : states)
    square += (s.col(0).tail(nz) - mean).cwiseAbs2() / static_cast<double>(states.size());
  const VectorXd spread = square.cwiseSqrt();
  double cost = 0;
  for (const Linear& l : linear) {
    if (!l.ok) continue;
    const Eigen::ColPivHouseholderQR<MatrixXd> qr(l.rows.leftCols(2 * n));
    MatrixXd hidden = l.J_e().rightCols(nz) * spread.asDiagonal();
    hidden.applyOnTheLeft(qr.householderQ().adjoint());
    const auto own = hidden.bottomRows(hidden.rows() - qr.rank());
    const MatrixXd information = own.transpose() * own * inverse_scale;
    const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(information, Eigen::EigenvaluesOnly);
    for (const double x : eigen.eigenvalues()) cost += std::min(1.0, 0.5 * std::log1p(std::max(0.0, x)));
  }
  return cost;
}

// Moves the states of windows [first, last) with a step of the parameters, their starts to what then fits
// best; writes χ² of the windows simulated from there. `adopted`: χ² so far, where known. Returns how many
// windows were simulated.
size_t MoveStates(Lineariser& lin, int worker, int first, int last, const std::vector<Linear>& linear,
                  const std::vector<BestStart>& best, const VectorXd& step,
                  const std::vector<double>& adopted, NodeStates* states, std::vector<double>* chi2) {
  struct Moved {
    int window;
    VectorXd e0, start;  // of the free directions, and what they move the start by
    VectorXd tied;       // the start without that: what is not free goes with the parameters
    double share = 1.0;
  };
  std::vector<Moved> moved;
  std::vector<int> windows;
  std::vector<VectorXd> starts;
  for (int w = first; w < last; ++w) {
    if (!linear[w].ok) {
      (*chi2)[w] = lin.WorstChi2(w);
      continue;
    }
    const VectorXd at = (*states)[w].col(0);
    const auto E = linear[w].Node(0);
    moved.push_back({w, best[w].After(step, at), {}, {}});
    moved.back().start = E.leftCols(at.size()) * moved.back().e0;
    moved.back().tied = at + E.middleCols(at.size(), step.size()) * step + E.rightCols<1>();
    windows.push_back(w), starts.push_back(moved.back().tied + moved.back().start);
  }
  const std::vector<double> full = lin.Simulated(worker, windows, starts);
  for (size_t i = 0; i < moved.size(); ++i) (*chi2)[moved[i].window] = full[i];
  size_t simulated = windows.size();
  // A hidden state that hardly shows, or a joint that sticks, may be thrown far: then a shorter step in the
  // window's start.
  if (!adopted.empty()) {
    windows.clear(), starts.clear();
    std::vector<std::pair<Moved*, double>> shorter;
    for (Moved& m : moved) {
      if (!((*chi2)[m.window] > kThrown * adopted[m.window])) continue;
      for (const double less : {0.4, 0.1, 0.0}) {
        shorter.push_back({&m, less});
        windows.push_back(m.window), starts.push_back(m.tied + less * m.start);
      }
    }
    simulated += windows.size();
    const std::vector<double> c = lin.Simulated(worker, windows, starts);
    for (size_t i = 0; i < shorter.size(); ++i) {
      auto& [m, less] = shorter[i];
      if (c[i] < (*chi2)[m->window]) (*chi2)[m->window] = c[i], m->share = less;
    }
  }
  for (const Moved& m : moved) {
    MatrixXd& at = (*states)[m.window];
    VectorXd all(at.rows() + step.size() + 1);
    all << m.share * m.e0, step, 1.0;
    at.reshaped() += linear[m.window].E * all;
  }
  return simulated;
}

double Middle(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// The windows that are met worst start anew where that is nearer to the record: a motor that lies on the
// wrong face at first stays there, whatever the parameters become.
void ChooseFaces(const FitData& data, Lineariser& lin, int threads, double noise_scale,
                 std::vector<double>* chi2, NodeStates* states) {
  const int W = static_cast<int>(data.windows.size());
  std::vector<double> per_row;
  for (int w = 0; w < W; ++w) per_row.push_back((*chi2)[w] / lin.RowsOf(data.windows[w]));
  const double usual = Middle(per_row);
  const bool closely = usual < kMostlyMet * noise_scale;
  std::vector<VectorXd> ends;
  for (const MatrixXd& s : *states) ends.push_back(s.col(s.cols() - 1));
  sysid::ParallelFor(threads, W, [&](int worker, int w) {
    if (per_row[static_cast<size_t>(w)] < kUnusual * usual) return;
    const bool goes_on = w > 0 && data.windows[w].recording == data.windows[w - 1].recording &&
                         data.windows[w].t.front() - data.windows[w - 1].t.back() == 0;
    const VectorXd* before = goes_on ? &ends[w - 1] : nullptr;
    const double chosen = lin.ChooseFace(worker, w, before, closely, (*chi2)[w], &(*states)[w]);
    if (!(chosen < (*chi2)[w])) return;
    (*chi2)[w] = chosen;
    lin.CarryHidden(worker, data.windows[w], lin.sensed_motors(), &(*states)[w]);
  });
}

// Puts the nodes of every window on its simulation: faces that meet and part bend a motion more than a line
// from node to node could say, and off the simulation fits stay where they start.
void FollowSimulations(const FitData& data, Lineariser& lin, int threads, NodeStates* states) {
  sysid::ParallelFor(threads, static_cast<int>(data.windows.size()),
                     [&](int worker, int w) { lin.Simulate(worker, w, &(*states)[w]); });
}

// Noise throws a joint off that rests at a window's start. Windows that stand out, counted, are tried anew.
size_t TryRecordedStarts(Lineariser& lin, const FitData& data, int threads, NodeStates* states,
                         std::vector<double>* chi2) {
  const int W = static_cast<int>(chi2->size());
  const double middle = Middle(*chi2);
  std::vector<int> lost;
  for (int w = 0; w < W; ++w) {
    if ((*chi2)[w] > kStandsOut * std::max(middle, static_cast<double>(lin.RowsOf(data.windows[w]))))
      lost.push_back(w);
  }
  sysid::ParallelFor(threads, static_cast<int>(lost.size()), [&](int worker, int i) {
    lin.TryRecordedStart(worker, lost[i], &(*states)[lost[i]], &(*chi2)[lost[i]]);
  });
  return lost.size();
}

// Whether a fit whose least cost after each iteration was `costs` goes no further, far from a noise of
// `rows`: something else is missing, and a minimum found more closely says nothing more.
bool Stalls(const std::vector<double>& costs, double rows) {
  const size_t done = costs.size();
  return done > kStalled && costs.back() > kFarFromNoise * rows &&
         costs[done - 1 - kStalled] - costs.back() < kStalledGain * (costs.back() - rows);
}

// Whether a fit whose cost after each iteration was `costs` would not come to what it has to.
bool Hopeless(const std::vector<double>& costs, const LiftedOptions& options) {
  const size_t done = costs.size();
  if (!(options.to_beat > 0) || done <= kPatience) return false;
  const double pace = std::sqrt(costs[done - 1] / costs[done - 3]);
  const double left = options.iterations + options.more_iterations + 1.0 - static_cast<double>(done);
  return costs.back() * std::pow(pace, left) > options.to_beat;
}

}  // namespace

NodeStates CarriedStates(const FitData& data, const FitModel& to, const sim::Plant& from,
                         const NodeStates& states, const LiftedOptions& options) {
  const int n = data.n;
  const auto& theirs = from.internal_state_names();
  const auto& own = to.plant.internal_state_names();
  if (own == theirs) return states;
  NodeStates out = InitialStates(data, to, options);
  for (size_t w = 0; w < out.size(); ++w) {
    out[w].topRows(2 * n) = states[w].topRows(2 * n);
    for (size_t i = 0; i < own.size(); ++i) {
      const auto at = std::find(theirs.begin(), theirs.end(), own[i]);
      if (at != theirs.end())
        out[w].row(2 * n + static_cast<long>(i)) = states[w].row(2 * n + (at - theirs.begin()));
    }
  }
  return out;
}

FitResult Fit(const FitData& data, const FitModel& model, const LiftedOptions& options,
              const NodeStates* from) {
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
  NodeStates states = from != nullptr ? *from : InitialStates(data, start, options);
  const double inverse_scale = 1.0 / options.noise_scale;
  const std::vector<ArrivalCost> loose = ArrivalCosts(model.plant, states);
  if (lin.has_gaps()) FollowSimulations(data, lin, options.threads, &states);

  double best = std::numeric_limits<double>::infinity();
  double trust = 1.0;
  std::vector<Linear> linear(W);
  std::vector<BestStart> best_starts(W);
  std::vector<RowMatrixXd> grams(W);
  std::vector<double> adopted(W), costs;
  const bool hidden = nx > 2 * n;
  // A mass that has to find its swing, or a motor its face, may stall for a while and then come near.
  const auto& names = model.plant.internal_state_names();
  const bool plain = std::all_of(names.begin(), names.end(),
                                 [](const std::string& name) { return name.starts_with(kLagState); });
  const double simulation = SimulationWork(data, options, nx);
  if (hidden && from == nullptr) result.work += (1 + (lin.has_gaps() ? kFaces : 0)) * simulation;
  const int groups = (W + kTogether - 1) / kTogether;
  // What the cost falls by against the best so far, which the new state takes the place of if it does.
  const auto adopt = [&](const VectorXd& at, const VectorXd& trial, const NodeStates& nodes,
                         const std::vector<double>& chi2, const MatrixXd& information) {
    double total = 0;
    for (const double c : chi2) total += c;
    const double prior_cost = prior.dot((trial - theta0).cwiseAbs2());
    const double cost = total * inverse_scale + prior_cost, gain = best - cost;
    if (!(gain > 0)) return gain;
    best = cost;
    result.values = at, result.theta = trial, result.states = nodes;
    result.chi2 = total, result.window_chi2 = chi2, result.prior_cost = prior_cost;
    result.information = information;
    result.ok = true;
    return gain;
  };
  for (int it = 0; it <= options.iterations + options.more_iterations; ++it) {
    sysid::ParallelFor(options.threads, W, [&](int worker, int w) {
      lin.Run(worker, w, states[w], nullptr, nullptr, true, &linear[w]);
      if (!linear[w].ok) return;
      RobustWeights(loose[w], states[w].col(0), &linear[w]);
      best_starts[w] = BestStart(linear[w], loose[w]);
      RowMatrixXd rest = linear[w].rows.rightCols(P + 1);
      ProjectOut(linear[w].J_e(), &rest);
      grams[w].setZero(P + 1, P + 1);
      AddGram(rest, inverse_scale, grams[w]);
    });
    result.work += LinearisationWork(data, options, nx, nx + P) * (1 + W * lin.Memory() / data.Seconds());
    MatrixXd gram = MatrixXd::Zero(P + 1, P + 1);
    for (int w = 0; w < W; ++w) {
      if (linear[w].ok) gram += grams[w];
    }
    gram = MatrixXd(gram.selfadjointView<Eigen::Lower>());
    MatrixXd H = gram.topLeftCorner(P, P);
    const MatrixXd information = H;
    if ((hidden || from != nullptr) && it == 0) {  // the start itself counts
      std::vector<double> chi2(W);
      sysid::ParallelFor(options.threads, groups, [&](int worker, int g) {
        std::vector<int> windows;
        std::vector<VectorXd> starts;
        for (int w = g * W / groups; w < (g + 1) * W / groups; ++w) {
          if (linear[w].ok) {  // what is not free starts as the parameters say
            auto tied = linear[w].Node(0).rightCols<1>();
            states[w].col(0) += tied;
            tied.setZero();
          }
          windows.push_back(w), starts.push_back(states[w].col(0));
        }
        const std::vector<double> own = lin.Simulated(worker, windows, starts);
        std::copy(own.begin(), own.end(), chi2.begin() + windows.front());
      });
      adopt(values, theta, states, chi2, information);
      adopted = chi2;
    }
    VectorXd gradient = VectorXd::Zero(P);
    if (P > 0) {
      H.diagonal() += prior;
      gradient = -gram.col(P).head(P) + prior.cwiseProduct(theta - theta0);
    }
    const auto step_within = [&](double radius) -> VectorXd {
      if (P == 0 || radius == 0) return VectorXd::Zero(P);
      const VectorXd limit = (radius * sigma).cwiseMax(radius * 0.5 * theta.cwiseAbs());
      const VectorXd step =
          sysid::BoxedNewtonStep(H, gradient, (lower - theta).cwiseMax(-limit).cwiseMin(0.0),
                                 (upper - theta).cwiseMin(limit).cwiseMax(0.0));
      return step.allFinite() ? step : VectorXd::Zero(P);
    };
    // States follow. Where the cost is not what the linear model says, smaller steps are tried beside the
    // first while they are better: at last none, for states alone come to where the model holds.
    VectorXd trial, trial_values;
    NodeStates trial_states;
    std::vector<double> chi2;
    double least = std::numeric_limits<double>::infinity(), taken = 1.0;
    for (const double part : kParts) {
      const VectorXd step = step_within(part * trust);
      const VectorXd at = (theta + step).cwiseMax(lower).cwiseMin(upper);
      const VectorXd at_values = sysid::WithFitted(model.parameters, model.values, at);
      NodeStates nodes = states;
      std::vector<double> own(W);
      std::vector<size_t> simulated(groups);
      lin.SetValues(model, at_values);
      sysid::ParallelFor(options.threads, groups, [&](int worker, int g) {
        simulated[g] = MoveStates(lin, worker, g * W / groups, (g + 1) * W / groups, linear, best_starts,
                                  step, (hidden || it > 0) ? adopted : std::vector<double>{}, &nodes, &own);
      });
      const size_t windows = std::accumulate(simulated.begin(), simulated.end(), size_t{0});
      const size_t again = it < kPatience ? 0 : TryRecordedStarts(lin, data, options.threads, &nodes, &own);
      result.work += simulation * static_cast<double>(windows + 2 * again) / W;
      const double cost =
          std::accumulate(own.begin(), own.end(), 0.0) * inverse_scale + prior.dot((at - theta0).cwiseAbs2());
      const bool better = cost < least, known = least < best;
      if (better) {
        least = cost, taken = part;
        trial = at, trial_values = at_values, trial_states = std::move(nodes), chi2 = std::move(own);
      }
      const double expected = P == 0 ? cost
                                     : gram(P, P) + prior.dot((theta - theta0).cwiseAbs2()) +
                                           2 * gradient.dot(step) + step.dot(H * step);
      if (part == 1.0 && (P == 0 || cost <= kAsExpected * expected || best - cost > 0.25 * (best - expected)))
        break;
      if (!better && known) break;
    }
    lin.SetValues(model, trial_values);
    adopted = chi2;
    double gain = adopt(trial_values, trial, trial_states, chi2, information);
    // Where a smaller step was better, the next one is kept that small.
    trust *= taken < 1.0 ? std::max(kLeastTaken, taken) : gain > 0 ? 2.0 : 0.5;
    trust = std::min(1.0, trust);
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
    if (lin.has_gaps() && it < options.iterations + options.more_iterations) {
      if (options.free_hidden) {
        ChooseFaces(data, lin, options.threads, options.noise_scale, &adopted, &states);
        result.work += kFaces * simulation;
        const double more = adopt(trial_values, trial, states, adopted, information);
        if (more > 0) gain = std::max(gain, 0.0) + more;
      }
      FollowSimulations(data, lin, options.threads, &states);
      result.work += simulation;
    }
    if (it > 0 && std::abs(gain) < 0.02) break;
    if (it >= options.iterations && !(gain > options.still_falling * best)) break;
    costs.push_back(best);
    if ((plain && Stalls(costs, data.Rows())) || Hopeless(costs, options)) break;
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
  result.evidence = -0.5 * result.chi2 * inverse_scale - 0.5 * result.prior_cost - 0.5 * log_det -
                    HiddenCost(linear, result.states, n, inverse_scale);
  return result;
}

}  // namespace rg::diagnosis
