#include "common/base/number_text.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <string>

#include "common/base/rng.h"
#include "tests/support/base/comma_locale.h"

namespace rg {
namespace {

constexpr double kLargest = std::numeric_limits<double>::max();
constexpr double kSmallest = std::numeric_limits<double>::denorm_min();

struct Spelling {
  const char* text;
  double value;
};

const Spelling kNumbers[] = {
    {"0", 0.0},
    {"-0", -0.0},
    {"+0.", 0.0},
    {"7", 7.0},
    {"-7", -7.0},
    {"+7", 7.0},
    {".9", 0.9},
    {"-.21", -0.21},
    {"+.5", 0.5},
    {"3.", 3.0},
    {"-3.", -3.0},
    {"3.e2", 300.0},
    {".5e1", 5.0},
    {"4e1", 40.0},
    {"4E1", 40.0},
    {"4E-03", 0.004},
    {"+4.0e-3", 0.004},
    {"47.e-3", 0.047},
    {" 2.4E+0 ", 2.4},
    {"\t1.5", 1.5},
    {"1.5\n", 1.5},
    {"\r\n 1.5 \r\n", 1.5},
    {"0007", 7.0},
    {"-00.50", -0.5},
    {"1e0000000000000000000001", 10.0},
    {"0e99999999999", 0.0},
    {"0.17000000000000000000000001", 0.17},
    {"1700000000.123456789", 1700000000.123456789},
    {"1.764115200000000000e+09", 1764115200.0},
    {"0.0000000000000000000000000000000000000000000000000000000001e60", 100.0},
    {"1.7976931348623157e308", kLargest},
    {"4.9406564584124654e-324", kSmallest},
};

struct Refused {
  const char* text;
  NumberText outcome;
};

const Refused kNoNumbers[] = {
    {"", NumberText::kEmpty},
    {" \t\r\n", NumberText::kEmpty},
    {"1,5", NumberText::kNotANumber},
    {"1.234,5", NumberText::kNotANumber},
    {"1'000", NumberText::kNotANumber},
    {"0x10", NumberText::kNotANumber},
    {"0x1p3", NumberText::kNotANumber},
    {"1.2.3", NumberText::kNotANumber},
    {"..9", NumberText::kNotANumber},
    {".", NumberText::kNotANumber},
    {"-", NumberText::kNotANumber},
    {"+", NumberText::kNotANumber},
    {"+-1", NumberText::kNotANumber},
    {"-+1", NumberText::kNotANumber},
    {"++1", NumberText::kNotANumber},
    {"--1", NumberText::kNotANumber},
    {"- 1", NumberText::kNotANumber},
    {"+ 1", NumberText::kNotANumber},
    {"1e", NumberText::kNotANumber},
    {"1e+", NumberText::kNotANumber},
    {"1e 5", NumberText::kNotANumber},
    {"1e1.5", NumberText::kNotANumber},
    {"e5", NumberText::kNotANumber},
    {".e5", NumberText::kNotANumber},
    {"1d3", NumberText::kNotANumber},
    {"2kg", NumberText::kNotANumber},
    {"2 kg", NumberText::kNotANumber},
    {"1 2", NumberText::kNotANumber},
    {"1f", NumberText::kNotANumber},
    {"\"1\"", NumberText::kNotANumber},
    {"\xE2\x88\x92"
     "1",
     NumberText::kNotANumber},  // U+2212, a typeset minus
    {"1\xC2\xA0", NumberText::kNotANumber},
    {"${pi/2}", NumberText::kNotANumber},
    {"None", NumberText::kNotANumber},
    {"infin", NumberText::kNotANumber},
    {"nanometre", NumberText::kNotANumber},
    {"1e309", NumberText::kOutOfRange},
    {"-1e309", NumberText::kOutOfRange},
    {"1e-400", NumberText::kOutOfRange},
    {"1e99999999999999999999", NumberText::kOutOfRange},
    {"inf", NumberText::kNotFinite},
    {"-inf", NumberText::kNotFinite},
    {"+Infinity", NumberText::kNotFinite},
    {"nan", NumberText::kNotFinite},
    {" NaN ", NumberText::kNotFinite},
    {"-nan(ind)", NumberText::kNotFinite},
};

void ExpectTheTableHolds() {
  for (const Spelling& spelling : kNumbers) {
    double value = 99.0;
    EXPECT_EQ(ParseNumber(spelling.text, &value), NumberText::kOk) << "'" << spelling.text << "'";
    EXPECT_EQ(value, spelling.value) << "'" << spelling.text << "'";
    EXPECT_EQ(std::signbit(value), std::signbit(spelling.value)) << "'" << spelling.text << "'";
  }
  for (const Refused& refused : kNoNumbers) {
    double value = 99.0;
    EXPECT_EQ(ParseNumber(refused.text, &value), refused.outcome) << "'" << refused.text << "'";
    EXPECT_TRUE(value == 99.0 || refused.outcome == NumberText::kNotFinite) << "'" << refused.text << "'";
  }
}

TEST(NumberText, ReadsTheSpellingsOfXmlAndCsvWritersAndNothingElse) { ExpectTheTableHolds(); }

TEST(NumberText, InfAndNanAreTold) {
  double value = 0.0;
  EXPECT_EQ(ParseNumber("-inf", &value), NumberText::kNotFinite);
  EXPECT_EQ(value, -std::numeric_limits<double>::infinity());
  EXPECT_EQ(ParseNumber("nan", &value), NumberText::kNotFinite);
  EXPECT_TRUE(std::isnan(value));
}

TEST(NumberText, WritesTheShortestText) {
  EXPECT_EQ(NumberToText(0.1), "0.1");
  EXPECT_EQ(NumberToText(-0.75), "-0.75");
  EXPECT_EQ(NumberToText(4e10), "4e+10");
}

TEST(NumberText, ReadsNoFurtherThanTheView) {
  const std::string text = "12.5e3 and more";
  double value = 0.0;
  EXPECT_EQ(ParseNumber(std::string_view(text).substr(0, 4), &value), NumberText::kOk);
  EXPECT_EQ(value, 12.5);
  EXPECT_EQ(ParseNumber(std::string_view("1\0", 2), &value), NumberText::kNotANumber);
}

TEST(NumberText, EveryDoubleComesBackFromItsShortestText) {
  Rng rng(31);
  for (int i = 0; i < 20000; ++i) {
    const uint64_t bits = (rng.Index(1u << 16) << 48) | (rng.Index(1u << 24) << 24) | rng.Index(1u << 24);
    double expected = 0.0;
    std::memcpy(&expected, &bits, sizeof bits);
    if (!std::isfinite(expected)) continue;
    const std::string text = NumberToText(expected);
    double value = 0.0;
    ASSERT_EQ(ParseNumber(text, &value), NumberText::kOk) << text;
    EXPECT_EQ(value, expected);
  }
}

TEST(NumberText, ListsTakeAnyBlanksBetween) {
  std::array<double, 3> v{};
  ASSERT_EQ(ParseNumbers("  +4.0e-3\t0\n       -.21 ", v), NumberText::kOk);
  EXPECT_EQ(v, (std::array<double, 3>{0.004, 0.0, -0.21}));
  ASSERT_EQ(ParseNumbers("1 2\r\n3", v), NumberText::kOk);
  EXPECT_EQ(v, (std::array<double, 3>{1.0, 2.0, 3.0}));
  std::array<double, 1> one{};
  ASSERT_EQ(ParseNumbers(" 5 ", one), NumberText::kOk);
  EXPECT_EQ(one[0], 5.0);
}

TEST(NumberText, ListsOfAnotherLengthOrWithTextAreRefused) {
  std::array<double, 3> v{};
  EXPECT_EQ(ParseNumbers("", v), NumberText::kEmpty);
  EXPECT_EQ(ParseNumbers(" \n", v), NumberText::kEmpty);
  EXPECT_EQ(ParseNumbers("1 2", v), NumberText::kWrongCount);
  EXPECT_EQ(ParseNumbers("1 2 3 4", v), NumberText::kWrongCount);
  EXPECT_EQ(ParseNumbers("1, 2, 3", v), NumberText::kNotANumber);
  EXPECT_EQ(ParseNumbers("1 2 3;", v), NumberText::kNotANumber);
  EXPECT_EQ(ParseNumbers("1 2 x 4", v), NumberText::kNotANumber);
  EXPECT_EQ(ParseNumbers("0 inf 0", v), NumberText::kNotFinite);
  EXPECT_EQ(ParseNumbers("0 0 1e999", v), NumberText::kOutOfRange);
}

TEST(NumberText, EveryOutcomeHasItsWords) {
  EXPECT_EQ(NumberTextMessage(NumberText::kNotANumber), "is not a number");
  EXPECT_EQ(NumberTextMessage(NumberText::kOutOfRange), "is out of a double's range");
  EXPECT_EQ(NumberTextMessage(NumberText::kNotFinite), "is not finite");
  EXPECT_EQ(NumberTextMessage(NumberText::kEmpty), "is empty");
}

TEST(NumberText, ReadsTheSameWhereTheLocaleWritesCommas) {
  const testing_support::CommaLocale comma;
  ASSERT_TRUE(comma.is_c_locale_set()) << "install the package locales";
  EXPECT_EQ(std::strtod("1.5", nullptr), 1.0);  // the trap this reader avoids
  ExpectTheTableHolds();
  EXPECT_EQ(NumberToText(1234.5), "1234.5");
}

}  // namespace
}  // namespace rg
