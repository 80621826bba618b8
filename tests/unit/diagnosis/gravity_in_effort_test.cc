// Whether the effort carries gravity: of robots that do and do not, with all that ordinary robots have
// beside.
#include "services/diagnosis/data/gravity_in_effort.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/dynamics/dynamics.h"
#include "services/diagnosis/reporting/set_check.h"
#include "services/sysid/sysid_on_set.h"
#include "tests/unit/diagnosis/simulated_set.h"

namespace rg::diagnosis {
namespace {

using effects::MakeSpec;
using recordings::RecordingSet;
using ::testing::AllOf;
using ::testing::HasSubstr;

// The drive adds `share` of the torque that holds the arm by its own model, and leaves it out of the file.
RecordingSet InDrive(RecordingSet set, double share = 1.0) {
  const auto plant = sysid::NominalPlant(set);
  RG_CHECK(plant.ok()) << plant.status().ToString();
  const dynamics::Mechanism mechanism = sysid::MechanismOf(*plant, plant->parameters().Nominal());
  dynamics::Workspace workspace;
  Eigen::VectorXd gravity(plant->num_joints());
  for (auto& rec : set.recordings) {
    for (int k = 0; k < rec.rows(); ++k) {
      dynamics::GravityTorque(mechanism, workspace, rec.q.col(k), gravity);
      rec.effort_command.col(k) -= share * gravity;
    }
  }
  return set;
}

GravityEvidence EvidenceOf(const RecordingSet& set) {
  const auto plant = sysid::NominalPlant(set);
  RG_CHECK(plant.ok()) << plant.status().ToString();
  const auto survey = Survey(set, *plant);
  RG_CHECK(survey.ok()) << survey.status().ToString();
  return WeighGravity(*survey, *plant);
}

std::vector<effects::EffectSpec> Ordinary(const std::string& robot, double size) {
  const auto names = sysid::testing::LoadPlant(robot).joint_names();
  std::vector<effects::EffectSpec> out;
  for (const std::string& joint : names) {
    out.push_back(MakeSpec("coulomb_friction", {joint}, {{"coulomb", 0.6 * size}}));
    out.push_back(MakeSpec("viscous_friction", {joint}, {{"viscous", 0.4 * size}}));
    out.push_back(MakeSpec("rotor_inertia", {joint}, {{"armature", 0.05 * size}}));
  }
  return out;
}

// Friction of a third of gravity's torque, as most arms have less.
TEST(GravityInEffort, IsFoundInTheDriveOfOrdinaryRobots) {
  for (const char* robot : {"arm2", "mico2", "pendulum"}) {
    const double size = std::string(robot) == "pendulum" ? 0.1 : 0.3;
    const GravityEvidence e = EvidenceOf(InDrive(testing::MakeSet(robot, Ordinary(robot, size), 51)));
    EXPECT_EQ(e.side, GravitySide::kInDrive) << robot << " " << e.with << " " << e.without;
    EXPECT_GE(e.joints.size(), 1u);
  }
}

TEST(GravityInEffort, IsFoundInTheDriveWhereFrictionIsAsLargeAsGravity) {
  for (const char* robot : {"arm2", "mico2"}) {
    const auto set = testing::MakeSet(robot, Ordinary(robot, 1.0), 51);
    const GravityEvidence in_drive = EvidenceOf(InDrive(set)), in_effort = EvidenceOf(set);
    EXPECT_EQ(in_drive.side, GravitySide::kInDrive)
        << robot << " " << in_drive.with << " " << in_drive.without;
    EXPECT_NE(in_effort.side, GravitySide::kInDrive)
        << robot << " " << in_effort.with << " " << in_effort.without;
  }
}

// Its model of the arm need not be the URDF.
TEST(GravityInEffort, IsFoundWhereTheDriveCompensatesATenthTooLittle) {
  EXPECT_EQ(EvidenceOf(InDrive(testing::MakeSet("arm2", Ordinary("arm2", 0.3), 52), 0.9)).side,
            GravitySide::kInDrive);
}

TEST(GravityInEffort, IsFoundInTheEffortOfOrdinaryRobots) {
  for (const char* robot : {"arm2", "mico2", "pendulum"}) {
    const double size = std::string(robot) == "pendulum" ? 0.1 : 0.3;
    EXPECT_EQ(EvidenceOf(testing::MakeSet(robot, Ordinary(robot, size), 53)).side, GravitySide::kInEffort)
        << robot;
  }
}

// Nothing that a robot may have makes its drive a compensating one.
TEST(GravityInEffort, IsNotTakenOutOfTheEffortByAnyEffect) {
  const auto names = sysid::testing::LoadPlant("arm2").joint_names();
  for (const effects::EffectSpec& e :
       {MakeSpec("torque_gain", names, {{"gain", 2.5}}), MakeSpec("torque_gain", names, {{"gain", 0.3}}),
        MakeSpec("coulomb_friction", names, {{"coulomb", 6.0}}),
        MakeSpec("rotor_inertia", names, {{"armature", 2.0}}),
        MakeSpec("position_spring", {names[0]}, {{"stiffness", 30.0}, {"cubic", 0.0}, {"center", 0.2}}),
        MakeSpec("payload", {}, {{"mass", 2.0}, {"com_x", 0.1}}),
        MakeSpec("gravity_misalignment", {}, {{"tilt", 1.2}, {"azimuth", 0.5}}),
        MakeSpec("encoder_offset", names, {{"offset", 0.6}}),
        MakeSpec("actuator_delay", names, {{"delay", 0.05}})}) {
    const GravityEvidence of = EvidenceOf(testing::MakeSet("arm2", {e}, 54));
    EXPECT_NE(of.side, GravitySide::kInDrive) << e.id << " " << of.with << " " << of.without;
  }
}

TEST(GravityInEffort, OtherUnitsAreNoCompensation) {
  auto set = testing::MakeSet("arm2", {}, 55);
  for (auto& rec : set.recordings) rec.effort_command *= 0.02;
  EXPECT_NE(EvidenceOf(set).side, GravitySide::kInDrive);
}

// A link's centre of mass at 17 m by a slip of the pen: efforts are about neither torque.
TEST(GravityInEffort, AWrongUrdfIsNoCompensation) {
  auto set = testing::MakeSet("arm2", {}, 57);
  const size_t at = set.urdf_text.find("<origin xyz=\"0 0 -0.", set.urdf_text.find("<inertial>"));
  ASSERT_NE(at, std::string::npos);
  set.urdf_text.erase(set.urdf_text.find('.', at), 1);  // 0.2 becomes 02
  const GravityEvidence of = EvidenceOf(set);
  EXPECT_NE(of.side, GravitySide::kInDrive) << of.with << " " << of.without;
}

// So slow that only friction and gravity are in the torque.
RecordingSet Slowly(RecordingSet set, double coulomb, bool in_drive, double unit = 1.0) {
  const auto plant = sysid::NominalPlant(set);
  const dynamics::Mechanism mechanism = sysid::MechanismOf(*plant, plant->parameters().Nominal());
  dynamics::Workspace workspace;
  Eigen::VectorXd gravity(plant->num_joints());
  Rng rng(3);
  for (auto& rec : set.recordings) {
    for (int k = 0; k < rec.rows(); ++k) {
      for (int j = 0; j < rec.n(); ++j) {
        const double turn = 2 * M_PI * (0.05 + 0.02 * j);
        rec.q(j, k) = 0.6 * std::sin(turn * rec.t[k] + j);
        rec.v(j, k) = 0.6 * turn * std::cos(turn * rec.t[k] + j) + 1e-3 * rng.Normal();
        rec.effort_command(j, k) = (rec.v(j, k) > 0 ? coulomb : -coulomb) + 0.01 * rng.Normal();
      }
      dynamics::GravityTorque(mechanism, workspace, rec.q.col(k), gravity);
      if (!in_drive) rec.effort_command.col(k) += gravity;
      rec.effort_command.col(k) *= unit;
    }
  }
  set.noise = {};
  return set;
}

TEST(GravityInEffort, IsFoundInTheDriveWhereNoGainFindsItInASlowEffort) {
  const auto set = testing::MakeSet("arm2", {}, 56, 12.0);
  EXPECT_EQ(EvidenceOf(Slowly(set, 0.5, true)).side, GravitySide::kInDrive);
  EXPECT_EQ(EvidenceOf(Slowly(set, 0.5, false)).side, GravitySide::kInEffort);
  EXPECT_NE(EvidenceOf(Slowly(set, 0.5, false, 0.02)).side, GravitySide::kInDrive) << "raw currents";
}

TEST(GravityInEffort, IsUndecidedWhereNoGravityLoadsAJoint) {
  // The axes of this arm are along y.
  auto set = testing::MakeSet("arm2", {}, 57);
  set.gravity = {0, -9.81, 0};
  const GravityEvidence e = EvidenceOf(set);
  EXPECT_EQ(e.side, GravitySide::kUnclear);
  EXPECT_TRUE(e.joints.empty());
}

std::string RefusalOf(const RecordingSet& set, bool trust_effort = false) {
  const auto plant = sysid::NominalPlant(set);
  const auto check = CheckSet(set, *plant, trust_effort);
  RG_CHECK(check.ok()) << check.status().ToString();
  return check->refusal.message();
}

TEST(GravityInEffort, ContradictingTheManifestIsRefusedInOneLineWithTheRemedy) {
  auto set = InDrive(testing::MakeSet("arm2", {}, 58));
  const std::string line = RefusalOf(set);
  EXPECT_THAT(line, AllOf(HasSubstr("shoulder and elbow"), HasSubstr("\"effort_excludes_gravity\": true")));
  EXPECT_EQ(line.find('\n'), std::string::npos);
  set.effort_excludes_gravity = set.effort_excludes_gravity_given = true;
  EXPECT_EQ(RefusalOf(set), "");
}

TEST(GravityInEffort, AnExplicitFalseGoesOnWithANote) {
  auto set = InDrive(testing::MakeSet("arm2", {}, 58));
  set.effort_excludes_gravity_given = true;
  EXPECT_EQ(RefusalOf(set), "");
  const auto check = CheckSet(set, *sysid::NominalPlant(set), false);
  EXPECT_THAT(check->warnings, ::testing::Contains(HasSubstr("without gravity")));
}

TEST(GravityInEffort, DeclaredButInTheEffortIsRefusedUnlessTrusted) {
  auto set = testing::MakeSet("arm2", Ordinary("arm2", 0.3), 59);
  set.effort_excludes_gravity = set.effort_excludes_gravity_given = true;
  EXPECT_THAT(RefusalOf(set), HasSubstr("\"effort_excludes_gravity\": false"));
  EXPECT_EQ(RefusalOf(set, true), "");
}

}  // namespace
}  // namespace rg::diagnosis
