#include "services/diagnosis/reporting/findings.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <set>

#include "common/effects/effect_catalog.h"
#include "common/effects/inference.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/data/words.h"
#include "services/diagnosis/hypotheses/given_model.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/hypotheses/rivals.h"
#include "services/diagnosis/reporting/confidence.h"
#include "services/diagnosis/reporting/experiments.h"

namespace rg::diagnosis {

using effects::Regressor;
using effects::Variable;

namespace {

constexpr double kMuchOfTheEffort = 0.25;  // of its variance left: unexplained
constexpr double kSameDelay = 0.05;        // relative difference between joints, below which delays are equal
constexpr size_t kListedJoints = 3;  // from which a statement gives ranges instead of each joint's values
constexpr double kLittle = 0.1;  // expected χ² over explained χ², below which a small excess is ignored
constexpr double kSecond = 0.3;  // of the evidence of an unnamed force's joint, that a second one must add

// Name of an unnamed force in any form; whether it is the form over two joints' positions.
const std::string& Unnamed() { return effects::LawOf(Regressor::kPositionPiece).id; }
bool IsSurface(const std::string& id) {
  return IsUnnamed(id) && effects::FindEffect(id)->scope == effects::Scope::kJointPair;
}

std::vector<std::string> JointsOf(const std::vector<EffectSpec>& specs, const std::string& id,
                                  const std::vector<std::string>& order) {
  const std::string& coupling = effects::LawOf(Regressor::kOtherEffort).id;
  std::set<std::string> joints;
  std::vector<std::string> pair;  // in their own order
  for (const EffectSpec& s : specs) {
    if (s.id != id) continue;
    if (id == coupling) pair.insert(pair.end(), s.joints.begin(), s.joints.end());
    joints.insert(s.joints.begin(), s.joints.end());
  }
  if (id == coupling) return pair;
  std::vector<std::string> out;
  for (const std::string& name : order) {
    if (joints.count(name)) out.push_back(name);
  }
  return out;
}

// Whether a model has the effect, or a richer form of its law wherever the best one has it.
bool HasLaw(const std::vector<EffectSpec>& specs, const std::vector<EffectSpec>& best,
            const std::string& id) {
  const auto richer_there = [&](const EffectSpec& own) {
    return std::ranges::any_of(
        specs, [&](const EffectSpec& e) { return IsRicherFormOf(e.id, id) && e.joints == own.joints; });
  };
  return HasKind(specs, id) ||
         std::ranges::all_of(best, [&](const EffectSpec& own) { return own.id != id || richer_there(own); });
}

// Score of the best fitted model without effect `id`, hold-out predictive density included where known.
double BestWithout(const SearchResult& s, const std::string& id) {
  double best = kNoScore;
  const size_t kinds = FreshKinds(Candidate{}, s.best).size();
  for (const Candidate& c : s.tried) {
    const bool more = (c.base && !s.best.base) || FreshKinds(Candidate{}, c).size() > kinds;
    if (HasLaw(c.specs, s.best.specs, id)) continue;
    const bool asked = c.held_out && s.best.held_out;
    const double all = asked ? c.score + std::min(0.0, *c.held_out - *s.best.held_out) : c.score;
    best = std::max(best, all - (more ? s.beside : 0.0));
  }
  return best;
}

// Energy of the missing force above its noise, per joint.
VectorXd Energy(const MissingForce& f, int n) {
  VectorXd sum = VectorXd::Zero(n);
  for (size_t w = 0; w < f.force.size(); ++w) {
    if (f.force[w].size() == 0) continue;
    sum += (f.force[w].cwiseAbs2() - f.stddev[w].cwiseAbs2()).rowwise().sum();
  }
  return sum.cwiseMax(0.0);
}

class FindingsBuilder {
 public:
  FindingsBuilder(const SearchResult& search, const FitSetting& setting, DiagnosisResult* result)
      : s_(search), data_(setting.data), nominal_(setting.nominal), scales_(setting.scales), r_(*result) {}

  void Run() {
    Figures();
    Verdict();
    const Standing standing = s_.measured.active    ? Standing::kMeasured
                              : some_left_          ? Standing::kSomeLeft
                              : s_.beside_any_force ? Standing::kBesideAnyForce
                                                    : Standing::kPlain;
    Calibrate(r_.verdict, standing, static_cast<int>(r_.joints.size()), &r_.findings);
    if (s_.out_of_time) LimitOutOfTime(&r_.findings);
    r_.ledger = LedgerOf(s_);
    r_.candidates = CandidateRows(s_);
    r_.force_plots = ForcePlots(s_, data_);
  }

