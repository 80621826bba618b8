#include "services/jobs/identify_problem.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "common/effects/effect_catalog.h"
#include "common/effects/inference.h"
#include "realitygrad/v1/payloads.pb.h"
#include "services/sysid/drive_signal.h"
#include "services/sysid/initial_regression.h"

namespace rg::jobs {

namespace pb = ::realitygrad::v1;
using Eigen::VectorXd;

IdentifyProblem::IdentifyProblem(sysid::PaperProblem paper, sysid::LeastSquaresProblem problem,
                                 double long_weight)
    : paper_(std::move(paper)), problem_(std::move(problem)), long_weight_(long_weight) {}

namespace {

// What is believed of a parameter before any recording: bounds, and how far it may be off.
struct Belief {
  double lower, upper, stddev;
};

// `rotors`: rotor inertias are fitted on their own.
Belief PhysicalBelief(const sim::Parameter& parameter, bool rotors) {
  const double nominal = parameter.nominal;
  switch (parameter.kind) {
    case sim::ParameterKind::kGravity:
      return {nominal - 0.5, nominal + 0.5, 0.1};
    case sim::ParameterKind::kMass:
      return {0.3 * nominal, 3.0 * nominal, 0.2 * nominal};
    // Without a rotor inertia of its own a joint's has to find room in its links'.
    case sim::ParameterKind::kInertia:
      if (nominal <= 0) return {0, 0, 0};
      return rotors ? Belief{0.2 * nominal, 5.0 * nominal, 0.5 * nominal} : Belief{0.0, 0.6, 0.1};
    case sim::ParameterKind::kDamping:
      return {0.0, 30.0, 10.0};
    case sim::ParameterKind::kForceGain:
      return {0.6, 1.5, 0.05};
    default:
      return {parameter.lower, parameter.upper, parameter.prior_stddev};
  }
}

// The same of coordinate i. A body's mass and its stretches are half the logarithms of what they multiply the
// mass and, at that mass, the second moments by: raw beliefs about mass and inertia hold for these.
Belief BeliefOf(const sim::Plant& plant, const sysid::FitSpace& space, int i, bool rotors) {
  using Coordinate = sysid::FitSpace::Coordinate;
  const sim::Parameter& parameter = plant.parameters()[space.parameters()[static_cast<size_t>(i)].index];
  const Belief raw = PhysicalBelief(parameter, rotors);
  const Coordinate coordinate = space.CoordinateOf(i);
  if (coordinate == Coordinate::kItself) return raw;
  const Belief own{space.lower()[i], space.upper()[i], space.prior_stddev()[i]};
  const double nominal = parameter.nominal;
  if (coordinate == Coordinate::kCentre || coordinate == Coordinate::kShear || nominal <= 0.0) return own;
  return {std::max(0.5 * std::log(raw.lower / nominal), own.lower), 0.5 * std::log(raw.upper / nominal),
          0.5 * std::log1p(raw.stddev / nominal)};
}

// Bounds, search ranges and the weights of the pull towards p_init for BoundsKind::kPhysical.
void TakePhysicalBeliefs(const sim::Plant& plant, const sysid::FitSpace& space, double alpha, bool rotors,
                         sysid::LeastSquaresProblem* problem) {
  for (int e = 0; e < space.size(); ++e) {
    const Belief belief = BeliefOf(plant, space, e, rotors);
    problem->lower[e] = std::min(belief.lower, problem->initial[e]);
    problem->upper[e] = std::max(belief.upper, problem->initial[e]);
    problem->search_lower[e] = std::max(problem->lower[e], problem->initial[e] - 2 * belief.stddev);
    problem->search_upper[e] = std::min(problem->upper[e], problem->initial[e] + 2 * belief.stddev);
    if (belief.stddev > 0) {
      problem->alpha[e] = alpha / (belief.stddev * belief.stddev);
      problem->scale[e] = belief.stddev;
    }
  }
}

// Dry friction and the rotor. Where a diagnosis has put another law of dry friction, or a motor of its own, a
// second one is no news.
struct FrictionEffect {
  std::string id;
  effects::Slot stands_for_it;
};
std::vector<FrictionEffect> FrictionEffects() {
  using effects::LawOf, effects::Regressor, effects::Slot;
  return {{LawOf(Regressor::kDirection).id, Slot::kDryFriction},
          {LawOf(Regressor::kAcceleration).id, Slot::kTransmission}};
}

std::vector<int> FrictionParameters(const sim::Plant& plant) {
  std::vector<int> found;
  for (int i = 0; i < plant.parameters().size(); ++i) {
    for (const FrictionEffect& e : FrictionEffects()) {
      if (plant.parameters()[i].effect == e.id) found.push_back(i);
    }
  }
  return found;
}

// Joints on which the plant has neither the effect nor one that stands for it.
std::vector<std::string> JointsWithout(const sim::Plant& plant, const FrictionEffect& effect) {
  std::vector<std::string> joints = plant.joint_names();
  for (const effects::EffectSpec& spec : plant.effects()) {
    if (spec.id != effect.id && !effects::IsIn(effect.stands_for_it, spec.id)) continue;
    for (const std::string& joint : spec.joints) std::erase(joints, joint);
  }
  return joints;
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

Result<sim::ModelFile> ModelToFit(const sim::ModelFile& model, const IdentifyProblemOptions& options) {
  sim::ModelFile out = model;
  for (const FrictionEffect& effect : FrictionEffects()) {
    const std::string& id = effect.id;
    const std::vector<std::string> joints = JointsWithout(out.plant, effect);
    if (!options.friction || joints.empty()) continue;
    RG_ASSIGN_OR_RETURN(sim::Plant plant, out.plant.WithEffect(effects::MakeSpec(id, joints)));
    Eigen::VectorXd values = plant.ValuesFrom(out.plant.parameters(), out.values);
    for (int i = 0; i < plant.parameters().size(); ++i) {
      const sim::Parameter& row = plant.parameters()[i];
      if (row.effect == id && out.plant.parameters().Find(row.name) < 0) values[i] = 0.01 * row.prior_stddev;
    }
    out = {std::move(plant), std::move(values), model.version};
  }
  return out;
}

Result<IdentifyProblem> IdentifyProblem::Create(const sim::Plant& plant, const VectorXd& initial,
                                                const recordings::Recording& recording,
                                                const IdentifyProblemOptions& options) {
  if (recording.rows() < 2) return InvalidError(recording.name + ": too few rows to identify anything");
  sysid::PaperOptions paper_options;
  paper_options.alpha = options.alpha;
  paper_options.interpolate = !options.whole_recording;
  paper_options.simulator = options.simulator;
  paper_options.consistent_inertias = options.consistent_inertias;
  if (options.friction) paper_options.extra_parameters = FrictionParameters(plant);
  paper_options.windows.clear();
  for (const double start : WindowStarts(recording, options))
    paper_options.windows.push_back({start, options.window_s});
  if (options.long_weight > 0)
    paper_options.windows.push_back({0.0, std::numeric_limits<double>::infinity(), options.long_weight});
  RG_ASSIGN_OR_RETURN(auto paper, sysid::PaperProblem::Create(plant, initial, recording, paper_options));
  sysid::LeastSquaresProblem problem = paper.problem();
  if (options.bounds == BoundsKind::kPhysical)
    TakePhysicalBeliefs(plant, paper.space(), options.alpha, options.friction, &problem);
  return IdentifyProblem(std::move(paper), std::move(problem), options.long_weight);
}

VectorXd IdentifyProblem::Start(const sim::Plant& plant, const recordings::Recording& recording) const {
  const sysid::LeastSquaresProblem& ls = problem();
  const std::vector<sysid::FitRecording> fit{{&recording, sysid::DriveSignal(recording)}};
  const VectorXd p =
      sysid::RegressInverseDynamics(plant, FullValues(ls.initial), space(), ls.initial, fit).theta;
  double given = 0.0, regressed = 0.0;
  if (!sysid::EvaluateCost(ls, p, {}, &regressed)) return ls.initial;
  return sysid::EvaluateCost(ls, ls.initial, {}, &given) && given <= regressed ? ls.initial : p;
}

// A whole rollout counts as about as much as one of its seconds: errors grow along it.
constexpr double kLongWeight = 0.02;

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
  options.friction = payload.friction();
  options.consistent_inertias = payload.parametrisation() == pb::IDENTIFY_PARAMETRISATION_LOG_CHOLESKY;
  // The paper's search starts from what is given.
  options.regress = options.whole_recording && options.bounds == BoundsKind::kPhysical;
  const bool last_round = payload.round() + 1 == payload.rounds();
  if (options.whole_recording && payload.rounds() > 1 && last_round) options.long_weight = kLongWeight;
  options.simulator.step_s = 0.002;
  // Wide enough that a joint at rest still says something of its friction.
  if (options.friction) options.simulator.stick_velocity = 2e-3;
  return options;
}

sysid::Solver SolverOf(const pb::IdentifyPayload& payload) {
  return payload.solver() == pb::IDENTIFY_SOLVER_LBFGS ? sysid::Solver::kUnboundedLbfgs
                                                       : sysid::Solver::kBoundedLevenbergMarquardt;
}

}  // namespace rg::jobs
