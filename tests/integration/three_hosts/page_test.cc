// docs/three-hosts.md, followed to the letter: every command of the page on the host it names, an iteration on two
// workers, a cable that is pulled for longer than a lease, and what the page promises of it.
#include <gtest/gtest.h>
#include <sys/wait.h>

#include <algorithm>
#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <set>
#include <sstream>
#include <thread>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "tests/integration/three_hosts/hosts.h"
#include "tests/support/service/processes.h"

namespace rg::testing {
namespace {

using nlohmann::json;
namespace fs = std::filesystem;

constexpr double kPatience = 1'800.0;
const std::map<std::string, int> kHostNumbers = {{"lab", 1}, {"a", 2}, {"b", 3}};

// What stands between ```sh and ```, with "# on HOST, a service" or "# on HOST, at the end" before it.
struct Block {
  std::string host, when, commands;
};

std::vector<Block> BlocksOf(const std::string& page) {
  std::vector<Block> blocks;
  std::istringstream lines(page);
  bool inside = false;
  for (std::string line; std::getline(lines, line);) {
    if (line.rfind("```", 0) == 0) {
      inside = line == "```sh";
      if (inside) blocks.emplace_back();
    } else if (inside && line.rfind("# on ", 0) == 0) {
      const size_t comma = std::min(line.find(','), line.size());
      blocks.back().host = line.substr(5, comma - 5);
      if (comma < line.size()) blocks.back().when = line.substr(comma + 2);
    } else if (inside) {
      blocks.back().commands += line + "\n";
    }
  }
  std::erase_if(blocks, [](const Block& block) { return block.host.empty(); });  // scp: they share their files here
  return blocks;
}

class Page : public ::testing::Test {
 protected:
  void SetUp() override {
    if (!Hosts::WhyNot().empty()) GTEST_SKIP() << Hosts::WhyNot();
    hosts_ = std::make_unique<Hosts>("10.0.0.");
    if (!hosts_->ok()) GTEST_SKIP() << "this kernel or container does not let us make network namespaces";
    folder_ = "/tmp/rg-page-" + RandomHex(6);
    fs::create_directories(folder_);
    const char* source = std::getenv("RG_SOURCE_DIR");
    source_ = fs::absolute(source != nullptr ? source : ".").string();
    fs::create_directory_symlink(source_ + "/deploy", folder_ + "/deploy");
  }
  void TearDown() override {
    services_.clear();
    hosts_.reset();
    std::error_code ignored;
    if (!folder_.empty()) fs::remove_all(folder_, ignored);
  }
  std::vector<std::string> Command(const std::string& host, const std::string& script) const {
    return hosts_->On(kHostNumbers.at(host),
                      {"bash", "-ec",
                       "cd " + folder_ + "; export HOME=" + folder_ + " PATH=" + BinFolder() + ":$PATH\n" + script});
  }
  // What it printed; the test fails where it does.
  std::string Run(const std::string& host, const std::string& script) {
    const std::string log = folder_ + "/run.log";
    fs::remove(log);
    Process process(Command(host, script), log);
    EXPECT_EQ(process.WaitForExit(kPatience), 0) << script << *ReadFile(log) << Logs();
    return *ReadFile(log);
  }
  json Ask(const std::string& command) {
    const std::string out = folder_ + "/asked.json";
    Run("lab", exports_ + "realitygrad " + command + " --output json > " + out);
    return json::parse(*ReadFile(out), nullptr, false);
  }
  json WorkerNamed(const std::string& name) {
    const json workers = Ask("workers");
    for (const json& worker : workers["workers"]) {
      if (worker["name"] == name) return worker;
    }
    return {{"connected", false}, {"busy", 0}};
  }
  int Events(const std::string& kind, const std::string& worker) {
    int count = 0;
    const json all = Ask("events");
    for (const json& event : all["events"])
      count += event["event"] == kind && (worker.empty() || event["worker"] == worker);
    return count;
  }
  bool Until(const std::function<bool()>& holds, double seconds = 300.0) {
    const double end = RealClock().SteadySeconds() + seconds;
    while (!HasFatalFailure() && RealClock().SteadySeconds() < end) {
      if (holds()) return true;
      std::this_thread::sleep_for(std::chrono::milliseconds(50));
    }
    return false;
  }
  std::string Logs() const {
    std::string text;
    for (size_t i = 0; i < services_.size(); ++i) {
      const auto log = ReadFile(folder_ + "/service" + std::to_string(i));
      if (log.ok()) text += "--- service " + std::to_string(i) + "\n" + log->substr(log->size() - std::min<size_t>(log->size(), 2'000));
    }
    return text;
  }

  std::unique_ptr<Hosts> hosts_;
  std::string folder_, source_, exports_;
  std::vector<std::unique_ptr<Process>> services_;
};

TEST_F(Page, ItsCommandsLeadToAnIterationThatAPulledCableDoesNotStop) {
  const auto page = ReadFile(source_ + "/docs/three-hosts.md");
  ASSERT_TRUE(page.ok());
  std::string at_the_end;
  for (const Block& block : BlocksOf(*page)) {
    if (block.when == "at the end") {
      at_the_end = block.commands;
    } else if (block.when == "a service") {
      services_.push_back(std::make_unique<Process>(Command(block.host, "exec " + block.commands),
                                                    folder_ + "/service" + std::to_string(services_.size())));
    } else {
      std::istringstream lines(block.commands);
      for (std::string line; std::getline(lines, line);) {
        if (line.rfind("export ", 0) == 0) exports_ += line + "\n";
        // A person starts the services one after the other, and looks before submitting.
        if (line.rfind("realitygrad submit", 0) == 0) {
          ASSERT_TRUE(Until([&] { return Ask("workers")["workers"].size() == 3; })) << Logs();
        }
        if (line.rfind("export ", 0) != 0) Run(block.host, exports_ + line + "\n");
      }
    }
  }
  ASSERT_EQ(services_.size(), 4u);
  ASSERT_FALSE(at_the_end.empty());

  ASSERT_TRUE(Until([&] { return WorkerNamed("b")["busy"].get<int>() > 0; })) << Logs();
  hosts_->Plug(kHostNumbers.at("b"), false);
  ASSERT_TRUE(Until([&] { return Events("worker.lost", "b") > 0; })) << Logs();
  EXPECT_EQ(WorkerNamed("b")["connected"], false);
  EXPECT_GT(Events("task.lost", "b"), 0) << "it held work";
  std::this_thread::sleep_for(std::chrono::seconds(5));
  hosts_->Plug(kHostNumbers.at("b"), true);
  EXPECT_TRUE(Until([&] { return WorkerNamed("b")["connected"] == true; })) << "it joins by itself" << Logs();

  const std::string said = Run("lab", exports_ + at_the_end);
  EXPECT_NE(said.find("succeeded"), std::string::npos) << said;
  const json job = Ask("job show last");
  std::set<std::string> by;
  int attempts = 0;
  for (const json& task : job["task_list"]) {
    EXPECT_EQ(task["state"], "succeeded") << task.dump();
    attempts += task["attempts"].get<int>();
    by.insert(task["worker"].get<std::string>());
  }
  EXPECT_GT(attempts, static_cast<int>(job["task_list"].size())) << "what b held was given out again";
  EXPECT_TRUE(by.count("a")) << job.dump().substr(0, 2'000);
  by.erase("a"), by.erase("b");
  EXPECT_EQ(by.size(), 1u) << "the agent, which names itself after its host and process";
  EXPECT_EQ(Ask("params history")["versions"].size(), 1u);
}

}  // namespace
}  // namespace rg::testing
