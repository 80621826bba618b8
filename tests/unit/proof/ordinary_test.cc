#include "services/proof/generator/ordinary.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <dart/dynamics/DegreeOfFreedom.hpp>
#include <filesystem>
#include <set>

#include "common/base/file.h"
#include "common/base/ids.h"
#include "services/proof/generator/bodies.h"
#include "services/proof/generator/proof_case.h"
#include "services/proof/generator/robots.h"

namespace rg::proof {
namespace {

using nlohmann::json;

// An arm of three joints whose last link weighs next to nothing.
Scales LightWrist() {
  Scales s;
  s.joints = {"base", "elbow", "wrist"}, s.links = {"l1", "l2", "l3"};
  s.prismatic = {false, false, false};
  s.torque = Eigen::Vector3d(4, 10, 0.01), s.motion_torque = Eigen::Vector3d(4, 4, 0.005);
  s.peak_torque = 3 * s.torque;
  s.zero_matters = Eigen::Vector3d(0, 0.5, 0.5);
  s.velocity = Eigen::Vector3d(0.3, 0.3, 0.4), s.inertia = Eigen::Vector3d(0.5, 0.3, 1e-4);
  s.home = Eigen::Vector3d::Zero(), s.amplitude = Eigen::Vector3d::Constant(0.4);
  return s;
}

Truth Geared(const Ordinary& ordinary, uint64_t seed = 1) {
  Truth truth{std::vector<JointTruth>(3)};
  SetGears(ordinary, LightWrist(), 100, Rng(seed), &truth);
  return truth;
}

const json* Find(const json& effects, const std::string& id) {
  const auto at = std::find_if(effects.begin(), effects.end(), [&](const json& e) { return e["id"] == id; });
  return at == effects.end() ? nullptr : &*at;
}

TEST(ProofOrdinary, ALightWristHasTheFrictionAndTheRotorOfItsGear) {
  for (uint64_t seed = 1; seed < 20; ++seed) {
    const Truth truth = Geared({}, seed);
    double largest = 0;
    for (const JointTruth& j : truth.joint) largest = std::max(largest, j.dry.coulomb_positive);
    const JointTruth& wrist = truth.joint[2];
    EXPECT_GT(wrist.dry.coulomb_positive, 0.05 * largest);
    EXPECT_GT(wrist.armature, 50 * LightWrist().inertia[2]);
    EXPECT_LT(wrist.armature, truth.joint[0].armature);
    for (const JointTruth& j : truth.joint) {
      EXPECT_GT(j.viscous, 0);
      EXPECT_EQ(j.lag + j.delay, 0);
    }
  }
}

TEST(ProofOrdinary, DrivesAreLateTogether) {
  const Truth truth = Geared({.timing = "actuator_lag"});
  EXPECT_GE(truth.joint[0].lag, 0.006);
  EXPECT_EQ(truth.joint[0].lag, truth.joint[2].lag);
  const json effects = GearLabels({.timing = "actuator_lag"}, LightWrist(), truth);
  ASSERT_NE(Find(effects, "actuator_lag"), nullptr);
  EXPECT_EQ((*Find(effects, "actuator_lag"))["joints"].size(), 3u);
}

TEST(ProofOrdinary, LabelsSayEveryJointsFiguresAndWhichJointsMayBeLeftOut) {
  const Truth truth = Geared({});
  const json effects = GearLabels({}, LightWrist(), truth);
  ASSERT_EQ(effects.size(), 3u);
  for (const json& e : effects) EXPECT_EQ(e["joints"], json({"base", "elbow", "wrist"})) << e["id"];
  EXPECT_EQ((*Find(effects, "coulomb_friction"))["parameters"]["wrist"]["coulomb"]["value"],
            truth.joint[2].dry.coulomb_positive);
  const json& rotor = *Find(effects, "rotor_inertia");
  EXPECT_EQ(rotor["optional_joints"], json({"base"}));
  EXPECT_EQ(rotor["also_acceptable"], json({"parameters_only"}));
}

TEST(ProofOrdinary, FrictionThatGrowsWithTheLoadIsNoCoulombFrictionOfItsJoint) {
  Truth truth = Geared({});
  const auto entry = AddExtra("load_dependent_friction", 1, LightWrist(), Rng(3), &truth);
  ASSERT_TRUE(entry);
  const std::string joint = (*entry)["joints"][0];
  EXPECT_NE(joint, "wrist") << "which carries nothing";
  const json coulomb = *Find(GearLabels({}, LightWrist(), truth), "coulomb_friction");
  EXPECT_EQ(coulomb["joints"].size(), 2u);
  EXPECT_FALSE(coulomb["parameters"].contains(joint));
  EXPECT_EQ(coulomb["optional_joints"], json({joint}));
}

TEST(ProofOrdinary, TheMotorBehindASpringIsTheRotorThatTheJointHad) {
  const Truth before = Geared({});
  for (const char* id : {"joint_elasticity", "backlash"}) {
    for (uint64_t seed = 1; seed < 10; ++seed) {
      Truth truth = before;
      const auto entry = AddExtra(id, 1, LightWrist(), Rng(seed), &truth);
      ASSERT_TRUE(entry);
      const std::string joint = (*entry)["joints"][0];
      EXPECT_NE(joint, "wrist") << "a link of a hundredth of its rotor";
      const size_t i = joint == "base" ? 0 : 1;
      EXPECT_EQ(truth.joint[i].transmission.motor_inertia, before.joint[i].armature);
      EXPECT_EQ(truth.joint[i].armature, 0);
      EXPECT_EQ((*entry)["parameters"][joint]["motor_inertia"]["value"], before.joint[i].armature);
      const json effects = GearLabels({}, LightWrist(), truth);
      EXPECT_EQ((*Find(effects, "rotor_inertia"))["joints"].size(), 2u);
    }
  }
}

TEST(ProofOrdinary, AGainIsToldFromAJointWhoseOwnFrictionAndRotorAreLarger) {
  Truth truth = Geared({});
  const auto entry = AddExtra("torque_gain", 1, LightWrist(), Rng(5), &truth);
  ASSERT_TRUE(entry);
  EXPECT_LT((*entry)["joints"].size(), 3u) << "of all joints it is larger masses, friction and rotors";
  const auto siblings = OrdinarySiblings(truth, *entry, LightWrist(), Eigen::Vector3d::Ones());
  ASSERT_EQ(siblings.size(), 1u);
  for (size_t i = 0; i < 3; ++i) {
    const JointTruth &own = truth.joint[i], &other = siblings[0].joint[i];
    EXPECT_EQ(other.gain, 1);
    EXPECT_DOUBLE_EQ(other.armature * own.gain, own.armature);
    EXPECT_DOUBLE_EQ(other.viscous * own.gain, own.viscous);
    EXPECT_DOUBLE_EQ(other.dry.coulomb_negative * own.gain, own.dry.coulomb_negative);
  }
}

TEST(ProofOrdinary, ALawOfAllJointsIsToldFromOneLevelOnAll) {
  const Ordinary ordinary{.friction = "stribeck_friction"};
  const Truth truth = Geared(ordinary);
  const json entry = *Find(GearLabels(ordinary, LightWrist(), truth), "stribeck_friction");
  const auto siblings = OrdinarySiblings(truth, entry, LightWrist(), Eigen::Vector3d::Ones());
  ASSERT_GT(siblings.size(), 1u);
  for (const Truth& sibling : siblings) {
    for (size_t i = 0; i < 3; ++i) {
      EXPECT_EQ(sibling.joint[i].dry.static_extra, 0);
      EXPECT_GE(sibling.joint[i].dry.coulomb_positive, truth.joint[i].dry.coulomb_positive);
      EXPECT_EQ(sibling.joint[i].viscous, truth.joint[i].viscous);
    }
  }
}

TEST(ProofOrdinary, OnlyWhatCanBeToldThereIsTheOneThingMore) {
  const auto has = [](const std::vector<std::string>& list, const char* id) {
    return std::find(list.begin(), list.end(), id) != list.end();
  };
  const auto slow = OrdinaryExtras("arm6", 50, {}), fast = OrdinaryExtras("arm6", 100, {}),
             wrong = OrdinaryExtras("arm6", 100, {.wrong_bodies = true}),
             one = OrdinaryExtras("pendulum", 500, {});
  EXPECT_FALSE(has(slow, "backlash"));
  EXPECT_TRUE(has(fast, "backlash") && has(fast, "gravity_misalignment") && has(fast, "payload"));
  EXPECT_FALSE(has(wrong, "gravity_misalignment") || has(wrong, "torque_gain"));
  EXPECT_FALSE(has(one, "payload") || has(one, "joint_coupling"));
  EXPECT_FALSE(
      has(OrdinaryExtras("arm6", 100, {.friction = "stribeck_friction"}), "load_dependent_friction"));
}

TEST(ProofOrdinary, TwoThirdsHaveOneThingMoreAndAThirdOfControlsNoRotors) {
  int more = 0, late = 0, wrong = 0, rotorless = 0;
  std::set<std::string> extras, laws;
  constexpr int kDraws = 600;
  for (uint64_t seed = 0; seed < kDraws; ++seed) {
    const Ordinary drawn = DrawOrdinary("arm6", 200, Rng(seed)), declared = DrawDeclared(Rng(seed));
    more += !drawn.extra.empty(), late += !drawn.timing.empty(), wrong += drawn.wrong_bodies;
    if (!drawn.extra.empty()) extras.insert(drawn.extra);
    laws.insert(drawn.friction);
    EXPECT_TRUE(drawn.rotors);
    rotorless += !declared.rotors;
    EXPECT_TRUE(declared.rotors || declared.timing.empty()) << "a URDF has no words for late drives";
    EXPECT_FALSE(declared.wrong_bodies || !declared.extra.empty() || declared.friction != "coulomb_friction");
  }
  EXPECT_NEAR(more / double{kDraws}, 2.0 / 3, 0.07);
  EXPECT_NEAR(late / double{kDraws}, 0.55, 0.07);
  EXPECT_NEAR(wrong / double{kDraws}, 0.2, 0.06);
  EXPECT_NEAR(rotorless / double{kDraws}, 1.0 / 3, 0.07);
  EXPECT_EQ(extras.size(), 11u);
  EXPECT_EQ(laws.size(), 3u);
}

class OrdinaryCase : public ::testing::Test {
 protected:
  void TearDown() override { std::filesystem::remove_all(folder_); }
  CaseSummary Make(const CaseRequest& request) {
    const auto made = MakeCase(request, folder_ + "/sets", folder_ + "/labels");
    EXPECT_TRUE(made.ok()) << made.status().ToString();
    return made.ok() ? *made : CaseSummary{};
  }
  std::string Text(const std::string& file) const { return ReadFile(folder_ + "/" + file).value(); }
  json Read(const std::string& file) const { return json::parse(Text(file)); }

