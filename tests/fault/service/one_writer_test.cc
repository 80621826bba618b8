// One coordinator per database, by whatever name it comes: a link, a path of another spelling, at the same moment.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <filesystem>
#include <thread>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/store/restore.h"
#include "tests/support/service/processes.h"

namespace rg::testing {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

constexpr double kPatience = 60.0;

// Another coordinator on another socket.
class Another {
 public:
  Another(const std::string& folder, const std::string& name, const std::string& database)
      : address_file_(folder + "/" + name + ".address"),
        log_(folder + "/" + name + ".log"),
        process_({BinFolder() + "/realitygrad-coordinator", "--listen", "ipc://" + folder + "/" + name, "--db", database,
                  "--address-file", address_file_},
                 log_) {}
  bool Listens() const { return fs::exists(address_file_); }
  // -1: it has not ended.
  int End(double patience_s) { return process_.WaitForExit(patience_s); }
  std::string Log() const { return ReadFile(log_).value(); }

 private:
  const std::string address_file_, log_;
  Process process_;
};

bool Within(const std::function<bool()>& is_so) {
  const double until = RealClock().SteadySeconds() + kPatience;
  while (!is_so()) {
    if (RealClock().SteadySeconds() > until) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
  return true;
}

int64_t SubmitOne(Service& service) {
  pb::JobSpec job;
  AddTask(&job, "t", "echo", R"({"text": "x"})");
  return service.client().Submit(job).value();
}

TEST(OneWriter, NoNameOfALivingCoordinatorsDatabaseLeadsToASecondOne) {
  Service service;
  const int64_t job = SubmitOne(service);
  const std::string folder = service.folder(), soft = folder + "/soft.db", hard = folder + "/other/hard.db";
  fs::create_directories(folder + "/other");
  fs::create_symlink("service.db", soft);
  fs::create_hard_link(service.database(), hard);
  fs::remove(service.database() + ".lock");
  Another by_link(folder, "soft", soft), by_hard_link(folder, "hard", hard),
      by_path(folder, "path", folder + "/other/../service.db");
  for (Another* another : {&by_link, &by_hard_link, &by_path}) {
    EXPECT_EQ(another->End(kPatience), 1);
    EXPECT_THAT(another->Log(), HasSubstr("in use by process " + std::to_string(service.coordinator().pid())));
  }
  EXPECT_EQ(SubmitOne(service), job + 1);

  const auto backup = service.client().Backup("backup.db");
  ASSERT_TRUE(backup.ok()) << backup.status().ToString();
  EXPECT_EQ(store::RestoreDatabase({backup->path(), soft, true}, {}).code(), StatusCode::kUnavailable);
  EXPECT_TRUE(fs::is_symlink(soft));
  EXPECT_EQ(SubmitOne(service), job + 2);

  service.KillCoordinator();
  Another by_two_names(folder, "two_names", soft);
  EXPECT_EQ(by_two_names.End(kPatience), 1) << "its log may be beside the other name";
  EXPECT_THAT(by_two_names.Log(), HasSubstr("the file has 2 names"));
  fs::remove(hard);
  service.UseDatabase("soft.db");
  service.StartCoordinator();
  EXPECT_TRUE(service.client().GetJob(job + 2).ok()) << "nothing is lost by the other name";
}

TEST(OneWriter, OfTwoThatStartAtOnceOnANewDatabaseOneStays) {
  Service service;  // for its folder
  using Pair = std::array<std::unique_ptr<Another>, 2>;
  std::vector<Pair> pairs;
  for (const std::string name : {"a", "b", "c"}) {
    const std::string file = service.folder() + "/" + name;
    fs::create_symlink(name + ".db", file + "_link.db");
    const auto start = [&](const char* number, const std::string& database) {
      return std::make_unique<Another>(service.folder(), name + number, database);
    };
    pairs.push_back({start("1", file + "_link.db"), start("2", file + ".db")});
  }
  for (const Pair& pair : pairs) {
    ASSERT_TRUE(Within([&] { return pair[0]->End(0.0) >= 0 || pair[1]->End(0.0) >= 0; }));
    Another& ended = pair[0]->End(0.0) >= 0 ? *pair[0] : *pair[1];
    Another& other = &ended == pair[0].get() ? *pair[1] : *pair[0];
    EXPECT_EQ(ended.End(0.0), 1);
    EXPECT_THAT(ended.Log(), HasSubstr("in use by process"));
    EXPECT_TRUE(other.Listens()) << other.Log();
    EXPECT_EQ(other.End(0.0), -1);
  }
}

}  // namespace
}  // namespace rg::testing
