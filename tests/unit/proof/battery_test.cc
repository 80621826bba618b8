#include "services/proof/battery.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>

#include "common/base/file.h"
#include "common/base/ids.h"
#include "services/proof/run_record.h"

namespace rg::proof {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

class Battery : public ::testing::Test {
 protected:
  Battery() : root_(fs::temp_directory_path() / ("rg_battery_" + RandomHex(6))) {}
  ~Battery() override { fs::remove_all(root_); }

  void Write(const std::string& file, const std::string& text = "{}") const {
    ASSERT_TRUE(WriteFileAtomically(At(file), text).ok());
  }
  std::string At(const std::string& file) const { return (root_ / file).string(); }

  static json Label(const std::string& effect) {
    return {{"name", "another"},
            {"robot", "arm2"},
            {"verdict", {"unmodelled_physics"}},
            {"effects", {{{"id", effect}, {"joints", {"elbow"}}, {"localisation", "joints"}}}}};
  }
  static json Answer(const std::string& effect, double confidence, double after = 0.002) {
    return {{"verdict", "unmodelled_physics"},
            {"elapsed_s", 77.0},
            {"fit", {{"holdout", {{"before_rms", 0.1}, {"after_rms", after}, {"noise_floor_rms", 0.001}}}}},
            {"findings", {{{"effect", effect}, {"joints", {"elbow"}}, {"confidence", confidence}}}}};
  }