  std::string folder_ = (std::filesystem::temp_directory_path() / ("rg_ordinary_" + RandomHex(6))).string();
};

TEST_F(OrdinaryCase, ShowsEachOfItsEffectsAndDeclaresNone) {
  CaseRequest request{.name = "one", .kind = "arm2"};
  request.ordinary = Ordinary{.timing = "actuator_lag", .extra = "position_spring"};
  request.seed = 4;
  EXPECT_GT(Make(request).ratio, 3);
  const json label = Read("labels/one/label.json"), oracle = Read("labels/one/oracle.json");
  EXPECT_EQ(label["stratum"], "ordinary");
  EXPECT_EQ(label["verdict"], json({"unmodelled_physics"}));
  ASSERT_EQ(label["effects"].size(), 5u);
  EXPECT_EQ(label["effects"][4]["id"], "position_spring");
  for (const json& e : label["effects"]) {
    const std::string id = e["id"];
    EXPECT_GT(oracle["rms_without"][id].get<double>(), 1.3 * oracle["oracle_rms"].get<double>()) << id;
    if (id == "position_spring") continue;
    EXPECT_EQ(e["joints"], json({"shoulder", "elbow"})) << id;
  }
  const auto bodies = ParseBodies(Text("sets/one/robot.urdf"));
  ASSERT_TRUE(bodies.ok());
  EXPECT_EQ((*bodies)->getDof(0)->getDampingCoefficient(), 0) << "what the URDF declares is not concealed";
  EXPECT_FALSE(std::filesystem::exists(folder_ + "/sets/one/model.json"));
}

TEST_F(OrdinaryCase, DeclaredLeavesNothingToFind) {
  CaseRequest request{.name = "two", .kind = "arm2"};
  request.ordinary = Ordinary{.timing = "actuator_delay"};
  request.declared = true;
  request.seed = 6;
  EXPECT_LT(Make(request).ratio, 1.3);
  const json label = Read("labels/two/label.json"), model = Read("sets/two/model.json");
  EXPECT_EQ(label["stratum"], "declared");
  EXPECT_EQ(label["verdict"], json({"no_mismatch"}));
  EXPECT_TRUE(label["effects"].empty());
  const auto bodies = ParseBodies(Text("sets/two/robot.urdf"));
  ASSERT_TRUE(bodies.ok());
  for (size_t i : {size_t{0}, size_t{1}}) {
    EXPECT_GT((*bodies)->getDof(i)->getDampingCoefficient(), 0);
    EXPECT_GT((*bodies)->getDof(i)->getCoulombFriction(), 0);
  }
  EXPECT_EQ(model["urdf"], Text("sets/two/robot.urdf"));
  ASSERT_EQ(model["effects"].size(), 2u);
  EXPECT_EQ(model["effects"][0]["effect"], "rotor_inertia");
  EXPECT_GT(model["effects"][0]["parameters"]["elbow"]["armature"].get<double>(), 0);
  EXPECT_EQ(model["effects"][1]["effect"], "actuator_delay");
}

TEST_F(OrdinaryCase, WithoutRotorsTheUrdfSaysAll) {
  CaseRequest request{.name = "three", .kind = "pendulum"};
  request.ordinary = Ordinary{.rotors = false};
  request.declared = true;
  EXPECT_LT(Make(request).ratio, 1.3);
  EXPECT_FALSE(std::filesystem::exists(folder_ + "/sets/three/model.json"));
}

}  // namespace
}  // namespace rg::proof