 private:
  void Figures() {
    const Candidate& without = s_.calibrated.score > s_.nominal.score ? s_.calibrated : s_.nominal;
    const double scale = s_.noise_scale * std::max(1, without.fit.rows);
    r_.noise_scale = s_.noise_scale;
    r_.null_threshold = s_.null_gain;
    r_.mismatch = without.fit.chi2 / scale;
    r_.remaining = s_.best.fit.chi2 / scale;
    const VectorXd energy = Energy(s_.missing, data_.n).cwiseQuotient(scales_.torque.cwiseAbs2());
    r_.joint_share = energy / std::max(1e-300, energy.sum());
    r_.plant = *s_.best.plant;
    r_.values = s_.best.fit.values;
    r_.units.clear();
    for (const std::string& j : r_.joints) {
      const auto& joint = nominal_.model().joint(nominal_.model().FindJoint(j));
      r_.units.push_back(joint.is_revolute() ? "rad" : "m");
    }
  }

  void Verdict() {
    std::set<std::string> ids;
    beyond_ = Beyond(nominal_, s_.best.specs);
    for (const EffectSpec& e : beyond_) {
      if (!OfStillJoints(e)) ids.insert(e.id);
    }
    // With a measured effort χ² cannot reach 1: most of the misfit must be explained.
    const bool most_left = s_.measured.active ? Remains() : MostIsLeft();
    const bool some_left = !s_.measured.active && !ids.empty() && Inconsistent();
    const bool unnamed = std::ranges::any_of(ids, IsUnnamed);
    for (const std::string& id : ids) {
      if (!PartOfField(id)) r_.findings.push_back(FindingOf(id));
    }
    if (most_left || some_left || unnamed) {
      r_.verdict = "unexplained";
      some_left_ = !most_left && !unnamed;
      if (!unnamed) AddUnknown();
      if (some_left_ && s_.best.base) AddParameters(Confidence(OddsOfParameters()));
      return;
    }
    if (ids.empty()) {
      const double odds = s_.calibrated.score - s_.nominal.score - s_.threshold;
      r_.verdict = odds > 0 ? "parameters_only" : "no_mismatch";
      if (odds > 0) AddParameters(Confidence(odds));
      return;
    }
    r_.verdict = "unmodelled_physics";
    if (s_.best.base) AddParameters(Confidence(OddsOfParameters()));  // a side remark
  }

  // Whether χ² exceeds its value under the model itself (own_chi2.h; one-sided test at 1 %), and the excess
  // is more than half of that of the model without effects. An excess of errors below a twentieth of the
  // noise does not count where the findings explain ten times as much or there are none.
  bool MostIsLeft() const {
    const double scatter = std::sqrt(4.0 * s_.best.fit.rows) * s_.noise_scale;
    if (s_.best.fit.chi2 < s_.own_chi2 + kZ99OneSided * scatter) return false;
    const double explained = s_.nominal.fit.chi2 - s_.best.fit.chi2;
    const bool little = beyond_.empty() || s_.own_chi2 < kLittle * explained;
    if (s_.best.fit.chi2 < kExplained * s_.own_chi2 && little) return false;
    const double excess = r_.mismatch - 1.0, left = r_.remaining - 1.0;
    return left > 0.5 * excess;
  }

  // Whether the best model, whatever it explains, is inconsistent with the noise.
  bool Inconsistent() const { return s_.best.fit.chi2 > kConsistent * s_.own_chi2; }

  // Joints that never moved appear only in the notes.
  bool Silent(const std::string& joint) const {
    const int j = nominal_.model().FindJoint(joint);
    return j >= 0 && scales_.still[j];
  }
  bool OfStillJoints(const EffectSpec& e) const {
    return !e.joints.empty() &&
           std::ranges::all_of(e.joints, [&](const std::string& j) { return Silent(j); });
  }

