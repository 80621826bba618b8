// A diagnosis on a worker, or with its fits spread over workers, is the diagnosis on this machine: real
// coordinator, real worker, a set of another engine.
#include <nlohmann/json.hpp>

#include "tests/integration/cli/program.h"

namespace rg {
namespace {

using nlohmann::json;

json WithoutTime(json diagnosis) {
  diagnosis.erase("elapsed_s");
  return diagnosis;
}

TEST(SubmitDiagnose, SaysWhatADiagnosisHereSays) {
  const std::string maker = BinDir() + "/realitygrad-proof-generator";
  if (!std::filesystem::exists(maker))
    GTEST_SKIP() << "SKIPPED: realitygrad-proof-generator is not built (libdart-dev)";
  const ScratchFolder scratch;
  const std::string make = maker + " --sets " + (scratch / "sets") + " --labels " + (scratch / "labels") +
                           " --robots " + std::getenv("RG_SOURCE_DIR") +
                           "/deploy/robots --robot pendulum --rate 50 --effect viscous_friction --weak 0"
                           " --wrong-parameters 0 --seed 12 --count 1 > " +
                           (scratch / "made") + " 2>&1";
  ASSERT_EQ(std::system(make.c_str()), 0) << ReadFile(scratch / "made").value();

  const std::string address = "ipc://" + (scratch / "c.sock");
  const Background coordinator(scratch, "realitygrad-coordinator", "--listen " + address + " --db c.db");
  const Background worker(scratch, "realitygrad-worker",
                          "--coordinator " + address + " --folder w --slots 1");
  const Said there =
      RunProgram(scratch, "--coordinator " + address +
                              " submit diagnose sets/case_000 --threads 1 --out there --output quiet");
  ASSERT_EQ(there.code, 0) << there.err;
  const Said here = RunProgram(scratch, "diagnose sets/case_000 --threads 1 --out here --output quiet");
  ASSERT_EQ(here.code, 0) << here.err;
  const auto read = [&](const std::string& file) { return json::parse(ReadFile(scratch / file).value()); };
  EXPECT_EQ(WithoutTime(read("there/diagnosis.json")), WithoutTime(read("here/diagnosis.json")));
  EXPECT_EQ(read("there/model.json")["values"], read("here/model.json")["values"]);
  EXPECT_TRUE(std::filesystem::exists(scratch / "there/report.html"));

  // Led by this process, its fits made by the worker and here; and without any worker.
  const Said spread = RunProgram(
      scratch, "--coordinator " + address + " diagnose sets/case_000 --threads 1 --out spread --output json");
  ASSERT_EQ(spread.code, 0) << spread.err;
  EXPECT_EQ(WithoutTime(read("spread/diagnosis.json")), WithoutTime(read("here/diagnosis.json")));
  EXPECT_EQ(ReadFile(scratch / "spread/model.json").value(), ReadFile(scratch / "here/model.json").value());
  EXPECT_NE(spread.err.find("fits by workers"), std::string::npos) << spread.err;
  EXPECT_EQ(spread.err.find("\n0 fits by workers"), std::string::npos) << spread.err;
  const json jobs =
      json::parse(RunProgram(scratch, "--coordinator " + address + " jobs --output json").out)["jobs"];
  EXPECT_NE(jobs.dump().find("\"fits\""), std::string::npos) << jobs.dump(1);

  const std::string empty = "ipc://" + (scratch / "e.sock");
  const Background idle(scratch, "realitygrad-coordinator", "--listen " + empty + " --db e.db");
  const Said alone = RunProgram(
      scratch, "--coordinator " + empty + " diagnose sets/case_000 --threads 1 --out alone --output json");
  ASSERT_EQ(alone.code, 0) << alone.err;
  EXPECT_NE(alone.err.find("\n0 fits by workers"), std::string::npos) << alone.err;
  EXPECT_EQ(ReadFile(scratch / "alone/model.json").value(), ReadFile(scratch / "here/model.json").value());

  const Said bad = RunProgram(scratch, "--coordinator " + address + " submit diagnose nowhere");
  EXPECT_EQ(bad.code, 1);
  EXPECT_NE(bad.err.find("nowhere"), std::string::npos);
}

}  // namespace
}  // namespace rg
