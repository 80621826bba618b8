#include "services/diagnosis/search/trials.h"

#include <algorithm>
#include <functional>
#include <map>
#include <set>

#include "common/effects/effect_catalog.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/hypotheses/field_starts.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/hypotheses/push_starts.h"

namespace rg::diagnosis {

using effects::EffectSpec, effects::LawOf, effects::Regressor;

namespace {

constexpr size_t kNearest = 2;        // springs, and play, that are tried of either place of the sensor
constexpr size_t kSprungJoints = 2;   // on which the screen sees a spring, that are tried
constexpr size_t kSurfaces = 2;       // of one normal and point each
constexpr size_t kRotors = 2;         // the largest, behind which a spring is tried
constexpr size_t kFewJoints = 3;      // on which springs and play are looked for in any case
constexpr double kLeastForce = 0.05;  // of the evidence for a force on the joint that lacks most
constexpr double kLeastRotor = 0.01;  // of the joint's inertia, before which play is tried
constexpr size_t kMostSets = 6;       // of joints, and as many pairs of effects
constexpr double kHardlyLess = 0.9;   // of what a part of it leaves

const effects::EffectInfo& Rotor() { return LawOf(Regressor::kAcceleration); }

// The first start of each.
TrialSpecs Together(const std::vector<Scored>& parts, const sim::Plant& nominal, const MotionScales& scales) {
  TrialSpecs out;
  for (const Scored& h : parts) {
    const TrialSpecs part = SpecsFor(h, nominal, scales).front();
    out.insert(out.end(), part.begin(), part.end());
  }
  return out;
}

class TrialBuilder {
 public:
  TrialBuilder(const FitData& data, const sim::Plant& nominal, const MotionScales& scales,
               const Candidate& from, const ScreenResult& screened,
               const std::function<const MissingForce*()>& force, const diagnosis::Nearest& nearest)
      : data_(data),
        nominal_(nominal),
        scales_(scales),
        from_(from),
        screened_(screened),
        force_(force),
        nearest_(nearest) {}

  std::vector<TrialSpecs> Run(double least_gain) {
    Singles(least_gain);
    Sets(screened_.sets, least_gain);
    Sets(screened_.pairs, least_gain);
    const std::string& held = effects::EffectOf(effects::Role::kBodyInertia).id;
    if (!from_.base && data_.n > 1 && !Has(held)) Push(BodyStarts(held, nominal_, scales_));
    const bool promised = least_gain > 1.0;
    // No screen promises what pushes the robot from outside.
    if (!promised || HasHiddenStates(from_)) FromOutside();
    if (promised) {
      Nearest(effects::Spring().id, SprungJoints(least_gain));
      return std::move(out_);
    }
    for (const std::string& id : {effects::SwingingMass().id, effects::SoftMount().id}) {
      if (!Has(id) && (data_.n <= 2 || !from_.base || !from_.specs.empty()))
        Push(BodyStarts(id, nominal_, scales_));
    }
    Transmissions(JointsWithForce());  // last, for they cost most
    return std::move(out_);
  }

  std::vector<TrialSpecs> OnJoint(int joint) {
    Singles(1.0);
    Sets(screened_.sets, 1.0);
    Sets(screened_.pairs, 1.0);
    FromOutside();
    Transmissions({joint});
    return std::move(out_);
  }

  std::vector<TrialSpecs> OfTransmission() {
    Transmissions(JointsWithForce());
    return std::move(out_);
  }

 private:
  void Push(const std::vector<TrialSpecs>& starts) { out_.insert(out_.end(), starts.begin(), starts.end()); }

  bool Has(const std::string& id) const { return HasKind(from_.specs, id); }

  bool Known(const Scored& h) const { return AlreadyIn(from_.specs, h, nominal_); }

  void Singles(double least_gain) {
    size_t taken = 0, springs = 0, surfaces = 0;
    for (const Scored& h : screened_.hypotheses) {
      if (h.gain < least_gain || taken >= (from_.base ? 10u : 16u) || Known(h)) continue;
      if (h.effect == effects::Surface().id && surfaces++ >= kSurfaces) continue;
      ++taken;
      const bool sprung = effects::IsIn(effects::Slot::kTransmission, h.effect);
      if (!sprung || springs++ < kSprungJoints) Push(SpecsFor(sprung ? OfMotor(h) : h, nominal_, scales_));
    }
  }