  // Whether the effect merely corrects the coarse nodes of an unnamed force over the same joint's position.
  bool PartOfField(const std::string& id) const {
    if (s_.beside_any_force) return false;
    const auto& all = s_.best.specs;
    const auto in_field = [&](const EffectSpec& part) {
      const std::string& joint = part.joints[0];
      return FieldVariable(all, joint) == "position" || std::ranges::any_of(all, [&](const EffectSpec& e) {
               return IsSurface(e.id) && Contains({e}, e.id, joint);
             });
    };
    return IsOfPosition(id) && !IsUnnamed(id) &&
           std::ranges::all_of(all, [&](const EffectSpec& e) { return e.id != id || in_field(e); });
  }

  // Log evidence of free base parameters given the same effects.
  double OddsOfParameters() const {
    for (const Candidate& c : s_.tried) {
      if (!c.base && KeyOf(c.specs) == KeyOf(s_.best.specs)) return s_.best.score - c.score;
    }
    return s_.calibrated.score - s_.nominal.score;
  }

  // With a measured effort: whether the residual is structured and more than what the effects explain, or,
  // without effects, a large part of the effort.
  bool Remains() const {
    const auto& m = s_.measured;
    if (s_.best.specs.empty() && m.effort_share.maxCoeff() > kMuchOfTheEffort) return true;
    return m.explained < 0.5 && m.structured.size() > 0 && m.structured.maxCoeff() > 0.3;
  }

  static double Confidence(double nats) {
    // The likelihood is approximate: half of each nat counts.
    const double p = 1.0 / (1.0 + std::exp(-std::clamp(0.5 * nats, -30.0, 30.0)));
    return std::clamp(p, 0.02, 0.98);
  }

  Finding FindingOf(const std::string& id) {
    Finding f;
    f.effect = IsUnnamed(id) ? Unnamed() : id;
    f.joints = JointsOf(beyond_, id, r_.joints);
    std::erase_if(f.joints, [&](const std::string& j) { return Silent(j); });
    f.equation = effects::Equation(SpecOf(id, "*"));
    f.shows_over = effects::ShowsOver(SpecOf(id, "*"));
    const auto gain = s_.measured.gain.find(id);
    f.confidence =
        Confidence(gain != s_.measured.gain.end() ? gain->second : s_.best.score - BestWithout(s_, id));
    // Models with catalogue effects that fit better were rejected before: they are no reason for doubt.
    // Effects that hold beside any force were compared with that force alone.
    if ((IsUnnamed(id) && !s_.measured.active) || s_.beside_any_force) f.confidence = 1.0;
    FillParameters(id, &f);
    f.statement = StatementOf(id, f);
    FillClass(id, &f);
    FillWhere(id, &f);
    return f;
  }

  // The effect of that id on the owner; for "*" the first.
  const EffectSpec& SpecOf(const std::string& id, const std::string& owner) const {
    return *std::ranges::find_if(s_.best.specs, [&](const EffectSpec& e) {
      return e.id == id &&
             (owner == "*" || e.joints.empty() || std::ranges::find(e.joints, owner) != e.joints.end());
    });
  }

  void FillParameters(const std::string& id, Finding* f) {
    for (size_t k = 0; k < s_.best.parameters.size(); ++k) {
      const sim::Parameter& p = s_.best.Free(k);
      // The 36 weights of a surface are in model.json only.
      const bool of_it =
          p.owner == "*" || f->joints.empty() || std::ranges::find(f->joints, p.owner) != f->joints.end();
      if (p.effect != id || !of_it || IsSurface(id) || Silent(p.owner)) continue;
      ParameterEstimate e{p.owner, p.field, p.unit, s_.best.fit.theta[k], s_.best.fit.stddev[k]};
      f->parameters.push_back(e);
    }
    // diagnosis.json has a positive tilt and an azimuth within ±π.
    if (id == effects::EffectOf(effects::Role::kGravity).id && f->parameters.size() == 2) {
      double &tilt = f->parameters[0].value, &azimuth = f->parameters[1].value;
      if (tilt < 0) tilt = -tilt, azimuth += M_PI;
      azimuth = std::remainder(azimuth, 2 * M_PI);
    }
  }

