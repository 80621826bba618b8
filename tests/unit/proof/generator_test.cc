#include <gtest/gtest.h>

#include <cmath>
#include <dart/dynamics/DegreeOfFreedom.hpp>
#include <dart/dynamics/Joint.hpp>
#include <dart/utils/urdf/DartLoader.hpp>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "common/base/file.h"
#include "common/base/ids.h"
#include "services/proof/generator/bodies.h"
#include "services/proof/generator/comparison.h"
#include "services/proof/generator/engine.h"
#include "services/proof/generator/equivalents.h"
#include "services/proof/generator/fields.h"
#include "services/proof/generator/hypotheses.h"
#include "services/proof/generator/likeness.h"
#include "services/proof/generator/proof_case.h"
#include "services/proof/generator/robots.h"
#include "services/proof/generator/set_files.h"
#include "services/proof/generator/siblings.h"
#include "services/proof/generator/tuning.h"

namespace rg::proof {
namespace {

using Eigen::VectorXd;

const char kPendulum[] = R"(<robot name="p"><link name="base"/>
  <link name="rod"><inertial><origin xyz="0 0 -0.3"/><mass value="1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="pivot" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="5" velocity="8"/></joint></robot>)";

dart::dynamics::SkeletonPtr Pendulum() {
  dart::utils::DartLoader::Options options;
  options.mDefaultRootJointType = dart::utils::DartLoader::RootJointType::FIXED;
  auto skeleton = dart::utils::DartLoader(options).parseSkeletonString(kPendulum, "");
  return skeleton;
}

Truth OneJoint() { return Truth{std::vector<JointTruth>(1)}; }

VectorXd One(double x) { return VectorXd::Constant(1, x); }

TEST(ProofEngine, SmallSwingsHaveThePendulumsPeriod) {
  Engine engine(Pendulum(), {"pivot"}, OneJoint(), 1e-4);
  engine.Reset(One(0.01), One(0), One(0), 0);
  const double omega = std::sqrt(1.0 * 9.81 * 0.3 / (0.01 + 0.09));
  const int half = static_cast<int>(std::lround(M_PI / omega / 1e-4));
  for (int i = 0; i < half; ++i) engine.Step(One(0));
  EXPECT_NEAR(engine.SensedPosition()[0], -0.01, 1e-5);
}

TEST(ProofEngine, FrictionHoldsAtRestAndSlipsAboveItsLevel) {
  Truth truth = OneJoint();
  truth.joint[0].dry.coulomb_positive = truth.joint[0].dry.coulomb_negative = 0.5;
  Engine engine(Pendulum(), {"pivot"}, truth, 1e-4);
  engine.Reset(One(0), One(0), One(0), 0);
  for (int i = 0; i < 5000; ++i) engine.Step(One(0.49));
  EXPECT_LT(std::abs(engine.SensedPosition()[0]), 1e-9);
  for (int i = 0; i < 5000; ++i) engine.Step(One(0.7));
  EXPECT_GT(engine.SensedPosition()[0], 0.01);
}

TEST(ProofEngine, WhatTheUrdfDeclaresIsNoConcealedEffect) {
  auto skeleton = Pendulum();
  skeleton->getDof(0)->setDampingCoefficient(0.2);
  Truth viscous = OneJoint();
  viscous.joint[0].viscous = 0.2;
  Engine declared(skeleton, {"pivot"}, OneJoint(), 1e-4), concealed(Pendulum(), {"pivot"}, viscous, 1e-4);
  for (Engine* engine : {&declared, &concealed}) {
    engine->Reset(One(0.5), One(0), One(0), 0);
    for (int i = 0; i < 3000; ++i) engine->Step(One(0));
  }
  EXPECT_DOUBLE_EQ(declared.SensedPosition()[0], concealed.SensedPosition()[0]);
  EXPECT_LT(declared.SensedPosition()[0], 0.49);
}

TEST(ProofEngine, DelayShiftsTheCommand) {
  Truth truth = OneJoint();
  truth.joint[0].delay = 0.02;
  Engine engine(Pendulum(), {"pivot"}, truth, 1e-4);
  engine.Reset(One(0), One(0), One(0), 0);
  for (int i = 0; i < 199; ++i) engine.Step(One(1));
  EXPECT_EQ(engine.SensedVelocity()[0], 0.0);
  for (int i = 0; i < 20; ++i) engine.Step(One(1));
  EXPECT_GT(engine.SensedVelocity()[0], 0.0);
}

Truth Played(double gap, bool sensor_on_motor) {
  Truth truth = OneJoint();
  truth.joint[0].transmission = {
      .stiffness = 600, .damping = 2, .motor_inertia = 0.02, .gap = gap, .sensor_on_motor = sensor_on_motor};
  return truth;
}

TEST(ProofEngine, ARigidModelRestartsWhereItIsSensedOfARobotWithPlay) {
  for (const bool motor : {false, true}) {
    Engine real(Pendulum(), {"pivot"}, Played(0.05, motor), 1e-4);
    real.Reset(One(0.3), One(0), One(0), 0);
    for (int i = 0; i < 4000; ++i) real.Step(One(0.8));
    Truth rigid = OneJoint();
    Engine model(Pendulum(), {"pivot"}, rigid, 1e-4), same(Pendulum(), {"pivot"}, Played(0.05, motor), 1e-4);
    model.ResetLike(real, real.SensedPosition(), real.SensedVelocity());
    same.ResetLike(real, real.SensedPosition(), real.SensedVelocity());
    const double before = real.SensedPosition()[0], speed = real.SensedVelocity()[0];
    for (Engine* engine : {&real, &model, &same}) engine->Step(One(0.8));
    EXPECT_NEAR(model.SensedPosition()[0], before + 1e-4 * speed, 1e-5) << motor;
    EXPECT_EQ(same.SensedPosition()[0], real.SensedPosition()[0]) << motor;
  }
}

constexpr double kRowRate = 100, kFine = 2e-4;

// What a pendulum does that is swung back and forth, without noise.
Track Swung(const Truth& truth, double strength = 1) {
  constexpr int kRows = 301;
  Track track;
  track.q = track.v = track.u = track.true_q = track.true_v = Eigen::MatrixXd(1, kRows);
  Engine real(Pendulum(), {"pivot"}, truth, kFine);
  real.Reset(One(0), One(0), One(0), 0);
  for (int k = 0; k < kRows; ++k) {
    track.q.col(k) = track.true_q.col(k) = real.SensedPosition();
    track.v.col(k) = track.true_v.col(k) = real.SensedVelocity();
    track.u(0, k) = strength * (2 * std::sin(3.0 * k / kRowRate) + std::sin(8.0 * k / kRowRate));
    for (int i = 0; i < 50; ++i) real.Step(track.u.col(k));
  }
  return track;
}

// Least deviation of a simpler effect, over the sensor's noise.
double Hallmark(const Truth& truth, const std::string& effect) {
  const Track track = Swung(truth);
  std::vector<Rival> rivals;
  for (const Truth& model : SimplerSiblings(truth, effect, 0, track.u.cwiseAbs().mean(), {0, 0, -0.6}))
    rivals.push_back({Pendulum(), model, Start::kTrue});
  WindowSquares squares;
  Comparison(Pendulum(), {"pivot"}, kFine, kRowRate).Add(truth, track, rivals, &squares);
  double least = 1e9;
  for (const auto& s : squares.rivals) least = std::min(least, Rms(s) / 4e-4);
  return least;
}

// χ² per second, at a noise of 0.4 mrad, that other bodies leave of an effect on a pendulum.
double LeftByBodies(const Truth& truth) {
  const Track track = Swung(truth, 0.3);
  const Comparison compared(Pendulum(), {"pivot"}, kFine, kRowRate);
  return LeftByNearestBodies(compared, truth, {track}, OneJoint(), {"rod"}, 4e-4);
}

TEST(ProofLikeness, AWeakSpringIsAnotherMassAndFrictionIsNot) {
  Truth weak = OneJoint(), strong = OneJoint(), friction = OneJoint();
  weak.joint[0].spring_stiffness = 0.005;
  strong.joint[0].spring_stiffness = 3, strong.joint[0].spring_center = 0.8;
  friction.joint[0].dry.coulomb_positive = friction.joint[0].dry.coulomb_negative = 0.05;
  EXPECT_LT(LeftByBodies(weak), 0.5);
  EXPECT_GT(LeftByBodies(strong), 50);
  EXPECT_GT(LeftByBodies(friction), 50);
}

TEST(ProofLikeness, OtherBodiesAreFoundAgain) {
  Truth bodies = OneJoint();
  bodies.links["rod"].mass_factor = 1.03, bodies.links["rod"].com_shift[0] = 0.003;
  bodies.joint[0].viscous = 0.005;
  EXPECT_LT(LeftByBodies(bodies), 0.01);
}

TEST(ProofSiblings, APlayOfAHairIsARotorsInertiaAndOneOfADegreeIsNot) {
  for (const bool motor : {false, true}) {
    EXPECT_LT(Hallmark(Played(0.0003, motor), "backlash"), 1) << motor;
    EXPECT_GT(Hallmark(Played(0.03, motor), "backlash"), 5) << motor;
  }
  Truth stiff = Played(0, false), soft = Played(0, false);
  stiff.joint[0].transmission.stiffness = 5000, soft.joint[0].transmission.stiffness = 60;
  EXPECT_LT(Hallmark(stiff, "joint_elasticity"), 1);
  EXPECT_GT(Hallmark(soft, "joint_elasticity"), 5);
}

TEST(ProofSiblings, FrictionOfSeveralLevelsIsToldFromThatOfOne) {
  Truth truth = OneJoint();
  truth.joint[0].dry = {
      .coulomb_positive = 0.3, .coulomb_negative = 0.3, .static_extra = 0.4, .stribeck_velocity = 0.5};
  EXPECT_GT(Hallmark(truth, "stribeck_friction"), 5);
  truth.joint[0].dry.static_extra = 1e-3;
  EXPECT_LT(Hallmark(truth, "stribeck_friction"), 1);
  truth.joint[0].dry = {.coulomb_positive = 0.5, .coulomb_negative = 0.2};
  EXPECT_GT(Hallmark(truth, "asymmetric_friction"), 5);
  truth.joint[0].dry = {.coulomb_positive = 0.3, .coulomb_negative = 0.2999};
  EXPECT_LT(Hallmark(truth, "asymmetric_friction"), 1);
  truth.joint[0].dry = {.coulomb_positive = 0.3, .coulomb_negative = 0.3};
  EXPECT_GT(Hallmark(truth, "coulomb_friction"), 5);
  truth.joint[0].dry = {.coulomb_positive = 4, .coulomb_negative = 4};
  EXPECT_EQ(Hallmark(truth, "coulomb_friction"), 0) << "it never moves";
  truth = OneJoint();
  truth.slosh_mass = 0.2, truth.slosh_length = 0.1;
  EXPECT_GT(Hallmark(truth, "sloshing_payload"), 1) << "a robot with other joints restarts from its state";
}

TEST(ProofHypotheses, SpringsAndGapsStayThoseOfGearsHoweverStrong) {
  Scales scales;
  scales.joints = {"a"}, scales.links = {"l"}, scales.prismatic = {false};
  scales.torque = scales.motion_torque = scales.velocity = scales.amplitude = One(1);
  scales.inertia = One(0.1);
  for (const char* id : {"backlash", "joint_elasticity"}) {
    const StrengthRange range = StrengthsOf({"payload", id});
    for (uint64_t seed = 0; seed < 50; ++seed) {
      for (const double strength : {range.low, 1.0, range.high}) {
        Truth truth = OneJoint();
        AddEffect(id, strength, scales, Rng(seed), &truth);
        const Transmission& t = truth.joint[0].transmission;
        EXPECT_GE(t.motor_inertia, 0.01);
        EXPECT_LE(t.motor_inertia, 0.04);
        if (t.gap > 0) {
          EXPECT_GE(t.gap, 0.006) << "a third of a degree";
          EXPECT_LE(t.gap, 0.15);
        } else {
          const double hertz = std::sqrt(t.stiffness / 0.1) / (2 * M_PI);
          EXPECT_GE(hertz, 2);
          EXPECT_LE(hertz, 17);
        }
      }
    }
  }
}

TEST(ProofRobots, BeyondTheirStopsNobodyRecordsThem) {
  const auto bodies = Pendulum();  // from -3 to 3 rad, 8 rad/s
  const auto beyond = [&](double q, double v) {
    return BeyondStops(bodies, {"pivot"}, One(0), One(q), One(v));
  };
  EXPECT_FALSE(beyond(3.5, 8));
  EXPECT_TRUE(beyond(4, 0));
  EXPECT_TRUE(beyond(-4, 0));
  EXPECT_FALSE(beyond(0, 30));
  EXPECT_TRUE(beyond(0, -33));
}

TEST(ProofRobots, EveryDrawnOneIsAnotherAndCanBeSimulated) {
  for (const std::string& kind : KnownRobots()) {
    if (kind == "mico2") continue;  // read from a file
    const std::string one = *DrawRobot(kind, "", Rng(1)), other = *DrawRobot(kind, "", Rng(2));
    EXPECT_NE(one, other) << kind;
    dart::utils::DartLoader::Options options;
    options.mDefaultRootJointType = dart::utils::DartLoader::RootJointType::FIXED;
    const auto skeleton = dart::utils::DartLoader(options).parseSkeletonString(one, "");
    ASSERT_NE(skeleton, nullptr) << kind;
    const Eigen::MatrixXd mass = skeleton->getMassMatrix();
    EXPECT_GT(mass.selfadjointView<Eigen::Lower>().eigenvalues().minCoeff(), 0) << kind;
  }
  EXPECT_FALSE(DrawRobot("crane", "", Rng(1)).ok());
}

TEST(ProofFields, NoLawIsConstantAndDragsOppose) {
  Eigen::VectorXd q(2), v(2);
  Field field;
  field.on = 0, field.over[1] = 1, field.amplitude = 2;
  for (const std::string& form : FieldForms(2)) {
    field.form = form;
    q << 0.2, 0.1, v << 0.5, 0.4;
    const double here = FieldForce(field, q, v, 0.3);
    q << 1.3, -0.6, v << 1.1, -0.7;
    EXPECT_NE(here, FieldForce(field, q, v, 0.9)) << form;
    if (form == "sticky_patch" || form == "speed_bump") {
      EXPECT_LE(here * 0.5, 0) << form;
      EXPECT_EQ(FieldForce(field, q, Eigen::VectorXd::Zero(2), 0), 0) << form;
    }
  }
}

TEST(ProofSetFiles, CommandsHoldFromRowToRowHoweverIrregularTheRows) {
  SetStyle style;
  style.rows = Rows::kMissing, style.rows_per_command = 5;
  const RowPlan missing = PlanRows(style, false, 6, 500, 1e-4, Rng(3));
  int left_out = 0;
  for (size_t k = 0; k < missing.time.size(); ++k) {
    left_out += !missing.written[k];
    EXPECT_TRUE(missing.written[k] || !missing.commands[k]) << "a command that no row says";
  }
  EXPECT_GT(left_out, 100);
  style = {};
  style.rows = Rows::kJittered;
  const RowPlan jittered = PlanRows(style, false, 6, 100, 1e-4, Rng(3));
  double shortest = 1, longest = 0;
  for (size_t k = 1; k < jittered.time.size(); ++k) {
    const double gap = jittered.time[k] - jittered.time[k - 1];
    shortest = std::min(shortest, gap), longest = std::max(longest, gap);
  }
  EXPECT_GT(shortest, 0.006);
  EXPECT_LT(shortest, 0.008);
  EXPECT_GT(longest, 0.015);
  EXPECT_EQ(PlanRows(style, true, 6, 100, 1e-4, Rng(3)).time.size(), 601u) << "concealed ones are regular";
}

// Torque of a pendulum that is swung by hand, plus what is concealed.
Motion Swung(double extra_inertia, double coulomb, double ripple) {
  Motion m;
  const int rows = 500;
  m.q = m.v = m.a = m.u = Eigen::MatrixXd(1, rows);
  for (int k = 0; k < rows; ++k) {
    const double t = 0.01 * k;
    m.q(0, k) = 0.8 * std::sin(2 * t) + ripple * std::sin(9 * t);
    m.v(0, k) = 1.6 * std::cos(2 * t) + 9 * ripple * std::cos(9 * t);
    m.a(0, k) = -3.2 * std::sin(2 * t) - 81 * ripple * std::sin(9 * t);
    m.u(0, k) = (0.1 + extra_inertia) * m.a(0, k) + 9.81 * 0.3 * std::sin(m.q(0, k)) +
                std::copysign(coulomb, m.v(0, k));
  }
  return m;
}

TEST(ProofTuning, DampingSwallowsDryFriction) {
  const Tuning tuned = Tune(Pendulum(), {"pivot"}, {"rod"}, Swung(0, 0.2, 0), TunedPart::kDamping);
  // Least squares of c·sign(v) by d·v: d = c·mean|v|/mean v².
  EXPECT_NEAR(tuned.damping[0], 0.2 * (2 / M_PI * 1.6) / (0.5 * 1.6 * 1.6), 0.01);
  EXPECT_TRUE(tuned.links.empty());
  EXPECT_NE(WithTuning(kPendulum, Pendulum(), {"pivot"}, tuned).find("damping=\"0.1"), std::string::npos);
}

TEST(ProofTuning, BodiesSwallowARotorsInertia) {
  const Motion motion = Swung(0.008, 0, 0.1);
  const Tuning tuned = Tune(Pendulum(), {"pivot"}, {"rod"}, motion, TunedPart::kBodies);
  Truth bodies = OneJoint();
  bodies.links = tuned.links;
  const auto skeleton = TrueBodies(Pendulum(), {"pivot"}, bodies);
  EXPECT_NEAR(skeleton->getMassMatrix()(0, 0), 0.108, 0.001);
  dart::utils::DartLoader::Options options;
  options.mDefaultRootJointType = dart::utils::DartLoader::RootJointType::FIXED;
  const auto read_again = dart::utils::DartLoader(options).parseSkeletonString(
      WithTuning(kPendulum, Pendulum(), {"pivot"}, tuned), "");
  EXPECT_NEAR(read_again->getMassMatrix()(0, 0), skeleton->getMassMatrix()(0, 0), 1e-7);
}

nlohmann::json EffectOf(const char* id, std::vector<std::string> joints) {
  return {{"id", id},
          {"joints", joints},
          {"also_acceptable", nlohmann::json::array()},
          {"equivalents", nlohmann::json::array()}};
}

TEST(ProofLabels, CallEquivalentWhatIsAndNothingElse) {
  using nlohmann::json;
  RobotFacts arm{.joints = 2, .first_joint = "a", .upright_plane = true};
  json one = {EffectOf("sensor_delay", {"b"}), EffectOf("encoder_offset", {"a"})};
  AddEquivalents(arm, &one);
  EXPECT_TRUE(one[0]["equivalents"].empty()) << "one of two joints";
  EXPECT_EQ(one[1]["equivalents"], json{"gravity_misalignment"});
  json all = {EffectOf("sensor_delay", {"a", "b"}), EffectOf("encoder_offset", {"b"})};
  AddEquivalents(arm, &all);
  EXPECT_EQ(all[0]["equivalents"], json{"actuator_delay"});
  EXPECT_TRUE(all[1]["equivalents"].empty());

  json rotor = {EffectOf("rotor_inertia", {"a"}), EffectOf("rotor_inertia", {"b"})};
  AddEquivalents(arm, &rotor);
  EXPECT_EQ(rotor[0]["equivalents"], json{"parameters_only"}) << "the first link turns about that axis alone";
  EXPECT_TRUE(rotor[1]["equivalents"].empty());

  json held = {EffectOf("payload", {}), EffectOf("parameters_only", {})}, alone = {EffectOf("payload", {})};
  AddEquivalents(arm, &held), AddEquivalents(arm, &alone);
  EXPECT_EQ(held[0]["equivalents"], json{"parameters_only"}) << "a part of a body that is wrong anyway";
  EXPECT_TRUE(alone[0]["equivalents"].empty());

  arm.damped = {"a"};
  json viscous = {EffectOf("viscous_friction", {"a"}), EffectOf("viscous_friction", {"a", "b"})};
  AddEquivalents(arm, &viscous);
  EXPECT_EQ(viscous[0]["equivalents"], json{"parameters_only"}) << "the URDF has that parameter";
  EXPECT_TRUE(viscous[1]["equivalents"].empty()) << "on one of two joints";
  EXPECT_EQ(AcceptedVerdicts(json::array({viscous[0]})).size(), 2u);

  RobotFacts slide{.joints = 1, .first_joint = "s", .linear = true, .heavier = false};
  json mass = {EffectOf("torque_gain", {"s"}), EffectOf("coulomb_friction", {"s"})};
  AddEquivalents(slide, &mass);
  EXPECT_EQ(mass[0]["equivalents"], json{"parameters_only"}) << "no payload makes it lighter";
  EXPECT_TRUE(mass[1]["equivalents"].empty());
  slide.heavier = true;
  json heavier = {EffectOf("torque_gain", {"s"})};
  AddEquivalents(slide, &heavier);
  EXPECT_EQ(heavier[0]["equivalents"].size(), 3u);
}

// A SCARA's lift feels nothing of the other two, nor they of it: a delay of both is one of their drives.
TEST(ProofLabels, OneDelayOfAllThatFeelEachOtherIsOneOfTheirDrives) {
  using nlohmann::json;
  const RobotFacts scara{.joints = 3, .first_joint = "a", .apart = {"lift"}};
  const auto equivalents = [&](std::vector<std::string> joints, const char* beside) {
    json effects = {EffectOf("sensor_delay", std::move(joints)), EffectOf(beside, {})};
    AddEquivalents(scara, &effects);
    return effects[0]["equivalents"].size();
  };
  EXPECT_EQ(equivalents({"a", "b"}, "parameters_only"), 1u);
  EXPECT_EQ(equivalents({"lift"}, "parameters_only"), 1u);
  EXPECT_EQ(equivalents({"a", "lift"}, "parameters_only"), 0u);
  EXPECT_EQ(equivalents({"a", "b"}, "base_flexibility"), 0u) << "which couples them all";
}

TEST(ProofLabels, WhatIsPartOfAnotherEffectIsNotAskedFor) {
  using nlohmann::json;
  const RobotFacts arm{.joints = 2, .first_joint = "a"},
      slide{.joints = 1, .first_joint = "s", .linear = true};
  const json spring = EffectOf("joint_elasticity", {"a"});
  EXPECT_TRUE(Hides(arm, json{EffectOf("rotor_inertia", {"a", "b"}), spring}));
  EXPECT_FALSE(Hides(arm, json{EffectOf("rotor_inertia", {"b"}), spring}));
  const json tilt = EffectOf("gravity_misalignment", {});
  EXPECT_TRUE(Hides(slide, json{EffectOf("position_spring", {"s"}), tilt}));
  EXPECT_FALSE(Hides(slide, json{EffectOf("viscous_friction", {"s"}), tilt}));
}

TEST(ProofCase, ConcealsTheTruthFromTheSet) {
  const std::string folder = std::filesystem::temp_directory_path() / ("rg_proof_" + RandomHex(6));
  CaseRequest request;
  request.name = "case";
  request.urdf = kPendulum;
  request.kind = "pendulum";
  request.effects = {"coulomb_friction"};
  request.rate_hz = 25;
  const auto summary = MakeCase(request, folder + "/sets", folder + "/labels");
  ASSERT_TRUE(summary.ok()) << summary.status().ToString();
  EXPECT_GT(summary->ratio, 1.5);
  const auto label = nlohmann::json::parse(*ReadFile(folder + "/labels/case/label.json"));
  EXPECT_EQ(label["effects"][0]["id"], "coulomb_friction");
  EXPECT_TRUE(label["rate_hz"].is_number_integer()) << "scores count rows per second with it";
  for (const auto& entry : std::filesystem::recursive_directory_iterator(folder + "/sets")) {
    if (!entry.is_regular_file()) continue;
    const std::string text = *ReadFile(entry.path());
    EXPECT_EQ(text.find("true_"), std::string::npos) << entry.path();
    EXPECT_EQ(text.find("coulomb"), std::string::npos) << entry.path();
  }
  std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace rg::proof