  fs::path root_;
};

TEST_F(Battery, FindsSetsWithTheirLabelsWhereverPeopleKeepThem) {
  Write("practice/p00/manifest.json"), Write("practice/p00/label.json");
  Write("exam/sets/case_1/manifest.json"), Write("exam/sealed/case_1/label.json");
  Write("mine/sets/case_1/manifest.json"), Write("mine/labels/case_1/label.json");
  const auto sets = FindLabelledSets({At("practice"), At("exam"), At("mine/sets")});
  ASSERT_TRUE(sets.ok()) << sets.status().ToString();
  ASSERT_EQ(sets->size(), 3u);
  EXPECT_EQ((*sets)[0].name, "p00");
  EXPECT_EQ((*sets)[1].name, "exam.case_1") << "two sets have that name";
  EXPECT_EQ((*sets)[2].name, "mine.case_1");
  EXPECT_EQ((*sets)[2].label, fs::weakly_canonical(At("mine/labels/case_1/label.json")).string());
  EXPECT_EQ(FindLabelledSets({At("practice/p00")}).value().at(0).name, "p00");
}

TEST_F(Battery, SaysWhatIsNoSetOrHasNoLabel) {
  Write("sets/one/manifest.json"), Write("empty/x");
  EXPECT_NE(FindLabelledSets({At("empty")}).status().message().find("no recording set"), std::string::npos);
  EXPECT_NE(FindLabelledSets({At("sets")}).status().message().find("one: no label.json"), std::string::npos);
  Write("sets/one/label.json");
  EXPECT_NE(FindLabelledSets({At("sets"), At("sets")}).status().message().find("one name"),
            std::string::npos);
}

TEST_F(Battery, ReadsAnAnswerWithWhatItTook) {
  Write("label.json", Label("coulomb_friction").dump());
  const LabelledSet set = {"mine", At("set"), At("label.json")};
  const auto none = MarkAnswer(set, At("a"), {});
  ASSERT_TRUE(none.ok());
  EXPECT_FALSE(none->diagnosed);
  ASSERT_TRUE(WriteRunRecord(At("a"), {set.folder, "abc", RunRecord::Outcome::kOutOfTime, 30.4, 30}).ok());
  EXPECT_EQ(MarkAnswer(set, At("a"), {})->reason, "no answer in 30 s of CPU time");
  Write("a/diagnosis.json", Answer("coulomb_friction", 0.9).dump());
  const auto late = MarkAnswer(set, At("a"), {});
  EXPECT_FALSE(late->diagnosed) << "stopped when it had written this much";
  EXPECT_EQ(late->reason, "no answer in 30 s of CPU time");
  ASSERT_TRUE(WriteRunRecord(At("a"), {set.folder, "abc", RunRecord::Outcome::kAnswered, 3.5, 30}).ok());
  const auto marks = MarkAnswer(set, At("a"), {});
  EXPECT_EQ(marks->name, "mine");
  EXPECT_EQ(marks->seconds, 3.5) << "CPU, not the clock's";
  EXPECT_NEAR(marks->over_floor.value(), 2.0, 1e-12);
  EXPECT_FALSE(Missed(*marks));
  Write("label.json", "no label");
  EXPECT_FALSE(MarkAnswer(set, At("a"), {}).ok());
}

TEST(RunRecord, ARunThatWasOutOfTimeIsMadeAgainWithMoreOfIt) {
  const RunRecord out = {"set", "abc", RunRecord::Outcome::kOutOfTime, 30, 30};
  EXPECT_TRUE(out.Settles("set", 30));
  EXPECT_TRUE(out.Settles("set", 20));
  EXPECT_FALSE(out.Settles("set", 60));
  EXPECT_FALSE(out.Settles("set", 0)) << "no limit";
  EXPECT_FALSE(out.Settles("another", 30));
  const RunRecord answered = {"set", "abc", RunRecord::Outcome::kAnswered, 3, 0};
  EXPECT_TRUE(answered.Settles("set", 0));
  EXPECT_TRUE(answered.Settles("set", 1));
  EXPECT_FALSE((RunRecord{"set", "abc", RunRecord::Outcome::kFailed, 3, 0}).Settles("set", 0));
}

CaseMarks Marks(const std::string& truth, const std::string& said, double confidence, double seconds) {
  const json label = {{"name", "x"},
                      {"robot", "arm2"},
                      {"verdict", {"unmodelled_physics"}},
                      {"effects", {{{"id", truth}, {"joints", {"elbow"}}, {"localisation", "joints"}}}}};
  const json answer = {{"verdict", "unmodelled_physics"},
                       {"findings", {{{"effect", said}, {"joints", {"elbow"}}, {"confidence", confidence}}}}};
  CaseMarks marks = Mark(label, said.empty() ? json(nullptr) : answer, {}).value();
  marks.seconds = seconds;
  return marks;
}

TEST(BatterySums, CountWhatWasSureAndWrongAndWhatHadNoAnswer) {
  const auto sums =
      SumByStratum({Marks("coulomb_friction", "coulomb_friction", 0.9, 2),
                    Marks("coulomb_friction", "torque_gain", 0.9, 4), Marks("unknown_field", "", 0, 60)});
  ASSERT_EQ(sums.size(), 3u);
  EXPECT_EQ(*sums[0].kind, CaseKind::kSingle);
  EXPECT_EQ(sums[0].sets, 2);
  EXPECT_EQ(sums[0].right.value, 0.5);
  EXPECT_EQ(sums[0].f1, 0.5);
  EXPECT_EQ(sums[0].joints_f1, 0.5);
  EXPECT_EQ(sums[0].sure.n, 2);
  EXPECT_EQ(sums[0].sure.wrong, 1);
  EXPECT_EQ(*sums[1].kind, CaseKind::kOpen);
  EXPECT_EQ(sums[1].unanswered, 1);
  EXPECT_FALSE(sums[2].kind.has_value());
  EXPECT_EQ(sums[2].sets, 3);
  EXPECT_EQ(sums[2].seconds, 4);
  EXPECT_EQ(sums[2].seconds_worst, 60);
  EXPECT_TRUE(std::isnan(sums[2].over_floor));
}

TEST(BatteryComparison, CountsWinsAndLossesAndTakesTheRatioOfWhatBothAnswered) {
  const CaseMarks right = Marks("coulomb_friction", "coulomb_friction", 0.9, 2),
                  wrong = Marks("coulomb_friction", "torque_gain", 0.9, 4),
                  none = Marks("coulomb_friction", "", 0, 100);
  const auto rows =
      CompareByStratum({{wrong, right}, {wrong, right}, {right, wrong}, {right, right}, {none, right}});
  ASSERT_EQ(rows.size(), 2u);
  EXPECT_EQ(rows[0].won, 3);
  EXPECT_EQ(rows[0].lost, 1);
  EXPECT_NEAR(rows[0].p, 0.625, 1e-12);
  EXPECT_NEAR(rows[0].cpu_ratio, 0.75, 1e-12);             // of 0.5, 0.5, 1 and 2
  EXPECT_NEAR(rows[0].cpu_total_ratio, 10.0 / 12, 1e-12);  // without the one that had no answer
  EXPECT_NEAR(rows[0].f1_before, 0.4, 1e-12);
  EXPECT_NEAR(rows[0].f1_after, 0.8, 1e-12);
}

TEST(Statistics, McNemarsExactTest) {
  EXPECT_EQ(McNemarExact(0, 0), 1.0);
  EXPECT_EQ(McNemarExact(3, 3), 1.0);
  EXPECT_NEAR(McNemarExact(5, 0), 0.0625, 1e-12);
  EXPECT_NEAR(McNemarExact(1, 9), 0.021484375, 1e-12);
  EXPECT_EQ(McNemarExact(9, 1), McNemarExact(1, 9));
}

}  // namespace
}  // namespace rg::proof
