#include "common/base/status.h"

#include <gtest/gtest.h>

namespace rg {
namespace {

Result<int> Half(int x) {
  if (x % 2 != 0) return InvalidError("odd: " + std::to_string(x));
  return x / 2;
}

Result<int> Quarter(int x) {
  RG_ASSIGN_OR_RETURN(const int half, Half(x));
  RG_ASSIGN_OR_RETURN(const int quarter, Half(half));
  return quarter;
}

TEST(Status, TextNamesTheCodeAndPrefixesStack) {
  const Status status = InvalidError("row 3: NaN").WithPrefix("a.csv");
  EXPECT_EQ(status.ToString(), "invalid: a.csv: row 3: NaN");
  EXPECT_EQ(Status::Ok().WithPrefix("a.csv").ToString(), "ok");
}

TEST(Result, ErrorsPassThroughAssignOrReturn) {
  EXPECT_EQ(*Quarter(12), 3);
  EXPECT_EQ(Quarter(6).status().message(), "odd: 3");
}

TEST(ResultDeathTest, ReadingAnErrorAsAValueAborts) { EXPECT_DEATH((void)Half(1).value(), "odd: 1"); }

}  // namespace
}  // namespace rg
