// What an administrator sets up once: backups by themselves, a command at the end of each job.
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <functional>
#include <set>
#include <thread>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/ids.h"
#include "coordinator/server/scheduled_backups.h"
#include "tests/support/service/processes.h"

namespace rg::testing {
namespace {

constexpr double kPatience = 120.0;

bool Within(double seconds, const std::function<bool()>& is_so) {
  const double until = RealClock().SteadySeconds() + seconds;
  while (!is_so()) {
    if (RealClock().SteadySeconds() > until) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  return true;
}

std::string TextOf(const std::string& path) {
  const auto text = ReadFile(path);
  return text.ok() ? *text : "";
}

TEST(Administration, BackupsAreMadeByThemselvesAndTheOldestGo) {
  Service service(400, {"--backup-every", "1s", "--keep", "2"});
  const coordinator::BackupOptions options{service.database(), 1.0, 2};
  std::set<std::string> seen;
  EXPECT_TRUE(Within(kPatience, [&] {
    for (const std::string& path : coordinator::ScheduledBackups::List(options)) seen.insert(path);
    return seen.size() >= 4;
  })) << service.Logs();
  EXPECT_TRUE(Within(kPatience, [&] { return coordinator::ScheduledBackups::List(options).size() <= 2; }));
  service.KillCoordinator();
  service.UseDatabase("backups/" + std::filesystem::path(coordinator::ScheduledBackups::List(options).back()).filename().string());
  EXPECT_TRUE(service.TryStartCoordinator()) << "one of them serves as a database";
}

TEST(Administration, AnIntervalIsANumberWithAUnit) {
  EXPECT_EQ(*coordinator::ParseInterval("24h"), 86'400.0);
  EXPECT_EQ(*coordinator::ParseInterval(""), 0.0);
  for (const char* wrong : {"24", "h", "-1h", "1w", "1h5"}) EXPECT_FALSE(coordinator::ParseInterval(wrong).ok()) << wrong;
}

TEST(Administration, ACommandIsRunWhenAJobEndsWithTheJobOnItsInput) {
  const std::string told = "/tmp/rg-told-" + RandomHex(6);
  Service service(400, {"--on-end", "cat >> " + told});
  service.StartWorker("a");
  pb::JobSpec job;
  job.set_name("night");
  AddTask(&job, "t", "echo");
  const int64_t good = service.client().Submit(job).value();
  ASSERT_TRUE(service.client().WaitForJob(good, kPatience).ok());
  pb::JobSpec bad;
  AddTask(&bad, "t", "fail", R"({"code": 1})");
  const int64_t failed = service.client().Submit(bad).value();
  ASSERT_TRUE(service.client().WaitForJob(failed, kPatience).ok());
  std::string text;
  EXPECT_TRUE(Within(kPatience, [&] {
    text = TextOf(told);
    return std::count(text.begin(), text.end(), '\n') == 2;
  })) << text << service.Logs();
  EXPECT_NE(text.find(R"("name":"night")"), std::string::npos) << text;
  EXPECT_NE(text.find(R"("state":"succeeded")"), std::string::npos) << text;
  EXPECT_NE(text.find(R"("state":"failed")"), std::string::npos) << text;
  std::filesystem::remove(told);
}

}  // namespace
}  // namespace rg::testing