  // A sentence per joint by the effect's own template, or ranges over many joints.
  std::string StatementOf(const std::string& id, const Finding& f) const {
    std::map<std::string, std::map<std::string, double>> by_owner;
    for (const ParameterEstimate& p : f.parameters) by_owner[p.owner][p.name] = p.value;
    if (by_owner.size() >= kListedJoints && by_owner.count("*") == 0) return StatementOfMany(id, f);
    std::string text;
    for (const auto& [owner, values] : by_owner) {
      const int joint = nominal_.model().FindJoint(owner);
      const bool prismatic = joint >= 0 && !nominal_.model().joint(joint).is_revolute();
      const std::string name = owner == "*" && !f.joints.empty() ? Listed(f.joints)
                               : owner == "*"                    ? "the robot"
                                                                 : owner;
      text += (text.empty() ? "" : " ") + effects::Sentence(SpecOf(id, owner), name, prismatic, values);
    }
    if (IsUnnamed(f.effect) && f.parameters.empty())
      return effects::Sentence(SpecOf(id, "*"), Listed(f.joints), false, {});
    return text.empty() ? effects::FindEffect(id)->title + "." : text;
  }

  // "Coulomb friction that the model does not have on all 6 joints: coulomb 0.12 to 1.94 N*m."
  std::string StatementOfMany(const std::string& id, const Finding& f) const {
    std::vector<std::string> ranges;
    for (const auto& info : effects::FindEffect(id)->parameters) {
      double least = effects::kInf, most = -effects::kInf;
      std::string unit;
      for (const ParameterEstimate& p : f.parameters) {
        if (p.name == info.name)
          least = std::min(least, p.value), most = std::max(most, p.value), unit = p.unit;
      }
      if (least > most) continue;
      const std::string from = Number(least), to = Number(most);
      ranges.push_back(info.name + " " + (from == to ? from : from + " to " + to) +
                       (unit == "-" ? "" : " " + unit));
    }
    const std::string count = std::to_string(f.joints.size());
    return effects::FindEffect(id)->title + " that the model does not have on " +
           (f.joints.size() == r_.joints.size() ? "all " + count
                                                : count + " of " + std::to_string(r_.joints.size())) +
           " joints: " + Listed(ranges) + ".";
  }

  void FillClass(const std::string& id, Finding* f) {
    f->effect_class.push_back(f->effect);
    if (s_.beside_any_force) return;  // scores with a grid of weights in the force's place compare nothing
    for (const auto& [effect, c] : RivalsOf(s_, id)) {
      Alternative a;
      a.effect = effect;
      a.joints = JointsOf(c->specs, effect, r_.joints);
      // Without held-out recordings, or with a measured effort, whose scores are cross-validated: the scores.
      const bool predicted = c->held_out && s_.best.held_out;
      const double fitted = c->score - s_.best.score - (c->base && !s_.best.base ? s_.beside : 0.0);
      a.evidence = predicted ? *c->held_out - *s_.best.held_out : fitted;
      a.separable = (predicted ? fitted + a.evidence : fitted) < -kSeparable;
      a.experiment = ExperimentFor(id, effect, f->joints);
      if (SameUnderAShiftedClock(id, effect) && OneClock(id)) {
        a.separable = a.by_motion = false;
        a.experiment = kClockExperiment;
      }
      if (!a.separable) f->effect_class.push_back(effect);
      f->alternatives.push_back(a);
    }
    AddScaledOther(id, f);
  }

  // With free base parameters all efforts may be scaled: a gain of one of two drives equals its inverse on
  // the other.
  void AddScaledOther(const std::string& id, Finding* f) const {
    if (!s_.best.base || !effects::ScalesEffort(id) || f->joints.size() != 1) return;
    const int other = data_.OtherOfTwo(nominal_.model().FindJoint(f->joints[0]));
    if (other < 0) return;
    Alternative a;
    a.effect = id;
    a.joints = {r_.joints[other]};
    a.separable = a.by_motion = false;
    a.experiment = kScaleExperiment;
    f->alternatives.push_back(a);
  }

  static bool SameUnderAShiftedClock(const std::string& a, const std::string& b) {
    return a != b && effects::IsIn(effects::Slot::kDelay, a) && effects::IsIn(effects::Slot::kDelay, b);
  }

  // Whether the delays of all joints are equal: then delays of sensors and of commands differ by a shift of
  // the clock only.
  bool OneClock(const std::string& id) const {
    double least = 1e300, most = 0, error = 0;
    int joints = 0;
    for (size_t k = 0; k < s_.best.parameters.size(); ++k) {
      const sim::Parameter& p = s_.best.Free(k);
      if (p.effect != id || p.field != "delay") continue;
      const double delay = s_.best.fit.theta[k];
      least = std::min(least, delay), most = std::max(most, delay);
      error = std::max(error, s_.best.fit.stddev[k]);
      ++joints;
    }
    return joints == data_.n &&
           most - least <= std::max(kZ99TwoSided * std::sqrt(2.0) * error, kSameDelay * most);
  }

