#include "services/lab/process_pool.h"

#include <gtest/gtest.h>

#include <csignal>
#include <map>

namespace rg::lab {
namespace {

std::map<size_t, PooledEnd> Ran(const std::vector<PooledProcess>& processes) {
  std::map<size_t, PooledEnd> ends;
  EXPECT_TRUE(RunPool(
                  processes, 2, [&](size_t i, const PooledEnd& end) { ends[i] = end; }, nullptr)
                  .ok());
  return ends;
}

TEST(ProcessPool, EndsAProcessThatTakesMoreCpuTimeThanItsLimitAndGoesOn) {
  const auto ends = Ran({{{"/bin/sh", "-c", "while :; do :; done"}, "/dev/null", 1},
                         {{"/bin/sh", "-c", "trap '' XCPU; while :; do :; done"}, "/dev/null", 1},
                         {{"/bin/sh", "-c", "exit 3"}, "/dev/null", 1}});
  ASSERT_EQ(ends.size(), 3u);
  EXPECT_TRUE(ends.at(0).out_of_time);
  EXPECT_EQ(ends.at(0).code, 128 + SIGXCPU);
  EXPECT_GE(ends.at(0).cpu_s, 0.8);
  EXPECT_LT(ends.at(0).cpu_s, 1.9);
  EXPECT_TRUE(ends.at(1).out_of_time) << "also where it does not listen";
  EXPECT_EQ(ends.at(1).code, 128 + SIGKILL);
  EXPECT_FALSE(ends.at(2).out_of_time);
  EXPECT_EQ(ends.at(2).code, 3);
}

TEST(ProcessPool, SleepingTakesNoneOfTheLimit) {
  const auto ends = Ran({{{"/bin/sh", "-c", "sleep 1.5"}, "/dev/null", 1}});
  EXPECT_EQ(ends.at(0).code, 0);
  EXPECT_LT(ends.at(0).cpu_s, 1.0);
}

TEST(ProcessPool, AProcessKilledBySomebodyIsNotOutOfTime) {
  const auto ends = Ran({{{"/bin/sh", "-c", "kill -KILL $$"}, "/dev/null", 1000}});
  EXPECT_FALSE(ends.at(0).out_of_time);
  EXPECT_EQ(ends.at(0).code, 128 + SIGKILL);
}

}  // namespace
}  // namespace rg::lab
