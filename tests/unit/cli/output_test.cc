#include "services/cli/output.h"

#include <gtest/gtest.h>

#include "services/cli/progress_display.h"

namespace rg::cli {
namespace {

TEST(TextTable, AlignsByDisplayWidth) {
  TextTable table({"NAME", ">N"});
  table.AddRow({"Mico²", "7"});
  table.AddRow({"arm", "120"});
  EXPECT_EQ(table.ToString(), "NAME     N\nMico²    7\narm    120\n");
}

TEST(ExitCodes, FollowTheKindOfFailure) {
  EXPECT_EQ(ExitCodeOf(Status::Ok()), 0);
  EXPECT_EQ(ExitCodeOf(InvalidError("x")), 1);
  EXPECT_EQ(ExitCodeOf(CancelledError("x")), 4);
  EXPECT_EQ(ExitCodeOf(DeadlineExceededError("x")), 5);
  EXPECT_EQ(ExitCodeOf(UnavailableError("x")), 6);
}

TEST(FormatSeconds, IsReadableAtEveryScale) {
  EXPECT_EQ(FormatSeconds(0.84), "0.8 s");
  EXPECT_EQ(FormatSeconds(12.4), "12 s");
  EXPECT_EQ(FormatSeconds(185), "3 min 05 s");
  EXPECT_EQ(FormatSeconds(7800), "2 h 10 min");
}

TEST(ProgressDisplay, EtaComesFromThePaceOfTheStage) {
  EXPECT_EQ(ProgressDisplay::Line({"trajectories", 100, 400, "2 failed"}, 10.0, 120),
            "trajectories     [#####---------------] 100/400  ETA 30 s  2 failed");
}

TEST(ProgressDisplay, NeverExceedsTheTerminal) {
  const std::string line = ProgressDisplay::Line({"policy", 1, 3, std::string(300, 'x') + "²²²"}, 1.0, 60);
  EXPECT_LT(DisplayWidth(line), 60);
}

TEST(OutputFormat, UnknownNamesAreRefused) {
  EXPECT_TRUE(ParseOutputFormat("json").ok());
  EXPECT_EQ(ParseOutputFormat("xml").status().message(), "--output is 'xml', must be table, json or quiet");
}

TEST(TextTable, ACellCannotSpeakToTheTerminal) {
  TextTable table({"NAME", "STATE"});
  table.AddRow({"\x1b]0;owned\x07job\nid", "done"});
  EXPECT_EQ(table.ToString(), "NAME                       STATE\n\\x1b]0;owned\\x07job\\x0aid  done\n");
}

TEST(ShellWord, IsQuotedWhereAShellWouldCutIt) {
  EXPECT_EQ(ShellWord("out/model.json"), "out/model.json");
  EXPECT_EQ(ShellWord("mes essais/\xC3\xA9paule"), "'mes essais/\xC3\xA9paule'");
  EXPECT_EQ(ShellWord("it's"), "'it'\\''s'");
  EXPECT_EQ(ShellWord("a;b"), "'a;b'");
  EXPECT_EQ(ShellWord(""), "''");
}

TEST(Print, ShowsWhatATerminalWouldObey) {
  ::testing::internal::CaptureStdout();
  Print("a log line\x1b[2J\nand\tanother");
  EXPECT_EQ(::testing::internal::GetCapturedStdout(), "a log line\\x1b[2J\nand\tanother\n");
}

}  // namespace
}  // namespace rg::cli