  // The interval of a joint's positions in which an unnamed force differs from zero by more than three of its
  // standard deviations and a seventh of its peak; the whole motion where it does so nowhere.
  Region FieldRegion(const std::string& id, const std::string& joint) const {
    const int j = nominal_.model().FindJoint(joint);
    const double low = scales_.low[j], high = scales_.high[j];
    Region region{"position." + joint, low, high};
    const bool pair = IsSurface(id);
    bool own = true;  // the joint that feels the force, not the one it sees
    for (const EffectSpec& e : s_.best.specs) own = own && !(pair && e.id == id && e.joints[0] == joint);
    const auto mine = [&](const sim::Parameter& p) {
      return p.effect == id && p.field[0] == 'w' && (pair || p.owner == joint);
    };
    double peak = 0;
    for (size_t k = 0; k < s_.best.parameters.size(); ++k) {
      if (mine(s_.best.Free(k))) peak = std::max(peak, std::abs(s_.best.fit.theta[k]));
    }
    const double spacing = (high - low) / (pair ? 5 : 7);
    double first = high, last = low;
    for (size_t k = 0; k < s_.best.parameters.size(); ++k) {
      const sim::Parameter& p = s_.best.Free(k);
      const double size = std::abs(s_.best.fit.theta[k]);
      if (!mine(p) || size < peak / 7 || size < 3 * s_.best.fit.stddev[k]) continue;
      const double node = low + spacing * (p.field[pair && !own ? 2 : 1] - '0');
      first = std::min(first, node - spacing), last = std::max(last, node + spacing);
    }
    if (first < last) region.low = std::max(low, first), region.high = std::min(high, last);
    return region;
  }

  void FillWhere(const std::string& id, Finding* f) {
    const auto& names = r_.joints;
    const auto on = [&](const std::string& joint) {
      return f->joints.empty() || std::ranges::find(f->joints, joint) != f->joints.end();
    };
    double share = 0;
    for (size_t j = 0; j < names.size(); ++j) share += on(names[j]) ? r_.joint_share[j] : 0.0;
    f->share_of_mismatch = std::clamp(share, 0.0, 1.0);
    f->summary = f->joints.empty() ? "all joints" : Listed(f->joints);
    for (const std::string& joint : f->joints) {
      const int j = nominal_.model().FindJoint(joint);
      const Variable over = effects::ShowsOver(SpecOf(id, joint));
      if (over == Variable::kTime) {
        for (const ParameterEstimate& p : f->parameters) {
          if (p.name == "start") f->regions.push_back({"time", p.value, p.value});
          if (p.name == "end" && !f->regions.empty()) f->regions.back().high = p.value;
        }
        break;
      }
      if (over == Variable::kPosition) {
        f->regions.push_back(IsUnnamed(id) ? FieldRegion(id, joint)
                                           : Region{"position." + joint, scales_.low[j], scales_.high[j]});
      } else if (over == Variable::kVelocity) {
        f->regions.push_back({"velocity." + joint, -scales_.top_speed[j], scales_.top_speed[j]});
      }
    }
    // The windows with most of it.
    std::vector<std::pair<double, size_t>> loud;
    for (size_t w = 0; w < s_.missing.force.size(); ++w) {
      double sum = 0;
      for (size_t j = 0; j < names.size(); ++j) {
        if (on(names[j])) sum += (s_.missing.force[w].row(j) / scales_.torque[j]).squaredNorm();
      }
      loud.push_back({sum, w});
    }
    std::sort(loud.rbegin(), loud.rend());
    for (size_t i = 0; i < std::min<size_t>(4, loud.size()); ++i) {
      const NodeWindow& w = data_.windows[loud[i].second];
      const recordings::Recording& rec = *data_.recordings[w.recording].recording;
      f->windows.push_back({rec.name, w.t.front() + rec.time_offset, w.t.back() + rec.time_offset});
    }
    if (f->windows.empty()) {
      f->summary += ", most in no window";
    } else {
      const TimeWindow& most = f->windows[0];
      f->summary += ", most in " + most.recording + " around " + Number(0.5 * (most.start + most.end)) + " s";
    }
  }

