#include <nlohmann/json.hpp>

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
  for (const char* wrong : {"jobs --frob", "predict --window abc", "sysid", "params diff 0 1"}) {
    const Said said = RunProgram(scratch, wrong);
    EXPECT_EQ(said.code, 2) << wrong;
    EXPECT_TRUE(said.out.empty()) << wrong;
    EXPECT_EQ(std::count(said.err.begin(), said.err.end(), '\n'), 1) << said.err;
  }
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
    EXPECT_EQ(said.code, 1) << wrong;
    EXPECT_EQ(std::count(said.err.begin(), said.err.end(), '\n'), 1) << said.err;
    EXPECT_FALSE(std::filesystem::exists(scratch / "made")) << wrong;
  }
}

TEST(CommandLine, NoCoordinatorExitsWithSix) {
  const ScratchFolder scratch;
  const Said said = RunProgram(scratch, "--coordinator tcp://127.0.0.1:9 jobs");
  EXPECT_EQ(said.code, 6);
  EXPECT_TRUE(said.out.empty());
  EXPECT_NE(said.err.find("127.0.0.1:9"), std::string::npos) << said.err;
}

TEST(CommandLine, HelpNamesEveryCommandOfTheTour) {
  const ScratchFolder scratch;
  const Said said = RunProgram(scratch, "--help");
  EXPECT_EQ(said.code, 0);
  for (const char* name : {"run", "submit", "jobs", "job", "workers", "params", "artifacts", "sysid",
                           "predict", "doctor", "keys", "config"}) {
    EXPECT_NE(said.out.find(name), std::string::npos) << name;
  }
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

}  // namespace
}  // namespace rg
