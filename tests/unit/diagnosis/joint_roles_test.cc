// Diagnoses of robots whose joints are not all driven ones.
#include "services/sysid/joint_roles.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "services/diagnosis/data/prepare_data.h"
#include "services/diagnosis/diagnosis.h"
#include "services/diagnosis/likelihood/lifted_fit.h"
#include "services/sysid/sysid_on_set.h"
#include "tests/unit/diagnosis/simulated_set.h"
#include "tests/unit/sysid/roles_of_joints.h"

namespace rg::diagnosis {
namespace {

using effects::MakeSpec;
using sysid::testing::Pendubot;
using sysid::testing::Prescribe;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

DiagnosisResult Diagnosed(const recordings::RecordingSet& set) {
  DiagnosisOptions options;
  options.threads = 2;
  auto result = Diagnose(set, options, RealClock());
  RG_CHECK(result.ok()) << result.status().ToString();
  return *result;
}

double Value(const Finding& f, const std::string& owner, const std::string& name) {
  for (const ParameterEstimate& p : f.parameters) {
    if (p.owner == owner && p.name == name) return p.value;
  }
  return NAN;
}

// What was tried, with joints: "viscous_friction (elbow)".
std::vector<std::string> Tried(const DiagnosisResult& r) {
  std::vector<std::string> out;
  for (const CandidateRow& row : r.candidates) out.push_back(row.name);
  return out;
}

TEST(PrescribedJoint, HasNoFindingsAndLeavesThoseOfTheOthers) {
  auto set =
      testing::MakeSet("arm2", {MakeSpec("coulomb_friction", {"shoulder", "elbow"}, {{"coulomb", 0.9}})}, 51);
  Prescribe(&set, 0);
  const DiagnosisResult r = Diagnosed(set);
  ASSERT_EQ(r.verdict, "unmodelled_physics");
  ASSERT_FALSE(r.findings.empty());
  EXPECT_EQ(r.findings[0].effect, "coulomb_friction");
  EXPECT_THAT(r.findings[0].joints, ElementsAre("elbow"));
  EXPECT_NEAR(Value(r.findings[0], "elbow", "coulomb"), 0.9, 0.05);
  for (const Finding& f : r.findings) EXPECT_THAT(f.joints, Not(Contains("shoulder"))) << f.effect;
  EXPECT_THAT(Tried(r), Not(Contains(HasSubstr("(shoulder"))));
  EXPECT_THAT(r.notes, Contains(HasSubstr("shoulder moves as measured (prescribed)")));
  EXPECT_THAT(r.notes, Not(Contains(HasSubstr("shoulder never moved"))));
  EXPECT_EQ(r.joint_share[0], 0.0);
  ASSERT_TRUE(r.plant);
  EXPECT_THAT(r.plant->prescribed(), ElementsAre(0));
}

TEST(PrescribedJoint, CountsInNoRowsOfTheFits) {
  auto set = testing::MakeSet("arm2", {}, 52);
  Prescribe(&set, 0);
  const sim::Plant nominal = *sysid::NominalPlant(set);
  const FitData data = *PrepareData(set, nominal, {});
  EXPECT_EQ(data.judged(), 1);
  int measured = 0;
  for (const NodeWindow& w : data.windows) {
    for (const char m : w.measured) measured += m;
    EXPECT_FALSE(w.q_stddev.row(0).allFinite());
    EXPECT_TRUE(w.q_stddev.row(1).allFinite());
  }
  EXPECT_EQ(data.Rows(), 2 * measured);
  const FitResult fit = Fit(data, FitModel{nominal, nominal.parameters().Nominal(), {}}, {.iterations = 3});
  ASSERT_TRUE(fit.ok);
  // The sensors' noise of the other joint, and what the smoothed motion's own doubt does to it: without
  // that 1.8.
  EXPECT_NEAR(fit.chi2 / fit.rows, 1.0, 0.15);
}

// Doubt about the motion of one joint is noise of the other, of every row and kind: pieces of a window have
// their part of it.
TEST(PrescribedJoint, IsInDoubtInPiecesOfWindowsToo) {
  auto set = testing::MakeSet("arm2", {}, 54);
  Prescribe(&set, 0);
  const sim::Plant nominal = *sysid::NominalPlant(set);
  FitData data = *PrepareData(set, nominal, {});
  for (const NodeWindow& w : data.windows) {
    ASSERT_GT(w.q_doubt.cols(), 0);
    EXPECT_TRUE(w.q_doubt.allFinite() && w.factor.allFinite());
    EXPECT_TRUE(w.q_doubt.topRows(2).isZero(0)) << "a window's start is free";
  }
  data.windows = InPieces(data.windows, 0.25, data.RowNoise());
  const FitResult fit = Fit(data, FitModel{nominal, nominal.parameters().Nominal(), {}}, {.iterations = 3});
  ASSERT_TRUE(fit.ok);
  EXPECT_NEAR(fit.chi2 / fit.rows, 1.0, 0.15);
}

TEST(PrescribedJoint, BesideAMeasuredEffortIsInTheBalanceOfTheOthers) {
  auto set = testing::MakeSet("arm2", {MakeSpec("coulomb_friction", {"elbow"}, {{"coulomb", 1.2}})}, 53, 6.0);
  for (recordings::Recording& r : set.recordings) {
    r.effort_measured = r.effort_command;
    for (int k = 1; k < r.rows(); ++k)
      r.effort_measured.col(k) = 0.5 * (r.effort_command.col(k - 1) + r.effort_command.col(k));
    r.effort_command.resize(0, 0);
    r.drive = recordings::EffortKind::kMeasured;
  }
  Prescribe(&set, 0);
  const DiagnosisResult r = Diagnosed(set);
  ASSERT_TRUE(r.effort_measured);
  ASSERT_FALSE(r.findings.empty());
  EXPECT_EQ(r.findings[0].effect, "coulomb_friction");
  EXPECT_THAT(r.findings[0].joints, ElementsAre("elbow"));
  EXPECT_NEAR(Value(r.findings[0], "elbow", "coulomb"), 1.2, 0.1);
  for (const Finding& f : r.findings) EXPECT_THAT(f.joints, Not(Contains("shoulder"))) << f.effect;
}

// `start`: of the recordings' times. Pushes that stand for a missing force once ended at 1e9 s, before any
// time since 1970.
void ExpectFrictionOfTheFreeJoint(double start) {
  const DiagnosisResult r =
      Diagnosed(Pendubot({MakeSpec("coulomb_friction", {"elbow"}, {{"coulomb", 0.15}})}, 0.0, start));
  ASSERT_FALSE(r.findings.empty()) << start;
  EXPECT_EQ(r.findings[0].effect, "coulomb_friction") << start;
  EXPECT_THAT(r.findings[0].joints, ElementsAre("elbow"));
  EXPECT_NEAR(Value(r.findings[0], "elbow", "coulomb"), 0.15, 0.02);
  EXPECT_THAT(r.notes, Contains(HasSubstr("elbow has no drive (passive)")));
  for (const std::string& tried : Tried(r)) {
    for (const char* id : {"joint_elasticity", "backlash", "torque_gain", "actuator_delay", "actuator_lag",
                           "torque_saturation", "rotor_inertia", "load_dependent_friction"})
      EXPECT_THAT(tried, Not(HasSubstr(std::string(id) + " (elbow"))) << tried;
  }
}

TEST(PassiveJoint, HasFrictionAndNothingOfADrive) { ExpectFrictionOfTheFreeJoint(0.0); }
TEST(PassiveJoint, HasItUnderEpochSecondsToo) { ExpectFrictionOfTheFreeJoint(1.607e9); }

TEST(LinkWithoutInertia, IsCalibratedAndNoFindingByItself) {
  const auto set = sysid::testing::SetOf(sysid::testing::ArmWithFlange(),
                                         {MakeSpec("coulomb_friction", {"elbow"}, {{"coulomb", 0.6}})},
                                         {{"armature.joint_tool", 4e-3}}, 71, 4.0);
  const DiagnosisResult r = Diagnosed(set);
  ASSERT_EQ(r.findings.size(), 1u) << r.verdict;
  EXPECT_EQ(r.findings[0].effect, "coulomb_friction");
  EXPECT_THAT(r.findings[0].joints, ElementsAre("elbow"));
  EXPECT_TRUE(std::isnan(r.holdout.before_rms));
  EXPECT_TRUE(std::isfinite(r.holdout.calibrated_rms));
  EXPECT_LT(r.holdout.after_rms, 2 * r.holdout.noise_floor_rms);
  EXPECT_NEAR(r.values[r.plant->parameters().Find("armature.joint_tool")], 4e-3, 4e-4);
  EXPECT_THAT(r.notes,
              Contains(HasSubstr("joint_tool moves link tool, which has no inertia about its axis")));
  const auto json = nlohmann::json::parse(DiagnosisJson(r));
  EXPECT_TRUE(json["fit"]["holdout"]["before_rms"].is_null());
  EXPECT_TRUE(json["fit"]["holdout"]["improvement_ci95"][0].is_null());
  EXPECT_TRUE(json["fit"]["holdout"]["calibrated_rms"].is_number());
}

TEST(LinkWithoutInertia, AloneIsNoMismatch) {
  const auto set =
      sysid::testing::SetOf(sysid::testing::ArmWithFlange(), {}, {{"armature.joint_tool", 4e-3}}, 72, 4.0);
  const DiagnosisResult r = Diagnosed(set);
  EXPECT_EQ(r.verdict, "no_mismatch");
  EXPECT_TRUE(r.findings.empty());
}

TEST(FollowingJoint, IsPartOfTheModelThatIsJudged) {
  const auto quiet = Diagnosed(sysid::testing::SetOf(sysid::testing::ArmWithLinkage(), {}, {}, 73, 4.0));
  EXPECT_EQ(quiet.verdict, "no_mismatch");
  const auto r = Diagnosed(
      sysid::testing::SetOf(sysid::testing::ArmWithLinkage(),
                            {MakeSpec("viscous_friction", {"elbow"}, {{"viscous", 0.6}})}, {}, 74, 4.0));
  ASSERT_FALSE(r.findings.empty());
  EXPECT_EQ(r.findings[0].effect, "viscous_friction");
  EXPECT_THAT(r.findings[0].joints, ElementsAre("elbow"));
  EXPECT_NEAR(Value(r.findings[0], "elbow", "viscous"), 0.6, 0.05);
}

TEST(PassiveJoint, ThatSomethingDroveIsRefusedWithTheRemedy) {
  const auto set = Pendubot({}, 3.0);
  const auto r = Diagnose(set, {.threads = 1, .work_limit = 0}, RealClock());
  ASSERT_FALSE(r.ok());
  EXPECT_THAT(r.status().message(), HasSubstr("effort_command.elbow is zero throughout"));
  EXPECT_THAT(r.status().message(), HasSubstr("\"passive\" in the manifest"));
}

}  // namespace
}  // namespace rg::diagnosis