  // The joint of an unexplained force, and a second one if that adds enough: by the log evidence of a free
  // force on these joints, not by its size, since a torque error of one joint moves all, and light ones most.
  std::vector<int> JointsOfTheRest() const {
    const MatrixXd& evidence = s_.remaining.evidence;
    MatrixXd worth = evidence;
    if (evidence.size() == 0) {
      const VectorXd energy = Energy(s_.remaining, data_.n).cwiseQuotient(scales_.torque.cwiseAbs2());
      worth = energy.replicate(1, data_.n) + energy.transpose().replicate(data_.n, 1);
      worth.diagonal() = energy;
    }
    for (const int j : data_.prescribed)
      worth.row(j).setConstant(-effects::kInf), worth.col(j).setConstant(-effects::kInf);
    int first = 0, second = 0;
    worth.diagonal().maxCoeff(&first);
    worth.row(first).maxCoeff(&second);
    if (worth(first, second) - worth(first, first) <= kSecond * std::max(0.0, worth(first, first)))
      second = first;
    std::vector<int> out = {std::min(first, second)};
    if (second != first) out.push_back(std::max(first, second));
    return out;
  }

  void AddUnknown() {
    Finding f;
    f.effect = Unnamed();
    f.confidence = 1.0;
    f.modelled = false;
    f.equation = "tau = f(q, dq, t)";
    f.effect_class = {Unnamed()};
    for (const int j : JointsOfTheRest()) {
      f.joints.push_back(r_.joints[j]);
      f.regions.push_back({"position." + r_.joints[j], scales_.low[j], scales_.high[j]});
    }
    f.summary = Listed(f.joints) + ": a force that no named effect explains";
    f.share_of_mismatch = std::min(1.0, (r_.remaining - 1) / std::max(1e-9, r_.mismatch - 1));
    f.statement = "Something acts on " + Listed(f.joints) +
                  " that no named effect explains: " + Number(100 * f.share_of_mismatch) +
                  " % of the mismatch remains after the best of them.";
    // Names that explain most come before the rest.
    r_.findings.insert(some_left_ ? r_.findings.end() : r_.findings.begin(), f);
  }

  void AddParameters(double confidence) {
    Finding f;
    f.effect = "parameters_only";
    f.confidence = confidence;
    f.effect_class = {"parameters_only"};
    if (data_.n == 1) f.joints = r_.joints;  // where it shows
    f.equation = "M(q)*ddq + h(q, dq) = u with other masses, centres of mass, inertias";
    const Candidate& c = s_.best;
    int moved = 0;
    for (size_t k = 0; k < c.parameters.size(); ++k) {
      const sim::Parameter& p = c.Free(k);
      // A rotor inertia that the URDF cannot declare is not an error of it.
      if (p.kind == sim::ParameterKind::kEffect || p.kind == sim::ParameterKind::kArmature) continue;
      const double value = c.fit.theta[k], sd = c.fit.stddev[k];
      f.parameters.push_back({p.owner, p.field, p.unit, value, sd});
      moved += std::abs(value - p.nominal) > 3 * sd;
    }
    const std::string by_how_much =
        moved == 0 ? "which shows in all of them together, in none alone by three standard deviations"
                   : std::to_string(moved) + (moved == 1 ? " parameter" : " parameters") +
                         " by more than three standard deviations";
    f.statement = std::string(r_.findings.empty() ? "The structure of the model is right; masses"
                                                  : "Beside this, masses") +
                  ", centres of mass or inertias differ from the URDF (" + by_how_much + ").";
    f.summary = "all poses and motions";
    f.share_of_mismatch = 1.0;
    r_.findings.push_back(f);
  }

  const SearchResult& s_;
  const FitData& data_;
  const sim::Plant& nominal_;
  const MotionScales& scales_;
  DiagnosisResult& r_;
  std::vector<EffectSpec> beyond_;  // effects that the given model has not
  bool some_left_ = false;          // unexplained, though the findings explain most
};

}  // namespace

void Conclude(const SearchResult& search, const FitSetting& setting, DiagnosisResult* result) {
  FindingsBuilder(search, setting, result).Run();
}

}  // namespace rg::diagnosis
