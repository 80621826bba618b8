// `realitygrad prove` at its smallest: sets are made by the other engine, sealed, diagnosed and marked by
// real processes, and a second run goes on instead of starting anew.
#include <nlohmann/json.hpp>

#include "tests/integration/cli/program.h"

namespace rg {
namespace {

using nlohmann::json;

TEST(Prove, SealsDiagnosesMarksAndGoesOn) {
  if (!std::filesystem::exists(BinDir() + "/realitygrad-proof-generator"))
    GTEST_SKIP() << "SKIPPED: realitygrad-proof-generator is not built (libdart-dev)";
  const ScratchFolder scratch;
  const std::string command =
      "prove --robots pendulum --seed 7 --cases 1 --controls 1 --outside 1 --ordinary 0 --declared 1 --jobs "
      "2 --out p --markdown p.md "
      "--output "
      "json";
  const Said said = RunProgram(scratch, command);
  ASSERT_EQ(said.code, 0) << said.err;
  const json proof = json::parse(said.out);
  EXPECT_EQ(proof["format"], "realitygrad.proof/1");
  EXPECT_EQ(proof["seal"].get<std::string>().size(), 64u);
  EXPECT_NE(said.err.find(proof["seal"].get<std::string>()), std::string::npos) << "sealed before all else";
  ASSERT_EQ(proof["cases"].size(), 4u);
  EXPECT_EQ(proof["summary"]["ordinary"]["false_alarms_declared"]["n"], 1);
  EXPECT_EQ(proof["summary"]["outside_catalogue"]["n"], 1);
  EXPECT_EQ(proof["summary"]["undiagnosed"], 0);
  for (const json& one : proof["cases"]) {
    EXPECT_TRUE(one["rms"].is_number()) << one.dump();
    EXPECT_TRUE(one["black_box_rms"].is_number()) << one.dump();
  }
  const std::string page = ReadFile(scratch / "p/proof.html").value();
  size_t plots = 0;
  for (size_t at = 0; (at = page.find("class=\"mini", at)) != std::string::npos; ++at) ++plots;
  EXPECT_EQ(plots, 1 + 4u) << "the grid and one of each case";
  EXPECT_NE(ReadFile(scratch / "p.md").value().find("Every miss"), std::string::npos);

  const auto before = std::filesystem::last_write_time(scratch / "p/answers/case_000/diagnosis.json");
  const Said again = RunProgram(scratch, command);
  ASSERT_EQ(again.code, 0) << again.err;
  EXPECT_EQ(json::parse(again.out)["seal"], proof["seal"]);
  EXPECT_EQ(std::filesystem::last_write_time(scratch / "p/answers/case_000/diagnosis.json"), before)
      << "what was answered is not asked again";

  // A set that its reader refuses has no diagnosis; the others are marked all the same.
  const auto csv = scratch / "p/sets/case_000/rec_000.csv";
  ASSERT_TRUE(WriteFileAtomically(csv, ReadFile(csv).value() + "not a row\n").ok());
  std::filesystem::remove_all(scratch / "p/answers/case_000");
  const Said refused = RunProgram(scratch, command);
  ASSERT_EQ(refused.code, 0) << refused.err;
  EXPECT_NE(refused.err.find("case_000: no diagnosis: "), std::string::npos) << refused.err;
  const json marked = json::parse(refused.out);
  EXPECT_EQ(marked["summary"]["undiagnosed"], 1);
  EXPECT_EQ(marked["cases"].size(), 4u);
  EXPECT_EQ(marked["cases"][0]["right_first"], 0.0);
  EXPECT_NE(marked["cases"][0]["reason"].get<std::string>().find("rec_000.csv"), std::string::npos);
  EXPECT_TRUE(marked["cases"][1]["rms"].is_number());
}

TEST(Prove, MakesSetsAndLabelsAloneWhereThatIsAsked) {
  if (!std::filesystem::exists(BinDir() + "/realitygrad-proof-generator"))
    GTEST_SKIP() << "SKIPPED: realitygrad-proof-generator is not built (libdart-dev)";
  const ScratchFolder scratch;
  const Said said =
      RunProgram(scratch,
                 "prove --make-only --robots pendulum --seed 7 --cases 0 --controls 0 --outside 0 "
                 "--ordinary 1 --declared 2 --jobs 2 --out p --output json");
  ASSERT_EQ(said.code, 0) << said.err;
  EXPECT_EQ(json::parse(said.out)["format"], "realitygrad.proof_sets/1");
  const auto stratum = [&](const std::string& name) {
    return json::parse(ReadFile(scratch / ("p/sealed/" + name + "/label.json")).value())["stratum"];
  };
  EXPECT_EQ(stratum("case_1000"), "ordinary");
  EXPECT_EQ(stratum("case_1500"), "declared");
  EXPECT_EQ(stratum("case_1501"), "declared");
  EXPECT_TRUE(std::filesystem::is_empty(scratch / "p/answers"));
  EXPECT_FALSE(std::filesystem::exists(scratch / "p/proof.json"));

  // What the set declares is what its recordings were made with, by the other engine.
  bool rotors = false;
  for (const char* name : {"case_1500", "case_1501"}) {
    const std::string set = (scratch / "p/sets").string() + "/" + name;
    const bool model = std::filesystem::exists(set + "/model.json");
    rotors = rotors || model;
    const Said predicted = RunProgram(scratch, "predict --model " + set + (model ? "/model.json" : "") +
                                                   " --recording p/sealed/" + name +
                                                   "/hidden_000.csv --out predicted.csv --output json");
    EXPECT_EQ(predicted.code, 0) << predicted.err;
  }
  EXPECT_TRUE(rotors);
}

}  // namespace
}  // namespace rg
