#include "worker/scratch_space.h"

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <fstream>

#include "common/base/ids.h"

namespace rg::worker {
namespace {

namespace fs = std::filesystem;

class Scratch : public ::testing::Test {
 protected:
  ~Scratch() override { fs::remove_all(folder_); }
  void Write(const ScratchSpace& space) {
    fs::create_directories(space.path() + "/7");
    std::ofstream(space.path() + "/7/output") << "bytes";
  }
  // A process that opens one, writes to it and is killed.
  void LeaveBehind(const std::string& instance) {
    const pid_t pid = fork();
    if (pid == 0) {
      const auto space = ScratchSpace::Open(folder_, instance);
      if (space.ok()) Write(*space);
      kill(getpid(), SIGKILL);
    }
    ASSERT_EQ(waitpid(pid, nullptr, 0), pid);
    ASSERT_TRUE(fs::exists(folder_ + "/" + instance + "/7/output"));
  }
  size_t Entries() const {
    return static_cast<size_t>(std::distance(fs::directory_iterator(folder_), fs::directory_iterator()));
  }
  const std::string folder_ = (fs::temp_directory_path() / ("rg-scratch-" + RandomHex(6))).string();
};

TEST_F(Scratch, WhatAKilledProcessLeftGoesWithTheNextThatStartsAndALivingOnesStays) {
  LeaveBehind("dead");
  const auto living = ScratchSpace::Open(folder_, "living");
  ASSERT_TRUE(living.ok()) << living.status().ToString();
  EXPECT_FALSE(fs::exists(folder_ + "/dead"));
  Write(*living);
  const auto third = ScratchSpace::Open(folder_, "third");
  ASSERT_TRUE(third.ok());
  EXPECT_TRUE(fs::exists(living->path() + "/7/output"));
  EXPECT_EQ(Entries(), 3u) << "living, and the locks of both";
}

TEST_F(Scratch, NothingIsLeftOfOneThatEnded) {
  {
    const auto space = ScratchSpace::Open(folder_, "one");
    Write(*space);
  }
  EXPECT_EQ(Entries(), 0u);
}

TEST_F(Scratch, WhatOlderWorkersLeftGoesAfterAWeek) {
  for (const char* name : {"old", "new"}) fs::create_directories(folder_ + "/" + name);
  fs::last_write_time(folder_ + "/old", fs::file_time_type::clock::now() - std::chrono::hours(24 * 8));
  ASSERT_TRUE(ScratchSpace::Open(folder_, "one").ok());
  EXPECT_FALSE(fs::exists(folder_ + "/old"));
  EXPECT_TRUE(fs::exists(folder_ + "/new"));
}

TEST_F(Scratch, OneInstanceIsOneProcess) {
  const auto one = ScratchSpace::Open(folder_, "one");
  EXPECT_EQ(ScratchSpace::Open(folder_, "one").status().code(), StatusCode::kUnavailable);
}

TEST_F(Scratch, AFolderThatCannotBeMadeIsNamed) {
  const auto space = ScratchSpace::Open("/proc/none", "one");
  EXPECT_NE(space.status().message().find("/proc/none"), std::string::npos) << space.status().ToString();
}

}  // namespace
}  // namespace rg::worker
