#include "services/diagnosis/likelihood/candidate.h"

#include <gtest/gtest.h>

#include "services/diagnosis/hypotheses/hypotheses.h"
#include "tests/unit/diagnosis/prepared_set.h"

namespace rg::diagnosis {
namespace {

// A swinging mass on a pendulum, each parameter known to a tenth of its prior.
Candidate Swinging() {
  const auto p = testing::Prepare("pendulum", {}, 31);
  Candidate c;
  c.specs = {effects::MakeSpec("sloshing_payload", {}, {{"mass", 0.05}})};
  const auto plant = sim::Plant::Create(p->nominal.shared_model(), p->nominal.options(), c.specs);
  RG_CHECK(plant.ok()) << plant.status().ToString();
  c.plant = std::make_shared<const sim::Plant>(*plant);
  c.parameters = FreeParameters(*c.plant, p->scales, false);
  const auto count = static_cast<Eigen::Index>(c.parameters.size());
  c.fit.theta.resize(count), c.fit.stddev.resize(count);
  for (Eigen::Index k = 0; k < count; ++k) {
    const sysid::FitParameter& q = c.parameters[static_cast<size_t>(k)];
    c.fit.theta[k] = std::max(0.05, 10 * q.lower), c.fit.stddev[k] = 0.1 * q.prior_stddev;
  }
  return c;
}

TEST(Candidate, IsSeenWhereItsParametersAreKnown) {
  Candidate c = Swinging();
  EXPECT_FALSE(Uninformed(c));
  for (Eigen::Index k = 0; k < c.fit.stddev.size(); ++k)
    c.fit.stddev[k] = c.parameters[static_cast<size_t>(k)].prior_stddev;
  EXPECT_TRUE(Uninformed(c));
}

TEST(Candidate, IsNotSeenWhereItsMassVanishes) {
  Candidate c = Swinging();
  bool mass = false;
  for (Eigen::Index k = 0; k < c.fit.theta.size(); ++k) {
    const sysid::FitParameter& q = c.parameters[static_cast<size_t>(k)];
    if (c.plant->parameters()[q.index].field != "mass") continue;
    mass = true;
    c.fit.theta[k] = 1.1 * q.lower;
  }
  ASSERT_TRUE(mass);
  EXPECT_TRUE(Uninformed(c));
}

// A tilt of which only its part along one axis shows: neither angle is known, that it is there is certain.
TEST(Candidate, IsStrongWhereOnlyTheSumOfItsPartsIsKnown) {
  const auto p = testing::Prepare("arm2", {}, 31);
  Candidate c;
  c.specs = {effects::MakeSpec("gravity_misalignment", {})};
  c.plant = std::make_shared<const sim::Plant>(
      *sim::Plant::Create(p->nominal.shared_model(), p->nominal.options(), c.specs));
  c.parameters = FreeParameters(*c.plant, p->scales, false);
  c.fit.ok = true, c.fit.values = c.plant->parameters().Nominal();
  c.fit.theta = Eigen::Vector2d(0.03, 1.4);
  const double along = std::cos(c.fit.theta[1]), slope = -c.fit.theta[0] * std::sin(c.fit.theta[1]);
  const Eigen::Vector2d shows(along, slope);
  c.fit.information = shows * shows.transpose() / (1e-4 * 1e-4);
  c.fit.stddev = Eigen::Vector2d(0.05, 3);
  EXPECT_NEAR(Strength(c, 0), c.fit.theta[0] * along / 1e-4, 1.0);
  EXPECT_EQ(StrongEffects(c).size(), 1u);
}

// A lag's time constant cannot be simulated down to zero.
TEST(Candidate, IsWithoutALagAtTheLeastThatIsSimulated) {
  const auto p = testing::Prepare("arm2", {}, 31);
  Candidate c;
  c.specs = {effects::MakeSpec("actuator_lag", {"shoulder"}), effects::MakeSpec("actuator_lag", {"elbow"})};
  c.plant = std::make_shared<const sim::Plant>(
      *sim::Plant::Create(p->nominal.shared_model(), p->nominal.options(), c.specs));
  EXPECT_TRUE(HasHiddenStates(c));
  EXPECT_FALSE(HasFreeStates(c)) << "the commands settle them";
  c.parameters = FreeParameters(*c.plant, p->scales, false);
  ASSERT_EQ(c.parameters.size(), 2u);
  c.fit.ok = true, c.fit.values = c.plant->parameters().Nominal();
  c.fit.theta = Eigen::Vector2d(c.parameters[0].lower, 0.02);
  c.fit.information = Eigen::Matrix2d::Identity() / (1e-7 * 1e-7);
  c.fit.stddev = Eigen::Vector2d(1e-7, 1e-7);
  ASSERT_GT(c.parameters[0].lower, 100 * c.fit.stddev[0]);
  EXPECT_LT(Strength(c, 0), kAbsent);
  const auto strong = StrongEffects(c);
  ASSERT_EQ(strong.size(), 1u);
  EXPECT_EQ(strong[0].joints[0], "elbow");
  EXPECT_TRUE(HasFreeStates(Swinging()));
}

TEST(Candidate, IsRefreshedFromAnotherWhereBothHaveAnEffect) {
  Candidate before = Swinging(), c = Swinging();
  before.fit.ok = c.fit.ok = true;
  before.fit.values = c.fit.values = c.plant->parameters().Nominal();
  const int mass = c.plant->parameters().Find("sloshing_payload.*.mass");
  ASSERT_GE(mass, 0);
  c.fit.values[mass] = 0.08;
  EXPECT_EQ(RefreshedFrom(before, c)[0].values.at("*").at("mass"), 0.08);
  c.specs[0].options["point"] = "last_link";  // another law
  EXPECT_EQ(RefreshedFrom(before, c)[0].values.at("*").at("mass"), 0.05);
}

class Rippling : public ::testing::Test {
 protected:
  // `cycles` per turn, known to `error`, on a pendulum.
  bool Repeats(double cycles, double error, bool spring = false, double chi2_per_row = 1.0, bool whole = true,
               int rows = 1, double noise_scale = 1) {
    const std::string joint = p_->nominal.joint_names()[0];
    Candidate c;
    c.specs = {effects::MakeSpec("torque_ripple", {joint}, {{"amplitude", 0.1}, {"cycles_per_rev", cycles}})};
    if (spring) c.specs.push_back(effects::MakeSpec("position_spring", {joint}, {{"stiffness", 1.0}}));
    const auto plant = sim::Plant::Create(p_->nominal.shared_model(), p_->nominal.options(), c.specs);
    RG_CHECK(plant.ok()) << plant.status().ToString();
    c.plant = std::make_shared<const sim::Plant>(*plant);
    c.parameters = FreeParameters(*c.plant, p_->scales, false);
    const auto count = static_cast<Eigen::Index>(c.parameters.size());
    c.fit.theta.setConstant(count, cycles), c.fit.stddev.setConstant(count, error);
    c.fit.rows = rows, c.fit.chi2 = chi2_per_row * rows;
    return Aperiodic(c, p_->scales, noise_scale, whole).empty();
  }
  double Turns() const { return (p_->scales.high[0] - p_->scales.low[0]) / (2 * M_PI); }

