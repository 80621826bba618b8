#include "services/diagnosis/design/separating_motion.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "common/base/parallel.h"
#include "common/dynamics/dynamics.h"
#include "common/sim/simulator.h"
#include "services/diagnosis/design/probe_motions.h"
#include "services/diagnosis/hypotheses/rivals.h"
#include "services/sysid/drive_signal.h"

namespace rg::diagnosis {

namespace {

constexpr size_t kMostPairs = 3;       // of rivals
constexpr double kControl = 5e-3;      // s: period of the simulated controller
constexpr double kStiffness = 12.0;    // rad/s: natural frequency of its closed loop
constexpr double kLeastPeriod = 5e-3;  // s between rows
constexpr double kLost = 1.0;          // rad or m of tracking error: the motion cannot be followed
constexpr int kRefitIterations = 3;    // of a rival
constexpr size_t kMostJoints = 6;      // that move

struct Pair {
  const Candidate* chosen;
  const Candidate* rival;
};

// A recording of a motion by a robot with a candidate's physics under computed-torque control, without noise.
struct Imagined {
  recordings::Recording recording;
  FitData data;
};

class Drive {
 public:
  Drive(const Candidate& candidate, const FitData& like, double step_s)
      : c_(candidate), like_(like), simulator_(*candidate.plant, {.step_s = step_s}) {
    simulator_.SetParameters(c_.fit.values);
  }

  // False where the robot cannot follow.
  bool Record(const ProbeMotion& motion, Imagined* out) {
    const int n = like_.n;
    const double period = std::max(kLeastPeriod, like_.recordings[0].recording->SamplePeriod());
    const auto ticks = static_cast<int>(motion.t.back() / kControl);
    const int every = std::max(1, static_cast<int>(std::lround(period / kControl)));
    MatrixXd commands(n, ticks);
    std::vector<double> times(static_cast<size_t>(ticks));
    recordings::Recording& rec = out->recording;
    const int rows = (ticks - 1) / every + 1;
    rec.name = "imagined", rec.joints = like_.recordings[0].recording->joints;
    rec.t.resize(rows), rec.q.resize(n, rows), rec.v.resize(n, rows);
    VectorXd q(n), v(n), u = Torque(motion, 0, motion.q.col(0), VectorXd::Zero(n));
    sim::State state = simulator_.MakeState(motion.q.col(0), VectorXd::Zero(n), 0, &u);
    for (int k = 0; k < ticks; ++k) {
      simulator_.Measure(state, &q, &v);
      if ((q - Row(motion, k * kControl)).cwiseAbs().maxCoeff() > kLost) return false;
      if (k % every == 0) rec.t[k / every] = k * kControl, rec.q.col(k / every) = q, rec.v.col(k / every) = v;
      u = Torque(motion, k * kControl, q, v);
      times[k] = k * kControl, commands.col(k) = u;
      if (!simulator_.Advance(state, u, kControl).ok()) return false;
    }
    auto signal = sim::CommandSignal::Create(times, commands, sim::Hold::kZeroOrder);
    if (!signal.ok()) return false;
    Prepare(std::move(signal).value(), out);
    return true;
  }

 private:
  static VectorXd Row(const ProbeMotion& m, double t) {
    const auto last = static_cast<double>(m.t.size() - 1);
    const double at = std::clamp(t / (m.t[1] - m.t[0]), 0.0, last - 1e-9);
    const auto k = static_cast<Eigen::Index>(at);
    const double part = at - static_cast<double>(k);
    return (1 - part) * m.q.col(k) + part * m.q.col(k + 1);
  }

  // Computed-torque control by the candidate's rigid bodies.
  VectorXd Torque(const ProbeMotion& m, double t, const VectorXd& q, const VectorXd& v) {
    const auto k = std::min<Eigen::Index>(std::lround(t / (m.t[1] - m.t[0])), m.q.cols() - 1);
    const VectorXd acceleration =
        m.a.col(k) + kStiffness * kStiffness * (Row(m, t) - q) + 2 * kStiffness * (m.v.col(k) - v);
    VectorXd u(q.size());
    dynamics::Rnea(mechanism_, workspace_, q, v, acceleration, u);
    return u;
  }

  void Prepare(sim::CommandSignal signal, Imagined* out) const {
    recordings::Recording& rec = out->recording;
    if (!like_.use_velocity) rec.v.resize(0, 0);
    FitData& d = out->data;
    d.n = like_.n, d.use_velocity = like_.use_velocity, d.noise = like_.noise, d.nodes = like_.nodes;
    d.recordings.push_back({&rec, std::move(signal)});
    d.motions.emplace_back(rec, d.noise);
    d.windows = CutIntoNodes(rec, 0, d.motions[0], d.noise, d.nodes);
    d.fine.push_back(FineMotionOf(rec, d.recordings[0].command, d.motions[0], d.nodes));
  }

