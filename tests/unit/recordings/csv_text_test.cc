#include "common/recordings/csv_text.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace rg::recordings {
namespace {

using Rows = std::vector<std::vector<std::string>>;

Rows RowsOf(const std::string& text, char separator = ',') {
  CsvText lines(text, separator);
  Rows rows;
  std::vector<std::string_view> fields;
  while (lines.Next(&fields)) rows.emplace_back(fields.begin(), fields.end());
  EXPECT_TRUE(lines.status().ok()) << lines.status().ToString();
  return rows;
}

TEST(CsvText, SplitsRowsWhateverEndsTheirLines) {
  const Rows rows = {{"a", "b"}, {"1", "2"}};
  for (const char* text : {"a,b\n1,2\n", "a,b\r\n1,2\r\n", "a,b\r1,2\r", "a,b\n1,2",
                           "\xEF\xBB\xBF"
                           "a,b\n1,2\n",
                           " a ,\tb\n 1,2 \n"}) {
    EXPECT_EQ(RowsOf(text), rows) << text;
  }
}

TEST(CsvText, QuotesHoldSeparatorsLineEndsAndQuotes) {
  EXPECT_EQ(RowsOf("\"a,b\",c\n\"say \"\"no\"\"\",\"two\nlines\"\n1,2\n"),
            (Rows{{"a,b", "c"}, {"say \"no\"", "two\nlines"}, {"1", "2"}}));
  EXPECT_EQ(RowsOf("1, \"x\" ,2\n"), (Rows{{"1", "x", "2"}}));
  EXPECT_EQ(RowsOf("1,\"\",\n"), (Rows{{"1", "", ""}}));
  EXPECT_EQ(RowsOf("1,5\" tube\n"), (Rows{{"1", "5\" tube"}}));
}

TEST(CsvText, CountsTheLinesOfAFileThatHasQuotedLineEndsAndComments) {
  CsvText lines("# made by a logger\na,b\n\"x\ny\",1\n3,4\n", ',');
  std::vector<std::string_view> fields;
  std::vector<int> at;
  while (lines.Next(&fields)) at.push_back(lines.line());
  EXPECT_EQ(at, (std::vector<int>{2, 3, 5}));
}

TEST(CsvText, AHashBeforeTheHeaderIsTakenOff) {
  EXPECT_EQ(RowsOf("# time,position.a\n0,1\n# a remark, in between\n1,2\n"),
            (Rows{{"time", "position.a"}, {"0", "1"}, {"1", "2"}}));
}

TEST(CsvText, AHeaderInACommentIsOneOverRowsThatBeginWithTextToo) {
  EXPECT_EQ(RowsOf("# by a logger, v2\n# mode,time,position.a\nauto,0,1\nauto,1,2\n"),
            (Rows{{"mode", "time", "position.a"}, {"auto", "0", "1"}, {"auto", "1", "2"}}));
  EXPECT_EQ(RowsOf("# one, two\nmode,time\nauto,0\n"), (Rows{{"mode", "time"}, {"auto", "0"}})) << "a remark";
  EXPECT_EQ(RowsOf("# 3, 4\nauto,0\n"), (Rows{{"auto", "0"}})) << "a row that was taken out";
  EXPECT_EQ(GuessSeparator("# mode;time\nauto;0,5\n"), ';');
}

TEST(CsvText, CommentsOfOtherKindsAreCommentsAndNoHeader) {
  const Rows rows = {{"time", "position.a"}, {"0", "1"}, {"1", "2"}};
  for (const char* text :
       {"# a log, of Tuesday; ours\ntime,position.a\n0,1\n1,2\n",
        "% made by Octave\ntime,position.a\n0,1\n1,2\n",
        "// a remark\ntime,position.a\n0,1\n// another\n1,2\n# the end\n",
        "sep=,\ntime,position.a\n0,1\n1,2\n", "# first\n\n# second\n% time,position.a\n0,1\n1,2\n"}) {
    Rows read = RowsOf(text, GuessSeparator(text));
    std::erase(read, std::vector<std::string>{});
    EXPECT_EQ(read, rows) << text;
  }
  EXPECT_EQ(GuessSeparator("# one, two\ntime;position.a\n0,5;1\n"), ';');
  EXPECT_EQ(GuessSeparator("sep=;\ntime,x;position.a\n"), ';');
  EXPECT_EQ(GuessSeparator("# time;position.a\n0,5;1,5\n"), ';');
}

TEST(CsvText, LineEndsMayDifferWithinAFile) {
  EXPECT_EQ(RowsOf("a,b\r1,2\r3,4\n5,6\r\n"), (Rows{{"a", "b"}, {"1", "2"}, {"3", "4"}, {"5", "6"}}));
}

TEST(CsvText, AMillionCommentLinesTakeOneLookEach) {
  std::string text;
  for (int k = 0; k < 1000000; ++k) text += "# x, y\n";
  EXPECT_EQ(RowsOf(text + "time,position.a\n0,1\n").size(), 2u);
  EXPECT_EQ(GuessSeparator(text + "time;position.a\n0;1\n"), ';');
}

TEST(CsvText, SaysWhereAQuoteIsNeverClosed) {
  CsvText lines("a,b\n1,\"2\n3,4\n", ',');
  std::vector<std::string_view> fields;
  while (lines.Next(&fields)) {
  }
  EXPECT_THAT(lines.status().message(), ::testing::HasSubstr("line 2: a quote"));
}

TEST(CsvText, KnowsOtherFormatsByTheirFirstBytes) {
  EXPECT_THAT(OtherFormatOf("#ROSBAG V2.0\n"), ::testing::HasSubstr("realitygrad import"));
  EXPECT_THAT(OtherFormatOf("\x89MCAP0\r\n"), ::testing::HasSubstr("realitygrad import"));
  EXPECT_THAT(OtherFormatOf("SQLite format 3"), ::testing::HasSubstr("realitygrad import"));
  EXPECT_THAT(OtherFormatOf("PK\x03\x04"), ::testing::HasSubstr("spreadsheet"));
  EXPECT_THAT(OtherFormatOf("\xFF\xFEt"), ::testing::HasSubstr("UTF-16"));
  EXPECT_EQ(OtherFormatOf("time,position.a\n"), "");
}

TEST(CsvText, GuessesTheSeparatorFromTheHeader) {
  EXPECT_EQ(GuessSeparator("time,position.a\n"), ',');
  EXPECT_EQ(GuessSeparator("\xEF\xBB\xBFtime;position.a\n0,5;1\n"), ';');
  EXPECT_EQ(GuessSeparator("time\tposition.a\n"), '\t');
  EXPECT_FALSE(ParseCsvDialect("excel").ok());
}

}  // namespace
}  // namespace rg::recordings
