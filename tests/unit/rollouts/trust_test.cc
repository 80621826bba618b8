#include "services/rollouts/trust.h"

#include <gtest/gtest.h>

namespace rg::rollouts {
namespace {

TEST(Trust, GrowsWithWhatRanToItsEndAndEndsAtOne) {
  double trust = 0.0;
  for (const double expected : {0.25, 0.5, 0.75, 1.0, 1.0}) {
    trust = TrustAfter(trust, "completed", true);
    EXPECT_EQ(trust, expected);
  }
}

TEST(Trust, TheFenceHalvesItAnUnconfirmedStopTakesItAPersonsStopSaysNothing) {
  EXPECT_EQ(TrustAfter(0.5, "velocity_limit", true), 0.25);
  EXPECT_EQ(TrustAfter(0.5, "controller_nan", true), 0.25);
  EXPECT_EQ(TrustAfter(1.0, "completed", false), 0.0);
  for (const char* reason : {"operator_stop", "driver_lost", "interrupted", "stale_state", "not_started", ""})
    EXPECT_EQ(TrustAfter(0.5, reason, true), 0.5) << reason;
}

TEST(Trust, WhatASlowerMotionMayAvoidIsMadeAgain) {
  for (const char* reason : {"velocity_limit", "position_limit", "torque_limit", "task_space_limit", "missed_deadlines"})
    EXPECT_TRUE(MayBeMadeAgain(reason)) << reason;
  for (const char* reason : {"completed", "operator_stop", "driver_lost", "controller_nan", "frozen_state", ""})
    EXPECT_FALSE(MayBeMadeAgain(reason)) << reason;
}

TEST(Trust, FirstRolloutsAreShortAndSlow) {
  const FirstRollouts first{.duration_s = 2.0, .speed = 0.4};
  EXPECT_EQ(first.DurationOf(6.0, 0.0), 2.0);
  EXPECT_EQ(first.DurationOf(6.0, 0.5), 4.0);
  EXPECT_EQ(first.DurationOf(6.0, 1.0), 6.0);
  EXPECT_EQ(first.DurationOf(1.0, 0.0), 1.0) << "a job may ask for less";
  EXPECT_DOUBLE_EQ(first.SpeedOf(0.0), 0.4);
  EXPECT_DOUBLE_EQ(first.SpeedOf(0.5), 0.7);
  EXPECT_DOUBLE_EQ(first.SpeedOf(7.0), 1.0);
  EXPECT_EQ(FirstRollouts().DurationOf(6.0, 0.0), 6.0);
  EXPECT_EQ(FirstRollouts().SpeedOf(0.0), 1.0);
}

}  // namespace
}  // namespace rg::rollouts