  void Sets(const std::vector<Combination>& sets, double least_gain) {
    size_t count = 0;
    for (const Combination& set : sets) {
      if (set.gain < least_gain || count == kMostSets) break;
      if (std::ranges::any_of(set.parts, [&](const Scored& h) { return Known(h); })) continue;
      out_.push_back(Together(set.parts, nominal_, scales_));
      ++count;
    }
  }

  void FromOutside() {
    if (!from_.fit.ok || Has(effects::Push().id)) return;
    // What one force over two positions leaves tells what a mass that swings would have to better.
    if (from_.specs.empty() && !from_.base && data_.n > 1) {
      if (const auto surface = FieldPairStart({data_, nominal_, scales_}, *force_())) Push({{*surface}});
    }
    Push(PushStarts(data_, nominal_, *force_()));
  }

  // On which a motor behind a spring or play may explain something: what it does is a force there. Of those
  // that lack least, more than a few are left out.
  std::vector<int> JointsWithForce() {
    std::vector<int> out;
    for (int joint = 0; joint < data_.n; ++joint) {
      if (MayHaveMotor(joint)) out.push_back(joint);
    }
    if (out.size() <= kFewJoints || !from_.fit.ok) return out;
    const Eigen::VectorXd evidence = force_()->evidence.diagonal();
    std::ranges::stable_sort(out, std::greater{}, [&](int j) { return evidence[j]; });
    const double least = kLeastForce * evidence[out.front()];
    if (!(least > 0)) return out;
    while (out.size() > kFewJoints && evidence[out.back()] < least) out.pop_back();
    return out;
  }

  // On which the screen sees a spring.
  std::vector<int> SprungJoints(double least_gain) const {
    std::vector<int> out;
    for (const Scored& h : screened_.hypotheses) {
      const bool sprung = effects::IsIn(effects::Slot::kTransmission, h.effect);
      if (sprung && h.gain >= least_gain && !Known(h) && out.size() < kSprungJoints &&
          std::ranges::count(out, h.joints.front()) == 0)
        out.push_back(h.joints.front());
    }
    return out;
  }

  void Transmissions(const std::vector<int>& joints) {
    for (const std::string& id : {effects::Spring().id, effects::Play().id}) Nearest(id, joints);
  }

  // A motor behind a spring or play is hidden, and no screen of forces far from a fit says on which of
  // several joints: a look from all starts on all of `joints` does.
  void Nearest(const std::string& id, const std::vector<int>& joints) {
    for (const char* sensor : {"link", "motor"}) {
      std::vector<std::vector<TrialSpecs>> of_joints;
      size_t most = 0;
      for (const int joint : joints) {
        if (!MayHaveMotor(joint)) continue;
        of_joints.push_back(TransmissionStarts(id, sensor, joint, nominal_, scales_, MotorOn(joint)));
        AsLateAsOthers(joint, &of_joints.back());
        most = std::max(most, of_joints.back().size());
      }
      // In turns: the look may end before it has seen all.
      std::vector<TrialSpecs> starts;
      for (size_t i = 0; i < most; ++i) {
        for (const auto& own : of_joints) {
          if (i < own.size()) starts.push_back(own[i]);
        }
      }
      Push(nearest_(starts, kNearest));
    }
  }

  // What a motor behind a spring or play does hides how late its drive is: as late as most others, where
  // these are late.
  void AsLateAsOthers(int joint, std::vector<TrialSpecs>* starts) const {
    const std::string& name = nominal_.joint_names()[joint];
    std::map<std::string, std::vector<EffectSpec>> late;
    for (const EffectSpec& s : from_.fit.ok ? Refreshed(from_) : TrialSpecs{}) {
      if (!IsLateDrive(s.id) || s.joints.size() != 1) continue;
      if (s.joints[0] == name) return;
      late[s.id].push_back(s);
    }
    for (auto& [id, of_others] : late) {
      if (2 * static_cast<int>(of_others.size()) < data_.judged()) continue;
      const auto seconds = [](const EffectSpec& s) { return s.values.begin()->second.begin()->second; };
      const auto middle = of_others.begin() + static_cast<long>(of_others.size() / 2);
      std::nth_element(of_others.begin(), middle, of_others.end(),
                       [&](const EffectSpec& a, const EffectSpec& b) { return seconds(a) < seconds(b); });
      EffectSpec own = effects::MakeSpec(id, {name}, middle->values.begin()->second);
      for (TrialSpecs& start : *starts) start.push_back(own);
    }
  }

  bool MayHaveMotor(int joint) const {
    const std::string& name = nominal_.joint_names()[joint];
    return nominal_.Takes(effects::Spring().id, joint) && data_.Judged(joint) &&
           !Contains(from_.specs, effects::Spring().id, name) &&
           !Contains(from_.specs, effects::Play().id, name);
  }

