#include "common/recordings/csv.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numbers>

#include "common/base/rng.h"

namespace rg::recordings {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

JointInfo Revolute(const std::string& name, double lower = -3.0, double upper = 3.0, double velocity = 2.0) {
  return {name, JointInfo::Type::kRevolute, lower, upper, velocity};
}

JointInfo Continuous(const std::string& name, double velocity = 2.0) {
  JointInfo info;
  info.name = name;
  info.type = JointInfo::Type::kContinuous;
  info.velocity = velocity;
  return info;
}

CsvOptions TwoJoints() {
  CsvOptions options;
  options.robot = {Revolute("a"), Revolute("b")};
  return options;
}

std::string ErrorOf(const std::string& text, const CsvOptions& options = TwoJoints()) {
  const auto recording = ParseCsv(text, "rec.csv", options);
  if (recording.ok()) return "accepted";
  EXPECT_EQ(recording.status().message().find('\n'), std::string::npos) << "not one line";
  EXPECT_THAT(recording.status().message(), ::testing::StartsWith("rec.csv: "));
  return recording.status().message();
}

constexpr const char* kHeader = "time,position.a,position.b,effort_command.a,effort_command.b\n";

std::string FileOf(int rows, const std::function<double(double)>& position,
                   const std::function<double(double)>* velocity = nullptr) {
  std::string text = std::string("time,position.a,") + (velocity ? "velocity.a," : "") + "effort_command.a\n";
  for (int k = 0; k < rows; ++k) {
    const double t = 0.01 * k;
    text += std::to_string(t) + "," + std::to_string(position(t));
    if (velocity) text += "," + std::to_string((*velocity)(t));
    text += "," + std::to_string(std::sin(3.0 * t)) + "\n";
  }
  return text;
}

TEST(ParseCsv, ReadsColumnsByNameInTheOrderWanted) {
  CsvOptions options;
  options.joints = {"b", "a"};
  const auto r = ParseCsv(
      "effort_measured.a,time,position.a,velocity.b,velocity.a,position.b,effort_measured.b,gripper\n"
      "1,0,2,3,4,5,6,7\n11,0.5,12,13,14,15,16,\n",
      "rec.csv", options);
  ASSERT_TRUE(r.ok()) << r.status().ToString();
  EXPECT_EQ(r->joints, (std::vector<std::string>{"b", "a"}));
  EXPECT_EQ(r->t, Eigen::Vector2d(0.0, 0.5));
  EXPECT_EQ(r->q.col(1), Eigen::Vector2d(15, 12));
  EXPECT_EQ(r->v.col(0), Eigen::Vector2d(3, 4));
  EXPECT_EQ(r->effort_measured.col(1), Eigen::Vector2d(16, 11));
  EXPECT_EQ(r->drive, EffortKind::kMeasured);
  EXPECT_EQ(&r->drive_effort(), &r->effort_measured);
  EXPECT_EQ(r->other.at("gripper")[0], 7.0);
  EXPECT_TRUE(std::isnan(r->other.at("gripper")[1]));
}

TEST(ParseCsv, TakesByteOrderMarkCarriageReturnsBlanksPlusSignsAndAMissingLastNewline) {
  const auto r = ParseCsv("\xEF\xBB\xBF" + std::string("time, position.a ,effort_command.a\r\n") +
                              "0,+1e-3, 2\r\n 1 ,-.5,3\r\n2,1,4",
                          "rec.csv", TwoJoints());
  ASSERT_TRUE(r.ok()) << r.status().ToString();
  EXPECT_EQ(r->rows(), 3);
  EXPECT_DOUBLE_EQ(r->q(0, 0), 1e-3);
  EXPECT_DOUBLE_EQ(r->effort_command(0, 2), 4.0);
}

TEST(ParseCsv, AcceptsIrregularSamplingAndMissingRows) {
  const auto r = ParseCsv(std::string(kHeader) + "0,0,0,0,0\n0.01,0,0,0,0\n0.0133,0,0,0,0\n7,0,0,0,0\n",
                          "rec.csv", TwoJoints());
  ASSERT_TRUE(r.ok()) << r.status().ToString();
  EXPECT_DOUBLE_EQ(r->t[3], 7.0);
}

TEST(ParseCsv, LeavesOtherColumnsAloneEvenWithText) {
  const auto r = ParseCsv("time,position.a,effort_command.a,mode,note.zzz\n0,0,0,idle,1\n1,0,0,run,2\n",
                          "rec.csv", TwoJoints());
  ASSERT_TRUE(r.ok()) << r.status().ToString();
  EXPECT_EQ(r->other.count("mode"), 0u);
  EXPECT_EQ(r->other.at("note.zzz")[1], 2.0);
}

// As in a file that a spreadsheet wrote: byte order mark, quotes, CRLF, a separator at each line's end, empty
// cells in columns that are not used, text with a comma.
TEST(ParseCsv, ReadsASpreadsheetsFileAsIfItWerePlain) {
  const auto r = ParseCsv(
      "\xEF\xBB\xBF\"time\",\"position.a\",\"effort_command.a\",\"battery\",\"comment\",\"position_reference."
      "a\"\r\n"
      "0, 0.1997,\"0.43\",24.1,\"start, now\",\r\n0.01, +.1997, 4.3E-1,,,,\r\n0.02,0.2,1.,,,,\r\n",
      "rec.csv", TwoJoints());
  ASSERT_TRUE(r.ok()) << r.status().ToString();
  EXPECT_EQ(r->rows(), 3);
  EXPECT_EQ(r->q(0, 1), 0.1997);
  EXPECT_EQ(r->effort_command(0, 0), 0.43);
  EXPECT_EQ(r->effort_command(0, 2), 1.0);
  EXPECT_EQ(r->other.count("comment"), 0u);
  EXPECT_EQ(r->other.at("battery")[0], 24.1);
}

TEST(ParseCsv, DecimalCommasAreReadWhereADialectSaysSoAndElseExplained) {
  const std::string text = "time;position.a;effort_command.a\n0,00;0,25;1\n0,01;-1,5e-1;2,5\n";
  EXPECT_THAT(ErrorOf(text), AllOf(HasSubstr("line 2"), HasSubstr("decimal comma"),
                                   HasSubstr("--csv-dialect semicolon"), HasSubstr("tr ',' '.'")));
  CsvOptions options = TwoJoints();
  options.dialect = CsvDialect{';', true};
  const auto r = ParseCsv(text, "rec.csv", options);
  ASSERT_TRUE(r.ok()) << r.status().ToString();
  EXPECT_EQ(r->t[1], 0.01);
  EXPECT_EQ(r->q(0, 1), -0.15);
  EXPECT_EQ(r->effort_command(0, 1), 2.5);
  EXPECT_THAT(ErrorOf("time,position.a,effort_command.a\n0,00,0,25,1,5\n"), HasSubstr("decimal commas?"));
}

TEST(ParseCsv, SemicolonsAndTabsWithDecimalPointsAreReadWithANote) {
  for (const char* separator : {";", "\t"}) {
    std::string text = "time,position.a,effort_command.a\n0,0.25,1\n0.01,0.5,2\n";
    for (char& c : text) c = c == ',' ? *separator : c;
    const auto r = ParseCsv(text, "rec.csv", TwoJoints());
    ASSERT_TRUE(r.ok()) << r.status().ToString();
    EXPECT_EQ(r->q(0, 1), 0.5);
    ASSERT_EQ(r->notes.size(), 1u);
    EXPECT_THAT(r->notes[0], HasSubstr("separated by"));
  }
}

TEST(ParseCsv, AVelocityColumnThatIsEmptyThroughoutIsLeftOut) {
  for (const char* blank : {"", "nan"}) {
    const std::string b = blank;
    const auto r =
        ParseCsv("time,position.a,velocity.a,effort_command.a\n0,0," + b + ",0\n0.1,0," + b + ",0\n",
                 "rec.csv", TwoJoints());
    ASSERT_TRUE(r.ok()) << r.status().ToString();
    EXPECT_FALSE(r->has_velocity());
    EXPECT_THAT(r->notes.at(0), HasSubstr("velocity.a: left out, the column is empty throughout"));
  }
  EXPECT_THAT(ErrorOf("time,position.a,velocity.a,effort_command.a\n0,0,1,0\n0.1,0,,0\n"),
              AllOf(HasSubstr("row 2 (line 3)"), HasSubstr("velocity.a"), HasSubstr("empty")));
  EXPECT_THAT(ErrorOf("time,position.a,effort_command.a\n0,0,\n0.1,0,\n"), HasSubstr("no effort"));
}

TEST(ParseCsv, TellsTheLineOfARowBehindCommentsAndQuotedLineEnds) {
  EXPECT_THAT(
      ErrorOf("# a log\ntime,position.a,effort_command.a,note\n0,0,0,\"two\nlines\"\n# again\n0.1,x,0,\n"),
      HasSubstr("row 2 (line 6), column position.a: not a number: 'x'"));
}

TEST(ParseCsv, EpochSecondsKeepTheirDigits) {
  const auto r =
      ParseCsv("time,position.a,effort_command.a\n1.607074831339118958e+09,0,0\n1607074831.349119,0,0\n",
               "rec.csv", TwoJoints());
  ASSERT_TRUE(r.ok()) << r.status().ToString();
  EXPECT_EQ(r->time_offset, 1607074831.0);
  EXPECT_EQ(r->t[0] + r->time_offset, 1607074831.339119);
  EXPECT_EQ(r->t[1] + r->time_offset, 1607074831.349119);
  EXPECT_NEAR(r->t[0], 0.339119, 1e-6);
  EXPECT_THAT(FormatCsv(*r), HasSubstr("1607074831.349119,"));
}

TEST(ParseCsv, TimeInNanosecondsIsReadWhereItsUserSaysSo) {
  std::string text = "time,position.a,effort_command.a\n";
  for (int k = 0; k < 50; ++k)
    text += std::to_string(1637836800000000000 + k * 10000000LL) + "," + std::to_string(std::sin(0.01 * k)) +
            ",0\n";
  EXPECT_THAT(ErrorOf(text), AllOf(HasSubstr("looks like nanoseconds"), HasSubstr("--time-unit ns")));
  CsvOptions options = TwoJoints();
  options.time_units_per_s = 1e9;
  options.time_unit_is_known = true;
  const auto r = ParseCsv(text, "rec.csv", options);
  ASSERT_TRUE(r.ok()) << r.status().ToString();
  EXPECT_EQ(r->t[0] + r->time_offset, 1637836800.0);
  EXPECT_NEAR(r->SamplePeriod(), 0.01, 1e-6);
}

TEST(ParseCsv, SaysWhatABinaryFileIsAndWhichColumnMayBeTime) {
  EXPECT_THAT(ErrorOf("#ROSBAG V2.0\n"), HasSubstr("`realitygrad import`"));
  EXPECT_THAT(ErrorOf("Timestamp,position.a,effort_command.a\n0,0,0\n"),
              HasSubstr("'Timestamp' looks like it"));
}

TEST(ParseCsv, AJointThatJumpsInDegreesIsRefusedForItsUnit) {
  const auto wrapped = [](double t) { return std::fmod(170.0 + 40.0 * t, 360.0) - 180.0; };
  CsvOptions options;
  options.robot = {Revolute("a", -6.4, 6.4, 2.0)};
  EXPECT_THAT(ErrorOf(FileOf(1000, wrapped), options), HasSubstr("degrees"));
}

// As pandas writes its index.
TEST(ParseCsv, ColumnsWithoutANameAreLeftAlone) {
  const auto r = ParseCsv(",time,position.a,effort_command.a,,\n0,0.00,1,2,,\n1,0.01,1,3,,\n2,0.02,1,4,,\n",
                          "rec.csv", {});
  ASSERT_TRUE(r.ok()) << r.status().ToString();
  EXPECT_EQ(r->rows(), 3);
  EXPECT_EQ(r->effort_command(0, 2), 4);
  EXPECT_TRUE(r->other.empty());
  EXPECT_THAT(r->notes, ::testing::ElementsAre("column 1 has no name: left alone"));
}

TEST(ParseCsv, WordsForNothingMeasuredAreEmptyFields) {
  const auto r = ParseCsv(
      "time,position.a,velocity.a,effort_command.a,temperature.a\n0.00,1,None,2,-\n0.01,1,null,3,20\n",
      "rec.csv", {});
  ASSERT_TRUE(r.ok()) << r.status().ToString();
  EXPECT_FALSE(r->has_velocity());
  EXPECT_TRUE(std::isnan(r->other.at("temperature.a")[0]));
  EXPECT_EQ(r->other.at("temperature.a")[1], 20);
}

// A few MB of line ends under a header of many columns must not take memory for as many rows.
TEST(ParseCsv, LinesThatHoldNothingTakeNoMemory) {
  std::string text = "time,position.a,effort_command.a";
  for (int k = 0; k < 50000; ++k) text += ",c" + std::to_string(k);
  text += std::string(2000000, '\n');
  EXPECT_THAT(ErrorOf(text), HasSubstr("no rows"));
}

struct BadFile {
  std::string name, text;
  std::vector<std::string> said;  // parts of the message
};

class RefusedCsv : public ::testing::TestWithParam<BadFile> {};

TEST_P(RefusedCsv, IsOneLineWithFileRowAndColumn) {
  const std::string error = ErrorOf(GetParam().text);
  for (const std::string& part : GetParam().said) EXPECT_THAT(error, HasSubstr(part));
}

const std::string kRows = std::string(kHeader) + "0,0,0,0,0\n0.1,0,0,0,0\n";

INSTANTIATE_TEST_SUITE_P(
    All, RefusedCsv,
    ::testing::Values(
        BadFile{"empty", "", {"empty"}}, BadFile{"blank", "\n \r\n", {"empty"}},
        BadFile{"no_rows", kHeader, {"no rows"}},
        BadFile{"one_row", std::string(kHeader) + "0,0,0,0,0\n", {"one row"}},
        BadFile{"no_time", "position.a,effort_command.a\n0,0\n", {"no column time"}},
        BadFile{"no_position", "time,effort_command.a\n0,0\n", {"position."}},
        BadFile{"no_effort", "time,position.a\n0,0\n1,1\n", {"no effort"}},
        BadFile{"column_twice",
                "time,position.a,position.a,effort_command.a\n0,0,0,0\n",
                {"position.a", "twice"}},
        BadFile{"unknown_joint",
                "time,position.a,position.elbow,effort_command.a\n",
                {"position.elbow", "'elbow'"}},
        BadFile{"unknown_joint_of_a_sensor",
                "time,position.a,effort_command.a,torque_sensor.c\n",
                {"torque_sensor.c"}},
        BadFile{"efforts_of_two_kinds",
                "time,position.a,position.b,effort_command.a,effort_measured.b\n0,0,0,0,0\n",
                {"effort_command.b is missing"}},
        BadFile{"time_back",
                kRows + "0.05,0,0,0,0\n",
                {"row 3 (line 4)", "column time", "goes back", "0.05", "0.1"}},
        BadFile{"time_repeats", kRows + "0.1,0,0,0,0\n", {"row 3", "column time", "repeats"}},
        BadFile{"nan", kRows + "0.2,0,nan,0,0\n", {"row 3 (line 4)", "position.b", "NaN"}},
        BadFile{"upper_case_nan", kRows + "0.2,0,0,0,NaN\n", {"row 3", "effort_command.b", "NaN"}},
        BadFile{"nan_time", kRows + "nan,0,0,0,0\n", {"row 3", "column time", "NaN"}},
        BadFile{"infinite", kRows + "0.2,0,-inf,0,0\n", {"row 3", "position.b", "not finite"}},
        BadFile{"text", kRows + "0.2,0,zero,0,0\n", {"row 3", "position.b", "not a number", "'zero'"}},
        BadFile{"decimal_comma", kRows + "\"0,2\",0,0,0,0\n", {"row 3", "column time"}},
        BadFile{"empty_field", kRows + "0.2,0,,0,0\n", {"row 3", "position.b", "empty"}},
        BadFile{"too_large", kRows + "0.2,1e999,0,0,0\n", {"row 3", "position.a", "range"}},
        BadFile{"too_many_fields", kRows + "0.2,0,0,0,0,0\n", {"row 3", "6 of 5"}},
        BadFile{"short_row", kRows + "0.2,0,0\n0.3,0,0,0,0\n", {"row 3", "effort_command.a", "3 of 5"}},
        BadFile{"truncated_row", kRows + "0.2,0,0", {"row 3", "effort_command.a", "truncated"}},
        BadFile{"truncated_number", kRows + "0.2,0,0,0,1e-", {"row 3", "effort_command.b", "truncated"}},
        BadFile{"truncated_before_number", kRows + "0.2,0,0,0,", {"row 3", "effort_command.b", "truncated"}},
        BadFile{"zeros_at_the_end", kRows + std::string(10, '\0'), {"row 3"}},
        BadFile{"empty_line_within", kRows + "\n0.2,0,0,0,0\n", {"row 3", "empty"}}),
    [](const auto& info) { return info.param.name; });

TEST(ParseCsv, SeesAFileThatEndsInsideItsLastNumber) {
  const std::string whole = FileOf(40, [](double t) { return std::sin(t); });
  const std::string cut = whole.substr(0, whole.size() - 4);  // three digits and the newline
  EXPECT_THAT(ErrorOf(cut),
              AllOf(HasSubstr("row 40 (line 41)"), HasSubstr("effort_command.a"), HasSubstr("truncated")));
  const std::string no_newline = whole.substr(0, whole.size() - 1);
  EXPECT_TRUE(ParseCsv(whole, "rec.csv", TwoJoints()).ok());
  EXPECT_TRUE(ParseCsv(no_newline, "rec.csv", TwoJoints()).ok());
}

const double kDegrees = 180.0 / std::numbers::pi;

TEST(CheckUnits, RefusesPositionsInDegrees) {
  const auto error = ErrorOf(FileOf(200, [](double t) { return kDegrees * std::sin(2.0 * t); }));
  EXPECT_THAT(error, AllOf(HasSubstr("position.a"), HasSubstr("degrees"), HasSubstr("row ")));
}

TEST(CheckUnits, RefusesVelocitiesInDegreesBesidePositionsInRadians) {
  const std::function<double(double)> v = [](double t) { return kDegrees * 0.5 * std::cos(t); };
  const auto error = ErrorOf(FileOf(
      300, [](double t) { return 0.5 * std::sin(t); }, &v));
  EXPECT_THAT(error, AllOf(HasSubstr("velocity.a"), HasSubstr("degrees")));
}

TEST(CheckUnits, RefusesVelocitiesAgainstTheirPositionsAndTimeInMilliseconds) {
  const auto q = [](double t) { return 0.5 * std::sin(t); };
  const std::function<double(double)> against = [](double t) { return -0.5 * std::cos(t); };
  EXPECT_THAT(ErrorOf(FileOf(300, q, &against)),
              AllOf(HasSubstr("velocity.a"), HasSubstr("wrong sign"), HasSubstr("times the rate")));
  std::string text = "time,position.a,velocity.a,effort_command.a\n";
  for (int k = 0; k < 300; ++k) {
    const double t = 0.01 * k;
    text += std::to_string(1000 * t) + "," + std::to_string(q(t)) + "," + std::to_string(0.5 * std::cos(t)) +
            ",0\n";
  }
  EXPECT_THAT(ErrorOf(text), AllOf(HasSubstr("column time"), HasSubstr("milliseconds")));
}

TEST(CheckUnits, RefusesPositionsInDegreesBesideVelocitiesInRadiansOfAContinuousJoint) {
  CsvOptions options;
  options.robot = {Continuous("a", std::numeric_limits<double>::infinity())};
  const std::function<double(double)> v = [](double t) { return 0.5 * std::cos(t); };
  const auto error = ErrorOf(FileOf(
                                 300, [](double t) { return kDegrees * 0.5 * std::sin(t); }, &v),
                             options);
  EXPECT_THAT(error, AllOf(HasSubstr("position.a"), HasSubstr("degrees")));
}

TEST(CheckUnits, RefusesFastDegreesOfAContinuousJointBySpeedAlone) {
  CsvOptions options;
  options.robot = {Continuous("a")};
  const auto error = ErrorOf(FileOf(300, [](double t) { return kDegrees * std::sin(t); }), options);
  EXPECT_THAT(error, AllOf(HasSubstr("position.a"), HasSubstr("degrees")));
}

TEST(CheckUnits, RefusesMillimetresOfAPrismaticJoint) {
  CsvOptions options;
  options.robot = {{"a", JointInfo::Type::kPrismatic, -0.05, 0.3, 0.5}};
  const auto error = ErrorOf(FileOf(200, [](double t) { return 200.0 * std::sin(t); }), options);
  EXPECT_THAT(error, AllOf(HasSubstr("position.a"), HasSubstr("millimetres")));
}

TEST(CheckUnits, AcceptsManyTurnsOfAContinuousJoint) {
  CsvOptions options;
  options.robot = {Continuous("a")};
  const std::function<double(double)> v = [](double) { return 1.8; };
  EXPECT_TRUE(ParseCsv(FileOf(
                           20000, [](double t) { return 1.8 * t; }, &v),
                       "rec.csv", options)
                  .ok());
  EXPECT_TRUE(ParseCsv(FileOf(20000, [](double t) { return 1.8 * t; }), "rec.csv", options).ok());
}

TEST(CheckUnits, AcceptsPositionsSomewhatOutsideTheLimits) {
  EXPECT_TRUE(ParseCsv(FileOf(300, [](double t) { return 3.6 * std::sin(t); }), "rec.csv", TwoJoints()).ok());
}

TEST(ParseCsv, RefusesASingleGlitchByRowAndColumn) {
  const auto glitch = [](double t) { return t == 1.0 ? 150.0 : std::sin(t); };
  EXPECT_THAT(ErrorOf(FileOf(300, glitch)), AllOf(HasSubstr("row 101, column position.a"), HasSubstr("150")));
}

TEST(CheckUnits, RefusesDegreesOfAContinuousJointWithoutAnyLimit) {
  CsvOptions options;
  options.robot = {Continuous("a", std::numeric_limits<double>::infinity())};
  const std::function<double(double)> v = [](double t) { return kDegrees * 2.0 * std::cos(t); };
  const auto error = ErrorOf(FileOf(
                                 300, [](double t) { return kDegrees * 2.0 * std::sin(t); }, &v),
                             options);
  EXPECT_THAT(error, AllOf(HasSubstr("velocity.a"), HasSubstr("degrees"), HasSubstr("no speed limit")));
  const std::function<double(double)> fast = [](double) { return 45.0; };
  EXPECT_TRUE(ParseCsv(FileOf(
                           300, [](double t) { return 45.0 * t; }, &fast),
                       "rec.csv", options)
                  .ok());
}

TEST(CheckUnits, AcceptsALightJointThatRunsFarAboveItsLimitOverAFewRadians) {
  CsvOptions options;
  options.robot = {Continuous("a", 0.8)};
  const std::function<double(double)> v = [](double t) { return 40.0 * std::cos(10.0 * t); };
  EXPECT_TRUE(ParseCsv(FileOf(
                           300, [](double t) { return 4.0 * std::sin(10.0 * t); }, &v),
                       "rec.csv", options)
                  .ok());
}

// Thrown through its stops at times, as by a controller that a delay makes unstable.
TEST(CheckUnits, AcceptsAJointThatFliesFarBeyondItsLimitsAndComesBack) {
  CsvOptions options;
  options.robot = {{"a", JointInfo::Type::kRevolute, -3, 3, 5}};
  const auto thrown = [](double t) {
    const double calm = 1.3 + 0.3 * std::sin(t), burst = std::exp(-std::pow(t - 5.0, 2));
    return calm + 13.0 * burst * std::sin(14.0 * t);
  };
  const std::function<double(double)> speed = [&](double t) {
    return (thrown(t + 1e-5) - thrown(t - 1e-5)) / 2e-5;
  };
  EXPECT_TRUE(ParseCsv(FileOf(1000, thrown, &speed), "rec.csv", options).ok());
  EXPECT_TRUE(ParseCsv(FileOf(1000, thrown), "rec.csv", options).ok());

  options.robot = {{"a", JointInfo::Type::kPrismatic, -0.4, 0.4, 0.8}};
  const auto slide = [](double t) { return 0.1 + 6.0 * std::sin(4.0 * t); };
  const std::function<double(double)> slide_speed = [](double t) { return 24.0 * std::cos(4.0 * t); };
  EXPECT_TRUE(ParseCsv(FileOf(800, slide, &slide_speed), "rec.csv", options).ok());
}

TEST(CheckUnits, StillRefusesOtherUnitsOfAJointThatMovesSeldomOrLittle) {
  CsvOptions options;
  options.robot = {{"a", JointInfo::Type::kRevolute, -3, 3, 5}};
  const auto seldom = [](double t) { return 40.0 * std::exp(-4.0 * std::pow(t - 5.0, 2)); };
  EXPECT_THAT(ErrorOf(FileOf(1000, seldom), options), HasSubstr("degrees"));
  const auto held = [](double t) { return 45.0 + std::sin(t); };
  EXPECT_THAT(ErrorOf(FileOf(500, held), options), HasSubstr("degrees"));
  const auto small = [](double t) { return 15.0 * std::sin(3.0 * t); };
  EXPECT_THAT(ErrorOf(FileOf(500, small), options), HasSubstr("degrees"));
  options.robot = {{"a", JointInfo::Type::kPrismatic, -0.4, 0.4, 0.8}};
  const auto little = [](double t) { return 150.0 + 5.0 * std::sin(t); };
  EXPECT_THAT(ErrorOf(FileOf(500, little), options), HasSubstr("millimetres"));
}

TEST(CheckUnits, AcceptsMotionAboveADummySpeedLimitOfOne) {
  CsvOptions options;
  options.robot = {Continuous("a", 1.0)};
  const auto swing = [](double t) { return 2.0 * std::sin(4.0 * t); };  // 8 rad/s
  EXPECT_TRUE(ParseCsv(FileOf(500, swing), "rec.csv", options).ok());
}

TEST(CheckUnits, AcceptsNoisyVelocitiesAtRest) {
  Rng rng(1);
  const std::function<double(double)> v = [&](double) { return 0.5 * rng.Normal(); };
  EXPECT_TRUE(ParseCsv(FileOf(
                           500, [&](double) { return 1e-3 * rng.Normal(); }, &v),
                       "rec.csv", TwoJoints())
                  .ok());
}

TEST(ParseCsv, AcceptsOrRefusesInOneLineWhateverTheBytes) {
  const std::string whole = FileOf(30, [](double t) { return std::sin(t); });
  Rng rng(21);
  const std::string alphabet = "0123456789.,-+eE\n\r \"nainf\xEF\x00\xFF";
  for (int trial = 0; trial < 4000; ++trial) {
    std::string text = whole;
    for (uint64_t edits = 1 + rng.Index(4); edits > 0; --edits) {
      const size_t at = rng.Index(text.size());
      const uint64_t kind = rng.Index(3);
      if (kind == 0) text[at] = alphabet[rng.Index(alphabet.size())];
      if (kind == 1) text.erase(at, 1 + rng.Index(20));
      if (kind == 2) text.insert(at, text.substr(rng.Index(text.size()), rng.Index(40)));
      if (text.empty()) text = "t";
    }
    const auto recording = ParseCsv(text, "rec.csv", TwoJoints());
    if (!recording.ok()) {
      ASSERT_EQ(recording.status().message().find('\n'), std::string::npos) << recording.status().message();
      continue;
    }
    ASSERT_TRUE(recording->q.allFinite() && recording->t.allFinite() &&
                recording->effort_command.allFinite());
    for (int k = 1; k < recording->rows(); ++k) ASSERT_GT(recording->t[k], recording->t[k - 1]);
  }
}

TEST(FormatCsv, ReadsBackBitForBit) {
  Rng rng(7);
  Recording r;
  r.name = "rec.csv";
  r.joints = {"a", "b"};
  r.t = Eigen::VectorXd::LinSpaced(50, 0.0, 1.0 / 3.0);
  const auto random = [&] {
    return Eigen::MatrixXd(Eigen::MatrixXd::NullaryExpr(2, 50, [&] { return rng.Normal() * 0.1; }));
  };
  r.q = random();
  r.v = Eigen::MatrixXd::Zero(2, 50);
  r.effort_command = random();
  r.effort_measured = random();
  r.other["temperature.a"] = Eigen::VectorXd::Constant(50, 31.5);
  r.other["temperature.a"][3] = std::nan("");
  CsvOptions options = TwoJoints();
  options.joints = r.joints;
  const auto back = ParseCsv(FormatCsv(r), "rec.csv", options);
  ASSERT_TRUE(back.ok()) << back.status().ToString();
  EXPECT_EQ(back->t, r.t);
  EXPECT_EQ(back->q, r.q);
  EXPECT_EQ(back->v, r.v);
  EXPECT_EQ(back->effort_command, r.effort_command);
  EXPECT_EQ(back->effort_measured, r.effort_measured);
  EXPECT_TRUE(std::isnan(back->other.at("temperature.a")[3]));
}

TEST(Reorder, MovesEveryKindTogetherAndRefusesAJointThatIsNotThere) {
  const auto r =
      ParseCsv("time,position.a,position.b,effort_command.a,effort_command.b\n0,1,2,3,4\n1,5,6,7,8\n",
               "rec.csv", TwoJoints());
  ASSERT_TRUE(r.ok());
  const auto turned = Reorder(*r, {"b", "a"});
  ASSERT_TRUE(turned.ok());
  EXPECT_EQ(turned->q.col(0), Eigen::Vector2d(2, 1));
  EXPECT_EQ(turned->effort_command.col(1), Eigen::Vector2d(8, 7));
  EXPECT_THAT(Reorder(*r, {"c"}).status().message(), HasSubstr("'c'"));
}

}  // namespace
}  // namespace rg::recordings
