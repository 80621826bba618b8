#include "services/sysid/joint_roles.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/base/file.h"
#include "services/sysid/fit_parameters.h"
#include "services/sysid/prediction.h"
#include "services/sysid/sysid_on_set.h"
#include "tests/unit/sysid/roles_of_joints.h"
#include "tests/unit/sysid/simulated_recordings.h"

namespace rg::sysid {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

// arm2 with friction on both joints that its URDF does not declare; the third recording is held out.
recordings::RecordingSet MakeSet(const testing::MakeOptions& make) {
  const sim::Plant plant = testing::LoadPlant(
      "arm2", {effects::MakeSpec("coulomb_friction", {"shoulder", "elbow"}, {{"coulomb", 0.4}}),
               effects::MakeSpec("viscous_friction", {"shoulder"}, {{"viscous", 0.8}})});
  recordings::RecordingSet set;
  set.folder = ".";
  set.urdf_path = testing::RobotPath("arm2");
  set.urdf_text = *ReadFile(set.urdf_path);
  set.joints = plant.joint_names();
  for (int k = 0; k < 3; ++k) {
    set.recordings.push_back(testing::MakeRecording(plant, plant.parameters().Nominal(), 40 + k, make));
    set.recordings.back().joints = set.joints;
  }
  set.recordings.back().split = recordings::Split::kHoldout;
  return set;
}

const testing::MakeOptions kNoisy = {.duration_s = 8.0, .position_noise = 3e-4, .velocity_noise = 5e-3};

double FittedValue(const SysidReport& report, const std::string& name) {
  const int i = report.plant->parameters().Find(name);
  return i < 0 ? -1.0 : report.values[i];
}

TEST(PrescribedJoints, ArePredictedAsMeasuredAndCountInNoError) {
  recordings::RecordingSet set = MakeSet(kNoisy);
  testing::Prescribe(&set, 0);
  const auto plant = NominalPlant(set);
  ASSERT_TRUE(plant.ok()) << plant.status().ToString();
  ASSERT_THAT(plant->prescribed(), ElementsAre(0));
  const recordings::Recording& rec = set.recordings[0];
  for (const RestartState restart : {RestartState::kFiltered, RestartState::kMeasured}) {
    PredictionOptions options;
    options.restart = restart;
    const Prediction prediction = PredictRecording(*plant, plant->parameters().Nominal(), rec, options);
    EXPECT_EQ(prediction.q.row(0), rec.q.row(0));
    EXPECT_GT((prediction.q.row(1) - rec.q.row(1)).cwiseAbs().maxCoeff(), 1e-3) << "friction is missing";
    const PredictionError error = ErrorOf(prediction, rec);
    const long K = rec.rows() - 1;
    EXPECT_NEAR(error.rms, std::sqrt((prediction.q - rec.q).row(1).tail(K).squaredNorm() / K), 1e-12);
    EXPECT_EQ(error.joint_rms[0], 0.0);
    EXPECT_NEAR(error.joint_rms[1], error.rms, 1e-12);
  }
}

// The true model of the others, told what the shoulder did, is as good as the true model of all: the
// shoulder's own friction, which no one knows then, does not matter, its motion does.
TEST(PrescribedJoints, MoveTheOthersAsTheyDidWhenTheyWereDriven) {
  recordings::RecordingSet set = MakeSet(kNoisy);
  const sim::Plant truth =
      testing::LoadPlant("arm2", {effects::MakeSpec("coulomb_friction", {"elbow"}, {{"coulomb", 0.4}})});
  testing::Prescribe(&set, 0);
  const auto told = truth.WithRoles({"shoulder"}, {});
  ASSERT_TRUE(told.ok()) << told.status().ToString();
  for (const recordings::Recording& rec : set.recordings) {
    const PredictionError error = ErrorOf(PredictRecording(*told, told->parameters().Nominal(), rec), rec);
    EXPECT_LT(error.rms, 3e-3);
    recordings::Recording still = rec;  // what it would be if the shoulder's motion were left out
    still.q.row(0).setConstant(rec.q(0, 0));
    still.v.row(0).setZero();
    const PredictionError without =
        ErrorOf(PredictRecording(*told, told->parameters().Nominal(), still), still);
    EXPECT_GT(without.rms, 10 * error.rms);
  }
}

TEST(PrescribedJoints, LeaveIdentificationToTheOthers) {
  for (const bool velocity : {true, false}) {
    recordings::RecordingSet set = MakeSet(kNoisy);
    testing::Prescribe(&set, 0);
    if (!velocity) {
      for (recordings::Recording& r : set.recordings) r.v.resize(0, 0);
    }
    const auto report = SysidOnSet(set, {.threads = 1}, RealClock());
    ASSERT_TRUE(report.ok()) << report.status().ToString();
    EXPECT_LT(report->after_rms, 0.1 * report->before_rms);
    const double plain = FittedValue(*report, "coulomb_friction.elbow.coulomb");
    const double by_direction = 0.5 * (FittedValue(*report, "asymmetric_friction.elbow.coulomb_positive") +
                                       FittedValue(*report, "asymmetric_friction.elbow.coulomb_negative"));
    EXPECT_NEAR(std::max(plain, by_direction), 0.4, 0.06) << report->chosen;
    for (const ParameterVerdict& p : report->identifiability.parameters)
      EXPECT_THAT(p.name, Not(HasSubstr(".shoulder"))) << "nothing on it can be known";
    EXPECT_THAT(report->warnings, Contains(HasSubstr("shoulder moves as measured (prescribed)")));
  }
}

TEST(PrescribedJoints, MayHaveADriveThatCompensatesGravityBeside) {
  recordings::RecordingSet set = MakeSet(kNoisy);
  const sim::Plant truth =
      testing::LoadPlant("arm2", {effects::MakeSpec("coulomb_friction", {"elbow"}, {{"coulomb", 0.4}})});
  testing::Prescribe(&set, 0);
  const sim::Plant told = *truth.WithRoles({"shoulder"}, {});
  recordings::Recording rec = set.recordings[0];
  const auto all = DriveSignalWithGravity(rec, told, told.parameters().Nominal());
  rec.effort_command.row(1) -= all.values().row(1) - rec.effort_command.row(1);
  PredictionOptions options;
  options.effort_excludes_gravity = true;
  const Prediction prediction = PredictRecording(told, told.parameters().Nominal(), rec, options);
  EXPECT_EQ(prediction.q.row(0), rec.q.row(0));
  EXPECT_LT(ErrorOf(prediction, rec).rms, 1e-2);
}

using testing::Pendubot;

TEST(PassiveJoints, AreThoseOfZeroEffortThatTheRigidBodiesMove) {
  recordings::RecordingSet set = Pendubot();
  const auto plant = NominalPlant(set);
  ASSERT_TRUE(plant.ok()) << plant.status().ToString();
  EXPECT_TRUE(plant->IsPassive(1) && !plant->IsPassive(0));
  EXPECT_THAT(plant->options().passive, ElementsAre("elbow"));
  EXPECT_THAT(NotesOnRoles(set, *plant),
              ElementsAre(HasSubstr("elbow has no drive (passive): its effort is zero")));
  for (const FitParameter& p : EffectFitParameters(*plant)) EXPECT_THAT(p.name, Not(HasSubstr("rotor")));
  const auto report = SysidOnSet(set, {.threads = 1}, RealClock());
  ASSERT_TRUE(report.ok()) << report.status().ToString();
  EXPECT_LT(report->plant->parameters().Find("rotor_inertia.elbow.armature"), 0);
  EXPECT_GE(report->plant->effects().empty()
                ? 0
                : report->plant->parameters().Find("rotor_inertia.shoulder.armature"),
            0);
}

TEST(PassiveJoints, AreNotThoseThatSomethingMustHaveDriven) {
  const recordings::RecordingSet set = Pendubot({}, 3.0);  // pushed, but the file says nothing of it
  const auto plant = NominalPlant(set);
  ASSERT_TRUE(plant.ok()) << plant.status().ToString();
  EXPECT_THAT(plant->options().passive, IsEmpty());
}

TEST(PassiveJoints, AreWhatTheManifestSaysWhereItSaysAnything) {
  recordings::RecordingSet set = Pendubot();
  set.passive = std::vector<std::string>{};
  EXPECT_THAT(NominalPlant(set)->options().passive, IsEmpty());
  set.passive = std::vector<std::string>{"elbow"};
  for (recordings::Recording& r : set.recordings) r.effort_command.row(1).setConstant(0.7);
  const auto plant = NominalPlant(set);
  ASSERT_TRUE(plant.ok());
  EXPECT_THAT(plant->options().passive, ElementsAre("elbow"));
  EXPECT_THAT(NotesOnRoles(set, *plant), ElementsAre(HasSubstr("the manifest says so")));
  // What the file says of its effort moves nothing.
  EXPECT_LT(
      ErrorOf(PredictRecording(*plant, plant->parameters().Nominal(), set.recordings[0]), set.recordings[0])
          .rms,
      5e-3);
}

TEST(WorkPutIn, IsAllOfADriveAndNothingOfFriction) {
  VectorXd v(4);
  v << 1, -2, 0.5, 0;
  EXPECT_DOUBLE_EQ(WorkPutIn(3 * v, v), 1.0);
  EXPECT_DOUBLE_EQ(WorkPutIn(-3 * v, v), 0.0);
  EXPECT_DOUBLE_EQ(WorkPutIn(VectorXd::Zero(4), v), 0.0);
}

}  // namespace
}  // namespace rg::sysid
