// `realitygrad prove` at its smallest: sets are made by the other engine, sealed, diagnosed and marked by
// real processes, and a second run goes on instead of starting anew.
#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <sstream>

#include "tests/integration/cli/program.h"

namespace rg {
namespace {

using nlohmann::json;

// The first column whose name begins so.
std::vector<double> Column(const std::string& file, const std::string& begins) {
  std::ifstream in(file);
  std::string line, cell;
  std::getline(in, line);
  std::stringstream header(line);
  int at = 0;
  while (std::getline(header, cell, ',') && cell.rfind(begins, 0) != 0) ++at;
  std::vector<double> out;
  while (std::getline(in, line)) {
    std::stringstream row(line);
    for (int i = 0; i <= at; ++i) std::getline(row, cell, ',');
    out.push_back(std::stod(cell));
  }
  return out;
}

TEST(Prove, WithoutItsGeneratorSaysTheCommandThatMakesItAndLeavesNothing) {
  const ScratchFolder scratch;
  for (const char* name : {"/realitygrad", "/realitygrad-lab"})
    std::filesystem::copy_file(BinDir() + name, scratch.path() + name);
  const std::string command =
      "cd " + scratch.path() + " && ./realitygrad prove --quick --out p >out 2>err; test $? = 1";
  EXPECT_EQ(std::system(command.c_str()), 0);
  const std::string said = ReadFile(scratch / "err").value();
  EXPECT_EQ(std::count(said.begin(), said.end(), '\n'), 1) << said;
  EXPECT_NE(said.find("apt-get install -y libdart-dev libdart-utils-urdf-dev && cmake -S "),
            std::string::npos)
      << said;
  EXPECT_NE(said.find("--target realitygrad-proof-generator\n"), std::string::npos) << said;
  EXPECT_EQ(ReadFile(scratch / "out").value(), "");
  EXPECT_FALSE(std::filesystem::exists(scratch / "p"));
}

TEST(Prove, SealsDiagnosesMarksAndGoesOn) {
  if (!std::filesystem::exists(BinDir() + "/realitygrad-proof-generator"))
    GTEST_SKIP() << "SKIPPED: realitygrad-proof-generator is not built (libdart-dev)";
  const ScratchFolder scratch;
  const std::string command =
      "prove --robots pendulum --seed 13 --cases 1 --controls 1 --outside 1 --ordinary 0 --declared 1 --jobs "
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
    const std::string set = scratch / ("p/sets/" + std::string(name)),
                      sealed = scratch / ("p/sealed/" + std::string(name));
    const bool model = std::filesystem::exists(set + "/model.json");
    rotors = rotors || model;
    double squares = 0;
    size_t rows = 0;
    for (const char* hidden : {"/hidden_000.csv", "/hidden_001.csv"}) {
      const Said predicted = RunProgram(scratch, "predict --model " + set + (model ? "/model.json" : "") +
                                                     " --recording " + sealed + hidden + " --out p.csv");
      ASSERT_EQ(predicted.code, 0) << predicted.err;
      const auto truth = Column(sealed + hidden, "true_position."),
                 said_so = Column(scratch / "p.csv", "position.");
      ASSERT_EQ(truth.size(), said_so.size());
      for (size_t k = 1; k < truth.size(); ++k) squares += std::pow(truth[k] - said_so[k], 2), ++rows;
    }
    const json oracle = json::parse(ReadFile(sealed + "/oracle.json").value());
    EXPECT_LT(std::sqrt(squares / static_cast<double>(rows)), 1.5 * oracle["oracle_rms"].get<double>())
        << name;
  }
  EXPECT_TRUE(rotors);
}

// Two small sets with labels beside them, as practice sets have them.
void MakeLabelledSets(const ScratchFolder& scratch) {
  const std::string make = BinDir() +
                           "/realitygrad-proof-generator --robot pendulum --rate 100 --count 1 --sets " +
                           scratch / "s/sets" + " --labels " + scratch / "s/sealed" + " --robots " +
                           BinDir() + "/../../../deploy/robots";
  for (const std::string& one :
       {std::string(" --seed 3 --effect viscous_friction"), std::string(" --seed 4 --first 1 --declared")})
    ASSERT_EQ(std::system((make + one + " >" + scratch / "made" + " 2>&1").c_str()), 0)
        << ReadFile(scratch / "made").value();
}

TEST(Prove, DiagnosesAndMarksLabelledSetsAndComparesTwoBuildsAnswers) {
  if (!std::filesystem::exists(BinDir() + "/realitygrad-proof-generator"))
    GTEST_SKIP() << "SKIPPED: realitygrad-proof-generator is not built (libdart-dev)";
  const ScratchFolder scratch;
  MakeLabelledSets(scratch);
  const Said said = RunProgram(scratch, "prove --sets s --out a --jobs 2 --output json");
  ASSERT_EQ(said.code, 0) << said.err;
  const json battery = json::parse(said.out);
  EXPECT_EQ(battery["format"], "realitygrad.battery/1");
  ASSERT_EQ(battery["cases"].size(), 2u);
  EXPECT_EQ(battery["programs"].size(), 1u);
  const json& single = battery["cases"][0];
  EXPECT_EQ(single["kind"], "single");
  EXPECT_EQ(single["f1"], 1.0) << single.dump();
  EXPECT_EQ(single["joints_f1"], 1.0);
  EXPECT_LT(single["over_noise_floor"], 1.5);
  EXPECT_GT(single["seconds"], 0.1);
  EXPECT_EQ(battery["cases"][1]["kind"], "declared");
  EXPECT_EQ(battery["strata"].size(), 3u) << "single, declared, all";

  // Only what has no answer is asked again; with too little time it has none, and the others are told.
  const auto before = std::filesystem::last_write_time(scratch / "a/case_001/diagnosis.json");
  std::filesystem::copy(scratch / "a", scratch / "b", std::filesystem::copy_options::recursive);
  std::filesystem::remove_all(scratch / "b/case_000");
  const Said late = RunProgram(scratch, "prove --sets s --out b --jobs 2 --limit 1");
  ASSERT_EQ(late.code, 0) << late.err;
  const json run = json::parse(ReadFile(scratch / "b/case_000/run.json").value());
  if (run["outcome"] == "out_of_time") {
    EXPECT_NE(late.out.find("no answer in 1 s of CPU time"), std::string::npos) << late.out;
  } else {
    EXPECT_LE(run["cpu_s"], 2.0) << "answered within the limit: a fast machine";
  }
  EXPECT_EQ(json::parse(ReadFile(scratch / "b/battery.json").value())["cases"].size(), 2u);

  // A build that says the wrong thing of one set.
  std::filesystem::copy(
      scratch / "a/case_000", scratch / "b/case_000",
      std::filesystem::copy_options::recursive | std::filesystem::copy_options::overwrite_existing);
  json wrong = json::parse(ReadFile(scratch / "a/case_000/diagnosis.json").value());
  wrong["findings"][0]["effect"] = "torque_gain";
  ASSERT_TRUE(WriteFileAtomically(scratch / "b/case_000/diagnosis.json", wrong.dump()).ok());
  const Said compared = RunProgram(scratch, "prove --compare b a --output json");
  ASSERT_EQ(compared.code, 0) << compared.err;
  const json change = json::parse(compared.out);
  ASSERT_EQ(change["changed"].size(), 1u) << compared.out;
  EXPECT_EQ(change["changed"][0]["won"], true);
  EXPECT_EQ(change["strata"].back()["won"], 1);
  EXPECT_EQ(change["strata"].back()["lost"], 0);
  EXPECT_EQ(change["strata"].back()["mcnemar_p"], 1.0);
  EXPECT_EQ(std::filesystem::last_write_time(scratch / "a/case_001/diagnosis.json"), before);

  const Said marked = RunProgram(scratch, "prove --sets s --out b --mark-only");
  ASSERT_EQ(marked.code, 0) << marked.err;
  EXPECT_NE(marked.out.find("wrong at 0.8 or more: case_000: torque_gain"), std::string::npos) << marked.out;
  const Said reliability = RunProgram(scratch, "prove --reliability a b --svg r.svg --output json");
  ASSERT_EQ(reliability.code, 0) << reliability.err;
  EXPECT_EQ(json::parse(reliability.out)["findings"], 2);
  EXPECT_NE(ReadFile(scratch / "r.svg").value().find("</svg>"), std::string::npos);
}

TEST(Prove, SaysWhatIsNoLabelledSetOrNoAnswersFolder) {
  const ScratchFolder scratch;
  const auto refused = [&](const std::string& arguments, const std::string& why) {
    const Said said = RunProgram(scratch, "prove " + arguments);
    EXPECT_EQ(said.code, 1) << arguments;
    EXPECT_NE(said.err.find(why), std::string::npos) << said.err;
    EXPECT_EQ(std::count(said.err.begin(), said.err.end(), '\n'), 1) << said.err;
  };
  refused("--sets nowhere --out a", "nowhere: no recording set");
  refused("--compare a b", "a/battery.json");
  EXPECT_FALSE(std::filesystem::exists(scratch / "a"));
  EXPECT_EQ(RunProgram(scratch, "prove --sets x --seed 4").code, 2) << "sets have their own";
  EXPECT_EQ(RunProgram(scratch, "prove --mark-only").code, 2);
}

}  // namespace
}  // namespace rg
