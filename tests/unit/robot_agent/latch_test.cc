#include "robot_agent/safety/latch.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>

#include "common/base/ids.h"

namespace rg::robot_agent {
namespace {

using testing::HasSubstr;

class LatchFile : public testing::Test {
 protected:
  LatchFile() : folder_((std::filesystem::temp_directory_path() / ("rg-latch-" + RandomHex(6))).string()) {
    std::filesystem::create_directories(folder_);
  }
  ~LatchFile() override { std::filesystem::remove_all(folder_); }
  std::string folder_;
};

TEST_F(LatchFile, AMotionThatEndsWellLeavesNothing) {
  Latch latch(folder_);
  EXPECT_TRUE(latch.CheckClear().ok());
  ASSERT_TRUE(latch.BeginMotion("r", "now").ok());
  ASSERT_TRUE(latch.EndMotion().ok());
  EXPECT_TRUE(latch.CheckClear().ok());
  EXPECT_TRUE(std::filesystem::is_empty(folder_));
}

TEST_F(LatchFile, AMotionWhoseProcessDiedKeepsTheArmAlsoFromTheNextProcess) {
  ASSERT_TRUE(Latch(folder_).BeginMotion("r", "now").ok());
  Latch next(folder_);
  EXPECT_THAT(next.CheckClear().message(), HasSubstr("was lost before the stop was confirmed"));
  EXPECT_EQ(next.BeginMotion("s", "later").code(), StatusCode::kFailedPrecondition);
  ASSERT_TRUE(next.Clear().ok());
  EXPECT_TRUE(next.BeginMotion("s", "later").ok());
}

TEST_F(LatchFile, AnUnconfirmedStopSaysWhyAndWhatToDo) {
  ASSERT_TRUE(Latch(folder_).Set("job3-rollout", "the arm moves at 0.31 rad/s", "2026-11-25").ok());
  const std::string text = Latch(folder_).CheckClear().message();
  EXPECT_THAT(text, HasSubstr("latched since 2026-11-25, rollout job3-rollout"));
  EXPECT_THAT(text, HasSubstr("0.31 rad/s"));
  EXPECT_THAT(text, HasSubstr("realitygrad agent clear"));
}

TEST_F(LatchFile, OneThatCannotBeReadIsLatched) {
  for (const char* junk : {"", "{", "[]", "{\"state\": 3}"}) {
    std::ofstream(folder_ + "/latch.json") << junk;
    EXPECT_EQ(Latch(folder_).CheckClear().code(), StatusCode::kFailedPrecondition) << junk;
    EXPECT_TRUE(Latch(folder_).Read()->latched) << junk;
  }
}

TEST_F(LatchFile, NothingMovesIfItCannotBeWritten) {
  Latch latch(folder_ + "/a_file/below");
  std::ofstream(folder_ + "/a_file") << "not a folder";
  EXPECT_FALSE(latch.BeginMotion("r", "now").ok());
}

}  // namespace
}  // namespace rg::robot_agent
