#include "services/diagnosis/reporting/confidence.h"

#include <gtest/gtest.h>

namespace rg::diagnosis {
namespace {

Finding Named(const std::string& effect, double confidence, double rival = -100) {
  Finding f;
  f.effect = effect;
  f.confidence = confidence;
  f.alternatives.push_back({"other", {}, rival, rival < -3, ""});
  return f;
}

TEST(Confidence, NoOddsMakeAFindingSurerThanItsLikeWereRight) {
  std::vector<Finding> one = {Named("coulomb_friction", 0.999)};
  Calibrate("unmodelled_physics", Standing::kPlain, 2, &one);
  EXPECT_LT(one[0].confidence, 0.97);
  std::vector<Finding> doubtful = {Named("coulomb_friction", 0.4)};
  Calibrate("unmodelled_physics", Standing::kPlain, 2, &doubtful);
  EXPECT_EQ(doubtful[0].confidence, 0.4) << "poor odds stay poor";
}

TEST(Confidence, OfASearchThatItsTimeLimitEndedIsLow) {
  std::vector<Finding> two = {Named("coulomb_friction", 0.96), Named("payload", 0.2)};
  LimitOutOfTime(&two);
  EXPECT_LT(two[0].confidence, 0.5);
  EXPECT_EQ(two[1].confidence, 0.2);
}

TEST(Confidence, ANearRivalAndManyNamesLowerIt) {
  std::vector<Finding> near = {Named("coulomb_friction", 1, -2)};
  Calibrate("unmodelled_physics", Standing::kPlain, 2, &near);
  std::vector<Finding> many = {Named("coulomb_friction", 1), Named("payload", 1), Named("torque_gain", 1)};
  Calibrate("unmodelled_physics", Standing::kPlain, 2, &many);
  EXPECT_LE(near[0].confidence, 0.6);
  EXPECT_LE(many[0].confidence, 0.5);
}

TEST(Confidence, ARicherFormOfTheSameLawLowersItLessThanAnotherLaw) {
  const auto beside = [](const std::string& rival) {
    std::vector<Finding> f = {Named("coulomb_friction", 1, -2)};
    f[0].alternatives[0].effect = rival;
    Calibrate("unmodelled_physics", Standing::kPlain, 2, &f);
    return f[0].confidence;
  };
  EXPECT_GT(beside("stribeck_friction"), 0.7);
  EXPECT_LT(beside("stribeck_friction"), 0.8);
  EXPECT_LE(beside("viscous_friction"), 0.5);
}

TEST(Confidence, WhatDrivesShareIsSurerThanManyNamesElsewhere) {
  const auto on = [](const std::string& effect, std::vector<std::string> joints) {
    Finding f = Named(effect, 1);
    f.joints = std::move(joints);
    return f;
  };
  std::vector<Finding> arm = {on("viscous_friction", {"a", "b", "c"}),
                              on("coulomb_friction", {"a", "b", "c"}), on("actuator_lag", {"a", "b", "c"}),
                              on("position_spring", {"b"})};
  Calibrate("unmodelled_physics", Standing::kPlain, 3, &arm);
  for (int i = 0; i < 3; ++i) EXPECT_NEAR(arm[i].confidence, 0.95, 0.03) << arm[i].effect;
  EXPECT_EQ(arm[3].effect, "position_spring");
  EXPECT_LT(arm[3].confidence, 0.8) << "too few were seen to be acted on";
  std::vector<Finding> few = {on("viscous_friction", {"a"}), on("coulomb_friction", {"a"}),
                              on("actuator_lag", {"a", "b", "c"})};
  Calibrate("unmodelled_physics", Standing::kPlain, 3, &few);
  EXPECT_LE(few[0].confidence, 0.5) << "losses of one joint are no habit of drives";
}

TEST(Confidence, BesideWhatHasNoNameANameIsHardlyClaimed) {
  std::vector<Finding> both = {Named("torque_ripple", 1), Named("unknown_field", 1)};
  both[0].joints = both[1].joints = {"elbow"};
  Calibrate("unexplained", Standing::kPlain, 2, &both);
  EXPECT_EQ(both[0].effect, "unknown_field");
  EXPECT_LT(both[1].confidence, 0.3) << "a ripple is over positions too";
  std::vector<Finding> late = {Named("sensor_delay", 1), Named("unknown_field", 1)};
  late[0].shows_over = effects::Variable::kVelocity;
  Calibrate("unexplained", Standing::kPlain, 2, &late);
  EXPECT_EQ(late[0].effect, "unknown_field");
  EXPECT_GT(late[1].confidence, 0.3);
  EXPECT_LT(late[1].confidence, 0.5);
  both[0].joints = {"elbow"}, both[1].joints = {"shoulder"};
  both[0].confidence = both[1].confidence = 1;
  Calibrate("unexplained", Standing::kPlain, 2, &both);
  EXPECT_GT(both[1].confidence, 0.3) << "a ripple of another joint";
  std::vector<Finding> measured = {Named("coulomb_friction", 1), Named("unknown_field", 1)};
  Calibrate("unexplained", Standing::kMeasured, 2, &measured);
  EXPECT_EQ(measured[0].effect, "coulomb_friction") << "a real arm's friction holds whatever else remains";
}

TEST(Confidence, AForceIsHardlyClaimedToHaveNoNameWhereNoModelOfItWasFound) {
  std::vector<Finding> modelled = {Named("unknown_field", 1)}, missing = modelled, measured = modelled;
  missing[0].modelled = measured[0].modelled = false;
  Calibrate("unexplained", Standing::kPlain, 2, &modelled);
  EXPECT_NEAR(modelled[0].confidence, 0.8, 0.01);
  Calibrate("unexplained", Standing::kPlain, 2, &missing);
  EXPECT_LT(missing[0].confidence, 0.5) << "it may be several effects that were not found";
  std::vector<Finding> beside = {missing[0], Named("sensor_delay", 1)};
  beside[0].confidence = 1, beside[1].shows_over = effects::Variable::kVelocity;
  Calibrate("unexplained", Standing::kPlain, 2, &beside);
  EXPECT_EQ(beside[0].effect, "unknown_field") << "a name is no surer than that something is missing";
  EXPECT_LE(beside[1].confidence, beside[0].confidence);
  std::vector<Finding> rest = {Named("coulomb_friction", 1), missing[0]};
  rest[1].confidence = 1;
  Calibrate("unexplained", Standing::kSomeLeft, 2, &rest);
  EXPECT_NEAR(rest[1].confidence, 0.6, 0.01) << "what names leave that explain most";
  Calibrate("unexplained", Standing::kMeasured, 2, &measured);
  EXPECT_GT(measured[0].confidence, 0.5) << "no set of laws follows all that a real arm does";
}

TEST(Confidence, IsLessWhereTheRestIsBeyondTheNoise) {
  std::vector<Finding> f = {Named("joint_elasticity", 1), Named("coulomb_friction", 1),
                            Named("unknown_field", 1)};
  Calibrate("unexplained", Standing::kSomeLeft, 2, &f);
  for (const Finding& finding : f) {
    EXPECT_GT(finding.confidence, 0.5) << finding.effect;
    EXPECT_LT(finding.confidence, 0.8) << finding.effect;
  }
  std::vector<Finding> many = {Named("joint_elasticity", 1), Named("coulomb_friction", 1),
                               Named("torque_ripple", 1)};
  Calibrate("unexplained", Standing::kSomeLeft, 2, &many);
  EXPECT_LT(many[0].confidence, 0.5) << "as many names are doubted, whatever they leave";
}

TEST(Confidence, ASideRemarkComesLastAndIsNoSurerThanTheName) {
  std::vector<Finding> f = {Named("parameters_only", 1), Named("coulomb_friction", 0.7)};
  Calibrate("unmodelled_physics", Standing::kPlain, 2, &f);
  EXPECT_EQ(f[1].effect, "parameters_only");
  EXPECT_LE(f[1].confidence, f[0].confidence);
}

}  // namespace
}  // namespace rg::diagnosis
