#include "services/sysid/rotor_start.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "common/dynamics/dynamics.h"
#include "services/sysid/fit_parameters.h"
#include "services/sysid/sysid_on_set.h"
#include "tests/unit/sysid/roles_of_joints.h"

namespace rg::sysid {
namespace {

using Eigen::VectorXd;
using ::testing::AllOf;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

constexpr double kRotor = 4e-3;  // kg·m²
const char* const kName = "armature.joint_tool";

TEST(RotorStart, TheModelAsGivenDoesNotRunAndSaysSo) {
  const auto set = testing::SetOf(testing::ArmWithFlange(), {}, {{kName, kRotor}}, 60, 2.0);
  const sim::Plant nominal = *NominalPlant(set);
  const VectorXd values = nominal.parameters().Nominal();
  EXPECT_FALSE(Runs(nominal, values));
  EXPECT_THAT(JointsThatDoNotRun(nominal, values), ElementsAre("joint_tool"));
  sim::Simulator simulator(nominal);
  sim::State x = simulator.MakeState(VectorXd::Zero(3), VectorXd::Zero(3));
  EXPECT_FALSE(simulator.Advance(x, VectorXd::Ones(3), 0.01).ok());
  EXPECT_FALSE(nominal.Takes("rotor_inertia", 2)) << "it is a base parameter there";
  EXPECT_TRUE(nominal.Takes("rotor_inertia", 1));
  const auto twice =
      sim::Plant::Create(nominal.shared_model(), {}, {effects::MakeSpec("rotor_inertia", {"joint_tool"})});
  EXPECT_THAT(twice.status().message(), HasSubstr("the parameter armature.joint_tool"));
}

TEST(RotorStart, IsNearWhatTheEffortsSay) {
  const auto set = testing::SetOf(testing::ArmWithFlange(), {}, {{kName, kRotor}}, 60, 4.0);
  const sim::Plant nominal = *NominalPlant(set);
  const auto started = WithRotors(set, nominal, nominal.parameters().Nominal());
  ASSERT_TRUE(started.ok()) << started.status().ToString();
  const VectorXd values = started->parameters().Nominal();
  EXPECT_NEAR(values[started->parameters().Find(kName)], kRotor, 0.3 * kRotor);
  EXPECT_TRUE(Runs(*started, values));
  // Given values stay.
  VectorXd known = nominal.parameters().Nominal();
  known[nominal.parameters().Find(kName)] = 0.02;
  const sim::Plant kept = *WithRotors(set, nominal, known);
  EXPECT_EQ(kept.parameters()[kept.parameters().Find(kName)].nominal, 0.02);
}

TEST(RotorStart, WithoutEffortsIsAPartOfWhatOthersCarry) {
  auto set = testing::SetOf(testing::ArmWithFlange(), {}, {{kName, kRotor}}, 60, 2.0);
  for (recordings::Recording& r : set.recordings) r.effort_command.row(2).setZero();
  const sim::Plant nominal = *NominalPlant(set);
  const sim::Plant started = *WithRotors(set, nominal, nominal.parameters().Nominal());
  const double start = started.parameters()[started.parameters().Find(kName)].nominal;
  EXPECT_GT(start, 1e-5);
  EXPECT_LT(start, 0.1) << "of the scale of a forearm";
}

TEST(RotorStart, IdentificationCalibratesItAndJudgesNothingBefore) {
  const auto set = testing::SetOf(testing::ArmWithFlange(),
                                  {effects::MakeSpec("coulomb_friction", {"elbow"}, {{"coulomb", 0.4}})},
                                  {{kName, kRotor}}, 61);
  const auto report = SysidOnSet(set, {.threads = 1}, RealClock());
  ASSERT_TRUE(report.ok()) << report.status().ToString();
  EXPECT_TRUE(std::isnan(report->before_rms) && std::isnan(report->fit_before_rms));
  EXPECT_TRUE(std::isnan(report->holdout[0].before_rms));
  EXPECT_EQ(report->traces[0].before.size(), 0);
  EXPECT_LT(report->after_rms, 2e-2);
  EXPECT_EQ(report->candidates[0].parameters, 1) << "the rotor is part of the simplest model";
  EXPECT_NEAR(report->values[report->plant->parameters().Find(kName)], kRotor, 0.1 * kRotor);
  EXPECT_THAT(report->warnings, Contains(AllOf(HasSubstr("joint_tool moves link tool"),
                                               HasSubstr("has no inertia about its axis"))));
  const auto json = SysidToJson(*report);
  EXPECT_TRUE(json["holdout"]["before_rms"].is_null());
  EXPECT_TRUE(json["holdout"]["after_rms"].is_number());
  EXPECT_THAT(FormatSysid(*report), HasSubstr("cannot run"));

  // What was found is a model like any other.
  SysidOptions again{.threads = 1};
  again.model = sim::ModelFile{*report->plant, report->values};
  const auto second = SysidOnSet(set, again, RealClock());
  ASSERT_TRUE(second.ok()) << second.status().ToString();
  EXPECT_NEAR(second->before_rms, report->after_rms, 0.3 * report->after_rms);
  EXPECT_EQ(second->candidates[0].name, "nominal");
}

// A rod that turns with the elbow: its weight and inertia are in the elbow's equation.
TEST(FollowingJoints, AreIdentifiedAndPredictedWithTheirDrivers) {
  const auto set =
      testing::SetOf(testing::ArmWithLinkage(),
                     {effects::MakeSpec("coulomb_friction", {"elbow"}, {{"coulomb", 0.5}})}, {}, 62);
  ASSERT_EQ(set.joints.size(), 2u);
  const sim::Plant nominal = *NominalPlant(set);
  ASSERT_EQ(nominal.model().followers().size(), 1u);
  ASSERT_EQ(nominal.num_joints(), 2);
  const auto report = SysidOnSet(set, {.threads = 1}, RealClock());
  ASSERT_TRUE(report.ok()) << report.status().ToString();
  EXPECT_LT(report->after_rms, 0.1 * report->before_rms);
  const auto& table = report->plant->parameters();
  const int plain = table.Find("coulomb_friction.elbow.coulomb");
  const int forward = table.Find("asymmetric_friction.elbow.coulomb_positive");
  ASSERT_TRUE(plain >= 0 || forward >= 0) << report->chosen;
  EXPECT_NEAR(report->values[plain >= 0 ? plain : forward], 0.5, 0.06) << report->chosen;
  EXPECT_NEAR(report->values[table.Find("mass.rod")], 1.5, 0.5);
}

}  // namespace
}  // namespace rg::sysid
