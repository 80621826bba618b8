#include "services/rollouts/rollout_end.h"

#include <gtest/gtest.h>

namespace rg::rollouts {
namespace {

TEST(RolloutEnd, SaysReasonDetailAndSeconds) {
  const RolloutEnd end = HowItEnded(
      std::string(R"({"end_reason": "velocity_limit", "detail": "elbow: velocity 2.1 beyond its limit 2",
                      "ended_after_s": 1.44, "duration_s": 6, "held": true})"));
  EXPECT_FALSE(end.as_asked);
  EXPECT_EQ(end.text, "stopped by velocity_limit (elbow: velocity 2.1 beyond its limit 2) after 1.44 of 6 s");
  EXPECT_EQ(HowItEnded(std::string(R"({"end_reason": "interrupted"})")).text, "stopped by interrupted");
}

TEST(RolloutEnd, OneThatRanToItsEndIsCompleteWhereTheArmWasSeenAtRest) {
  const RolloutEnd end = HowItEnded(std::string(R"({"end_reason": "completed", "held": true, "ended_after_s": 6})"));
  EXPECT_TRUE(end.as_asked);
  EXPECT_EQ(end.text, "complete");
  const RolloutEnd latched = HowItEnded(std::string(R"({"end_reason": "completed", "held": false})"));
  EXPECT_FALSE(latched.as_asked);
  EXPECT_EQ(latched.text, "complete; the arm was not seen at rest");
}

TEST(RolloutEnd, ARecordingThatDoesNotSayHowIsNoReproach) {
  for (const char* text : {"", "{}", "[]", "no JSON", R"({"end_reason": 3})"}) {
    const RolloutEnd end = HowItEnded(std::string(text));
    EXPECT_TRUE(end.as_asked) << text;
    EXPECT_EQ(end.text, "") << text;
  }
}

}  // namespace
}  // namespace rg::rollouts
