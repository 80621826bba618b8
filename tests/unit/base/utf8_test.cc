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

}  // namespace
}  // namespace rg
