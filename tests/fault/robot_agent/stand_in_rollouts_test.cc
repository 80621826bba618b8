// Seeded rollouts of the stand-in with faults: the arm never moves twice for one rollout, no recording is lost.
// RG_SCENARIOS says how many (5), RG_SCENARIOS_STATE names a file in which finished ones are kept, one line each,
// so that a long run goes on where it was cut.
#include <gtest/gtest.h>

#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>

#include "common/base/ids.h"
#include "tests/fault/robot_agent/stand_in_scenarios.h"

namespace rg::robot_agent {
namespace {

using nlohmann::json;

std::string FromEnvironment(const char* name, const char* otherwise) {
  const char* value = std::getenv(name);
  return value != nullptr ? value : otherwise;
}

json LineOf(const Scenario& scenario, const Verdict& v) {
  return {{"seed", scenario.seed},       {"fault", TroubleName(scenario.fault)}, {"begun", v.begun},
          {"completed", v.completed},    {"refused", v.refused},               {"salvaged", v.salvaged},
          {"latched", v.latched},        {"recordings", v.recordings},         {"moved_twice", v.moved_twice},
          {"lost", v.lost},              {"reason", v.reason},                 {"wrong", v.wrong}};
}

// Of this very program.
std::map<uint64_t, json> Finished(const std::string& state) {
  namespace fs = std::filesystem;
  std::map<uint64_t, json> finished;
  if (!fs::exists(state) || fs::last_write_time(state) < fs::last_write_time("/proc/self/exe")) {
    fs::remove(state);
    return finished;
  }
  std::ifstream in(state);
  for (std::string line; std::getline(in, line);) {
    const json said = json::parse(line, nullptr, false);
    if (said.is_object() && said.contains("seed")) finished[said["seed"]] = said;
  }
  return finished;
}

TEST(StandInRollouts, NoFaultMovesTheArmTwiceOrLosesARecording) {
  const uint64_t count = std::strtoull(FromEnvironment("RG_SCENARIOS", "5").c_str(), nullptr, 10);
  const uint64_t first = std::strtoull(FromEnvironment("RG_FIRST_SCENARIO", "8").c_str(), nullptr, 10);
  const std::string state = FromEnvironment("RG_SCENARIOS_STATE", "");
  const auto folder = std::filesystem::temp_directory_path() / ("rg-scenarios-" + RandomHex(6));
  auto finished = state.empty() ? std::map<uint64_t, json>() : Finished(state);
  std::map<std::string, int> sum, ends;
  for (uint64_t seed = first; seed < first + count; ++seed) {
    if (!finished.contains(seed)) {
      const Scenario scenario = DrawScenario(seed);
      finished[seed] = LineOf(scenario, RunScenario(scenario, (folder / std::to_string(seed)).string()));
      if (!state.empty()) std::ofstream(state, std::ios::app) << finished[seed].dump() << std::endl;
    }
    const json& line = finished[seed];
    for (const char* key : {"begun", "completed", "refused", "salvaged", "latched", "recordings", "moved_twice", "lost"})
      sum[key] += line[key].get<int>();
    ++ends[line["fault"].get<std::string>() + " -> " +
           (line["reason"].get<std::string>().empty() ? "refused" : line["reason"].get<std::string>())];
    EXPECT_TRUE(line["wrong"].empty()) << "seed " << seed << " (" << line["fault"] << "): " << line["wrong"].dump()
                                       << "; look into " << (folder / std::to_string(seed));
  }
  EXPECT_EQ(sum["moved_twice"], 0);
  EXPECT_EQ(sum["lost"], 0);
  EXPECT_EQ(sum["recordings"], sum["begun"]);
  EXPECT_GT(sum["begun"], 0);
  std::printf("%llu scenarios: %s\n", static_cast<unsigned long long>(count), json(sum).dump().c_str());
  for (const auto& [what, times] : ends) std::printf("  %4d  %s\n", times, what.c_str());
  std::error_code ignored;
  std::filesystem::remove(folder, ignored);  // empty where nothing went wrong
  if (!state.empty()) std::filesystem::remove(state, ignored);
}

}  // namespace
}  // namespace rg::robot_agent
