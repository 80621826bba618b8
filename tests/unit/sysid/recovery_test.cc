// Parameters come back from recordings that were made with them.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <cmath>
#include <map>
#include <memory>

#include "common/math/gradient_check.h"
#include "services/sysid/identifiability.h"
#include "services/sysid/initial_regression.h"
#include "services/sysid/recording_shooting.h"
#include "tests/unit/sysid/simulated_recordings.h"

namespace rg::sysid {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

std::vector<effects::EffectSpec> Friction(const std::vector<std::string>& joints) {
  return {effects::MakeSpec("viscous_friction", joints), effects::MakeSpec("coulomb_friction", joints),
          effects::MakeSpec("rotor_inertia", joints)};
}

recordings::SensorNoise Noise(int n, double q, double v) {
  return {VectorXd::Constant(n, q), VectorXd::Constant(n, v), VectorXd::Zero(n)};
}

VectorXd Theta(const std::vector<FitParameter>& parameters, const VectorXd& values) {
  VectorXd theta(parameters.size());
  for (size_t i = 0; i < parameters.size(); ++i) theta[i] = values[parameters[i].index];
  return theta;
}

struct Arm {
  sim::Plant plant = testing::LoadPlant("arm2", Friction({"shoulder", "elbow"}));
  VectorXd truth = plant.parameters().Nominal();
  std::vector<FitParameter> parameters =
      *NamedFitParameters(plant, {"mass.forearm", "com_z.forearm", "viscous_friction.shoulder.viscous",
                                  "viscous_friction.elbow.viscous", "coulomb_friction.shoulder.coulomb",
                                  "coulomb_friction.elbow.coulomb"});
  Arm() {
    truth[parameters[0].index] *= 1.25;
    truth[parameters[1].index] *= 0.9;
    truth[parameters[2].index] = 0.3;
    truth[parameters[3].index] = 0.15;
    truth[parameters[4].index] = 0.5;
    truth[parameters[5].index] = 0.3;
    parameters[0].prior_stddev = 0.5;
    parameters[1].prior_stddev = 0.05;
    space = std::make_unique<FitSpace>(parameters);
  }
  std::unique_ptr<FitSpace> space;
};

// Windows in SIMD lanes are those one by one, and the fit does not depend on how threads share them.
TEST(RecordingShooting, EvaluatesManyWindowsAsEachAlone) {
  Arm arm;
  const auto rec =
      testing::MakeRecording(arm.plant, arm.truth, 3, {.duration_s = 5.3, .position_noise = 1e-4});
  const std::vector<FitRecording> fit{{&rec, DriveSignal(rec)}};
  const int n = arm.plant.num_joints(), P = arm.space->size();
  RecordingShooting shooting(arm.plant, arm.truth, *arm.space, fit, ScalesOf(Noise(n, 1e-4, 1e-3)),
                             {.window_s = 0.5}, 1);
  ASSERT_GT(shooting.num_windows(), 9);
  EXPECT_GT(shooting.side_by_side(), 1);
  const VectorXd theta = arm.space->nominal();
  std::vector<VectorXd> xi, r;
  std::vector<RowMatrix> dr_dtheta, dr_dxi;
  std::vector<ShootingModel::Evaluation> many(shooting.num_windows());
  for (int w = 0; w < shooting.num_windows(); ++w) {
    xi.push_back(VectorXd::Constant(shooting.window_unknowns(w), 0.1 * w));
    r.emplace_back(shooting.window_residuals(w));
    dr_dtheta.emplace_back(shooting.window_residuals(w), P);
    dr_dxi.emplace_back(shooting.window_residuals(w), shooting.window_unknowns(w));
  }
  for (int w = 0; w < shooting.num_windows(); ++w)
    many[w] = {.window = w, .xi = &xi[w], .r = &r[w], .dr_dtheta = &dr_dtheta[w], .dr_dxi = &dr_dxi[w]};
  shooting.EvaluateMany(0, theta, &many);
  for (int w = 0; w < shooting.num_windows(); ++w) {
    VectorXd one(r[w].size());
    RowMatrix one_theta = dr_dtheta[w], one_xi = dr_dxi[w];
    ASSERT_TRUE(shooting.Evaluate(0, w, theta, xi[w], &one, &one_theta, &one_xi));
    EXPECT_TRUE(many[w].ok);
    EXPECT_LT((r[w] - one).norm(), 1e-10 * (1 + one.norm())) << w;
    EXPECT_LT((dr_dtheta[w] - one_theta).norm(), 1e-10 * (1 + one_theta.norm())) << w;
    EXPECT_LT((dr_dxi[w] - one_xi).norm(), 1e-10 * (1 + one_xi.norm())) << w;
  }
}

TEST(RecordingShooting, FitsTheSameBitsOnAnyNumberOfThreads) {
  Arm arm;
  const auto rec =
      testing::MakeRecording(arm.plant, arm.truth, 3, {.duration_s = 4.0, .position_noise = 1e-4});
  const std::vector<FitRecording> fit{{&rec, DriveSignal(rec)}};
  std::vector<VectorXd> found;
  for (const int threads : {1, 2, 5}) {
    RecordingShooting shooting(arm.plant, arm.truth, *arm.space, fit,
                               ScalesOf(Noise(arm.plant.num_joints(), 1e-4, 1e-3)), {.window_s = 0.4},
                               threads);
    found.push_back(SolveShooting(ShootingProblemFor(&shooting, *arm.space), arm.space->nominal(), {},
                                  {.max_iterations = 4, .threads = threads}, StopCondition())
                        .theta);
  }
  EXPECT_EQ(found[0], found[1]);
  EXPECT_EQ(found[0], found[2]);
}

TEST(InitialRegression, FindsMassesAndFrictionFromPositionsAlone) {
  Arm arm;
  const auto rec = testing::MakeRecording(
      arm.plant, arm.truth, 1, {.duration_s = 20.0, .position_noise = 1e-4, .with_velocity = false});
  const std::vector<FitRecording> fit{{&rec, DriveSignal(rec)}};
  const auto start = RegressInverseDynamics(arm.plant, arm.plant.parameters().Nominal(), *arm.space,
                                            arm.space->nominal(), fit);
  const VectorXd expected = Theta(arm.parameters, arm.truth);
  for (size_t i = 0; i < arm.parameters.size(); ++i) {
    EXPECT_NEAR(start.theta[i], expected[i], 0.15 * std::abs(expected[i])) << arm.parameters[i].name;
  }
}

TEST(InitialRegression, KeepsItsBounds) {
  Arm arm;
  const auto rec = testing::MakeRecording(arm.plant, arm.plant.parameters().Nominal(), 1,
                                          {.duration_s = 10.0, .position_noise = 1e-3});
  const std::vector<FitRecording> fit{{&rec, DriveSignal(rec)}};
  const auto start = RegressInverseDynamics(arm.plant, arm.plant.parameters().Nominal(), *arm.space,
                                            arm.space->nominal(), fit);
  for (size_t i = 0; i < arm.parameters.size(); ++i) {
    EXPECT_GE(start.theta[i], arm.parameters[i].lower);
    EXPECT_LE(start.theta[i], arm.parameters[i].upper);
  }
}

TEST(InitialRegression, TooFewRowsGiveTheStart) {
  Arm arm;
  const auto rec = testing::MakeRecording(arm.plant, arm.truth, 1, {.duration_s = 0.05});
  const std::vector<FitRecording> fit{{&rec, DriveSignal(rec)}};
  const VectorXd nominal = arm.plant.parameters().Nominal();
  const auto start = RegressInverseDynamics(arm.plant, nominal, *arm.space, arm.space->nominal(), fit);
  EXPECT_EQ(start.rows, 0);
  EXPECT_EQ(start.theta, Theta(arm.parameters, nominal));
}

TEST(RecordingShooting, JacobiansMatchCentralDifferences) {
  Arm arm;
  // Smooth forces only: differences across a reversal of Coulomb friction are no derivative.
  arm.truth[arm.parameters[4].index] = arm.truth[arm.parameters[5].index] = 0.0;
  const FitSpace space(std::vector<FitParameter>(arm.parameters.begin(), arm.parameters.begin() + 4));
  const auto rec = testing::MakeRecording(arm.plant, arm.truth, 2, {.duration_s = 1.0});
  const std::vector<FitRecording> fit{{&rec, DriveSignal(rec)}};
  RecordingShootingOptions options;
  options.window_s = 0.5;
  RecordingShooting model(arm.plant, arm.truth, space, fit, ScalesOf(Noise(2, 1e-3, 1e-2)), options, 1);
  ASSERT_EQ(model.num_windows(), 2);
  const VectorXd theta = Theta(space.parameters(), arm.truth);
  const int P = static_cast<int>(theta.size()), m = model.window_residuals(1), nx = model.window_unknowns(1);
  VectorXd r(m);
  RowMatrix J_t(m, P), J_x(m, nx);
  ASSERT_TRUE(model.Evaluate(0, 1, theta, VectorXd::Zero(nx), &r, &J_t, &J_x));
  VectorXd x(P + nx);
  x << theta, VectorXd::Zero(nx);
  MatrixXd J(m, P + nx);
  J << MatrixXd(J_t), MatrixXd(J_x);
  const auto f = [&](const VectorXd& y) {
    VectorXd out(m);
    RG_CHECK(model.Evaluate(0, 1, y.head(P), y.tail(nx), &out, nullptr, nullptr));
    return out;
  };
  math::GradientCheckOptions check;
  check.tolerance = 1e-5;
  const auto result = math::CheckGradient(f, x, J, check);
  EXPECT_TRUE(result) << result.message;
}

// Over many noisy recordings the truth lies within 1.96 stated deviations in about 95 % of cases.
TEST(RecordingShooting, StatedUncertaintyCoversTheTruth) {
  Arm arm;
  const std::vector<FitParameter> parameters(arm.parameters.begin(), arm.parameters.begin() + 4);
  const FitSpace space(parameters);
  VectorXd truth = arm.truth;
  truth[arm.parameters[4].index] = truth[arm.parameters[5].index] = 0.0;
  int covered = 0, total = 0;
  for (int trial = 0; trial < 25; ++trial) {
    const auto rec = testing::MakeRecording(
        arm.plant, truth, 100 + trial,
        {.duration_s = 3.0, .rate_hz = 50.0, .position_noise = 1e-3, .velocity_noise = 1e-2, .step_s = 2e-3});
    const std::vector<FitRecording> fit{{&rec, DriveSignal(rec)}};
    RecordingShootingOptions options;
    options.residual_rate_hz = 50.0;
    options.simulator.step_s = 2e-3;
    RecordingShooting model(arm.plant, truth, space, fit, ScalesOf(Noise(2, 1e-3, 1e-2)), options, 1);
    ShootingProblem problem = ShootingProblemFor(&model, space);
    problem.prior_information *= 1e-6;  // the data alone
    ShootingOptions solver;
    solver.huber = 1e9;
    const auto s = SolveShooting(problem, problem.theta0, {}, solver, {});
    const MatrixXd C = s.information.inverse();
    for (int i = 0; i < 4; ++i, ++total) {
      covered += std::abs(s.theta[i] - truth[parameters[i].index]) < 1.96 * std::sqrt(C(i, i)) ? 1 : 0;
    }
  }
  EXPECT_GE(covered, 0.87 * total);
}

TEST(RecordingShooting, RecoversFrictionAndMassFromPositionsAt25Hz) {
  Arm arm;
  const auto rec = testing::MakeRecording(
      arm.plant, arm.truth, 4,
      {.duration_s = 20.0, .rate_hz = 25.0, .position_noise = 5e-4, .with_velocity = false});
  const std::vector<FitRecording> fit{{&rec, DriveSignal(rec)}};
  const VectorXd nominal = arm.plant.parameters().Nominal();
  const auto start = RegressInverseDynamics(arm.plant, nominal, *arm.space, arm.space->nominal(), fit);
  RecordingShooting model(arm.plant, nominal, *arm.space, fit, ScalesOf(Noise(2, 5e-4, 0.02)), {}, 1);
  const ShootingProblem problem = ShootingProblemFor(&model, *arm.space);
  const auto s = SolveShooting(problem, start.theta, {}, {}, {});
  const VectorXd expected = Theta(arm.parameters, arm.truth);
  for (size_t i = 0; i < arm.parameters.size(); ++i) {
    EXPECT_NEAR(s.theta[i], expected[i], 0.08 * std::abs(expected[i])) << arm.parameters[i].name;
  }
}

TEST(Identifiability, FlagsTheLinksOfTheMicoThatCannotMoveAnything) {
  const sim::Plant plant = testing::LoadPlant("mico2");
  const VectorXd values = plant.parameters().Nominal();
  const auto rec = testing::MakeRecording(
      plant, values, 3,
      {.duration_s = 3.0, .rate_hz = 25.0, .amplitude = 0.2, .center = testing::CandlePose()});
  const std::vector<FitRecording> fit{{&rec, DriveSignal(rec)}};
  std::vector<std::string> names;
  for (const int i : PaperParameters(plant)) names.push_back(plant.parameters()[i].name);
  auto parameters = *NamedFitParameters(plant, names);
  for (FitParameter& p : parameters) p.prior_stddev = std::max(p.prior_stddev, 1e-6);
  const FitSpace space(parameters);
  RecordingShootingOptions options;
  options.window_s = 0.25;  // upright and frictionless: errors grow tenfold in 0.1 s
  RecordingShooting model(plant, values, space, fit, ScalesOf(Noise(6, 6e-4, 1e-2)), options, 1);
  ShootingOptions solver;
  solver.max_iterations = 0;
  const auto s = SolveShooting(ShootingProblemFor(&model, space), space.nominal(), {}, solver, {});
  IdentifiabilityInput in;
  const int P = static_cast<int>(parameters.size());
  ASSERT_EQ(P, 71);
  for (VectorXd* v : {&in.value, &in.nominal, &in.lower, &in.upper, &in.prior_stddev}) v->resize(P);
  for (int i = 0; i < P; ++i) {
    in.names.push_back(parameters[i].name);
    in.units.push_back(parameters[i].unit);
    in.value[i] = in.nominal[i] = parameters[i].nominal;
    in.lower[i] = -1e300;
    in.upper[i] = 1e300;
    in.prior_stddev[i] = parameters[i].prior_stddev;
  }
  ASSERT_EQ(s.failed_windows, 0);
  ASSERT_GT(s.information.trace(), 0.0);
  in.information = s.information;
  const auto report = Identify(in);
  std::map<std::string, Verdict> verdicts;
  for (const auto& p : report.parameters) verdicts[p.name] = p.verdict;
  for (const char* link : {"world", "root", "link_base"}) {
    for (const char* kind : {"mass.", "inertia_xx.", "inertia_yy.", "inertia_zz."}) {
      EXPECT_EQ(verdicts.at(std::string(kind) + link), Verdict::kUnseen) << kind << link;
    }
  }
  EXPECT_LT(report.determined, 71 - 12);
  EXPECT_GT(report.determined, 10);
  EXPECT_FALSE(report.correlations.empty()) << "fingers and hand move as one body";
}

}  // namespace
}  // namespace rg::sysid
