#include "services/lab/experiment_report.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "common/model/robot_model.h"
#include "tests/support/sim/plants.h"

namespace rg::lab {
namespace {

using nlohmann::json;
using ::testing::HasSubstr;
using ::testing::Not;

// A result of two rows on the two joints of arm2.
json Result(double residual, double tip, bool before_ok = true) {
  const json q = {{0.0, 0.1}, {0.0, 0.2}};
  const json judged = {{"ok", true}, {"rows", 2}, {"residual", residual}, {"accumulated_tip_m", tip}};
  json before = {{"ok", before_ok}, {"rows", 1}, {"residual", 9000.0}, {"accumulated_tip_m", 70.0}};
  return {
      {"identification",
       {{"best_cost", 0.5 * residual},
        {"before", before},
        {"after", judged},
        {"after_windows", {{"ok", true}, {"joint_rms", 0.01}}},
        {"before_windows", {{"ok", true}, {"joint_rms", 1.0}}},
        {"search", json::array({{{"seconds", {1.0, 2.0}},
                                 {"start", {9.0, nullptr}},
                                 {"cost", {2.0, 1.5}},
                                 {"accepted", {true, true}},
                                 {"whole_from", nullptr},
                                 {"search_seconds", 2.0},
                                 {"best_cost", 1.5}}})},
        {"hops", 2},
        {"identifiability",
         {{"parameters",
           {{{"name", "mass.upper"}, {"value", -0.5}}, {{"name", "damping.shoulder"}, {"value", 3.0}}}}}}}},
      {"seconds", {{"identification", 60.0}}},
      {"series", {{"t", {0.0, 0.04}}, {"measured", q}, {"before", q}, {"after", q}}}};
}

std::vector<json> ThreeRepetitions() {
  std::vector<json> out;
  for (const double r : {4.0, 2.0, 3.0}) {
    out.push_back({{"bounded", Result(10 * r, r)},
                   {"unbounded", Result(r, r)},
                   {"whole", Result(r, 0.5 * r)},
                   {"rollout", {{"ended_after_s", 8.0}}}});
  }
  return out;
}

TEST(Spread, IsMedianAndRangeOfWhatIsFinite) {
  const Spread spread = SpreadOf({3, std::nan(""), 1, 10});
  EXPECT_EQ(spread.median, 3);
  EXPECT_EQ(spread.min, 1);
  EXPECT_EQ(spread.max, 10);
  EXPECT_EQ(spread.count, 3);
  EXPECT_EQ(SpreadOf({1, 2}).median, 1.5);
  EXPECT_EQ(SpreadText(SpreadOf({3, 1, 10})), "3.00 [1.00 … 10.0]");
  EXPECT_EQ(SpreadText(SpreadOf({2})), "2.00");
  EXPECT_EQ(SpreadText(SpreadOf({})), "–");
}

TEST(ExperimentTable, HasOursWithSpreadBesideThePaper) {
  const std::string table = ExperimentTable(Experiment::kBoundedVsUnbounded, ThreeRepetitions());
  EXPECT_THAT(table, HasSubstr("15.0 [10.0 … 20.0]"));  // bounded, on the window
  EXPECT_THAT(table, HasSubstr("130.857"));
  EXPECT_THAT(table, HasSubstr("2.67"));
  EXPECT_THAT(table, HasSubstr("14.4414"));
  EXPECT_THAT(table, HasSubstr("1.50 [1.00 … 2.00]"));  // whole recording, task space
}

TEST(ExperimentRows, HoldTheSameFiguresForPrograms) {
  const json rows = ExperimentRows(Experiment::kBoundedVsUnbounded, ThreeRepetitions());
  const json& error = rows.at(3);
  EXPECT_EQ(error.at("figure"), "task-space error, accumulated");
  EXPECT_EQ(error.at("unit"), "m");
  EXPECT_EQ(error.at("arms").at("bounded").at("median"), 3.0);
  EXPECT_EQ(error.at("arms").at("unbounded").at("paper"), "10.2955");
  EXPECT_FALSE(error.at("arms").at("whole").contains("paper"));
  EXPECT_TRUE(rows.at(0).at("arms").at("whole").at("median").is_null()) << "its cost is another problem's";
}

TEST(ExperimentRows, ASimulationThatBrokeDownHasNoErrorButATime) {
  std::vector<json> repetitions = {
      {{"iteration_1", Result(3.0, 5.0, false)}, {"iteration_2", Result(2.0, 4.0)}}};
  for (const json& row : ExperimentRows(Experiment::kTwoIterations, repetitions)) {
    const json& first = row.at("arms").at("iteration_1").at("median");
    if (row.at("figure") == "residual before") {
      EXPECT_TRUE(first.is_null());
    }
    if (row.at("figure") == "simulation before breaks down after") {
      EXPECT_EQ(first, 0.04);
    }
  }
}

TEST(ExperimentTable, SurvivesRepetitionsThatLackFigures) {
  const std::string table = ExperimentTable(Experiment::kTwoIterations, {json::object()});
  EXPECT_THAT(table, HasSubstr("350155"));
  EXPECT_THAT(table, Not(HasSubstr("nan")));
}

TEST(ExperimentPage, ShowsTheBestRepetitionsPlotsAndDamping) {
  const auto robot = rg::testing::LoadRobot("arm2");
  const std::string page =
      ExperimentPage(Experiment::kBoundedVsUnbounded, ThreeRepetitions(), *robot, "simulated arm2");
  EXPECT_THAT(page, HasSubstr("Repetition 2, the best"));
  EXPECT_THAT(page, HasSubstr("End effector, z"));
  EXPECT_THAT(page, HasSubstr("whole recording"));
  EXPECT_THAT(page, HasSubstr("shoulder"));
  EXPECT_THAT(page, HasSubstr("12.12"));
  EXPECT_THAT(page, HasSubstr("search of each chain [s]"));
}

}  // namespace
}  // namespace rg::lab
