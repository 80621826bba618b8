// Sets from outside the repository, where they are there: ../shared beside the project's root.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>

#include "common/recordings/recording_set.h"

namespace rg::recordings {
namespace {

namespace fs = std::filesystem;
using ::testing::Contains;
using ::testing::HasSubstr;

fs::path Shared() {
  const char* source = std::getenv("RG_SOURCE_DIR");
  return fs::path(source ? source : ".") / ".." / "shared";
}

TEST(SharedSets, AllOfPracticeOrdinaryAndRealRobotsLoadAndNothingIsLeftOut) {
  if (!fs::exists(Shared() / "recordings")) GTEST_SKIP() << "no recordings beside the repository";
  for (const char* kind : {"practice", "ordinary", "real"}) {
    for (const auto& entry : fs::directory_iterator(Shared() / "recordings" / kind)) {
      const auto set = LoadSet(entry.path().string());
      EXPECT_TRUE(set.ok()) << set.status().ToString();
      if (!set.ok()) continue;
      for (const std::string& warning : set->warnings) {
        EXPECT_THAT(warning, ::testing::Not(HasSubstr("left out"))) << entry.path();
        EXPECT_THAT(warning, ::testing::Not(HasSubstr("unwrapped"))) << entry.path();
        std::printf("%s: %s\n", entry.path().filename().c_str(), warning.c_str());
      }
    }
  }
}

Result<RecordingSet> Case(const std::string& name) { return LoadSet((Shared() / "cases" / name).string()); }

TEST(SharedSets, CasesOfUsersReportsAreReadOrRefusedInOneLine) {
  if (!fs::exists(Shared() / "cases")) GTEST_SKIP() << "no cases beside the repository";
  EXPECT_THAT(Case("09_time_stamps/set_epoch_ns").status().message(),
              HasSubstr("time looks like nanoseconds"));
  const auto gap = Case("09_time_stamps/set");
  ASSERT_TRUE(gap.ok()) << gap.status().ToString();
  EXPECT_THAT(gap->warnings, Contains(HasSubstr("gap")));
  const auto dialect = Case("10_csv_dialects/set");
  EXPECT_TRUE(dialect.ok()) << dialect.status().ToString();
  const auto wrapped = Case("11_wrapped_angles/set");
  ASSERT_TRUE(wrapped.ok()) << wrapped.status().ToString();
  EXPECT_THAT(wrapped->warnings, Contains(HasSubstr("unwrapped")));
  const auto zero = Case("12_units_and_columns/set_velocity_zero");
  ASSERT_TRUE(zero.ok()) << zero.status().ToString();
  EXPECT_THAT(zero->warnings, Contains(HasSubstr("is 0 throughout")));
  EXPECT_FALSE(zero->recordings[0].has_velocity());
  EXPECT_TRUE(Case("08_pendubot_epoch_log/set").ok());
}

}  // namespace
}  // namespace rg::recordings
