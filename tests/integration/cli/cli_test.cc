#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <sstream>
#include <vector>

#include "tests/integration/cli/program.h"

namespace rg {
namespace {

using nlohmann::json;

TEST(CommandLine, WrongUseExitsWithTwoAndSaysWhy) {
  const ScratchFolder scratch;
  EXPECT_EQ(RunProgram(scratch, "").code, 2);
  EXPECT_EQ(RunProgram(scratch, "nonsense").code, 2);
  const Said said = RunProgram(scratch, "jobs --output xml");
  EXPECT_EQ(said.code, 2);
  EXPECT_NE(said.err.find("must be table, json or quiet"), std::string::npos) << said.err;
}

TEST(CommandLine, WrongUseIsOneLine) {
  const ScratchFolder scratch;
  for (const char* wrong :
       {"jobs --frob", "predict --window abc", "sysid", "sysid set --window-choice best",
        "sysid set --parametrisation nice", "submit identify --parametrisation nice", "run --parametrisation nice", "sysid set --fit-windows -1", "params diff 0 1",
        "artifacts gc --yes --older-than-days nan", "job wait 1 --timeout nan", "jobs --watch --timeout inf"}) {
    const Said said = RunProgram(scratch, wrong);
    EXPECT_EQ(said.code, 2) << wrong;
    EXPECT_TRUE(said.out.empty()) << wrong;
    EXPECT_EQ(std::count(said.err.begin(), said.err.end(), '\n'), 1) << said.err;
  }
}

TEST(Predict, NeverWritesOverWhatItReads) {
  const ScratchFolder scratch;
  std::string csv = "time,position.shoulder,position.elbow,effort_command.shoulder,effort_command.elbow\n";
  for (int k = 0; k < 50; ++k) csv += std::to_string(0.01 * k) + ",0.1,0.2,0,0\n";
  ASSERT_TRUE(WriteFileAtomically(scratch / "rec.csv", csv).ok());
  const std::string robot = std::string(std::getenv("RG_SOURCE_DIR")) + "/deploy/robots/arm2.urdf";
  ASSERT_TRUE(WriteFileAtomically(scratch / "arm.urdf", ReadFile(robot).value()).ok());
  for (const char* out : {"rec.csv", "./rec.csv", "arm.urdf"}) {
    const Said said = RunProgram(scratch, std::string("predict --model arm.urdf --recording rec.csv --out ") + out);
    EXPECT_EQ(said.code, 1) << out;
    EXPECT_EQ(std::count(said.err.begin(), said.err.end(), '\n'), 1) << said.err;
    EXPECT_NE(said.err.find("it would be lost: choose another"), std::string::npos) << said.err;
  }
  EXPECT_EQ(ReadFile(scratch / "rec.csv").value(), csv);
  EXPECT_EQ(RunProgram(scratch, "predict --model arm.urdf --recording rec.csv --out predicted.csv").code, 0);
}

TEST(CommandLine, ARunsDatabaseThatIsNoneIsNamed) {
  const ScratchFolder scratch;
  ASSERT_TRUE(WriteFileAtomically(scratch / "run/realitygrad.db", std::string(5000, 'x')).ok());
  // As a run leaves it that was killed.
  ASSERT_TRUE(WriteFileAtomically(scratch / "run/address", "ipc:///tmp/realitygrad-gone/socket").ok());
  const Said said = RunProgram(scratch, "--coordinator run jobs");
  EXPECT_NE(said.code, 0);
  EXPECT_EQ(std::count(said.err.begin(), said.err.end(), '\n'), 1) << said.err;
  EXPECT_NE(said.err.find("realitygrad.db: file is not a database"), std::string::npos) << said.err;
}

TEST(Run, RefusedFlagsLeaveNothing) {
  const ScratchFolder scratch;
  for (const char* wrong : {"--epochs 0", "--iterations 0", "--goal 1,2", "--spread nan", "--robot nope"}) {
    const Said said = RunProgram(scratch, std::string("run --dir made ") + wrong);
    EXPECT_EQ(said.code, std::string(wrong) == "--robot nope" ? 1 : 2) << wrong;
    EXPECT_EQ(std::count(said.err.begin(), said.err.end(), '\n'), 1) << said.err;
    EXPECT_FALSE(std::filesystem::exists(scratch / "made")) << wrong;
  }
}

TEST(CommandLine, NoCoordinatorExitsWithSix) {
  const ScratchFolder scratch;
  for (const char* command : {"jobs", "job wait 1"}) {
    const Said said = RunProgram(scratch, std::string("--coordinator tcp://127.0.0.1:9 ") + command);
    EXPECT_EQ(said.code, 6) << command;
    EXPECT_TRUE(said.out.empty()) << command;
    EXPECT_NE(said.err.find("127.0.0.1:9"), std::string::npos) << said.err;
  }
}

TEST(CommandLine, HelpNamesEveryCommandOfTheTour) {
  const ScratchFolder scratch;
  const Said said = RunProgram(scratch, "--help");
  EXPECT_EQ(said.code, 0);
  for (const char* name : {"run", "submit", "jobs", "job", "workers", "params", "artifacts", "sysid",
                           "predict", "diagnose", "prove", "effects", "doctor", "keys", "config"}) {
    EXPECT_NE(said.out.find(name), std::string::npos) << name;
  }
}

TEST(Effects, ListsTheCatalogueAndTellsOfOne) {
  const ScratchFolder scratch;
  const Said table = RunProgram(scratch, "effects");
  EXPECT_EQ(table.code, 0);
  const json all = json::parse(RunProgram(scratch, "effects --output json").out);
  EXPECT_EQ(all["format"], "realitygrad.effects/1");
  EXPECT_GE(all["effects"].size(), 28u);
  for (const json& effect : all["effects"]) {
    EXPECT_NE(table.out.find(effect["id"].get<std::string>()), std::string::npos) << effect["id"];
    ASSERT_TRUE(effect["needs"].is_array()) << effect["id"];
    if (effect["id"] == "load_dependent_friction") {
      EXPECT_EQ(effect["needs"], json({"both_ways", "load"}));
    }
    if (effect["id"] == "external_disturbance") {
      EXPECT_TRUE(effect["needs"].empty());
    }
  }
  const Said one = RunProgram(scratch, "effects coulomb_friction");
  for (const char* part : {"Coulomb friction", "-c*sign(dq)", "N*m or N", "stribeck_friction", "slow ramps"})
    EXPECT_NE(one.out.find(part), std::string::npos) << one.out;
  const Said none = RunProgram(scratch, "effects colomb");
  EXPECT_EQ(none.code, 1);
  EXPECT_NE(none.err.find("no effect 'colomb'"), std::string::npos) << none.err;
}

TEST(Config, FlagBeatsEnvironmentBeatsFile) {
  const ScratchFolder scratch;
  ASSERT_TRUE(WriteFileAtomically(scratch / ".realitygrad.json", R"({"coordinator": "tcp://file:1"})").ok());
  const auto address = [&](const std::string& flag) {
    const Said said = RunProgram(scratch, flag + " config show --output json");
    return json::parse(said.out)["coordinator"];
  };
  EXPECT_EQ(address("")["value"], "tcp://file:1");
  EXPECT_NE(address("")["origin"].get<std::string>().find("project file"), std::string::npos);
  setenv("REALITYGRAD_COORDINATOR", "tcp://environment:1", 1);
  EXPECT_EQ(address("")["value"], "tcp://environment:1");
  EXPECT_EQ(address("--coordinator tcp://flag:1")["value"], "tcp://flag:1");
  unsetenv("REALITYGRAD_COORDINATOR");
}

TEST(Config, UnknownKeysOfAFileAreRefused) {
  const ScratchFolder scratch;
  ASSERT_TRUE(WriteFileAtomically(scratch / ".realitygrad.json", R"({"coordinate": "x"})").ok());
  const Said said = RunProgram(scratch, "config show");
  EXPECT_EQ(said.code, 1);
  EXPECT_NE(said.err.find("unknown key 'coordinate'"), std::string::npos) << said.err;
}

TEST(Keys, GenerateAllowListRevoke) {
  const ScratchFolder scratch;
  const std::string folder = " --folder " + (scratch / "keys");
  EXPECT_EQ(RunProgram(scratch, "keys generate alice --role operator" + folder).code, 0);
  EXPECT_EQ(RunProgram(scratch, "keys generate alice --role operator" + folder).code, 1)
      << "must not overwrite";
  EXPECT_EQ(RunProgram(scratch, "keys allow alice" + folder).code, 0);
  const auto keys = json::parse(RunProgram(scratch, "keys list --output json" + folder).out)["keys"];
  ASSERT_EQ(keys.size(), 1u);
  EXPECT_EQ(keys[0]["allowed"], true);
  EXPECT_EQ(RunProgram(scratch, "keys revoke alice" + folder).code, 0);
  EXPECT_EQ(json::parse(RunProgram(scratch, "keys list --output json" + folder).out)["keys"][0]["allowed"],
            false);
}

TEST(Predict, BadInputIsOneLineAndLeavesNothing) {
  const ScratchFolder scratch;
  const Said said =
      RunProgram(scratch, "predict --model /nowhere/model.json --recording x.csv --out pred.csv");
  EXPECT_EQ(said.code, 1);
  EXPECT_EQ(std::count(said.err.begin(), said.err.end(), '\n'), 1) << said.err;
  EXPECT_NE(said.err.find("/nowhere/model.json"), std::string::npos);
  EXPECT_FALSE(std::filesystem::exists(scratch / "pred.csv"));
}

// A pendulum that swings freely: q, dq and the effort that holds its friction. `break_row` edits a row's
// fields.
struct PendulumSet {
  explicit PendulumSet(const ScratchFolder& scratch) : folder(scratch / "set") {
    std::filesystem::create_directories(folder);
    const char* root = std::getenv("RG_SOURCE_DIR");
    urdf = ReadFile(std::string(root ? root : ".") + "/deploy/robots/pendulum.urdf").value();
    manifest =
        R"({"format": "realitygrad.recordings/1", "robot": "robot.urdf", "joints": ["hinge"], "recordings": [{"file": "a.csv"}]})";
    csv = "time,position.hinge,velocity.hinge,effort_command.hinge\n";
    for (int k = 0; k < 400; ++k) {
      const double t = 0.01 * k, w = 3.0;
      char row[160];
      // Mass 0.6 kg at 0.45 m, inertia 0.1236 kg·m² about the hinge.
      const double q = 0.6 * std::sin(w * t), v = 0.6 * w * std::cos(w * t), a = -w * w * q;
      std::snprintf(row, sizeof row, "%.3f,%.6f,%.6f,%.6f\n", t, q, v,
                    0.1236 * a + 0.6 * 9.81 * 0.45 * std::sin(q) + 0.01 * v);
      csv += row;
    }
  }
  void Write() const {
    ASSERT_TRUE(WriteFileAtomically(folder + "/robot.urdf", urdf).ok());
    ASSERT_TRUE(WriteFileAtomically(folder + "/manifest.json", manifest).ok());
    ASSERT_TRUE(WriteFileAtomically(folder + "/a.csv", csv).ok());
  }
  std::string folder, urdf, manifest, csv;
};

std::string Replaced(std::string text, const std::string& from, const std::string& to) {
  const size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return at == std::string::npos ? text : text.replace(at, from.size(), to);
}

void ExpectRefused(const ScratchFolder& scratch, const PendulumSet& set, const std::string& said_of) {
  set.Write();
  const Said said = RunProgram(scratch, "diagnose set --out result --threads 1");
  EXPECT_EQ(said.code, 1) << said_of;
  EXPECT_EQ(std::count(said.err.begin(), said.err.end(), '\n'), 1) << said.err;
  EXPECT_NE(said.err.find(said_of), std::string::npos) << said.err;
  EXPECT_FALSE(std::filesystem::exists(scratch / "result")) << said_of;
}

// Lines that begin so, without it.
std::vector<std::string> LinesOf(const std::string& text, const std::string& prefix) {
  std::vector<std::string> out;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    if (line.starts_with(prefix)) out.push_back(line.substr(prefix.size()));
  }
  return out;
}

TEST(Check, SaysTheWarningsThatADiagnosisSaysFirst) {
  const ScratchFolder scratch;
  PendulumSet set(scratch);
  // A key that nobody knows, and a gap.
  set.manifest = Replaced(set.manifest, R"("joints")", R"("nois": 1, "joints")");
  set.manifest = Replaced(set.manifest, R"({"file": "a.csv"})", R"({"file": "a.csv"}, {"file": "b.csv"})");
  set.Write();
  const size_t from = set.csv.find("\n1.000,"), to = set.csv.find("\n1.400,");
  ASSERT_TRUE(from != std::string::npos && to != std::string::npos);
  ASSERT_TRUE(WriteFileAtomically(set.folder + "/b.csv", set.csv).ok());
  ASSERT_TRUE(WriteFileAtomically(set.folder + "/a.csv", set.csv.substr(0, from) + set.csv.substr(to)).ok());
  const Said check = RunProgram(scratch, "check set --output json");
  ASSERT_EQ(check.code, 0) << check.err;
  const std::vector<std::string> warnings = json::parse(check.out)["warnings"];
  ASSERT_GE(warnings.size(), 2u);
  EXPECT_TRUE(std::ranges::any_of(warnings, [](const auto& w) { return w.find("nois") != w.npos; }));
  const Said diagnosis = RunProgram(scratch, "diagnose set --out result --threads 1");
  ASSERT_EQ(diagnosis.code, 0) << diagnosis.err;
  const std::vector<std::string> said = LinesOf(diagnosis.err, "note: ");
  ASSERT_GE(said.size(), warnings.size()) << diagnosis.err;
  EXPECT_EQ(std::vector(said.begin(), said.begin() + static_cast<long>(warnings.size())), warnings);
  EXPECT_EQ(LinesOf(RunProgram(scratch, "check set").out, "note: "), warnings);
}

TEST(Diagnose, BadInputIsOneLineAndLeavesNothing) {
  const ScratchFolder scratch;
  const PendulumSet good(scratch);
  PendulumSet bad = good;
  bad.urdf = Replaced(bad.urdf, "\"hinge\"", "\"elbow\"");
  ExpectRefused(scratch, bad, "no joint 'hinge'");
  bad = good;
  bad.csv = Replaced(bad.csv, "0.100,", "0.050,");
  ExpectRefused(scratch, bad, "time goes back");
  bad = good;
  bad.csv = Replaced(bad.csv, "velocity.hinge", "position.hinge");
  ExpectRefused(scratch, bad, "twice");
  bad = good;
  bad.csv.resize(bad.csv.size() - 12);
  ExpectRefused(scratch, bad, "truncated");
  bad = good;
  bad.csv = Replaced(bad.csv, "0.000000", "nan");
  ExpectRefused(scratch, bad, "NaN");
  bad = good;
  bad.csv.resize(bad.csv.find("0.200,"));
  ExpectRefused(scratch, bad, "too little to say anything");
  bad = good;
  bad.manifest = "{";
  ExpectRefused(scratch, bad, "not JSON");
}

}  // namespace
}  // namespace rg
