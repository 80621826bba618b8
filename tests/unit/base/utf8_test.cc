#include "common/base/utf8.h"

#include <gtest/gtest.h>

namespace rg {
namespace {

TEST(Utf8, TellsValidFromInvalid) {
  for (const char* good : {"", "plain", "τ = J·q̈", "\xF0\x9F\xA6\xBE", "\xED\x9F\xBF", "\xF4\x8F\xBF\xBF"}) {
    EXPECT_TRUE(IsUtf8(good)) << good;
    EXPECT_EQ(CleanUtf8(good), good);
  }
  for (const char* bad : {"\xFF", "\xC0\xAF", "\xE0\x80\xAF", "\xED\xA0\x80", "\xF4\x90\x80\x80", "\x80",
                          "a\xCE", "\xF0\x9F\xA6"}) {
    EXPECT_FALSE(IsUtf8(bad));
    EXPECT_TRUE(IsUtf8(CleanUtf8(bad)));
  }
}

TEST(Utf8, BadBytesAreReplacedOneByOneAndTheRestIsKept) {
  EXPECT_EQ(CleanUtf8("a\xFF\xFE"
                      "b·c\xC2"),
            "a??b·c?");
}

TEST(Utf8, IsCutBetweenCharacters) {
  EXPECT_EQ(CleanUtf8("a··", 4), "a·");
  EXPECT_EQ(CleanUtf8("a··", 5), "a··");
  EXPECT_EQ(CleanUtf8("a··", 0), "");
}

TEST(PlainText, IsWhatATerminalShowsAndDoesNotObey) {
  for (const char* good : {"", "arm 7", "Mico², größer", "名前"}) EXPECT_TRUE(IsPlainText(good)) << good;
  for (const char* bad : {"\x1b]0;title\x07", "a\nb", "tab\t", "\x7f",
                          "\xc2\x9b"
                          "31m",
                          "\xe2\x80\xae"
                          "reversed",
                          "\xe2\x80\xa8", "\xff"})
    EXPECT_FALSE(IsPlainText(bad)) << VisibleText(bad);
}

TEST(VisibleText, ShowsWhatATerminalWouldObey) {
  EXPECT_EQ(VisibleText("\x1b[31mred\x1b[0m"), "\\x1b[31mred\\x1b[0m");
  EXPECT_EQ(VisibleText("\xc2\x9b"
                        "31m"),
            "\\x9b31m");
  EXPECT_EQ(VisibleText("a\xe2\x80\xae"
                        "b\xff"),
            "a\\u202eb\\xff");
  EXPECT_EQ(VisibleText("größer"), "größer");
  EXPECT_EQ(VisibleText("a\tb\r\nc"), "a\\x09b\\x0d\\x0ac");
  EXPECT_EQ(VisibleText("a\tb\r\nc", true), "a\tb\\x0d\nc");
  EXPECT_TRUE(IsPlainText(VisibleText("\x1b\xff\n")));
}

}  // namespace
}  // namespace rg