  // Along the motion of a model without it a spring shows at the frequency at which motor and link swing
  // against each other, and hardly with the motor's inertia, of which the model's rotor tells: with that, and
  // at the frequency of the motor alone, the link held.
  Scored OfMotor(Scored spring) const {
    const int joint = spring.joints.front();
    const double motor = MotorOn(joint), link = scales_.inertia[joint];
    if (!(motor > kLeastRotor * link)) return spring;
    spring.coefficients[0] = motor, spring.shape *= std::sqrt(link / (link + motor));
    return spring;
  }

  // The motor's inertia below its resonance: what a rotor holds already, or the screen takes for one.
  double MotorOn(int joint) const {
    double inertia = RotorOf(nominal_.joint_names()[joint]);
    for (const Scored& h : screened_.hypotheses) {
      if (h.effect == Rotor().id && h.joints == std::vector<int>{joint}) inertia += h.coefficients[0];
    }
    return inertia;
  }

  double RotorOf(const std::string& joint) const {
    const int at =
        from_.plant->parameters().Find(Rotor().id + "." + joint + "." + Rotor().parameters.front().name);
    return at >= 0 && from_.fit.ok ? from_.fit.values[at] : 0.0;
  }

  const FitData& data_;
  const sim::Plant& nominal_;
  const MotionScales& scales_;
  const Candidate& from_;
  const ScreenResult& screened_;
  const std::function<const MissingForce*()>& force_;
  const diagnosis::Nearest& nearest_;
  std::vector<TrialSpecs> out_;
};

}  // namespace

std::vector<TrialSpecs> Trials(const FitData& data, const sim::Plant& nominal, const MotionScales& scales,
                               const Candidate& from, const ScreenResult& screened, double least_gain,
                               const std::function<const MissingForce*()>& force, const Nearest& nearest) {
  return TrialBuilder(data, nominal, scales, from, screened, force, nearest).Run(least_gain);
}

std::vector<TrialSpecs> TransmissionTrials(const FitData& data, const sim::Plant& nominal,
                                           const MotionScales& scales, const Candidate& from,
                                           const ScreenResult& screened,
                                           const std::function<const MissingForce*()>& force,
                                           const Nearest& nearest) {
  return TrialBuilder(data, nominal, scales, from, screened, force, nearest).OfTransmission();
}

std::vector<TrialSpecs> TrialsOnJoint(int joint, const FitData& data, const sim::Plant& nominal,
                                      const MotionScales& scales, const Candidate& from,
                                      const ScreenResult& screened,
                                      const std::function<const MissingForce*()>& force,
                                      const Nearest& nearest) {
  // A coupling's force is on the second joint.
  const auto elsewhere = [&](const Scored& h) {
    if (h.effect == LawOf(Regressor::kOtherEffort).id) return h.joints.back() != joint;
    return h.joints.empty() || std::ranges::any_of(h.joints, [&](int j) { return j != joint; });
  };
  ScreenResult own = screened;
  std::erase_if(own.hypotheses, elsewhere);
  for (auto* list : {&own.sets, &own.pairs})
    std::erase_if(*list, [&](const Combination& c) { return std::ranges::any_of(c.parts, elsewhere); });
  return TrialBuilder(data, nominal, scales, from, own, force, nearest).OnJoint(joint);
}

std::vector<TrialSpecs> Promised(const Candidate& from, const ScreenResult& screened,
                                 const sim::Plant& nominal, const MotionScales& scales, bool holds,
                                 double needed, size_t count) {
  std::vector<std::pair<double, TrialSpecs>> promised;
  const auto add = [&](const std::vector<Scored>& parts, double gain) {
    for (const Scored& h : parts) {
      const bool known = h.joints.size() == 1 && HasKind(from.specs, h.effect);
      const bool sprung =
          effects::IsIn(effects::Slot::kTransmission, h.effect);  // starts of it are looked at
      if (IsUnnamed(h.effect) || sprung || AlreadyIn(from.specs, h, nominal) || (!holds && !known)) return;
    }
    TrialSpecs start = Together(parts, nominal, scales);
    // In the place of another law on its joint it would not bring what it does beside it.
    const bool beside = Joined(from.specs, start).size() == from.specs.size() + start.size();
    if (beside && gain > needed) promised.push_back({gain, std::move(start)});
  };
  const double before = StructurePrior(from.specs, false);
  for (const Scored& h : screened.hypotheses) {
    if (h.gain <= needed) break;
    const TrialSpecs with = Joined(from.specs, Together({h}, nominal, scales));
    add({h}, h.gain - (StructurePrior(with, false) - before));
  }
  for (const auto* list : {&screened.sets, &screened.pairs}) {
    for (const Combination& c : *list) add(c.parts, c.gain);
  }
  std::ranges::stable_sort(promised, [](const auto& a, const auto& b) { return a.first > b.first; });
  std::vector<TrialSpecs> out;
  std::set<std::string> seen;
  for (auto& [gain, start] : promised) {
    if (out.size() < count && seen.insert(KeyOf(start)).second) out.push_back(std::move(start));
  }
  return out;
}

std::vector<std::shared_ptr<const Candidate>> BestOf(std::vector<RankedTrial> trials,
                                                     std::vector<RankedTrial> apart, size_t count) {
  std::vector<std::shared_ptr<const Candidate>> out;
  std::set<std::string> seen;
  std::vector<RankedTrial>* lists[] = {&trials, &apart};
  for (std::vector<RankedTrial>* list : lists) {
    std::ranges::stable_sort(*list,
                             [](const RankedTrial& a, const RankedTrial& b) { return a.left < b.left; });
    std::erase_if(*list, [&](const RankedTrial& t) { return !seen.insert(KeyOf(t.fitted->specs)).second; });
    std::vector<RankedTrial> worth;
    for (const RankedTrial& t : *list) {
      const bool hardly = std::ranges::any_of(*list, [&](const RankedTrial& part) {
        return part.fitted->specs.size() < t.fitted->specs.size() && t.excess > kHardlyLess * part.excess &&
               IsPart(part.fitted->specs, t.fitted->specs);
      });
      if (!hardly) worth.push_back(t);
    }
    *list = std::move(worth);
  }
  for (size_t i = 0; i < std::max(trials.size(), apart.size()); ++i) {
    for (const std::vector<RankedTrial>* list : lists) {
      if (i < list->size() && out.size() < count) out.push_back((*list)[i].fitted);
    }
  }
  return out;
}

std::vector<TrialSpecs> Exchanges(const TrialSpecs& specs, const std::string& id, const TrialSpecs& held,
                                  const sim::Plant& nominal, const MotionScales& scales) {
  const auto is_one = [&](const EffectSpec& s) { return s.id == id && !IsPart({s}, held); };
  std::vector<TrialSpecs> out;
  if (!std::ranges::any_of(specs, is_one)) return out;
  for (const std::string& sibling : SiblingsOf(id)) {
    const bool taken = std::ranges::all_of(specs, [&](const EffectSpec& s) {
      return !is_one(s) || nominal.Takes(sibling, nominal.model().FindJoint(s.joints[0]));
    });
    if (sibling == id || !taken) continue;
    TrialSpecs other;
    for (const EffectSpec& s : specs) other.push_back(is_one(s) ? Exchanged(s, sibling, nominal, scales) : s);
    out.push_back(std::move(other));
  }
  return out;
}

std::vector<TrialSpecs> SpringsBehind(const Candidate& before, const Candidate& model,
                                      const sim::Plant& nominal, const MotionScales& scales) {
  std::vector<TrialSpecs> out;
  if (!model.fit.ok || FreshKinds(before, model).count(Rotor().id) == 0) return out;
  std::vector<std::pair<double, size_t>> rotors;  // strength, place
  for (size_t i = 0; i < model.specs.size(); ++i) {
    if (model.specs[i].id == Rotor().id && model.specs[i].joints.size() == 1)
      rotors.push_back({Strength(model, i), i});
  }
  std::ranges::stable_sort(rotors, [](const auto& a, const auto& b) { return a.first > b.first; });
  const std::vector<EffectSpec> specs = Refreshed(model);
  for (size_t i = 0; i < std::min(kRotors, rotors.size()); ++i) {
    const EffectSpec& rotor = specs[rotors[i].second];
    const int joint = nominal.model().FindJoint(rotor.joints[0]);
    const double armature = rotor.values.begin()->second.at(Rotor().parameters.front().name);
    for (const char* sensor : {"link", "motor"}) {
      for (TrialSpecs& start :
           TransmissionStarts(effects::Spring().id, sensor, joint, nominal, scales, armature))
        out.push_back(std::move(start));
      if (armature < kLeastRotor * SizeOf(scales, nominal, joint).inertia) continue;
      for (TrialSpecs& start : StartsBehind(effects::Play().id, sensor, joint, nominal, scales, armature))
        out.push_back(std::move(start));
    }
  }
  return out;
}

}  // namespace rg::diagnosis
