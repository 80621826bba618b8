#include "services/lab/bench.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "common/model/robot_model.h"
#include "services/lab/scaling.h"
#include "services/lab/subjects.h"
#include "tests/support/sim/plants.h"

namespace rg::lab {
namespace {

BenchOptions Quick(std::vector<std::string> only) {
  BenchOptions options;
  options.only = std::move(only);
  options.quick = true;
  return options;
}

TEST(Bench, HasTheAgreedKeysInTheirOrder) {
  std::vector<std::string> keys;
  for (const Row& row : Rows()) keys.push_back(row.key);
  EXPECT_EQ(keys,
            (std::vector<std::string>{
                "rnea_us", "aba_us", "aba_derivatives_us", "regressor_us", "step_sensitivities_us",
                "step_sensitivities_lanes_us", "step_effects_ratio", "jacobian_8s_ms", "identify_8s_s",
                "gnms_iteration_ms", "trajectory_1s_ms", "trajectories_450_s", "training_s", "iteration_s"}));
}

TEST(Bench, MeasuresCheapRowsAndNotesWhatWasMeasured) {
  const auto robot = rg::testing::LoadRobot("mico2");
  const auto out = RunBench(robot, Quick({"rnea_us", "regressor_us", "gnms_iteration_ms"}), RealClock());
  ASSERT_TRUE(out.ok()) << out.status().ToString();
  const nlohmann::json j = BenchJson(Rows(), *out);
  ASSERT_EQ(out->size(), 3u);
  for (const Measurement& m : *out) {
    EXPECT_GT(j.at(m.key).get<double>(), 0) << m.key << ": " << m.note;
    EXPECT_FALSE(j.at("notes").at(m.key).get<std::string>().empty());
    EXPECT_GT(j.at("samples").at(m.key).get<int>(), 0);
  }
  EXPECT_FALSE(j.contains("aba_us")) << "not asked for";
  EXPECT_EQ(j.at("targets").at("rnea_us"), 0.70);
}

TEST(Bench, RefusesAnUnknownKeyByName) {
  const auto out = RunBench(rg::testing::LoadRobot("arm2"), Quick({"rnea_us", "warp_us"}), RealClock());
  ASSERT_FALSE(out.ok());
  EXPECT_NE(out.status().message().find("'warp_us'"), std::string::npos);
}

TEST(Bench, ARowThatCannotBeMeasuredIsNullAndSaysWhy) {
  const auto out = RunBench(rg::testing::LoadRobot("arm2"), Quick({"iteration_s"}), RealClock());
  ASSERT_TRUE(out.ok());
  const nlohmann::json j = BenchJson(Rows(), *out);
  EXPECT_TRUE(j.at("iteration_s").is_null());
  EXPECT_EQ(j.at("notes").at("iteration_s"), "no programs to run an iteration with");
}

TEST(Bench, TakesTheIterationsTimeFromTheCaller) {
  BenchOptions options = Quick({"iteration_s"});
  options.run_iteration = [] { return Result<double>(42.0); };
  const auto out = RunBench(rg::testing::LoadRobot("arm2"), options, RealClock());
  ASSERT_TRUE(out.ok());
  EXPECT_EQ(out->front().value, 42.0);
}

TEST(Scaling, FindsTheLineAndHowMuchItExplains) {
  const ScalingLine exact = LineThrough({{1, 5}, {2, 7}, {4, 11}});
  EXPECT_DOUBLE_EQ(exact.at_zero, 3);
  EXPECT_DOUBLE_EQ(exact.slope, 2);
  EXPECT_DOUBLE_EQ(exact.r_squared, 1);
  EXPECT_LT(LineThrough({{0, 0}, {1, 1}, {2, 0}, {3, 1}}).r_squared, 0.5);
}

TEST(Scaling, MeasuresLengthsAndGrowingSubsetsOfParametersAndDrawsThem) {
  const auto robot = rg::testing::LoadRobot("mico2");
  const auto scaling = MeasureScaling(robot, true, 1);
  ASSERT_TRUE(scaling.ok()) << scaling.status().ToString();
  EXPECT_EQ(scaling->paper_parameters, 71);
  const nlohmann::json j = ScalingJson(*scaling);
  for (const auto* points : {&scaling->by_length, &scaling->by_parameters}) {
    ASSERT_GE(points->size(), 4u);
    for (size_t k = 0; k < points->size(); ++k) {
      EXPECT_GT((*points)[k].ms, 0);
      EXPECT_GT((*points)[k].x, k > 0 ? (*points)[k - 1].x : 0);
    }
  }
  EXPECT_EQ(j.at("by_length").at("points").size(), scaling->by_length.size());
  EXPECT_GT(scaling->by_parameters.back().x, 71) << "the whole table";
  const std::string svg = ScalingSvg(*scaling);
  size_t dots = 0;
  for (size_t at = 0; (at = svg.find("<circle", at)) != std::string::npos; ++at) ++dots;
  EXPECT_EQ(dots, scaling->by_length.size() + scaling->by_parameters.size());
}

TEST(Subjects, MedianOfOddAndEvenCounts) {
  EXPECT_EQ(Median({3, 1, 2}), 2);
  EXPECT_EQ(Median({4, 1, 2, 3}), 2.5);
}

TEST(Subjects, TheRecordedMotionDependsOnTheSeedOnly) {
  const sim::Plant plant = rg::testing::MakePlant("arm2");
  const Eigen::VectorXd p = DampedValues(plant);
  const recordings::Recording rec = RecordMotion(plant, p, 0.5, 1);
  EXPECT_EQ(rec.q.cols(), 51);
  EXPECT_EQ(RecordMotion(plant, p, 0.5, 1).q, rec.q) << "same seed, same recording";
  EXPECT_NE(RecordMotion(plant, p, 0.5, 2).q, rec.q);
}

}  // namespace
}  // namespace rg::lab
