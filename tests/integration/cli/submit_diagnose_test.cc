// A diagnosis on a worker, or with its fits spread over workers, is the diagnosis on this machine: real
// coordinator, real worker, a set of another engine.
#include <map>
#include <nlohmann/json.hpp>

#include "tests/integration/cli/program.h"

namespace rg {
namespace {

using nlohmann::json;

json WithoutTime(json diagnosis) {
  diagnosis.erase("elapsed_s");
  return diagnosis;
}

bool HasMaker() { return std::filesystem::exists(BinDir() + "/realitygrad-proof-generator"); }

// sets/case_000 in the folder.
void MakeCase(const ScratchFolder& scratch, const std::string& robot, int rate_hz) {
  const std::string make = BinDir() + "/realitygrad-proof-generator --sets " + (scratch / "sets") +
                           " --labels " + (scratch / "labels") + " --robots " + std::getenv("RG_SOURCE_DIR") +
                           "/deploy/robots --robot " + robot + " --rate " + std::to_string(rate_hz) +
                           " --effect viscous_friction --weak 0"
                           " --wrong-parameters 0 --seed 12 --count 1 > " +
                           (scratch / "made") + " 2>&1";
  ASSERT_EQ(std::system(make.c_str()), 0) << ReadFile(scratch / "made").value();
}

// The worker that leads the search is killed in the middle of it: another one takes the lead, with the fits
// that are done.
TEST(SubmitDiagnose, OutlivesTheWorkerThatLeadsIt) {
  if (!HasMaker()) GTEST_SKIP() << "SKIPPED: realitygrad-proof-generator is not built (libdart-dev)";
  const ScratchFolder scratch;
  MakeCase(scratch, "arm2", 100);
  const std::string address = "ipc://" + (scratch / "c.sock");
  const std::string service = "--coordinator " + address + " ";
  const Background coordinator(scratch, "realitygrad-coordinator",
                               "--listen " + address + " --db c.db --heartbeat-ms 400");
  std::map<std::string, Background> workers;
  for (const char* name : {"one", "two"}) {
    workers.try_emplace(name, scratch, "realitygrad-worker",
                        service + "--slots 2 --folder " + name + " --name " + name);
  }
  const Said submitted = RunProgram(
      scratch, service + "submit diagnose sets/case_000 --threads 1 --request-id once --output quiet");
  ASSERT_EQ(submitted.code, 0) << submitted.err;
  const std::string id = submitted.out.substr(0, submitted.out.find('\n'));
  const auto fits_done = [&] {
    const json jobs = json::parse(RunProgram(scratch, service + "jobs --of " + id + " --output json").out);
    int done = 0;
    for (const json& job : jobs["jobs"]) done += job["tasks"]["done"].get<int>();
    return done;
  };
  for (int i = 0; i < 2000 && fits_done() == 0; ++i) usleep(5'000);
  ASSERT_GT(fits_done(), 0);
  const json now = json::parse(RunProgram(scratch, service + "job show " + id + " --output json").out);
  workers.at(now["task_list"][0]["worker"].get<std::string>()).KillNow();
  const Said there = RunProgram(scratch, service +
                                             "submit diagnose sets/case_000 --threads 1 --request-id once"
                                             " --out there --output json");
  ASSERT_EQ(there.code, 0) << there.err;
  EXPECT_EQ(std::to_string(json::parse(there.out)["id"].get<int>()), id);
  EXPECT_EQ(json::parse(there.out)["task_list"][0]["attempts"], 2);
  const Said here = RunProgram(scratch, "diagnose sets/case_000 --threads 1 --out here --output quiet");
  ASSERT_EQ(here.code, 0) << here.err;
  const auto read = [&](const std::string& file) { return json::parse(ReadFile(scratch / file).value()); };
  EXPECT_EQ(WithoutTime(read("there/diagnosis.json")), WithoutTime(read("here/diagnosis.json")));
  EXPECT_EQ(read("there/model.json")["values"], read("here/model.json")["values"]);
}

TEST(SubmitDiagnose, SaysWhatADiagnosisHereSays) {
  if (!HasMaker()) GTEST_SKIP() << "SKIPPED: realitygrad-proof-generator is not built (libdart-dev)";
  const ScratchFolder scratch;
  MakeCase(scratch, "pendulum", 200);
  const std::string address = "ipc://" + (scratch / "c.sock");
  const Background coordinator(scratch, "realitygrad-coordinator", "--listen " + address + " --db c.db");
  const Background worker(scratch, "realitygrad-worker",
                          "--coordinator " + address + " --folder w --slots 2");
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
  const std::string log = RunProgram(scratch, "--coordinator " + address + " job logs last").out;
  EXPECT_NE(log.find(" fits by other tasks"), std::string::npos) << log;
  EXPECT_EQ(log.find(" 0 fits by other tasks"), std::string::npos) << log;

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

// `realitygrad WORDS` in the background, to be interrupted.
class Interrupted {
 public:
  Interrupted(const ScratchFolder& scratch, const std::string& words) : scratch_(scratch), pid_(fork()) {
    if (pid_ != 0) return;
    if (chdir(scratch.path().c_str()) != 0) _exit(9);
    execl("/bin/sh", "sh", "-c", ("exec " + BinDir() + "/realitygrad " + words + " >i.out 2>i.err").c_str(), nullptr);
    _exit(9);
  }
  void Interrupt() const { kill(pid_, SIGINT); }
  // Its exit code, or minus the signal that ended it.
  int End() const {
    int how = 0;
    waitpid(pid_, &how, 0);
    return WIFEXITED(how) ? WEXITSTATUS(how) : -WTERMSIG(how);
  }
  // Whether Ctrl-C is taken by the program itself by now.
  bool Listens() const {
    std::ifstream status("/proc/" + std::to_string(pid_) + "/status");
    for (std::string line; std::getline(status, line);)
      if (line.rfind("SigCgt:", 0) == 0) return (std::stoull(line.substr(8), nullptr, 16) & (1u << (SIGINT - 1))) != 0;
    return false;
  }
  std::string Said() const { return ReadFile(scratch_ / "i.err").value(); }

 private:
  const ScratchFolder& scratch_;
  const pid_t pid_;
};

TEST(Diagnose, EndsAtOnceOnTheSecondCtrlC) {
  if (!HasMaker()) GTEST_SKIP() << "SKIPPED: realitygrad-proof-generator is not built (libdart-dev)";
  const ScratchFolder scratch;
  MakeCase(scratch, "arm2", 100);
  const Interrupted run(scratch, "diagnose sets/case_000 --threads 1");
  while (!run.Listens()) usleep(1'000);
  for (int i = 0; i < 2; ++i) {
    run.Interrupt();
    usleep(50'000);
  }
  EXPECT_EQ(run.End(), -SIGINT) << run.Said();
}

}  // namespace
}  // namespace rg
