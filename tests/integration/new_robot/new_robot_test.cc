// docs/new-robot.md, followed to the letter: every command of the page in one shell, then what it promises.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <sstream>

#include "common/base/file.h"
#include "common/base/ids.h"

namespace rg {
namespace {

using nlohmann::json;

std::string Environment(const char* name) {
  const char* value = std::getenv(name);
  return value != nullptr ? value : ".";
}

void Replace(std::string* text, const std::string& what, const std::string& by) {
  for (size_t at = text->find(what); at != std::string::npos; at = text->find(what, at + by.size()))
    text->replace(at, what.size(), by);
}

// The indented lines, but for the build: it has been built.
std::string CommandsOf(const std::string& page, const std::string& folder) {
  std::istringstream lines(ReadFile(Environment("RG_SOURCE_DIR") + "/" + page).value());
  std::string script = "set -e\ntrap 'kill $(jobs -p)' EXIT\n";
  for (std::string line; std::getline(lines, line);)
    if (line.rfind("    ", 0) == 0 && line.find("cmake --build") == std::string::npos)
      script += line.substr(4) + "\n";
  const std::string bin = Environment("RG_BIN_DIR");
  Replace(&script, "W=/tmp/new_robot;", "W=" + folder + ";");
  Replace(&script, "build/release/bin/", bin + "/");
  Replace(&script, "build/release/bench_arm/",
          std::filesystem::path(bin).parent_path().string() + "/bench_arm/");
  return script;
}

TEST(NewRobot, ThePagesCommandsLeadToTheFirstDiagnosis) {
  const std::string folder = (std::filesystem::temp_directory_path() / ("rg-new-" + RandomHex(6))).string();
  std::filesystem::create_directories(folder);
  ASSERT_TRUE(WriteFileAtomically(folder + "/page.sh", CommandsOf("docs/new-robot.md", folder)).ok());
  const std::string command = "cd " + Environment("RG_SOURCE_DIR") + " && bash -x " + folder + "/page.sh > " +
                              folder + "/said.txt 2>&1";
  const int how = std::system(command.c_str());
  ASSERT_EQ(how, 0) << ReadFile(folder + "/said.txt").value() << ReadFile(folder + "/agent.log").value();
  const json diagnosis = json::parse(ReadFile(folder + "/found/diagnosis.json").value());
  std::map<std::string, json> found;
  for (const json& finding : diagnosis["findings"]) found[finding["effect"]] = finding;
  const std::map<std::string, std::map<std::string, double>> hidden = {
      {"viscous", {{"shoulder", 1.1}, {"elbow", 0.6}}}, {"coulomb", {{"shoulder", 0.5}, {"elbow", 0.3}}}};
  for (const auto& [parameter, joints] : hidden) {
    ASSERT_TRUE(found.contains(parameter + "_friction")) << diagnosis["findings"].dump(1);
    for (const auto& [joint, value] : joints)
      EXPECT_NEAR(found[parameter + "_friction"]["parameters"][joint][parameter]["value"].get<double>(),
                  value, 0.15 * value)
          << joint;
  }
  const json rollout = json::parse(ReadFile(folder + "/swings/rollout.json").value());
  EXPECT_EQ(rollout["driver"], "bench_arm");
  EXPECT_EQ(rollout["end_reason"], "completed");
  EXPECT_EQ(rollout["held"], true);
  EXPECT_EQ(rollout["trust"], 0.0);
  {
    std::error_code ignored;  // the coordinator may still be closing its files
    std::filesystem::remove_all(folder, ignored);
  }
}

// A driver of this page's size.
TEST(NewRobot, TheDriverIsAsShortAsThePageSays) {
  const std::string text =
      ReadFile(Environment("RG_SOURCE_DIR") + "/deploy/examples/new_robot/bench_arm_driver.cc").value();
  const auto lines = std::count(text.begin(), text.end(), '\n');
  EXPECT_LE(lines, 200);
  EXPECT_NE(ReadFile(Environment("RG_SOURCE_DIR") + "/docs/new-robot.md")
                .value()
                .find(std::to_string(lines) + " lines"),
            std::string::npos);
}

}  // namespace
}  // namespace rg
