// Start values read from the record: what is hidden or lives in Cartesian space has no gradient from rest.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <utility>

#include "services/diagnosis/data/prepare_data.h"
#include "services/diagnosis/hypotheses/field_starts.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/hypotheses/push_starts.h"
#include "services/diagnosis/likelihood/some_windows.h"
#include "services/diagnosis/search/fit_requests.h"
#include "services/diagnosis/search/trials.h"
#include "services/sysid/sysid_on_set.h"
#include "tests/unit/diagnosis/simulated_set.h"

namespace rg::diagnosis {
namespace {

using effects::EffectSpec;
using effects::MakeSpec;

struct Case {
  recordings::RecordingSet set;
  sim::Plant nominal;
  FitData data;
  MotionScales scales;
  std::optional<MissingForce> missing = {};  // once asked for

  static std::unique_ptr<Case> Of(const std::string& robot, std::vector<EffectSpec> truth, uint64_t seed) {
    recordings::RecordingSet set = testing::MakeSet(robot, std::move(truth), seed, 3.0);
    auto nominal = sysid::NominalPlant(set);
    RG_CHECK(nominal.ok()) << nominal.status().ToString();
    auto out = std::make_unique<Case>(Case{std::move(set), *nominal, {}, {}});
    auto data = PrepareData(out->set, out->nominal, {});
    RG_CHECK(data.ok()) << data.status().ToString();
    out->data = *data;
    out->scales = ScalesOf(out->data, out->nominal);
    return out;
  }
  const MissingForce* Missing() {
    if (!missing) {
      const FitModel bare{nominal, nominal.parameters().Nominal(), {}};
      missing = EstimateMissingForce(data, bare, InitialStates(data, bare, {}), scales.torque, 0.05, {});
    }
    return &*missing;
  }
  FitResult FitOf(const std::vector<EffectSpec>& specs, int iterations = 6) const {
    auto plant = sim::Plant::Create(nominal.shared_model(), nominal.options(), specs);
    RG_CHECK(plant.ok()) << plant.status().ToString();
    return Fit(data, {*plant, plant->parameters().Nominal(), FreeParameters(*plant, scales, false)},
               {.iterations = iterations});
  }
};

double PerRow(const FitResult& fit) { return fit.chi2 / fit.rows; }

TEST(PlayHeldClosed, IsTwiceTheOffsetOfItsSensorWithTheRotorBehindIt) {
  const auto c = Case::Of("arm2", {}, 3);
  const EffectSpec offset = MakeSpec("encoder_offset", {"elbow"}, {{"offset", -0.004}}),
                   rotor = MakeSpec("rotor_inertia", {"elbow"}, {{"armature", 0.03}}),
                   other = MakeSpec("encoder_offset", {"shoulder"}, {{"offset", 0.01}});
  const auto play = PlayHeldClosed({offset, rotor, other}, offset, c->nominal, c->scales);
  ASSERT_EQ(KeyOf(play), "backlash[elbow ]sensor=motor encoder_offset[shoulder ] ");
  const auto& values = play.back().values.at("elbow");
  EXPECT_DOUBLE_EQ(values.at("gap"), 0.008);
  EXPECT_DOUBLE_EQ(values.at("motor_inertia"), 0.03);
  EXPECT_TRUE(PlayHeldClosed({rotor}, rotor, c->nominal, c->scales).empty());
  EXPECT_TRUE(PlayHeldClosed({offset, play.back()}, offset, c->nominal, c->scales).empty());
}

// Gravity keeps the gap on one side: all that shows is a sensor that reads off, and what little the gap lets
// through when the joint is thrown.
TEST(PlayHeldClosed, LeadsFromTheOffsetToTheTruth) {
  EffectSpec play = MakeSpec("backlash", {"shoulder"},
                             {{"gap", 0.02}, {"contact_stiffness", 4000}, {"motor_inertia", 0.1}});
  play.options["sensor"] = "motor";
  const auto c = Case::Of("arm2", {play}, 3);
  const std::vector<EffectSpec> start = {MakeSpec("encoder_offset", {"shoulder"}, {{"offset", 0.008}})};
  const auto closed = PlayHeldClosed(start, start[0], c->nominal, c->scales);
  ASSERT_FALSE(closed.empty());
  EXPECT_LT(PerRow(c->FitOf(closed, 12)), 0.5 * PerRow(c->FitOf(start, 12)));
}

TEST(RipplesAcrossLags, MoveToTheOtherSideWhereTheDriveLags) {
  const EffectSpec ripple = MakeSpec("torque_ripple", {"elbow"}, {{"amplitude", 0.1}}),
                   lag = MakeSpec("actuator_lag", {"elbow"}, {{"time_constant", 0.01}}),
                   elsewhere = MakeSpec("actuator_lag", {"shoulder"}, {{"time_constant", 0.01}});
  EXPECT_TRUE(RipplesAcrossLags({ripple, elsewhere}).empty());
  EXPECT_TRUE(RipplesAcrossLags({lag}).empty());
  const std::vector<EffectSpec> across = RipplesAcrossLags({ripple, lag});
  ASSERT_EQ(across.size(), 2u);
  EXPECT_EQ(across[0].options.at("acts_on"), "command");
  EXPECT_EQ(KeyOf(RipplesAcrossLags(across)), KeyOf({ripple, lag}));
}

TEST(PushStarts, FindsAForceInItsWindow) {
  const auto c = Case::Of("mico2",
                          {MakeSpec("external_disturbance", {},
                                    {{"start", 1.0}, {"end", 2.0}, {"force_x", 1.5}, {"force_z", -2.0}})},
                          6);
  const auto starts = PushStarts(c->data, c->nominal, *c->Missing());
  ASSERT_EQ(starts.size(), 1u);
  EffectSpec spec = starts[0][0];
  EXPECT_TRUE(spec.joints.empty());
  const auto& v = spec.values.begin()->second;
  EXPECT_NEAR(v.at("start"), 1.0, 0.26);
  EXPECT_NEAR(v.at("end"), 2.0, 0.26);
  EXPECT_NEAR(v.at("force_z"), -2.0, 0.6);
}

// A hump over the positions of two joints.
std::unique_ptr<Case> OverAHump() {
  std::map<std::string, double> surface = {
      {"low", -2.0}, {"high", 2.0}, {"other_low", -2.0}, {"other_high", 2.0}};
  for (int i = 0; i < 36; ++i) {
    const double x = i / 6 - 2.5, y = i % 6 - 2.0;
    surface["w" + std::to_string(i / 6) + std::to_string(i % 6)] = 0.8 * std::exp(-0.5 * (x * x + y * y));
  }
  return Case::Of("arm2", {MakeSpec("unknown_field_pair", {"shoulder", "elbow"}, surface)}, 7);
}

TEST(Trials, TryAForceOverTwoPositionsBeforeAnythingIsFound) {
  const auto c = OverAHump();
  const auto surfaces = [&](const TrialSpecs& found, bool base) {
    Candidate from;
    from.specs = found, from.base = base, from.fit.ok = true;
    from.plant = std::make_shared<const sim::Plant>(c->nominal);
    size_t count = 0;
    const Nearest none = [](const std::vector<TrialSpecs>&, size_t) { return std::vector<TrialSpecs>{}; };
    for (const TrialSpecs& trial : Trials(
             c->data, c->nominal, c->scales, from, {}, 1.0, [&] { return c->Missing(); }, none))
      count += HasKind(trial, "unknown_field_pair");
    return count;
  };
  EXPECT_EQ(surfaces({}, false), 1u);
  EXPECT_EQ(surfaces({}, true), 0u) << "free masses and a surface explain nearly anything";
  EXPECT_EQ(surfaces({MakeSpec("viscous_friction", {"elbow"}, {{"viscous", 0.1}})}, false), 0u);
}

TEST(FieldPairStart, FindsBothJointsOfASurfaceAndLeavesNothing) {
  const auto c = OverAHump();
  const auto start = FieldPairStart({c->data, c->nominal, c->scales}, *c->Missing());
  ASSERT_TRUE(start.has_value());
  EXPECT_EQ(start->joints, (std::vector<std::string>{"shoulder", "elbow"}));
  const FitResult fit = c->FitOf({*start});
  ASSERT_TRUE(fit.ok);
  const double bare = PerRow(c->FitOf({}));
  EXPECT_GT(bare, 3.0);
  EXPECT_LT(PerRow(fit) - 1, 0.05 * (bare - 1));
}

TEST(FieldStart, OfADragInOnePlaceFindsTheJointAndLeavesNothing) {
  for (const std::string joint : {"shoulder", "elbow"}) {
    EffectSpec rub =
        MakeSpec("unknown_field", {joint}, {{"low", -2.0}, {"high", 2.0}, {"w3", 1.0}, {"w4", 0.6}});
    rub.options["variable"] = "drag";
    const auto c = Case::Of("arm2", {rub}, 7);
    const auto start = FieldStart({c->data, c->nominal, c->scales}, *c->Missing(), "drag");
    ASSERT_TRUE(start.has_value());
    EXPECT_EQ(start->joints, std::vector<std::string>{joint});
    const FitResult fit = c->FitOf({*start});
    ASSERT_TRUE(fit.ok);
    const double bare = PerRow(c->FitOf({}));
    EXPECT_GT(bare, 3.0);
    EXPECT_LT(PerRow(fit) - 1, 0.05 * (bare - 1));
  }
}

// Of each place of the sensor the search fits the two that are nearest after one step.
TEST(TransmissionStarts, OneOfTheTwoNearestLeadsToTheTruth) {
  const std::string joint = "elbow";
  const std::map<std::string, double> spring = {{"stiffness", 40}, {"damping", 0.3}, {"motor_inertia", 0.03}};
  const std::map<std::string, double> play = {
      {"gap", 0.05}, {"contact_stiffness", 400}, {"contact_damping", 1.0}, {"motor_inertia", 0.03}};
  for (const auto& [effect, values] : {std::pair("joint_elasticity", spring), std::pair("backlash", play)}) {
    for (const std::string sensor : {"link", "motor"}) {
      EffectSpec truth = MakeSpec(effect, {joint}, values);
      truth.options["sensor"] = sensor;
      const auto c = Case::Of("arm2", {truth}, 12);
      std::vector<std::pair<double, std::vector<EffectSpec>>> seen;
      for (const auto& start : TransmissionStarts(effect, sensor, 1, c->nominal, c->scales, 0))
        seen.push_back({c->FitOf(start, 0).chi2, start});
      std::sort(seen.begin(), seen.end(), [](const auto& a, const auto& b) { return a.first < b.first; });
      const double bare = PerRow(c->FitOf({}));
      const double left =
          std::min(PerRow(c->FitOf(seen[0].second, 20)), PerRow(c->FitOf(seen[1].second, 20)));
      EXPECT_GT(bare, 3.0) << effect << " " << sensor;
      EXPECT_LT(left - 1, 0.1 * (bare - 1)) << effect << " " << sensor;
    }
  }
}

// A spring that creeps bends anew in each window, as far as the link lies from the middle of the gap: play is
// sought with the motor and the sensor that the spring was found with.
TEST(OtherTransmission, PlayIsFoundInThePlaceOfASpringAndItsFacesAreOne) {
  EffectSpec play = MakeSpec(
      "backlash", {"elbow"},
      {{"gap", 0.05}, {"contact_stiffness", 400}, {"contact_damping", 1.0}, {"motor_inertia", 0.03}});
  play.options["sensor"] = "motor";
  const auto c = Case::Of("arm2", {play}, 12);
  EffectSpec spring = MakeSpec("joint_elasticity", {"elbow"},
                               {{"stiffness", 100}, {"damping", 1.0}, {"motor_inertia", 0.03}});
  spring.options["sensor"] = "motor";
  const double bent = PerRow(c->FitOf({spring}, 12));
  double least = 1e300;
  for (const auto& start : OtherTransmission(spring, c->nominal, c->scales)) {
    EXPECT_EQ(start[0].id, "backlash");
    EXPECT_EQ(start[0].options.at("sensor"), "motor");
    EXPECT_EQ(start[0].values.at("elbow").at("motor_inertia"), 0.03);
    least = std::min(least, PerRow(c->FitOf(start, 20)));
  }
  EXPECT_LT(least - 1, 0.2 * (bent - 1));
  const auto faces = OtherTransmission(play, c->nominal, c->scales);
  ASSERT_EQ(faces.size(), 1u);
  EXPECT_EQ(faces[0][0].id, "joint_elasticity");
  EXPECT_EQ(faces[0][0].values.at("elbow").at("stiffness"), 400);
}

TEST(Joined, ASpringTakesThePlaceOfACouplingThatEndsAtItsJoint) {
  const auto into = MakeSpec("joint_coupling", {"shoulder", "elbow"}, {{"coefficient", 0.1}});
  const auto from = MakeSpec("joint_coupling", {"elbow", "shoulder"}, {{"coefficient", 0.1}});
  const auto spring = MakeSpec("joint_elasticity", {"elbow"});
  EXPECT_EQ(Joined({into}, {spring}).size(), 1u);
  EXPECT_EQ(Joined({from}, {spring}).size(), 2u);
}

TEST(Joined, ALagMayStandBesideADelayButNoOtherDelay) {
  const auto delay = MakeSpec("actuator_delay", {"elbow"}, {{"delay", 0.02}});
  EXPECT_EQ(Joined({delay}, {MakeSpec("actuator_lag", {"elbow"})}).size(), 2u);
  EXPECT_EQ(Joined({delay}, {MakeSpec("sensor_delay", {"elbow"})}).size(), 1u);
  EXPECT_EQ(SiblingsOf("actuator_lag"), SiblingsOf("actuator_delay")) << "each is taken for the other";
}

// Under an effort that keeps its sign a dead band is a constant force of either sign.
TEST(Exchanges, AConstantForceMayBeADeadBandAsLarge) {
  const auto p = testing::Prepare("arm2", {}, 3);
  const std::string joint = p->nominal.joint_names()[1];
  const double offset = -2 * p->scales.torque[1];
  const auto bands = Exchanges({MakeSpec("torque_offset", {joint}, {{"offset", offset}})}, "torque_offset",
                               {}, p->nominal, p->scales);
  ASSERT_EQ(bands.size(), 1u);
  EXPECT_EQ(bands[0][0].id, "torque_deadband");
  EXPECT_EQ(bands[0][0].values.at(joint).at("deadband"), -offset);
  const auto offsets = Exchanges(bands[0], "torque_deadband", {}, p->nominal, p->scales);
  ASSERT_EQ(offsets.size(), 1u);
  EXPECT_EQ(offsets[0][0].id, "torque_offset");
  EXPECT_EQ(offsets[0][0].values.at(joint).at("offset"), 0) << "of neither sign";
  EXPECT_EQ(Joined(bands[0], offsets[0]).size(), 2u) << "one may stand beside the other";
}

// What the given model has is not doubted.
TEST(Exchanges, WhatIsHeldStays) {
  const auto p = testing::Prepare("arm2", {}, 3);
  const EffectSpec held = MakeSpec("coulomb_friction", {"shoulder"}, {{"coulomb", 0.2}});
  const EffectSpec found = MakeSpec("coulomb_friction", {"elbow"}, {{"coulomb", 0.1}});
  const auto others = Exchanges({held, found}, "coulomb_friction", {held}, p->nominal, p->scales);
  EXPECT_EQ(others.size(), Exchanges({found}, "coulomb_friction", {}, p->nominal, p->scales).size());
  for (const TrialSpecs& other : others) {
    EXPECT_TRUE(Contains(other, "coulomb_friction", "shoulder")) << KeyOf(other);
    EXPECT_FALSE(Contains(other, "coulomb_friction", "elbow")) << KeyOf(other);
  }
  EXPECT_TRUE(Exchanges({held}, "coulomb_friction", {held}, p->nominal, p->scales).empty());
}

RankedTrial Trialled(double left, const std::vector<EffectSpec>& specs) {
  Candidate c;
  c.specs = specs;
  return {left, 1000 * left, std::make_shared<const Candidate>(std::move(c))};
}

TEST(Trials, OfTwoReferencesTakeTurnsByWhatTheyLeave) {
  const auto named = [](double left, const std::string& id) {
    return Trialled(left, {MakeSpec(id, {"elbow"})});
  };
  const auto best = BestOf({named(0.9, "coulomb_friction"), named(0.7, "torque_gain")},
                           {named(0.1, "joint_elasticity"), named(0.2, "joint_elasticity"),
                            named(0.3, "backlash"), named(0.4, "sloshing_payload")},
                           4);
  ASSERT_EQ(best.size(), 4u);
  EXPECT_EQ(best[0]->specs[0].id, "torque_gain");
  EXPECT_EQ(best[1]->specs[0].id, "joint_elasticity");
  EXPECT_EQ(best[2]->specs[0].id, "coulomb_friction");
  EXPECT_EQ(best[3]->specs[0].id, "backlash");
}

TEST(Trials, AJointThatTakesLittleOffIsNotTriedFurther) {
  const EffectSpec elbow = MakeSpec("coulomb_friction", {"elbow"}),
                   shoulder = MakeSpec("coulomb_friction", {"shoulder"}),
                   gain = MakeSpec("torque_gain", {"shoulder"});
  const auto best = BestOf(
      {Trialled(0.50, {elbow}), Trialled(0.47, {elbow, shoulder}), Trialled(0.30, {elbow, gain})}, {}, 4);
  ASSERT_EQ(best.size(), 2u);
  EXPECT_EQ(best[0]->specs.back().id, "torque_gain");
  EXPECT_EQ(best[1]->specs.size(), 1u);
}

// Rotors on both joints stand for a motor behind a spring on one: springs are looked for behind the one that
// the account owes most to, with its inertia.
TEST(SpringsBehind, AreSoughtBehindTheRotorThatCountsMost) {
  const auto rotor = [](const std::string& joint, double armature) {
    return MakeSpec("rotor_inertia", {joint}, {{"armature", armature}});
  };
  EffectSpec spring = MakeSpec("joint_elasticity", {"shoulder"},
                               {{"stiffness", 60}, {"damping", 0.5}, {"motor_inertia", 0.05}});
  spring.options["sensor"] = "link";
  const auto c = Case::Of("arm2", {spring}, 14);
  Candidate account =
      Unfitted({c->data, c->nominal, c->scales}, {rotor("elbow", 0.01), rotor("shoulder", 0.01)}, false);
  account.fit = c->FitOf(account.specs);
  ASSERT_TRUE(account.fit.ok);
  EXPECT_GT(PerRow(account.fit), 2.0);
  const auto springs = SpringsBehind({}, account, c->nominal, c->scales);
  ASSERT_FALSE(springs.empty());
  EXPECT_EQ(springs[0][0].joints[0], "shoulder");
  double least = 1e300;
  for (const TrialSpecs& start : springs)
    least = std::min(least, PerRow(c->FitOf(Joined(account.specs, start), 12)));
  EXPECT_LT(least, 1.1);
  EXPECT_TRUE(SpringsBehind(account, account, c->nominal, c->scales).empty());  // nothing new
}

TEST(HiddenStarts, AMotorBehindPlayIsCarriedFromBeforeTheWindow) {
  const std::string joint = sysid::testing::LoadPlant("pendulum").joint_names()[0];
  EffectSpec play = MakeSpec("backlash", {joint},
                             {{"gap", 0.04},
                              {"contact_stiffness", 300},
                              {"contact_damping", 3.0},
                              {"motor_inertia", 0.02},
                              {"motor_viscous", 0.02}});
  play.options["sensor"] = "link";
  const auto c = Case::Of("pendulum", {play}, 8);
  const FitResult fit = c->FitOf({play});
  ASSERT_TRUE(fit.ok);
  EXPECT_LT(PerRow(fit), 1.3);
  EXPECT_NEAR(fit.theta[0], 0.04, 0.004);
}

TEST(GravityStarts, APlanarArmStartsFromATiltThatItFeelsOnlyBySecondOrder) {
  const auto plant = sysid::testing::LoadPlant("pendulum");
  Scored h;
  h.effect = "gravity_misalignment";
  h.coefficients = {0.05, 0.0};
  const auto starts = SpecsFor(h, plant, {});
  ASSERT_EQ(starts.size(), 2u);
  for (const auto& s : starts) {
    const auto& v = s[0].values.begin()->second;
    EXPECT_NEAR(v.at("tilt") * std::cos(v.at("azimuth")), 0.05 / 9.81, 1e-6);
  }
}

TEST(SomeWindows, AreEveryFewUntilThoseMissWhatIsAmiss) {
  std::vector<double> chi2(60, 1.0);
  const auto even = SomeWindows(chi2, 60, 14);
  ASSERT_EQ(even.size(), 14u);
  for (size_t i = 0; i < even.size(); ++i) EXPECT_EQ(even[i], i * 60 / 14);
  chi2[29] = chi2[31] = chi2[46] = 500;
  const auto seen = SomeWindows(chi2, 60, 14);
  for (const uint32_t w : {29u, 31u, 46u}) EXPECT_EQ(std::count(seen.begin(), seen.end(), w), 1) << w;
  // Half of the weight is every window's alike.
  EXPECT_GE(seen.size(), 8u);
  EXPECT_LE(seen.size(), 14u);
}

// Around a model that holds a screen is exact to first order and of all windows: what it gives more than is
// needed is fitted whatever a few windows say.
TEST(Promised, IsWhatAScreenGivesBeyondStructureAndNeed) {
  const auto c = Case::Of("arm2", {}, 9);
  const auto scored = [](const std::string& effect, int joint, double gain) {
    Scored h;
    h.effect = effect, h.joints = {joint}, h.gain = gain, h.coefficients = {0.1}, h.shape = 0.5;
    return h;
  };
  Candidate from;
  from.specs = {MakeSpec("viscous_friction", {"shoulder"}, {{"viscous", 0.1}})};
  from.plant = std::make_shared<const sim::Plant>(c->nominal);
  ScreenResult screened;
  screened.hypotheses = {scored("unknown_field", 1, 90),   scored("viscous_friction", 0, 80),
                         scored("encoder_offset", 1, 40),  scored("viscous_friction", 1, 39),
                         scored("torque_deadband", 1, 14), scored("rotor_inertia", 0, 10)};
  bool holds = true;
  const auto promised = [&](double needed, size_t count) {
    return Promised(from, screened, c->nominal, c->scales, holds, needed, count);
  };
  const auto two = promised(5, 2);
  ASSERT_EQ(two.size(), 2u);
  // One more joint of what is there costs less than one more name.
  EXPECT_EQ(KeyOf(two[0]), "viscous_friction[elbow ] ");
  EXPECT_EQ(KeyOf(two[1]), "encoder_offset[elbow ] ");
  EXPECT_EQ(promised(5, 9).size(), 3u) << "a rotor's gain is what its structure costs and the need";
  EXPECT_EQ(promised(30, 9).size(), 2u);
  screened.pairs = {{{scored("encoder_offset", 1, 0), scored("torque_deadband", 1, 0)}, 60}};
  const auto pair = promised(5, 1);
  ASSERT_EQ(pair.size(), 1u);
  EXPECT_EQ(pair[0].size(), 2u);
  // Around a model that does not hold only what it has already, on one joint more.
  holds = false;
  const auto further = promised(5, 9);
  ASSERT_EQ(further.size(), 1u);
  EXPECT_EQ(KeyOf(further[0]), "viscous_friction[elbow ] ");
}

TEST(WithoutSprings, LeavesTheRotorsBehindThem) {
  const TrialSpecs rigid =
      WithoutSprings({MakeSpec("joint_elasticity", {"elbow"},
                               {{"stiffness", 100}, {"damping", 0.1}, {"motor_inertia", 0.02}}),
                      MakeSpec("viscous_friction", {"elbow"}, {{"viscous", 0.1}})});
  EXPECT_EQ(KeyOf(rigid), "rotor_inertia[elbow ] viscous_friction[elbow ] ");
  EXPECT_EQ(rigid[0].values.at("elbow").at("armature"), 0.02);
}

TEST(WithConstantForce, HasTheForceOfThatJointsSpringInTheMiddleOfItsTravel) {
  const auto c = Case::Of("arm2", {}, 15);
  const auto spring = [](const std::string& joint) {
    return MakeSpec("position_spring", {joint}, {{"stiffness", 2.0}, {"cubic", 1.0}, {"center", 0.5}});
  };
  const TrialSpecs springs = {spring("shoulder"), spring("elbow")};
  const auto with = [&](const TrialSpecs& specs, const char* joint) {
    return WithConstantForce(specs, joint, c->nominal, c->scales);
  };
  const TrialSpecs constant = with(springs, "shoulder");
  EXPECT_EQ(KeyOf(constant), "position_spring[elbow ] torque_offset[shoulder ] ");
  const int joint = c->nominal.model().FindJoint("shoulder");
  const double x = 0.5 * (c->scales.low[joint] + c->scales.high[joint]) - 0.5;
  EXPECT_NEAR(constant[0].values.at("shoulder").at("offset"), -2.0 * x - x * x * x, 1e-12);
  EXPECT_EQ(KeyOf(with(constant, "elbow")), "torque_offset[elbow ] torque_offset[shoulder ] ");
  const TrialSpecs both = {spring("elbow"), MakeSpec("torque_offset", {"elbow"}, {{"offset", 0.1}})};
  EXPECT_EQ(KeyOf(with(both, "elbow")), KeyOf(both)) << "the joint has a constant force";
}

// A coupling's force is on its second joint; transmissions of that joint alone, and what touches the robot.
TEST(Trials, OnAJointAreWhatActsOnThatJointAlone) {
  const auto c = Case::Of("arm2", {MakeSpec("torque_offset", {"elbow"}, {{"offset", 0.3}})}, 9);
  const auto scored = [](const std::string& effect, std::vector<int> joints, double gain,
                         std::vector<double> coefficients) {
    Scored h;
    h.effect = effect, h.joints = std::move(joints), h.gain = gain, h.coefficients = std::move(coefficients);
    return h;
  };
  const Scored gain = scored("torque_gain", {1}, 50, {-0.1}), other = scored("torque_gain", {0}, 60, {-0.1});
  ScreenResult screened;
  screened.hypotheses = {other, gain, scored("torque_gain", {0, 1}, 45, {-0.1, -0.1}),
                         scored("joint_coupling", {0, 1}, 40, {0.1}),
                         scored("joint_coupling", {1, 0}, 30, {0.1})};
  screened.pairs = {{{gain, other}, 90}};
  std::set<std::string> sprung;
  const Nearest nearest = [&](const std::vector<TrialSpecs>& starts, size_t) {
    for (const TrialSpecs& start : starts) sprung.insert(start.front().joints[0]);
    return std::vector<TrialSpecs>{};
  };
  Candidate from;
  from.plant = std::make_shared<const sim::Plant>(c->nominal);
  from.fit.values = from.plant->parameters().Nominal(), from.fit.ok = true;
  std::set<std::string> tried;
  for (const TrialSpecs& trial : TrialsOnJoint(
           1, c->data, c->nominal, c->scales, from, screened, [&] { return c->Missing(); }, nearest)) {
    if (trial.front().id == "torque_gain" || trial.front().id == "joint_coupling") tried.insert(KeyOf(trial));
  }
  EXPECT_EQ(tried, (std::set<std::string>{"joint_coupling[shoulder elbow ] ", "torque_gain[elbow ] "}));
  EXPECT_EQ(sprung, std::set<std::string>{"elbow"});
}

// All joints are looked at but those that lack least force, each with the rotor that was found there among
// others.
TEST(Trials, LookAtSpringsAndPlayWhereAForceIsMissingBeforeTheRotorsThatTheyHave) {
  const auto c = Case::Of("mico2", {}, 9);
  const auto& joints = c->nominal.joint_names();
  Candidate from;
  from.specs = {MakeSpec("rotor_inertia", {joints[1]}, {{"armature", 0.02}}),
                MakeSpec("backlash", {joints[2]}, {{"gap", 0.01}})};
  from.plant = std::make_shared<const sim::Plant>(
      *sim::Plant::Create(c->nominal.shared_model(), c->nominal.options(), from.specs));
  from.fit.ok = true, from.fit.values = from.plant->parameters().Nominal();
  std::map<std::string, std::set<std::string>> kinds;  // by joint, with the sensor's place
  std::set<double> rotors;                             // of the second joint
  const Nearest nearest = [&](const std::vector<TrialSpecs>& starts, size_t count) {
    for (const TrialSpecs& start : starts) {
      const std::string& joint = start[0].joints[0];
      kinds[joint].insert(start[0].id + " " + start[0].options.at("sensor"));
      if (joint == joints[1]) rotors.insert(start[0].values.at(joint).at("motor_inertia"));
    }
    return std::vector<TrialSpecs>(starts.begin(), starts.begin() + static_cast<long>(count));
  };
  MissingForce force;
  force.evidence = Eigen::MatrixXd::Identity(c->data.n, c->data.n) * 100;
  force.evidence(2, 2) = 1e6, force.evidence(4, 4) = 1;
  const auto trials = [&] {
    return TransmissionTrials(
        c->data, c->nominal, c->scales, from, {}, [&] { return &force; }, nearest);
  };
  EXPECT_EQ(trials().size(), 8u);
  EXPECT_EQ(kinds.size(), joints.size() - 2) << "one has play, and one no force";
  EXPECT_EQ(kinds.count(joints[4]), 0u);
  for (const auto& [joint, of_joint] : kinds) EXPECT_EQ(of_joint.size(), 4u) << joint;
  EXPECT_EQ(rotors.count(0.02), 1u);
  kinds.clear();
  force.evidence(0, 0) = 1e6;
  trials();
  EXPECT_EQ(kinds.size(), 3u) << "more than one thing may be missing";
  force.evidence *= -1;  // nothing is missing
  trials();
  EXPECT_EQ(kinds.size(), joints.size() - 1);
}

// Before a spring is known its motor hides how late the drive is: it starts as late as most others are.
TEST(Trials, BeginWithADriveBehindASpringAsLateAsTheOthers) {
  const auto c = Case::Of("mico2", {}, 9);
  const auto& joints = c->nominal.joint_names();
  const auto of_springs = [&](const std::vector<double>& lags) {
    Candidate from;
    from.specs = {MakeSpec("rotor_inertia", {joints[1]}, {{"armature", 0.02}})};
    for (size_t j = 0; j < lags.size(); ++j) {
      if (lags[j] > 0)
        from.specs.push_back(MakeSpec("actuator_lag", {joints[j]}, {{"time_constant", lags[j]}}));
    }
    from.plant = std::make_shared<const sim::Plant>(
        *sim::Plant::Create(c->nominal.shared_model(), c->nominal.options(), from.specs));
    from.fit.ok = true, from.fit.values = from.plant->parameters().Nominal();
    const Nearest nearest = [](const std::vector<TrialSpecs>& starts, size_t) { return starts; };
    std::set<double> out;  // lags of the second joint; -1: none
    const auto force = [&] { return c->Missing(); };
    for (const TrialSpecs& trial :
         TransmissionTrials(c->data, c->nominal, c->scales, from, {}, force, nearest)) {
      if (trial[0].joints[0] != joints[1]) continue;
      const auto lag = std::find_if(trial.begin(), trial.end(),
                                    [](const EffectSpec& s) { return s.id == "actuator_lag"; });
      out.insert(lag == trial.end() ? -1.0 : lag->values.at(joints[1]).at("time_constant"));
    }
    return out;
  };
  EXPECT_EQ(of_springs({0.007, 0, 0.006, 0.008, 0.009, 0.007}), (std::set<double>{0.007}));
  EXPECT_EQ(of_springs({0.007, 0, 0, 0, 0, 0.007}), (std::set<double>{-1.0})) << "most drives are prompt";
  EXPECT_EQ(of_springs({0.007, 0.004, 0.006, 0.008, 0.009, 0.007}), (std::set<double>{-1.0}))
      << "it has a lag of its own";
}

// What pushes the whole robot is no column of a screen, which promises nothing of it.
TEST(Trials, TryAPushBesideHiddenStatesWithoutAPromise) {
  const auto c = Case::Of("mico2",
                          {MakeSpec("external_disturbance", {},
                                    {{"start", 1.0}, {"end", 2.0}, {"force_x", 1.5}, {"force_z", -2.0}})},
                          6);
  const std::string joint = c->nominal.joint_names()[1];
  const auto pushes = [&](std::vector<EffectSpec> specs) {
    Candidate from;
    from.specs = std::move(specs);
    from.plant = std::make_shared<const sim::Plant>(
        *sim::Plant::Create(c->nominal.shared_model(), c->nominal.options(), from.specs));
    from.fit.ok = true, from.fit.values = from.plant->parameters().Nominal();
    const Nearest nearest = [](const auto& starts, size_t) { return starts; };
    size_t count = 0;
    for (const TrialSpecs& trial : Trials(
             c->data, c->nominal, c->scales, from, {}, 2.0, [&] { return c->Missing(); }, nearest))
      count += HasKind(trial, "external_disturbance");
    return count;
  };
  EXPECT_GE(pushes({MakeSpec("actuator_lag", {joint}, {{"time_constant", 0.01}})}), 1u);
  EXPECT_EQ(pushes({MakeSpec("viscous_friction", {joint}, {{"viscous", 0.1}})}), 0u);
}

}  // namespace
}  // namespace rg::diagnosis
