#include "services/sysid/base_parameters.h"

#include <gtest/gtest.h>

#include <cmath>
#include <map>

#include "services/sysid/identifiability.h"
#include "services/sysid/recording_shooting.h"
#include "services/sysid/shooting_fit.h"
#include "tests/unit/sysid/simulated_recordings.h"

namespace rg::sysid {
namespace {

using Eigen::VectorXd;

// What a noisy recording of a robot determines of its inertial parameters at their true values.
IdentifiabilityReport ReportOf(const std::string& robot, double amplitude, const VectorXd& center = {},
                               const std::string& also = {}) {
  std::vector<effects::EffectSpec> effects;
  if (!also.empty()) effects.push_back(effects::MakeSpec(also, testing::LoadPlant(robot).joint_names()));
  const sim::Plant plant = testing::LoadPlant(robot, effects);
  const VectorXd values = plant.parameters().Nominal();
  const auto rec = testing::MakeRecording(plant, values, 5,
                                          {.duration_s = 10.0, .amplitude = amplitude, .center = center});
  const std::vector<FitRecording> fit{{&rec, DriveSignal(rec)}};
  std::vector<FitParameter> parameters = InertialFitParameters(plant);
  for (FitParameter& p : EffectFitParameters(plant)) parameters.push_back(std::move(p));
  const FitSpace space(parameters, false);
  const int n = plant.num_joints();
  const recordings::SensorNoise noise{VectorXd::Constant(n, 1e-4), VectorXd::Constant(n, 1e-3),
                                      VectorXd::Zero(n)};
  RecordingShootingOptions options;
  RecordingShooting model(plant, values, space, fit, ScalesOf(noise), options, 1);
  ShootingOptions look;
  look.max_iterations = 0;
  ShootingFit solved;
  solved.theta = space.nominal();
  solved.solution = SolveShooting(ShootingProblemFor(&model, space), solved.theta, {}, look, {});
  EXPECT_EQ(solved.solution.failed_windows, 0);
  solved.solution.variance_inflation = 1.0;
  return IdentifiabilityOf(space, solved);
}

const BaseParameter* Find(const IdentifiabilityReport& report, const std::string& first) {
  for (const BaseParameter& b : report.base.parameters) {
    if (b.terms.front().first == first) return &b;
  }
  return nullptr;
}

// Of two links in a vertical plane: Khalil & Dombre, Modeling, Identification and Control of Robots, 9.4.
TEST(BaseParameters, OfAPlanarArmAreThoseOfTheTextbook) {
  const auto report = ReportOf("arm2", 1.2);
  const std::map<std::string, std::map<std::string, double>> expected = {
      {"I_yy.upper_arm", {{"I_yy.upper_arm", 1.0}, {"mass.forearm", 0.35 * 0.35}}},
      {"moment_z.upper_arm", {{"moment_z.upper_arm", 1.0}, {"mass.forearm", -0.35}}},
      {"moment_x.upper_arm", {{"moment_x.upper_arm", 1.0}}},
      {"I_yy.forearm", {{"I_yy.forearm", 1.0}}},
      {"moment_z.forearm", {{"moment_z.forearm", 1.0}}},
      {"moment_x.forearm", {{"moment_x.forearm", 1.0}}}};
  ASSERT_EQ(report.base.parameters.size(), expected.size()) << FormatIdentifiability(report);
  for (const auto& [name, terms] : expected) {
    const BaseParameter* base = Find(report, name);
    ASSERT_NE(base, nullptr) << name << "\n" << FormatIdentifiability(report);
    ASSERT_EQ(base->terms.size(), terms.size()) << base->expression;
    for (const auto& [term, factor] : base->terms) EXPECT_NEAR(factor, terms.at(term), 1e-4) << term;
    EXPECT_LT(base->shrink, kDeterminedShrink) << base->expression;
    EXPECT_GT(base->stddev, 0.0);
  }
  // 0.02 + 1.8 · 0.16² + 0.35² · 1.1
  EXPECT_NEAR(Find(report, "I_yy.upper_arm")->value, 0.01999125 + 1.8 * 0.16 * 0.16 + 0.1225 * 1.1, 1e-9);
  // 20 inertial parameters, seven of them in a combination.
  EXPECT_EQ(report.base.prior_only.size(), 13u);
}

TEST(BaseParameters, ARotorOnTheFirstJointIsOneWithItsLink) {
  const auto report = ReportOf("pendulum", 1.2, {}, "rotor_inertia");
  bool together = false;
  for (const BaseParameter& b : report.base.parameters) {
    std::map<std::string, double> terms(b.terms.begin(), b.terms.end());
    together |= terms.contains("I_yy.pendulum") && terms.contains("rotor_inertia.hinge.armature") &&
                std::abs(terms["I_yy.pendulum"] / terms["rotor_inertia.hinge.armature"] - 1.0) < 1e-6;
  }
  EXPECT_TRUE(together) << FormatIdentifiability(report);
}

// However the pivots fall: along a base parameter the data say what the report says.
TEST(BaseParameters, StatedDeviationIsThatOfTheExpressionAsWritten) {
  const auto report = ReportOf("slide", 0.1, Eigen::Vector3d(0.0, 0.0, 0.12));
  ASSERT_FALSE(report.base.parameters.empty());
  std::map<std::string, int> index;
  for (size_t i = 0; i < report.parameters.size(); ++i)
    index[report.parameters[i].name] = static_cast<int>(i);
  int checked = 0;
  for (const BaseParameter& b : report.base.parameters) {
    VectorXd c = VectorXd::Zero(report.covariance.rows());
    bool masses_only = true;  // the only coordinates that are parameters themselves
    for (const auto& [name, factor] : b.terms) {
      masses_only = masses_only && name.starts_with("mass.");
      if (masses_only) c[index.at(name)] = factor;
    }
    if (!masses_only) continue;
    ++checked;
    EXPECT_NEAR(b.stddev, std::sqrt(c.dot(report.covariance * c)), 1e-6 * b.stddev) << b.expression;
  }
  EXPECT_GE(checked, 1) << "a rail carries the sum of the masses\n" << FormatIdentifiability(report);
}

TEST(BaseParameters, OfADiagonalProblemAreTheParametersThatTheDataSee) {
  IdentifiabilityInput in;
  in.names = {"a", "b", "c"};
  in.units = {"kg", "N*m", "-"};
  in.value = Eigen::Vector3d(1, 2, 3);
  in.nominal = Eigen::Vector3d(1, 1, 1);
  in.lower = Eigen::Vector3d::Constant(-1e300);
  in.upper = Eigen::Vector3d::Constant(1e300);
  in.prior_stddev = Eigen::Vector3d(1, 1, 1);
  in.information = Eigen::Vector3d(1e4, 1.0, 0.0).asDiagonal();
  const auto report = Identify(in);
  ASSERT_EQ(report.base.parameters.size(), 2u);
  EXPECT_EQ(report.base.parameters[0].expression, "a");
  EXPECT_NEAR(report.base.parameters[0].stddev, 1.0 / std::sqrt(1e4 + 1.0), 1e-12);
  EXPECT_EQ(VerdictOfShrink(report.base.parameters[1].shrink), Verdict::kWeak);
  EXPECT_EQ(report.base.prior_only, std::vector<std::string>{"c"});
}

}  // namespace
}  // namespace rg::sysid
