#include "robot_agent/drivers/kinova/kinova_options.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace rg::robot_agent::kinova {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

TEST(KinovaOptions, OfAMicoNeedNothing) {
  const KinovaOptions options = ParseKinovaOptions("{}", "mico2").value();
  EXPECT_EQ(options.robot_name, "m1n6s200");
  EXPECT_EQ(options.n(), 6);
  EXPECT_THAT(options.test_torque_nm, ElementsAre(2, 4, 2, 1, 1, 1));
  EXPECT_THAT(options.continuous, ElementsAre(true, false, false, true, true, true));
}

TEST(KinovaOptions, OfAnotherArmAskForWhatIsNotKnownByHeart) {
  const auto incomplete = ParseKinovaOptions(R"({"robot_type": "j2n7s300"})", "jaco");
  EXPECT_THAT(incomplete.status().message(), HasSubstr("zero_pose_deg is missing"));
  const auto complete = ParseKinovaOptions(R"({"robot_type": "j2n7s300", "robot_name": "left",
      "zero_pose_deg": [0, 180, 0, 180, 0, 180, 0], "test_torque_nm": [4, 8, 4, 4, 2, 2, 2]})",
                                           "jaco");
  ASSERT_TRUE(complete.ok()) << complete.status().ToString();
  EXPECT_EQ(complete->n(), 7);
  EXPECT_EQ(complete->robot_name, "left");
  EXPECT_THAT(complete->continuous, ElementsAre(true, false, true, false, true, false, true));
}

TEST(KinovaOptions, RefusalsNameFieldValueAndLimit) {
  const auto message = [](const char* text) { return ParseKinovaOptions(text, "mico2").status().message(); };
  EXPECT_THAT(message(R"({"robot_typ": "m1n6s200"})"), HasSubstr("unknown field \"robot_typ\""));
  EXPECT_THAT(message(R"({"robot_type": "mico"})"), HasSubstr("robot_type is \"mico\""));
  EXPECT_THAT(message(R"({"test_torque_nm": [1, 2]})"), HasSubstr("2 entries for 6 joints"));
  EXPECT_THAT(message(R"({"test_torque_nm": [1, 2, 3, 4, 5, 60]})"), HasSubstr("60, needs 0.05 to 20"));
  EXPECT_THAT(message(R"({"command_timeout_s": 0.5})"), HasSubstr("command_timeout_s is 0.5"));
  EXPECT_THAT(message(R"({"joints": ["a"]})"), HasSubstr("joints has 1 names"));
  EXPECT_THAT(message(R"({"master": 3})"), HasSubstr("kinova: "));
}

}  // namespace
}  // namespace rg::robot_agent::kinova
