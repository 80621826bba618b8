// Holds the #include lines of the tree to the arrows of docs/architecture.md, and what is known of an effect
// to the effect's own file: how often a folder names effects may only fall.
#include <gtest/gtest.h>

#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <set>
#include <sstream>
#include <string>
#include <vector>

#include "common/effects/effect_catalog.h"

namespace rg {
namespace {

namespace fs = std::filesystem;

// room -> rooms it may include beside itself. A room is the longest prefix listed here.
const std::map<std::string, std::set<std::string>>& Arrows() {
  static const std::set<std::string> model = {"common/base", "common/math", "common/model"};
  static const auto with = [](std::set<std::string> a, const std::set<std::string>& b) {
    a.insert(b.begin(), b.end());
    return a;
  };
  static const std::set<std::string> dynamics = with(model, {"common/dynamics"});
  static const std::set<std::string> sim =
      with(dynamics, {"common/effects", "common/integrators", "common/sim"});
  static const std::set<std::string> wire = {"common/base", "proto", "common/transport", "common/store"};
  static const std::set<std::string> algorithms =
      with(sim, {"common/recordings", "services/trajectories", "services/policy", "services/rollouts",
                 "services/sysid", "services/diagnosis"});
  static const std::set<std::string> fits = with(sim, {"common/recordings", "services/sysid"});
  static const auto diagnosis = [](const std::set<std::string>& rooms) {
    std::set<std::string> all = fits;
    for (const std::string& room : rooms) all.insert("services/diagnosis/" + room);
    return all;
  };
  static const std::map<std::string, std::set<std::string>> arrows = {
      {"common/base", {}},
      {"common/math", {"common/base"}},
      {"common/model", {"common/base", "common/math"}},
      {"common/dynamics", model},
      {"common/effects", dynamics},
      {"common/integrators", with(dynamics, {"common/effects"})},
      {"common/sim", with(dynamics, {"common/effects", "common/integrators"})},
      {"common/recordings", sim},
      {"common/transport", {"common/base", "proto"}},
      {"common/store", {"common/base", "proto"}},
      {"services/trajectories", sim},
      {"services/policy", sim},
      {"services/rollouts", with(sim, {"common/recordings", "services/policy"})},
      {"services/sysid", with(sim, {"common/recordings"})},
      {"services/diagnosis", with(fits, {"services/diagnosis"})},  // the facade knows its rooms
      {"services/diagnosis/api", fits},
      {"services/diagnosis/data", diagnosis({"api"})},
      {"services/diagnosis/likelihood", diagnosis({"api", "data"})},
      {"services/diagnosis/hypotheses", diagnosis({"api", "data", "likelihood"})},
      {"services/diagnosis/screening", diagnosis({"api", "data", "likelihood", "hypotheses"})},
      {"services/diagnosis/balance", diagnosis({"api", "data", "likelihood", "hypotheses"})},
      {"services/diagnosis/search", diagnosis({"api", "data", "likelihood", "hypotheses", "screening"})},
      {"services/diagnosis/design", diagnosis({"api", "data", "likelihood", "hypotheses"})},
      {"services/diagnosis/reporting", diagnosis({"api", "data", "likelihood", "hypotheses"})},
      {"services/report", algorithms},
      {"services/importing", with(model, {"common/recordings"})},
      {"services/proof", with(algorithms, {"services/report"})},
      {"services/proof/generator", {"common/base"}},  // the examiner's engine is independent
      {"services/jobs", with(with(with(algorithms, wire), {"services/report", "services/proof"}),
                             {"coordinator/client", "worker"})},
      {"services/cli",
       with(with(with(algorithms, wire), {"services/report"}),
            {"coordinator/client", "coordinator/store", "services/jobs", "services/importing"})},
      {"services/lab", with(with(with(algorithms, wire), {"services/report", "services/proof"}),
                            {"coordinator/client", "services/jobs", "services/cli"})},
      {"coordinator", wire},
      {"worker", with(wire, {"coordinator/client"})},
      {"robot_agent/drivers", dynamics},
      {"robot_agent/drivers/replay", with(dynamics, {"common/recordings", "robot_agent/drivers"})},
      {"robot_agent/safety", with(dynamics, {"robot_agent/drivers"})},  // no controller, policy or job
      {"robot_agent/guard", with(dynamics, {"robot_agent/drivers", "robot_agent/safety"})},
      {"robot_agent",
       with(with(algorithms, wire), {"worker", "coordinator/client", "services/jobs", "robot_agent/drivers",
                                     "robot_agent/safety", "robot_agent/guard"})},
  };
  return arrows;
}

std::string RoomOf(const std::string& path) {
  std::string best;
  for (const auto& [room, allowed] : Arrows()) {
    if (path.rfind(room + "/", 0) == 0 && room.size() > best.size()) best = room;
  }
  return path.rfind("proto/", 0) == 0 || path.rfind("realitygrad/v1/", 0) == 0 ? "proto" : best;
}

bool Allowed(const std::string& from_room, const std::string& included) {
  const std::string room = RoomOf(included);
  if (room.empty() || room == from_room) return true;
  const auto& allowed = Arrows().at(from_room);
  if (allowed.count(room)) return true;
  for (const std::string& a : allowed) {
    if (included.rfind(a + "/", 0) == 0) return true;
  }
  return false;
}

std::string SourceDir() {
  const char* dir = std::getenv("RG_SOURCE_DIR");
  return dir ? dir : ".";
}

std::vector<std::string> Violations() {
  std::vector<std::string> found;
  for (const char* top : {"common", "services", "coordinator", "worker", "robot_agent"}) {
    if (!fs::exists(SourceDir() + "/" + top)) continue;
    for (const auto& entry : fs::recursive_directory_iterator(SourceDir() + "/" + top)) {
      const std::string extension = entry.path().extension();
      if (extension != ".h" && extension != ".cc") continue;
      const std::string path = fs::relative(entry.path(), SourceDir());
      const std::string room = RoomOf(path);
      if (room.empty()) {
        found.push_back(path + " is in no room of the table");
        continue;
      }
      std::ifstream in(entry.path());
      for (std::string line; std::getline(in, line);) {
        if (line.rfind("#include", 0) != 0) continue;
        if (room == "coordinator" && line.find("<Eigen") != std::string::npos) {
          found.push_back(path + " includes Eigen");
        }
        const size_t open = line.find('"');
        if (open == std::string::npos) continue;
        const std::string included = line.substr(open + 1, line.find('"', open + 1) - open - 1);
        if (!Allowed(room, included)) found.push_back(path + " may not include " + included);
      }
    }
  }
  return found;
}

TEST(Layout, IncludesFollowTheArrows) {
  std::ostringstream all;
  const auto found = Violations();
  for (const auto& v : found) all << v << "\n";
  EXPECT_TRUE(found.empty()) << all.str();
}

TEST(Layout, TheTableForbidsWhatItShould) {
  EXPECT_FALSE(Allowed("common/dynamics", "common/sim/plant.h"));
  EXPECT_FALSE(Allowed("coordinator", "services/sysid/sysid.h"));
  EXPECT_FALSE(Allowed("services/sysid", "realitygrad/v1/job.pb.h"));
  EXPECT_TRUE(Allowed("common/sim", "common/base/status.h"));
  EXPECT_FALSE(Allowed("services/diagnosis/likelihood", "services/diagnosis/search/search.h"));
  EXPECT_FALSE(Allowed("services/diagnosis/search", "services/diagnosis/diagnosis.h"));
  EXPECT_TRUE(Allowed("services/diagnosis", "services/diagnosis/search/search.h"));
}

// String literals that are an effect's id, or begin with it as a parameter's name does
// ("payload.*.mass").
int EffectLiterals(const std::string& text) {
  int count = 0;
  for (const effects::EffectInfo& info : effects::Catalog()) {
    const std::string literal = "\"" + info.id;
    for (size_t at = text.find(literal); at != std::string::npos; at = text.find(literal, at + 1)) {
      const size_t end = at + literal.size();
      count += end < text.size() && (text[end] == '"' || text[end] == '.');
    }
  }
  return count;
}

// Folders whose code names effects, the longest prefix counts, with the most that it may. What has to be
// known of an effect is declared with it (common/effects), so that a new one is added in one place: a bound
// is lowered when the count falls and never raised. Other folders name none. The examiner's engine
// (generator) is independent and has names of its own; benches and examples choose effects by name as a user
// does.
const std::map<std::string, int>& MostLiterals() {
  static const std::map<std::string, int> most = {{"common/sim", 38},
                                                  {"services/lab", 5},
                                                  {"services/proof", 33},
                                                  {"services/proof/generator", 244},
                                                  {"services/trajectories", 12}};
  return most;
}

std::map<std::string, int> LiteralsByFolder() {
  std::map<std::string, int> found;
  for (const char* top : {"common", "services", "coordinator", "worker", "robot_agent"}) {
    for (const auto& entry : fs::recursive_directory_iterator(SourceDir() + "/" + top)) {
      const std::string extension = entry.path().extension();
      if (extension != ".h" && extension != ".cc") continue;
      const std::string path = fs::relative(entry.path(), SourceDir());
      if (path.rfind("common/effects/", 0) == 0) continue;
      std::string folder = fs::path(path).parent_path();
      for (const auto& [name, bound] : MostLiterals()) {
        if (path.rfind(name + "/", 0) == 0) folder = name;
      }
      std::ifstream in(entry.path());
      std::ostringstream text;
      text << in.rdbuf();
      found[folder] += EffectLiterals(text.str());
    }
  }
  return found;
}

TEST(Layout, FoldersNameNoMoreEffectsThanTheyDid) {
  for (const auto& [folder, count] : LiteralsByFolder()) {
    const auto bound = MostLiterals().find(folder);
    const int most = bound == MostLiterals().end() ? 0 : bound->second;
    EXPECT_LE(count, most) << folder << " names effects " << count << " times";
    if (count < most) std::printf("%s: %d, lower its bound of %d\n", folder.c_str(), count, most);
  }
}

TEST(Layout, CountsIdsAndNamesOfParameters) {
  EXPECT_EQ(EffectLiterals("Has(\"payload\") || Find(\"payload.*.mass\")"), 2);
  EXPECT_EQ(EffectLiterals("payload \"payloads\" \"unknown_field_pair\""), 1);
}

}  // namespace
}  // namespace rg
