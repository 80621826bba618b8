#include "services/diagnosis/likelihood/candidate.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cctype>
#include <cmath>
#include <limits>
#include <map>
#include <set>

#include "common/effects/effect_catalog.h"
#include "common/effects/inference.h"
#include "common/model/robot_model.h"

namespace rg::diagnosis {

using effects::EffectSpec;

namespace {

constexpr double kBasePrior = 1.0;    // −log prior odds of free base parameters, nats
constexpr double kShapePrior = 1.0;   // nats of each parameter beyond the first
constexpr double kAtBound = 1.3;      // times the lower bound of a mass or gap: below, it is at its bound
constexpr double kPhaseError = 0.02;  // rad of phase over the whole travel: 1 % of an amplitude
constexpr double kSeenAgain = 0.75;   // periods within the travel, from which periodicity shows
constexpr double kSharp =
    0.1;  // cycles per turn: an arbitrary number is as near to an integer with odds 1 in 5
constexpr double kBias = 0.25;  // cycles per turn, bias of the number by other missing effects, at most
constexpr double kSoftest = 4.0 / 6.0;  // 1/rad², cubic over linear term of a sine of two periods per turn
constexpr double kFarther = 10.0;       // times what bristles bend at most
constexpr double kMostlyGone = 0.01;    // ratio of squared strengths
constexpr double kUnseen = 0.7;         // posterior over prior stddev of the best known parameter
constexpr double kInformed = 0.9;       // the same of a weight of an unnamed force, at most
constexpr long kManyJoints = 3;
constexpr double kLeastOfMedian = 0.2;  // of the other joints' median strength

// Parameters that are an effect's strength: it is absent where they are zero (a gain: one).
const std::set<std::string> kStrengths = {"viscous",
                                          "coulomb",
                                          "coulomb_positive",
                                          "coulomb_negative",
                                          "static",
                                          "load_coefficient",
                                          "delay",
                                          "quadratic",
                                          "time_constant",
                                          "gain",
                                          "deadband",
                                          "amplitude",
                                          "mass",
                                          "armature",
                                          "tilt",
                                          "offset",
                                          "initial",
                                          "stiffness",
                                          "final",
                                          "torque",
                                          "coefficient",
                                          "gap",
                                          "cubic"};

// Whether the parameter belongs to the effect.
bool IsOf(const EffectSpec& s, const sim::Parameter& p) {
  return p.effect == s.id &&
         (s.joints.empty() || p.owner == "*" || std::ranges::find(s.joints, p.owner) != s.joints.end());
}

// How many parameters the effect has in this form.
double ParametersOf(const EffectSpec& spec) {
  const effects::EffectInfo& info = *effects::FindEffect(spec.id);
  int count = 0;
  for (size_t i = 0; i < info.parameters.size(); ++i) count += info.OfForm(static_cast<int>(i), spec);
  return count;
}

}  // namespace

double StructurePrior(const std::vector<EffectSpec>& specs, bool base) {
  std::set<std::string> ids;
  double cost = base ? kBasePrior : 0.0;
  for (const EffectSpec& s : specs) {
    ids.insert(s.id);
    // The weights of an unnamed force are charged by the Occam factor alone.
    const bool field = IsUnnamed(s.id);
    cost += kJointPrior;
    if (!field) cost += kShapePrior * (ParametersOf(s) - 1.0);
    cost += effects::InferenceOf(s.id).rare;
  }
  return cost + kEffectPrior * static_cast<double>(ids.size());
}

bool IsUnnamed(const std::string& id) { return effects::InferenceOf(id).unnamed; }

bool IsTiming(const std::string& id) {
  const effects::EffectInfo* info = effects::FindEffect(id);
  return info != nullptr && info->family == "timing";
}

bool IsLateDrive(const std::string& id) {
  return IsTiming(id) && effects::FindEffect(id)->stage == effects::Stage::kActuator;
}

bool IsOfPosition(const std::string& id) {
  const effects::EffectInfo* info = effects::FindEffect(id);
  return info != nullptr && info->family == "position" && info->scope == effects::Scope::kJoint;
}

bool IsLossOfDrives(const std::string& id) {
  const effects::EffectInfo* info = effects::FindEffect(id);
  return info != nullptr && (info->family == "friction" || info->family == "inertia");
}

std::string FieldVariable(const std::vector<EffectSpec>& specs, const std::string& joint) {
  for (const EffectSpec& s : specs) {
    const effects::EffectInfo& info = *effects::FindEffect(s.id);
    if (!IsUnnamed(s.id) || info.options.count("variable") == 0 || !Contains({s}, s.id, joint)) continue;
    return info.options.at("variable")[static_cast<size_t>(info.Option("variable", s))];
  }
  return "";
}

bool Contains(const std::vector<EffectSpec>& specs, const std::string& id, const std::string& joint) {
  for (const EffectSpec& s : specs) {
    if (s.id != id) continue;
    if (s.joints.empty() || joint.empty() || id == effects::LawOf(effects::Regressor::kOtherEffort).id) {
      if (s.joints.empty()) return true;
      continue;
    }
    if (std::ranges::find(s.joints, joint) != s.joints.end()) return true;
  }
  return false;
}

bool HasKind(const std::vector<EffectSpec>& specs, const std::string& id) {
  return std::ranges::any_of(specs, [&](const EffectSpec& s) { return s.id == id; });
}

std::vector<EffectSpec> WithoutKind(std::vector<EffectSpec> specs, const std::string& id) {
  std::erase_if(specs, [&](const EffectSpec& s) { return s.id == id; });
  return specs;
}

bool IsPart(const std::vector<EffectSpec>& part, const std::vector<EffectSpec>& whole) {
  return std::ranges::all_of(part, [&](const EffectSpec& s) {
    return std::ranges::any_of(whole,
                               [&](const EffectSpec& w) { return w.id == s.id && w.joints == s.joints; });
  });
}

std::vector<EffectSpec> Refreshed(const Candidate& c) {
  std::vector<EffectSpec> specs = c.specs;
  for (EffectSpec& s : specs) {
    std::vector<std::string> owners = s.joints;
    const bool pair = effects::FindEffect(s.id)->scope == effects::Scope::kJointPair;
    if (s.joints.empty() || pair) owners = {"*"};
    for (const std::string& owner : owners) {
      for (const auto& info : effects::FindEffect(s.id)->parameters) {
        const int at = c.plant->parameters().Find(s.id + "." + owner + "." + info.name);
        if (at >= 0 && c.fit.ok) s.values[owner][info.name] = c.fit.values[at];
      }
    }
  }
  return specs;
}

bool Uninformed(const Candidate& c) {
  for (size_t i = 0; i < c.specs.size(); ++i) {
    if (Uninformed(c, i) && !LikeOtherJoints(c, i)) return true;
  }
  return false;
}

bool Uninformed(const Candidate& c, size_t i) {
  const EffectSpec& s = c.specs[i];
  double known = 1;
  for (size_t k = 0; k < c.parameters.size(); ++k) {
    const sim::Parameter& p = c.Free(k);
    if (!IsOf(s, p)) continue;
    known = std::min(known, c.fit.stddev[k] / c.parameters[k].prior_stddev);
    // The hidden states of a mass or gap at its lower bound follow the noise.
    const bool vanishes = p.field == "mass" || p.field == "gap";
    if (vanishes && c.fit.theta[k] < kAtBound * c.parameters[k].lower) return true;
  }
  return known > kUnseen;
}

void ContinueFields(Candidate* c) {
  struct Node {
    long at;  // place among the free parameters
    int row, column;
    bool informed;
  };
  std::map<std::string, std::vector<Node>> fields;  // by effect and owner
  for (size_t k = 0; k < c->parameters.size() && c->fit.ok; ++k) {
    const sim::Parameter& p = c->Free(k);
    const bool weight = p.kind == sim::ParameterKind::kEffect && IsUnnamed(p.effect) && p.field.size() > 1 &&
                        p.field[0] == 'w' && std::isdigit(static_cast<unsigned char>(p.field[1]));
    if (!weight) continue;
    const auto at = static_cast<long>(k);
    fields[p.effect + p.owner].push_back({at, p.field[1] - '0', p.field.size() > 2 ? p.field[2] - '0' : 0,
                                          c->fit.stddev[at] < kInformed * c->parameters[k].prior_stddev});
  }
  for (const auto& [name, nodes] : fields) {
    for (const Node& node : nodes) {
      int nearest = std::numeric_limits<int>::max(), count = 0;
      double sum = 0;
      for (const Node& other : nodes) {
        if (node.informed || !other.informed) continue;
        const int rows = node.row - other.row, columns = node.column - other.column;
        const int distance = rows * rows + columns * columns;
        if (distance < nearest) nearest = distance, sum = 0, count = 0;
        if (distance == nearest) sum += c->fit.theta[other.at], ++count;
      }
      if (count == 0) continue;
      c->fit.theta[node.at] = sum / count;
      c->fit.values[c->parameters[node.at].index] = sum / count;
    }
  }
}

void Rescale(double before, double scale, Candidate* c) {
  c->score -= 0.5 * (1.0 / scale - 1.0 / before) * c->fit.chi2;
  const Eigen::Index count = c->fit.information.rows();
  if (count == 0 || !c->fit.information.allFinite()) return;  // of a refused fit
  const Eigen::VectorXd sigma = sysid::PriorStddevs(c->parameters);
  const double old = PosteriorOf(c->fit.information, sigma).half_log_det;
  c->fit.information *= before / scale;
  const Posterior now = PosteriorOf(c->fit.information, sigma);
  c->score -= now.half_log_det - old;
  c->fit.stddev = now.stddev;
}

std::set<size_t> Aperiodic(const Candidate& c, const MotionScales& scales, double noise_scale, bool whole) {
  const auto& model = c.plant->model();
  const double rows = c.fit.rows, per_row = c.fit.chi2 / std::max(1.0, rows) / noise_scale;
  // Nats above the noise and its standard deviation.
  const double left = std::max(0.0, 0.5 * (per_row - 1) * rows - std::sqrt(0.5 * rows));
  std::set<size_t> out, slow;
  bool seen_again = false;
  for (size_t k = 0; k < c.parameters.size(); ++k) {
    const sim::Parameter& p = c.Free(k);
    if (p.field != "cycles_per_rev") continue;
    const int joint = model.FindJoint(p.owner);
    const double cycles = c.fit.theta[k], lower = c.parameters[k].lower;
    const double range = scales.high[joint] - scales.low[joint];
    const double stddev = c.fit.stddev[k];
    const double error = std::max(kPhaseError / std::max(1e-9, range),
                                  kZ99TwoSided * stddev * std::sqrt(std::max(1.0, per_row)));
    const double times = cycles * range / (2 * M_PI);
    const bool turns = model.joint(joint).is_revolute();
    // Bias by other missing effects: near the noise no more than the nats that are left could pay for.
    const double bias = per_row > kExplained ? kBias : std::min(stddev * std::sqrt(2 * left), kBias);
    const bool at_bound = cycles < lower + 1e-6 * (1 + std::abs(lower));
    const bool whole_number = !turns || std::abs(cycles - std::round(cycles)) <= std::max(error, bias);
    const bool as_spring =
        times < 2 && Contains(c.specs, effects::LawOf(effects::Regressor::kPosition).id, p.owner);
    const auto at =
        std::find_if(c.specs.begin(), c.specs.end(), [&](const EffectSpec& s) { return IsOf(s, p); });
    const auto place = static_cast<size_t>(at - c.specs.begin());
    if (at_bound || !whole_number || as_spring) {
      out.insert(place);
    } else if (times >= kSeenAgain) {
      seen_again = true;
    } else if (!turns || (whole && error > kSharp)) {
      slow.insert(place);
    }
  }
  // One joint that shows whole periods supports the ripple of others.
  if (!seen_again) out.merge(slow);
  return out;
}

std::set<size_t> Rising(const Candidate& c) {
  const auto& parameters = c.plant->parameters();
  std::set<size_t> out;
  for (size_t i = 0; i < c.specs.size(); ++i) {
    const EffectSpec& s = c.specs[i];
    if (s.id != effects::LawOf(effects::Regressor::kSlowly).id) continue;
    const std::string name = s.id + "." + s.joints[0] + ".";
    if (c.fit.values[parameters.Find(name + "static")] < c.fit.values[parameters.Find(name + "coulomb")])
      out.insert(i);
  }
  return out;
}

bool PullsBack(const Candidate& c, const MotionScales& scales) {
  const auto& table = c.plant->parameters();
  return std::ranges::all_of(c.specs, [&](const EffectSpec& s) {
    if (s.id != effects::LawOf(effects::Regressor::kPosition).id) return true;
    const auto place = [&](const char* field) { return table.Find(s.id + "." + s.joints[0] + "." + field); };
    double error = 0;  // of the cubic term
    for (size_t k = 0; k < c.parameters.size() && static_cast<long>(k) < c.fit.stddev.size(); ++k) {
      if (c.parameters[k].index == place("cubic")) error = kZ99OneSided * c.fit.stddev[k];
    }
    const int joint = c.plant->model().FindJoint(s.joints[0]);
    const double stiffness = c.fit.values[place("stiffness")], center = c.fit.values[place("center")];
    // Against the linear term.
    const double against =
        std::max(0.0, -std::copysign(1.0, stiffness) * c.fit.values[place("cubic")] - error);
    const bool as_sine =
        c.plant->model().joint(joint).is_revolute() && against <= kSoftest * std::abs(stiffness);
    const double farthest =
        std::max(std::abs(scales.low[joint] - center), std::abs(scales.high[joint] - center));
    return as_sine || std::abs(stiffness) >= 3 * against * farthest * farthest;
  });
}

bool Slides(const Candidate& c, const MotionScales& scales) {
  const auto& table = c.plant->parameters();
  for (int i = 0; i < table.size(); ++i) {
    if (table[i].field != "bristle_stiffness") continue;
    const double level = c.fit.values[table.Find(table[i].effect + "." + table[i].owner + ".coulomb")];
    const int joint = c.plant->model().FindJoint(table[i].owner);
    if (kFarther * level > c.fit.values[i] * (scales.high[joint] - scales.low[joint])) return false;
  }
  return true;
}

double Strength(const Candidate& c, size_t i, bool gains_fixed) {
  const EffectSpec& s = c.specs[i];
  // The effect's strengths first, then the parameters of all other effects; its own shape is left out.
  std::vector<long> own, rest;
  for (size_t k = 0; k < c.parameters.size(); ++k) {
    const sim::Parameter& p = c.Free(k);
    const bool own_effect = IsOf(s, p);
    const bool fixed = gains_fixed && effects::ScalesEffort(p.effect);
    if (!own_effect && !fixed) rest.push_back(static_cast<long>(k));
    if (own_effect && kStrengths.count(p.field) > 0) own.push_back(static_cast<long>(k));
  }
  if (own.empty()) return 1e9;
  const long n = static_cast<long>(own.size());
  std::vector<long> order = own;
  order.insert(order.end(), rest.begin(), rest.end());
  Eigen::VectorXd value(n), weight(static_cast<long>(order.size()));
  for (size_t k = 0; k < order.size(); ++k) {
    const sysid::FitParameter& p = c.parameters[order[k]];
    weight[k] = 1 / (p.prior_stddev * p.prior_stddev);
    if (static_cast<long>(k) >= n) continue;
    // A lag is absent at its lower bound.
    const double none = c.plant->parameters()[p.index].field == "gain"            ? 1
                        : s.id == effects::LawOf(effects::Regressor::kLagging).id ? p.lower
                                                                                  : 0;
    value[k] = c.fit.theta[order[k]] - none;
  }
  Eigen::MatrixXd precision = c.fit.information(order, order);
  precision.diagonal() += weight;
  const auto others = Eigen::seq(n, Eigen::last);
  const Eigen::MatrixXd cross = precision(others, Eigen::seqN(0, n));
  const Eigen::MatrixXd own_precision =
      precision.topLeftCorner(n, n) - cross.transpose() * precision(others, others).ldlt().solve(cross);
  return std::sqrt(std::max(0.0, value.dot(own_precision * value)));
}

std::vector<EffectSpec> StrongEffects(const Candidate& c) {
  const std::vector<EffectSpec> all = Refreshed(c);
  std::vector<EffectSpec> out;
  for (size_t i = 0; i < all.size(); ++i) {
    if (Strength(c, i) > kAbsent || LikeOtherJoints(c, i)) out.push_back(all[i]);
  }
  return out;
}

std::vector<EffectSpec> StillNeeded(const Candidate& model, const Candidate& other) {
  const std::vector<EffectSpec> specs = Refreshed(other);
  if (!other.fit.ok) return specs;
  // Squared strengths grow with the number of rows.
  const double seen = other.fit.rows < model.fit.rows && other.fit.rows > 0
                          ? static_cast<double>(other.fit.rows) / model.fit.rows
                          : 1.0;
  std::vector<EffectSpec> out;
  for (size_t i = 0; i < specs.size(); ++i) {
    double before = 0;
    for (size_t k = 0; k < model.specs.size(); ++k) {
      if (model.specs[k].id == specs[i].id && model.specs[k].joints == specs[i].joints)
        before = Strength(model, k);
    }
    const double now = Strength(other, i);
    if (now * now > kMostlyGone * seen * before * before) out.push_back(specs[i]);
  }
  return out;
}

bool OfAllJoints(const Candidate& c, size_t i) {
  const std::string& id = c.specs[i].id;
  const bool timing = IsTiming(id);
  if (!timing && !IsLossOfDrives(id)) return false;
  long have = 0, told = c.plant->num_joints();
  for (size_t k = 0; k < c.specs.size(); ++k) {
    if (c.specs[k].id != id) continue;
    if (c.fit.information.size() == 0 || Strength(c, k) > kAbsent) {
      ++have;
    } else if (Uninformed(c, k)) {
      --told;
    }
  }
  return timing ? have > 1 : have >= kManyJoints && 2 * have > told;
}

bool LikeOtherJoints(const Candidate& c, size_t i) {
  if (!OfAllJoints(c, i) || c.specs[i].joints.size() != 1) return false;
  // The first parameter that is a strength, in prior stddevs.
  const auto strength = [&](size_t of, double* error) {
    const EffectSpec& s = c.specs[of];
    for (size_t k = 0; k < c.parameters.size(); ++k) {
      const sim::Parameter& p = c.Free(k);
      if (p.effect != s.id || p.owner != s.joints[0] || kStrengths.count(p.field) == 0) continue;
      *error = c.fit.stddev[k] / c.parameters[k].prior_stddev;
      return c.fit.theta[k] / c.parameters[k].prior_stddev;
    }
    return 0.0;
  };
  std::vector<double> fellows;
  double error = 0;
  for (size_t k = 0; k < c.specs.size(); ++k) {
    if (k == i || c.specs[k].id != c.specs[i].id || c.specs[k].joints.size() != 1 || Uninformed(c, k))
      continue;
    fellows.push_back(strength(k, &error));
  }
  if (2 * fellows.size() < static_cast<size_t>(c.plant->num_joints())) return false;
  const auto middle = fellows.begin() + static_cast<long>(fellows.size() / 2);
  std::nth_element(fellows.begin(), middle, fellows.end());
  const double own = strength(i, &error);
  return own + 2 * error > kLeastOfMedian * *middle;
}

bool ClearlyNonzero(const Candidate& c, size_t i, double needed) {
  if (LikeOtherJoints(c, i)) return true;
  const double strength = Strength(c, i);
  if (strength <= 4.0 || c.specs[i].id == effects::LawOf(effects::Regressor::kBeyond).id) return false;
  return OfAllJoints(c, i) || 0.5 * strength * strength > 2 * needed;
}

std::vector<EffectSpec> RefreshedFrom(const Candidate& before, const Candidate& c) {
  std::vector<EffectSpec> out = Refreshed(before);
  for (const EffectSpec& theirs : Refreshed(c)) {
    for (EffectSpec& own : out) {
      if (own.id == theirs.id && own.joints == theirs.joints && own.options == theirs.options) own = theirs;
    }
  }
  return out;
}

std::set<std::string> FreshKinds(const Candidate& before, const Candidate& c) {
  std::set<std::string> out;
  for (const EffectSpec& s : c.specs) out.insert(s.id);
  for (const EffectSpec& s : before.specs) out.erase(s.id);
  return out;
}

bool HasUnnamed(const Candidate& c) {
  return std::ranges::any_of(c.specs, [](const EffectSpec& e) { return IsUnnamed(e.id); });
}

bool HasHiddenStates(const Candidate& c) {
  return c.plant != nullptr && c.plant->num_states() > 2 * c.plant->num_joints();
}

bool HasFreeStates(const Candidate& c) { return c.plant != nullptr && HasFreeStates(*c.plant); }

bool HasUnseenStates(const Candidate& c) {
  return c.plant != nullptr && HasStatesBut({kLagState, kBristleState}, *c.plant);
}

bool OfPosition(const Candidate& c) {
  return std::ranges::any_of(c.specs, [](const EffectSpec& e) { return IsOfPosition(e.id); });
}

}  // namespace rg::diagnosis
