// A diagnosis on a worker is the diagnosis on this machine: real coordinator, real worker, a set of another
// engine.
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

  const Said bad = RunProgram(scratch, "--coordinator " + address + " submit diagnose nowhere");
  EXPECT_EQ(bad.code, 1);
  EXPECT_NE(bad.err.find("nowhere"), std::string::npos);
}

}  // namespace
}  // namespace rg
