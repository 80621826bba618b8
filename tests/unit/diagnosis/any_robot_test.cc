// Diagnosis on robots of other sizes and other joints than the Mico².
#include <gtest/gtest.h>

#include "services/diagnosis/diagnosis.h"
#include "tests/unit/diagnosis/simulated_set.h"

namespace rg::diagnosis {
namespace {

struct Case {
  const char* robot;
  const char* joint;
  double coulomb;  // beyond what the URDF declares
};

class AnyRobot : public ::testing::TestWithParam<Case> {};

TEST_P(AnyRobot, FrictionIsNamedOnItsJoint) {
  const Case& c = GetParam();
  const auto set = testing::MakeSet(
      c.robot, {effects::MakeSpec("coulomb_friction", {c.joint}, {{"coulomb", c.coulomb}})}, 31, 2.0);
  DiagnosisOptions options;
  options.threads = 2;
  const auto result = Diagnose(set, options, RealClock());
  ASSERT_TRUE(result.ok()) << result.status().ToString();
  EXPECT_EQ(result->verdict, "unmodelled_physics");
  ASSERT_FALSE(result->findings.empty());
  EXPECT_EQ(result->findings[0].effect, "coulomb_friction");
  EXPECT_EQ(result->findings[0].joints, std::vector<std::string>{c.joint});
  EXPECT_LT(result->holdout.after_rms, 0.7 * result->holdout.before_rms);
}

INSTANTIATE_TEST_SUITE_P(Robots, AnyRobot,
                         ::testing::Values(Case{"slide", "extension", 3.0}, Case{"arm7", "joint_2", 2.0}),
                         [](const auto& info) {
                           return std::string(info.param.robot) + "_" + info.param.joint;
                         });

}  // namespace
}  // namespace rg::diagnosis