  const Candidate& c_;
  const FitData& like_;
  sim::Simulator simulator_;
  dynamics::Mechanism mechanism_{sysid::MechanismOf(*c_.plant, c_.fit.values)};
  dynamics::Workspace workspace_;
};

// ½ (χ² + prior cost) of `model` fitted to the simulated recording of another one.
double Behind(const Imagined& imagined, const Candidate& model, const LiftedOptions& options) {
  FitModel fit{*model.plant, model.fit.values, model.parameters};
  for (size_t k = 0; k < fit.parameters.size(); ++k) {
    const auto at = static_cast<Eigen::Index>(k);
    fit.parameters[k].nominal = model.fit.theta[at];
    fit.parameters[k].prior_stddev = std::clamp(model.fit.stddev[at], 1e-9, model.parameters[k].prior_stddev);
  }
  const FitResult result = Fit(imagined.data, fit, options);
  if (!result.ok) return 0.0;
  return 0.5 * (result.chi2 / options.noise_scale + result.prior_cost);
}

// Expected log evidence of a motion for the truth `a` over `b`; 0 where a simulation or fit fails.
double Expected(const ProbeMotion& motion, const Candidate& a, const Candidate& b, const FitData& data,
                const LiftedOptions& options) {
  Imagined imagined;
  if (!Drive(a, data, AsFitted(options, a.fit).step_s).Record(motion, &imagined)) return 0.0;
  return std::max(0.0, Behind(imagined, b, options) - Behind(imagined, a, options));
}

// Joints on which the rivals act; all where one acts on the robot as a whole.
std::vector<int> JointsOf(const std::vector<Pair>& pairs, const std::set<std::string>& ids,
                          const sim::Plant& nominal) {
  std::set<std::string> names;
  for (const Pair& pair : pairs) {
    for (const Candidate* c : {pair.chosen, pair.rival}) {
      for (const EffectSpec& e : c->specs) {
        if (ids.count(e.id) == 0) continue;
        if (e.joints.empty()) names.insert(nominal.joint_names().begin(), nominal.joint_names().end());
        names.insert(e.joints.begin(), e.joints.end());
      }
    }
  }
  std::vector<int> out;
  for (int j = 0; j < nominal.num_joints() && out.size() < kMostJoints; ++j) {
    if (names.count(nominal.joint_names()[j])) out.push_back(j);
  }
  return out;
}

}  // namespace

std::optional<ProposedMotion> ProposeMotion(const SearchResult& search, const FitSetting& setting,
                                            const std::vector<Finding>& findings, double step_s, int threads,
                                            const CancelToken* cancel) {
  const auto& [data, nominal, scales] = setting;
  std::vector<Pair> pairs;
  std::set<std::string> ids;
  for (const Finding& f : findings) {
    for (const Rival& rival : RivalsOf(search, f.effect)) {
      const bool open = std::ranges::any_of(f.alternatives, [&](const Alternative& a) {
        return a.effect == rival.effect && !a.separable && a.by_motion;
      });
      if (!open || !rival.candidate->fit.ok || pairs.size() >= kMostPairs) continue;
      pairs.push_back({&search.best, rival.candidate});
      ids.insert(f.effect), ids.insert(rival.effect);
    }
  }
  if (pairs.empty() || !search.best.fit.ok) return {};
  const std::vector<ProbeMotion> motions = ProbeMotions(setting, JointsOf(pairs, ids, nominal));
  LiftedOptions options;
  options.iterations = kRefitIterations, options.noise_scale = search.noise_scale, options.step_s = step_s;
  const auto trials = static_cast<int>(motions.size() * pairs.size() * 2);
  std::vector<double> nats(static_cast<size_t>(trials));
  ParallelFor(threads, trials, [&](int, int i) {
    if (cancel != nullptr && cancel->cancelled()) return;
    const auto at = static_cast<size_t>(i);
    const Pair& pair = pairs[at / 2 % pairs.size()];
    const bool swapped = at % 2 == 1;
    nats[at] = Expected(motions[at / 2 / pairs.size()], swapped ? *pair.rival : *pair.chosen,
                        swapped ? *pair.chosen : *pair.rival, data, options);
  });
  double best = kSeparable;
  const ProbeMotion* chosen = nullptr;
  for (size_t m = 0; m < motions.size(); ++m) {
    const auto first = nats.begin() + static_cast<long>(m * pairs.size() * 2);
    const double least = *std::min_element(first, first + static_cast<long>(pairs.size() * 2));
    if (least > best) best = least, chosen = &motions[m];
  }
  if (chosen == nullptr) return {};
  return ProposedMotion{std::vector<std::string>(ids.begin(), ids.end()),
                        chosen->description,
                        best,
                        chosen->t,
                        chosen->q,
                        chosen->v};
}

}  // namespace rg::diagnosis
