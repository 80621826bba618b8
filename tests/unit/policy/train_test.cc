#include "services/policy/train.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <set>

#include "common/base/rng.h"

namespace rg::policy {
namespace {

using ::testing::HasSubstr;

// Points of u = K (goal − q) − D v for `joints` joints, trajectories of ten points.
Dataset FeedbackLaw(int joints, int trajectories, uint64_t seed = 1, double unit_in = 1.0,
                    double unit_out = 1.0) {
  Rng rng(seed);
  Dataset dataset;
  for (int k = 0; k < trajectories; ++k) {
    const auto random = [&](double size) {
      return Eigen::MatrixXd(Eigen::MatrixXd::NullaryExpr(joints, 10, [&] { return size * rng.Normal(); }));
    };
    const Eigen::MatrixXd q = random(1.0), v = random(0.5);
    const Eigen::VectorXd goal = random(1.0).col(0);
    const Eigen::MatrixXd u = 4.0 * (goal.replicate(1, 10) - q) - 1.5 * v;
    dataset.AddTrajectory(static_cast<uint64_t>(k), unit_in * q, unit_in * v, unit_in * goal, unit_out * u);
  }
  return dataset;
}

TrainOptions Small(int epochs = 60) {
  TrainOptions options;
  options.hidden = {32, 32};
  options.epochs = epochs;
  options.learning_rate = 3e-3;
  return options;
}

TEST(Train, LearnsAFeedbackLawOnTrajectoriesItHasNotSeen) {
  const auto result = Train(FeedbackLaw(2, 300), Small());
  ASSERT_TRUE(result.ok()) << result.status().ToString();
  EXPECT_EQ(result->termination, Termination::kCompleted);
  EXPECT_LT(result->train_loss, 2e-3);
  EXPECT_LT(result->validation_loss, 4e-3);
  // The error in N·m goes with the loss: outputs have a standard deviation of about 5.7.
  ASSERT_EQ(result->validation_rms.size(), 2u);
  EXPECT_LT(result->validation_rms[0], 0.4);
  EXPECT_GT(result->validation_rms[0], 0.0);
}

TEST(Train, KeepsALearningCurveThatFalls) {
  const auto result = Train(FeedbackLaw(2, 100), Small(20));
  ASSERT_TRUE(result.ok());
  const auto& curve = result->policy.record().curve;
  ASSERT_EQ(curve.size(), 20u);
  EXPECT_LT(curve[4].train, 0.5 * curve[0].train);
  EXPECT_LT(curve[19].train, 0.5 * curve[4].train);
  EXPECT_LT(curve[19].validation, 0.5 * curve[0].validation);
  EXPECT_EQ(result->policy.record().points, 900);
  EXPECT_EQ(result->policy.record().validation_points, 100);
}

TEST(Train, GivesTheSameBitsForTheSameSeedAndOthersForAnother) {
  const Dataset dataset = FeedbackLaw(3, 40);
  TrainOptions options = Small(3);
  const auto first = Train(dataset, options), second = Train(dataset, options);
  options.seed = 2;
  const auto other = Train(dataset, options);
  ASSERT_TRUE(first.ok() && second.ok() && other.ok());
  EXPECT_EQ(SerializePolicy(first->policy), SerializePolicy(second->policy));
  EXPECT_NE(first->policy.parts().network.parameters(), other->policy.parts().network.parameters());
}

TEST(Train, AgreesAcrossInstructionSetsAfterAFewSteps) {
  const Dataset dataset = FeedbackLaw(3, 20);
  TrainOptions options = Small(2);
  options.kernels = KernelsBaseline();
  const auto plain = Train(dataset, options);
  ASSERT_TRUE(plain.ok());
  for (const Kernels* kernels : {KernelsAvx2(), KernelsAvx512()}) {
    if (!kernels) continue;
    options.kernels = kernels;
    const auto wide = Train(dataset, options);
    ASSERT_TRUE(wide.ok());
    EXPECT_NEAR(wide->train_loss, plain->train_loss, 1e-3 * plain->train_loss) << kernels->name;
  }
}

TEST(Train, IsBlindToUnits) {
  // Powers of two scale without rounding, so the network must come out the same to the last bit.
  const auto plain = Train(FeedbackLaw(2, 40), Small(5));
  const auto scaled = Train(FeedbackLaw(2, 40, 1, 1024.0, 1.0 / 64.0), Small(5));
  ASSERT_TRUE(plain.ok() && scaled.ok());
  EXPECT_EQ(plain->policy.parts().network.parameters(), scaled->policy.parts().network.parameters());
  const std::vector<double> x = {0.3, -0.2, 0.1, 0.4, 1.0, -1.0};
  std::vector<double> x_scaled(x), u(2), u_scaled(2);
  for (double& value : x_scaled) value *= 1024.0;
  ASSERT_TRUE(plain->policy.Evaluate(x, u).ok());
  ASSERT_TRUE(scaled->policy.Evaluate(x_scaled, u_scaled).ok());
  EXPECT_DOUBLE_EQ(u_scaled[0], u[0] / 64.0);
  EXPECT_DOUBLE_EQ(u_scaled[1], u[1] / 64.0);
}

TEST(Train, LeavesConstantInputsAndOutputsAtTheirMean) {
  Dataset dataset = FeedbackLaw(2, 30);
  dataset.inputs.row(3).setConstant(0.7f);
  dataset.outputs.row(1).setConstant(-2.5f);
  const auto result = Train(dataset, Small(3));
  ASSERT_TRUE(result.ok());
  std::vector<double> x(6, 0.1), u(2), moved(2);
  ASSERT_TRUE(result->policy.Evaluate(x, u).ok());
  EXPECT_DOUBLE_EQ(u[1], -2.5);
  x[3] = 100.0;
  ASSERT_TRUE(result->policy.Evaluate(x, moved).ok());
  EXPECT_EQ(moved, u);
}

TEST(Train, DoesNotSeeWholeTurnsOfAContinuousJoint) {
  TrainOptions options = Small(3);
  options.periodic_inputs = PeriodicInputs({false, true});
  EXPECT_EQ(options.periodic_inputs, (std::vector<int>{1, 5}));
  const auto result = Train(FeedbackLaw(2, 30), options);
  ASSERT_TRUE(result.ok());
  std::vector<double> x = {0.3, 1.2, 0.1, 0.4, 1.0, -1.0}, u(2), turned(2);
  ASSERT_TRUE(result->policy.Evaluate(x, u).ok());
  x[1] += 2.0 * std::numbers::pi;
  x[5] -= 4.0 * std::numbers::pi;
  ASSERT_TRUE(result->policy.Evaluate(x, turned).ok());
  EXPECT_NEAR(turned[0], u[0], 1e-4);
  x[0] += 2.0 * std::numbers::pi;
  ASSERT_TRUE(result->policy.Evaluate(x, turned).ok());
  EXPECT_GT(std::abs(turned[0] - u[0]), 1e-2);
}

TEST(Train, ReturnsWhatItHasWhenCancelled) {
  CancelToken cancel;
  int calls = 0;
  const auto progress = [&](const ProgressUpdate& update) {
    EXPECT_EQ(update.total, 50.0);
    EXPECT_THAT(update.note, HasSubstr("loss"));
    if (++calls == 3) cancel.Cancel();
  };
  const auto result = Train(FeedbackLaw(2, 40), Small(50), progress, &cancel);
  ASSERT_TRUE(result.ok());
  EXPECT_EQ(result->termination, Termination::kCancelled);
  EXPECT_EQ(result->policy.record().curve.size(), 3u);
  EXPECT_LT(result->train_loss, result->policy.record().curve[0].train);
  EXPECT_THAT(result->Message(), HasSubstr("cancelled after 3 epochs"));
}

TEST(Train, SaysInWhichEpochItDivergedAndReturnsTheOneBefore) {
  TrainOptions options = Small(50);
  options.learning_rate = 1e30;
  const auto result = Train(FeedbackLaw(2, 20), options);
  ASSERT_TRUE(result.ok());
  EXPECT_EQ(result->termination, Termination::kDiverged);
  EXPECT_EQ(result->diverged_epoch, static_cast<int>(result->policy.record().curve.size()));
  std::vector<double> u(2);
  EXPECT_TRUE(result->policy.Evaluate(std::vector<double>(6, 0.0), u).ok());
}

TEST(Train, WeightDecayMakesWeightsSmaller) {
  TrainOptions options = Small(20);
  const auto free = Train(FeedbackLaw(2, 40), options);
  options.weight_decay = 1.0;
  const auto decayed = Train(FeedbackLaw(2, 40), options);
  ASSERT_TRUE(free.ok() && decayed.ok());
  const auto norm = [](const Policy& p) {
    double sum = 0.0;
    for (const float w : p.parts().network.parameters())
      sum += static_cast<double>(w) * static_cast<double>(w);
    return sum;
  };
  EXPECT_LT(norm(decayed->policy), 0.8 * norm(free->policy));
}

TEST(Train, KeepBestReturnsTheBestValidationLossOfTheCurve) {
  TrainOptions options = Small(25);
  options.keep_best = true;
  options.schedule = Schedule::kConstant;
  options.learning_rate = 2e-2;  // noisy on purpose
  const auto result = Train(FeedbackLaw(2, 40), options);
  ASSERT_TRUE(result.ok());
  double best = 1e9;
  for (const EpochLoss& e : result->policy.record().curve) best = std::min(best, e.validation);
  EXPECT_NEAR(result->validation_loss, best, 1e-9);
}

TEST(Train, RefusesOptionsAndDataByName) {
  const Dataset dataset = FeedbackLaw(1, 5);
  const auto error = [&](const TrainOptions& options) { return Train(dataset, options).status().message(); };
  TrainOptions options = Small();
  options.epochs = 0;
  EXPECT_THAT(error(options), HasSubstr("epochs"));
  options = Small();
  options.hidden = {0};
  EXPECT_THAT(error(options), HasSubstr("hidden"));
  options = Small();
  options.batch = 0;
  EXPECT_THAT(error(options), HasSubstr("batch"));
  options = Small();
  options.learning_rate = std::nan("");
  EXPECT_THAT(error(options), HasSubstr("learning_rate"));
  options = Small();
  options.periodic_inputs = {7};
  EXPECT_THAT(error(options), HasSubstr("periodic_inputs"));
  Dataset bad = dataset;
  bad.inputs(2, 7) = std::nanf("");
  EXPECT_THAT(Train(bad, Small()).status().message(), HasSubstr("point 7, input 2"));
  EXPECT_THAT(Train(Dataset{}, Small()).status().message(), HasSubstr("empty"));
}

TEST(SplitByTrajectory, NeverTearsATrajectoryApart) {
  std::vector<uint64_t> ids;
  for (int p = 0; p < 500; ++p) ids.push_back(static_cast<uint64_t>(p / 7) * 1000);
  const DataSplit split = SplitByTrajectory(ids, 0.2, 3);
  EXPECT_EQ(split.train.size() + split.validation.size(), 500u);
  std::set<uint64_t> train, validation;
  for (const int p : split.train) train.insert(ids[static_cast<size_t>(p)]);
  for (const int p : split.validation) validation.insert(ids[static_cast<size_t>(p)]);
  EXPECT_EQ(validation.size(), 14u);  // 0.2 of 72
  for (const uint64_t id : validation) EXPECT_EQ(train.count(id), 0u);
  EXPECT_TRUE(SplitByTrajectory(ids, 0.0, 3).validation.empty());
  EXPECT_TRUE(SplitByTrajectory({5, 5, 5}, 0.5, 3).validation.empty());
}

}  // namespace
}  // namespace rg::policy