  std::unique_ptr<testing::Prepared> p_ = testing::Prepare("pendulum", {}, 32);
};

TEST_F(Rippling, IsTheSameAfterEachTurn) {
  EXPECT_TRUE(Repeats(14.02, 0.01));
  EXPECT_FALSE(Repeats(14.3, 0.01));
  EXPECT_TRUE(Repeats(14.3, 0.2));
  EXPECT_TRUE(Repeats(14.2, 0.01, false, 1.9)) << "what is left bends the period";
  EXPECT_FALSE(Repeats(14.4, 0.01, false, 1.9)) << "but not that far";
  EXPECT_FALSE(Repeats(14.2, 0.01, false, 1.05));
}

// Whether what is left is noise or not is the caller's to say.
TEST_F(Rippling, MayBeBentByWhatIsNotTakenForNoise) {
  EXPECT_FALSE(Repeats(14.2, 0.01, false, 3.6, true, 5000, 4.0));
  EXPECT_TRUE(Repeats(14.2, 0.01, false, 3.6, true, 5000, 1.0));
  EXPECT_FALSE(Repeats(14.4, 0.01, false, 3.6, true, 5000, 1.0));
}

// Ten standard deviations take off 50 nats: as many are left of 5000 rows at 1.05 beyond the noise's scatter,
// at 1.00 none are.
TEST_F(Rippling, MayBeBentByWhatLittleIsLeft) {
  EXPECT_TRUE(Repeats(14.1, 0.01, false, 1.05, true, 5000));
  EXPECT_FALSE(Repeats(14.2, 0.01, false, 1.05, true, 5000)) << "no bend of 200 nats is there to be gained";
  EXPECT_FALSE(Repeats(14.1, 0.01, false, 1.0, true, 5000));
}

TEST_F(Rippling, IsNoLessOneForWhatAnotherStepWouldBendIt) {
  // Known to a hair, as a strong ripple is: a hundredth of its amplitude, from one end to the other, is no
  // other period.
  const double hair = 0.01 / (2 * M_PI * Turns());
  EXPECT_TRUE(Repeats(14 + hair, 1e-6));
  EXPECT_FALSE(Repeats(14 + 4 * hair, 1e-6));
}

TEST_F(Rippling, IsNoneWhereItGoesThroughLessThanTwoFifthsOfAPeriod) {
  p_->scales.high[0] = p_->scales.low[0] + 2 * M_PI / 5;
  // The fit's lower limit: it wants something slower still.
  EXPECT_FALSE(Repeats(0.4 / Turns(), 1.0));
}

TEST_F(Rippling, ThatHardlyComesRoundMustBeWholeSharply) {
  p_->scales.high[0] = p_->scales.low[0] + 2 * M_PI / 5;
  ASSERT_LT(3 * Turns(), 0.75);
  EXPECT_TRUE(Repeats(3.01, 0.01));
  EXPECT_FALSE(Repeats(3.01, 0.2)) << "as would be any curve's";
  EXPECT_TRUE(Repeats(3.01, 0.2, false, 1.0, false)) << "all windows may tell it better";
  EXPECT_TRUE(Repeats(4.01, 0.2)) << "seen nearly whole";
}

// One drive that ripples is no reason to doubt another.
TEST(Candidate, ASlowRippleIsOneWhereAnotherJointsComesRound) {
  const auto p = testing::Prepare("arm2", {}, 31);
  const auto& names = p->nominal.joint_names();
  for (const int j : {0, 1}) p->scales.high[j] = p->scales.low[j] + 2 * M_PI / 5;
  const auto repeats = [&](double other, double cycles) {
    Candidate c;
    c.specs = {effects::MakeSpec("torque_ripple", {names[1]}, {{"cycles_per_rev", cycles}})};
    if (other > 0)
      c.specs.push_back(effects::MakeSpec("torque_ripple", {names[0]}, {{"cycles_per_rev", other}}));
    c.plant = std::make_shared<const sim::Plant>(
        *sim::Plant::Create(p->nominal.shared_model(), p->nominal.options(), c.specs));
    c.parameters = FreeParameters(*c.plant, p->scales, false);
    const auto count = static_cast<Eigen::Index>(c.parameters.size());
    c.fit.theta.resize(count), c.fit.stddev.setConstant(count, 0.2);
    for (Eigen::Index k = 0; k < count; ++k)
      c.fit.theta[k] = c.plant->parameters()[c.parameters[static_cast<size_t>(k)].index].nominal;
    return Aperiodic(c, p->scales, 1.0, true).empty();
  };
  EXPECT_FALSE(repeats(0, 3.01));
  EXPECT_TRUE(repeats(14.0, 3.01));
  EXPECT_FALSE(repeats(3.0, 3.01)) << "neither came round";
  EXPECT_FALSE(repeats(14.0, 1.5)) << "less than two fifths of a period";
}

TEST(Candidate, WhatStoodForAnotherLawIsNotNeededBesideIt) {
  const auto p = testing::Prepare("arm2", {}, 31);
  const auto& names = p->nominal.joint_names();
  const auto with = [&](double offset) {
    Candidate c;
    c.specs = {effects::MakeSpec("encoder_offset", {names[0]}, {{"offset", offset}}),
               effects::MakeSpec("viscous_friction", {names[1]}, {{"viscous", 0.1}})};
    c.plant = std::make_shared<const sim::Plant>(
        *sim::Plant::Create(p->nominal.shared_model(), p->nominal.options(), c.specs));
    c.parameters = FreeParameters(*c.plant, p->scales, false);
    c.fit.ok = true, c.fit.values = c.plant->parameters().Nominal();
    c.fit.theta.resize(static_cast<Eigen::Index>(c.parameters.size()));
    for (size_t k = 0; k < c.parameters.size(); ++k)
      c.fit.theta[static_cast<Eigen::Index>(k)] = c.fit.values[c.parameters[k].index];
    c.fit.information = Eigen::MatrixXd::Identity(c.fit.theta.size(), c.fit.theta.size()) * 1e8;
    return c;
  };
  const Candidate account = with(0.015);
  const auto left = StillNeeded(account, with(-0.001));
  ASSERT_EQ(left.size(), 1u);
  EXPECT_EQ(left[0].id, "viscous_friction");
  EXPECT_EQ(StillNeeded(account, with(0.005)).size(), 2u);
  Candidate whole = account, few = with(0.015);
  whole.fit.rows = 10000, few.fit.rows = 50;
  few.fit.information *= 50.0 / 10000;
  EXPECT_EQ(StillNeeded(whole, few).size(), 2u) << "of fewer windows what is as strong is known less";
  Candidate failed = with(-0.001);
  failed.fit.ok = false;
  EXPECT_EQ(StillNeeded(account, failed).size(), 2u) << "a fit that failed says nothing";
}

TEST_F(Rippling, ComesRoundTwiceBesideASpring) {
  const double once = std::ceil(std::max(3.0, 1.0 / Turns())), often = std::ceil(2.0 / Turns()) + 1;
  ASSERT_LT(once * Turns(), 2.0);
  EXPECT_TRUE(Repeats(once, 0.01));
  EXPECT_FALSE(Repeats(once, 0.01, true));
  EXPECT_TRUE(Repeats(often, 0.01, true));
}

TEST(Candidate, StribeckFrictionThatGrowsWithSpeedIsNone) {
  const auto p = testing::Prepare("pendulum", {}, 31);
  const std::string joint = p->nominal.joint_names()[0];
  Candidate c;
  c.specs = {effects::MakeSpec("stribeck_friction", {joint},
                               {{"coulomb", 0.1}, {"static", 0.2}, {"stribeck_velocity", 0.1}})};
  const auto plant = sim::Plant::Create(p->nominal.shared_model(), p->nominal.options(), c.specs);
  ASSERT_TRUE(plant.ok()) << plant.status().ToString();
  c.plant = std::make_shared<const sim::Plant>(*plant);
  c.fit.values = c.plant->parameters().Nominal();
  EXPECT_TRUE(Rising(c).empty());
  c.fit.values[c.plant->parameters().Find("stribeck_friction." + joint + ".static")] = 0.05;
  EXPECT_EQ(Rising(c), std::set<size_t>{0});
}

TEST(Candidate, AnUnnamedForceGoesOnWhereNoMotionTellsOfIt) {
  const auto p = testing::Prepare("pendulum", {}, 31);
  Candidate c;
  c.specs = {effects::MakeSpec("unknown_field", {p->nominal.joint_names()[0]},
                               {{"low", p->scales.low[0]}, {"high", p->scales.high[0]}})};
  c.specs[0].options["variable"] = "position";
  const auto plant = sim::Plant::Create(p->nominal.shared_model(), p->nominal.options(), c.specs);
  ASSERT_TRUE(plant.ok()) << plant.status().ToString();
  c.plant = std::make_shared<const sim::Plant>(*plant);
  c.parameters = FreeParameters(*plant, p->scales, false);
  c.fit.values = c.plant->parameters().Nominal();
  const auto count = static_cast<long>(c.parameters.size());
  c.fit.theta.setZero(count), c.fit.stddev.resize(count);
  std::vector<long> weights;
  for (long k = 0; k < count; ++k) {
    const sim::Parameter& parameter = c.plant->parameters()[c.parameters[static_cast<size_t>(k)].index];
    const double prior = c.parameters[static_cast<size_t>(k)].prior_stddev;
    c.fit.stddev[k] = 0.01 * prior;
    if (parameter.field[0] != 'w') continue;
    const auto node = weights.size();
    weights.push_back(k);
    if (node == 0 || node == 3 || node > 5)
      c.fit.stddev[k] = 0.99 * prior;
    else
      c.fit.theta[k] = 1.0 + static_cast<double>(node);
  }
  ASSERT_EQ(weights.size(), 8u);
  c.fit.ok = true;
  ContinueFields(&c);
  const std::vector<double> expected = {2, 2, 3, 4, 5, 6, 6, 6};
  for (size_t i = 0; i < 8; ++i) {
    EXPECT_DOUBLE_EQ(c.fit.theta[weights[i]], expected[i]) << i;
    const int at = c.parameters[static_cast<size_t>(weights[i])].index;
    // What was known already is not touched.
    const bool continued = i == 0 || i == 3 || i > 5;
    EXPECT_DOUBLE_EQ(c.fit.values[at], continued ? expected[i] : 0.0) << i;
  }
}

TEST(Candidate, ASpringThatTurnsBackSoonIsNone) {
  const auto p = testing::Prepare("pendulum", {}, 31);
  const std::string joint = p->nominal.joint_names()[0];
  const double reach = p->scales.high[0] - p->scales.low[0];
  ASSERT_GT(reach, 0.5);
  const auto pulls = [&](double stiffness, double cubic) {
    Candidate c;
    c.specs = {effects::MakeSpec("position_spring", {joint},
                                 {{"stiffness", stiffness}, {"cubic", cubic}, {"center", p->scales.low[0]}})};
    const auto plant = sim::Plant::Create(p->nominal.shared_model(), p->nominal.options(), c.specs);
    EXPECT_TRUE(plant.ok()) << plant.status().ToString();
    c.plant = std::make_shared<const sim::Plant>(*plant);
    c.fit.values = c.plant->parameters().Nominal();
    return PullsBack(c, p->scales);
  };
  EXPECT_TRUE(pulls(1.0, 0.0));
  EXPECT_TRUE(pulls(1.0, 5.0)) << "it stiffens";
  EXPECT_TRUE(pulls(1.0, -0.16)) << "as a counterbalance, whose force is a sine of the angle";
  EXPECT_TRUE(pulls(1.0, -0.3 / (reach * reach))) << "it softens and never turns back";
  EXPECT_FALSE(pulls(1.0, -20.0)) << "as a detent of ten periods a turn";
  EXPECT_TRUE(pulls(-1.0, 0.0)) << "it pushes away, which grows with the distance";
  EXPECT_TRUE(pulls(-1.0, -5.0));
  EXPECT_FALSE(pulls(-1.0, 20.0)) << "it pushes away from two points and from the one between";
}

TEST(Candidate, DrivesShareDelaysAndLossesOfMostJoints) {
  const auto arm = testing::Prepare("mico2", {}, 31);
  const auto& names = arm->nominal.joint_names();
  Candidate c;
  const auto add = [&](const char* id, size_t joints) {
    for (size_t j = 0; j < joints; ++j) c.specs.push_back(effects::MakeSpec(id, {names[j]}));
  };
  c.plant = std::make_shared<const sim::Plant>(arm->nominal);
  add("actuator_delay", 2), add("rotor_inertia", 4), add("coulomb_friction", 3), add("torque_gain", 6);
  EXPECT_TRUE(OfAllJoints(c, 0)) << "a delay of two";
  EXPECT_TRUE(OfAllJoints(c, 2)) << "rotors on four of six";
  EXPECT_FALSE(OfAllJoints(c, 6)) << "friction on three of six";
  EXPECT_FALSE(OfAllJoints(c, 9)) << "gains are no loss";
  c.specs = {effects::MakeSpec("actuator_delay", {names[0]})};
  EXPECT_FALSE(OfAllJoints(c, 0)) << "a delay of one";
}

TEST(Candidate, ALagFollowsCommandsABristleItsJointAndAMotorNeither) {
  const auto p = testing::Prepare("pendulum", {}, 31);
  const auto with = [&](std::vector<effects::EffectSpec> specs) {
    Candidate c;
    c.specs = std::move(specs);
    const auto plant = sim::Plant::Create(p->nominal.shared_model(), p->nominal.options(), c.specs);
    EXPECT_TRUE(plant.ok()) << plant.status().ToString();
    c.plant = std::make_shared<const sim::Plant>(*plant);
    return c;
  };
  const std::string joint = p->nominal.joint_names()[0];
  const Candidate lag = with({effects::MakeSpec("actuator_lag", {joint})}),
                  bristle = with({effects::MakeSpec("presliding_hysteresis", {joint})}),
                  motor = with({effects::MakeSpec("joint_elasticity", {joint})});
  EXPECT_TRUE(HasHiddenStates(lag));
  EXPECT_FALSE(HasFreeStates(lag));
  EXPECT_TRUE(HasFreeStates(bristle));
  EXPECT_FALSE(HasUnseenStates(bristle));
  EXPECT_TRUE(HasUnseenStates(motor));
  EXPECT_FALSE(HasHiddenStates(with({})));
}

// A joint that never slides would have a free force in every window, the start of its bristles.
TEST(Candidate, BristlesOfAJointThatNeverSlidesAreNoLaw) {
  const auto p = testing::Prepare("pendulum", {}, 31);
  const double range = p->scales.high[0] - p->scales.low[0];
  const auto slides = [&](double bend) {
    Candidate c;
    c.specs = {
        effects::MakeSpec("presliding_hysteresis", {p->nominal.joint_names()[0]},
                          {{"coulomb", 0.1}, {"bristle_stiffness", 0.1 / bend}, {"bristle_damping", 0.0}})};
    const auto plant = sim::Plant::Create(p->nominal.shared_model(), p->nominal.options(), c.specs);
    EXPECT_TRUE(plant.ok()) << plant.status().ToString();
    c.plant = std::make_shared<const sim::Plant>(*plant);
    c.fit.values = c.plant->parameters().Nominal();
    return Slides(c, p->scales);
  };
  EXPECT_TRUE(slides(0.05 * range));
  EXPECT_FALSE(slides(0.2 * range));
}

TEST(Candidate, AJointThatTellsLittleIsTakenToBeLikeItsFellows) {
  const auto arm = testing::Prepare("mico2", {}, 31);
  Candidate c;
  for (const std::string& joint : arm->nominal.joint_names())
    c.specs.push_back(effects::MakeSpec("viscous_friction", {joint}));
  const auto plant = sim::Plant::Create(arm->nominal.shared_model(), arm->nominal.options(), c.specs);
  ASSERT_TRUE(plant.ok()) << plant.status().ToString();
  c.plant = std::make_shared<const sim::Plant>(*plant);
  c.parameters = FreeParameters(*c.plant, arm->scales, false);
  ASSERT_EQ(c.parameters.size(), 6u);
  Eigen::VectorXd prior(6);
  for (long k = 0; k < 6; ++k) prior[k] = c.parameters[static_cast<size_t>(k)].prior_stddev;
  c.fit.theta = 0.5 * prior, c.fit.stddev = 0.01 * prior;
  c.fit.information = (0.01 * prior).cwiseAbs2().cwiseInverse().asDiagonal();
  const auto last = [&](double value, double stddev) {
    c.fit.theta[5] = value * prior[5], c.fit.stddev[5] = stddev * prior[5];
    c.fit.information(5, 5) = std::pow(stddev * prior[5], -2);
  };
  last(0.0, 0.9);
  EXPECT_TRUE(LikeOtherJoints(c, 5)) << "nothing is known of it";
  EXPECT_FALSE(Uninformed(c)) << "the others are known";
  EXPECT_EQ(StrongEffects(c).size(), 6u);
  last(0.0, 0.01);
  EXPECT_FALSE(LikeOtherJoints(c, 5)) << "it is known to have none";
  EXPECT_EQ(StrongEffects(c).size(), 5u);
  const Eigen::VectorXd theta = c.fit.theta;
  c.fit.theta.tail(4).setZero();
  EXPECT_FALSE(OfAllJoints(c, 0)) << "four of six are known to have none";
  EXPECT_EQ(StrongEffects(c).size(), 2u);
  c.fit.theta[2] = 0.5 * prior[2], c.fit.stddev.tail(3) = 0.9 * prior.tail(3);
  c.fit.information.diagonal().tail(3) = (0.9 * prior.tail(3)).cwiseAbs2().cwiseInverse();
  EXPECT_TRUE(OfAllJoints(c, 0)) << "three have it, and nothing is known of the others";
  c.fit.theta = theta, c.fit.stddev = 0.01 * prior;
  c.fit.information = (0.01 * prior).cwiseAbs2().cwiseInverse().asDiagonal();
  last(0.45, 0.3);
  EXPECT_TRUE(ClearlyNonzero(c, 5, 100.0)) << "as strong as the others, if less well known";
  c.fit.stddev = 0.9 * prior;
  EXPECT_TRUE(Uninformed(c)) << "nothing is known of any";
}

}  // namespace
}  // namespace rg::diagnosis
