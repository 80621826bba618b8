// Looking closely: describe, logs, watching, parameters over robots and jobs, completion in a real shell.
#include <gtest/gtest.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <thread>

#include "tests/integration/cli/program.h"
#include "tests/support/service/processes.h"

namespace rg {
namespace {

using nlohmann::json;
namespace pb = realitygrad::v1;

class JobCommands : public ::testing::Test {
 protected:
  Said Run(const std::string& arguments) {
    return RunProgram(scratch_, "--coordinator " + service_.endpoint() + " " + arguments);
  }
  json RunJson(const std::string& arguments) {
    const Said said = Run(arguments + " --output json");
    EXPECT_EQ(said.code, 0) << arguments << ": " << said.err;
    return json::parse(said.out, nullptr, false);
  }
  int64_t SubmitOne(const std::string& kind, const std::string& payload) {
    pb::JobSpec job;
    job.set_kind("test");
    testing::AddTask(&job, "t", kind, payload);
    (*job.mutable_labels())["robot"] = "arm";
    return *service_.client().Submit(job);
  }
  int64_t Parameters(const std::string& robot, double value) {
    const int64_t id = SubmitOne("parameters", json{{"robot", robot}, {"value", value}}.dump());
    EXPECT_TRUE(service_.client().WaitForJob(id, 60.0).ok());
    return id;
  }

  ScratchFolder scratch_;
  testing::Service service_;
};

TEST_F(JobCommands, ASelectorBeyondAllJobsIsRefusedAndAnUnknownRobotIsNamed) {
  for (const char* wrong : {"99999999999999999999", "9223372036854775807", "1-9223372036854775807", "2-1", "0"}) {
    const Said said = Run(std::string("job show ") + wrong);
    EXPECT_NE(said.code, 0) << wrong;
    EXPECT_NE(said.err.find("must be a number"), std::string::npos) << said.err;
  }
  service_.StartWorker("a");
  Parameters("left", 1.0);
  const Said said = Run("params history --robot right");
  EXPECT_EQ(said.code, 1);
  EXPECT_NE(said.err.find("robot 'right' has no parameters; these have: left"), std::string::npos) << said.err;
}

TEST_F(JobCommands, AllJobsAreCancelledAtOnceAndThoseOfOthersOnlyWhereThatIsMeant) {
  const auto submit = [&](const std::string& who) {
    pb::JobSpec job;
    job.set_kind("test");
    job.set_submitted_by(who);
    testing::AddTask(&job, "t", "echo");
    return *service_.client().Submit(job);
  };
  const int64_t others = submit("eve@far");
  submit("");
  submit("");
  const Said refused = Run("job cancel all < /dev/null");
  EXPECT_EQ(refused.code, 1);
  EXPECT_NE(refused.err.find("1 of the 3 jobs are others' (eve@far)"), std::string::npos) << refused.err;
  EXPECT_EQ(RunJson("jobs --state queued")["jobs"].size(), 3u);
  EXPECT_EQ(RunJson("jobs --by eve@far")["jobs"][0]["id"], others);
  EXPECT_EQ(RunJson("job cancel all --mine < /dev/null")["jobs"].size(), 2u);
  EXPECT_EQ(RunJson("jobs --state queued")["jobs"].size(), 1u);
  EXPECT_EQ(RunJson("job cancel all --others < /dev/null")["jobs"].size(), 1u);
  const Said none = Run("jobs --state queued");
  EXPECT_EQ(none.code, 0);
  EXPECT_EQ(none.out, "no jobs\n");
  EXPECT_EQ(RunJson("jobs --limit 2")["more"], true);
}

TEST_F(JobCommands, AFileOfJobsIsSubmittedAtOnceOrNotAtAll) {
  const std::string file = scratch_ / "jobs.jsonl";
  const auto write = [&](const std::string& text) { ASSERT_TRUE(WriteFileAtomically(file, text).ok()); };
  write("[\"trajectories\", \"--name\", \"a\"]\n\n[\"trajectories\", \"--name\", \"b\", \"--seed\", \"x\"]\n");
  const Said wrong = Run("submit --file jobs.jsonl");
  EXPECT_EQ(wrong.code, 1);
  EXPECT_NE(wrong.err.find("jobs.jsonl: line 3: "), std::string::npos) << wrong.err;
  EXPECT_EQ(RunJson("jobs")["jobs"].size(), 0u);
  write("[\"trajectories\", \"--name\", \"a\"]\n\n[\"trajectories\", \"--name\", \"b\", \"--seed\", \"2\"]\n");
  EXPECT_EQ(RunJson("submit --file jobs.jsonl")["jobs"], json::array({1, 2}));
  const json jobs = RunJson("jobs")["jobs"];
  ASSERT_EQ(jobs.size(), 2u);
  EXPECT_EQ(jobs[0]["name"], "b");
  EXPECT_EQ(jobs[1]["name"], "a");
}

TEST_F(JobCommands, AnErrorIsJsonOnStdoutTooWhereJsonIsAskedFor) {
  const Said unknown = Run("job show 77 --output json");
  EXPECT_EQ(unknown.code, 1);
  const json error = json::parse(unknown.out, nullptr, false);
  ASSERT_TRUE(error.is_object()) << unknown.out;
  EXPECT_EQ(error["format"], "realitygrad.error/1");
  EXPECT_EQ(error["error"], "there is no job 77");
  const Said usage = Run("--output json job shw");
  EXPECT_EQ(usage.code, 2);
  EXPECT_TRUE(json::parse(usage.out, nullptr, false).is_object()) << usage.out;
  const Said none = Run("params history");
  EXPECT_EQ(none.code, 0) << none.err;
  EXPECT_EQ(none.out, "no versions yet\n");
}

TEST_F(JobCommands, DescribeSaysAllAboutAJob) {
  service_.StartWorker("a");
  const int64_t id = SubmitOne("fail", R"({"code": 5, "until": 1})");  // unavailable: tried again
  ASSERT_TRUE(service_.client().WaitForJob(id, 60.0).ok());
  const Said said = Run("job describe " + std::to_string(id));
  EXPECT_EQ(said.code, 0) << said.err;
  for (const char* part :
       {"robot=arm", "attempts that came to nothing", "failed", "outputs", "events", "job.submitted"})
    EXPECT_NE(said.out.find(part), std::string::npos) << part << "\n" << said.out;
  const json described = RunJson("job describe last");
  EXPECT_EQ(described["id"], id);
  EXPECT_EQ(described["events"][0]["event"], "job.submitted");
  EXPECT_EQ(Run("job describe 99").code, 1);
}

TEST_F(JobCommands, LogsAreCutFollowedAndOfEarlierAttempts) {
  service_.StartWorker("a");
  const int64_t id = SubmitOne("garble", "{}");  // fails thrice and says something each time
  ASSERT_TRUE(service_.client().WaitForJob(id, 60.0).ok());
  const std::string number = std::to_string(id);
  const json all = RunJson("job logs " + number)["lines"];
  ASSERT_GT(all.size(), 2u);
  const json last = RunJson("job logs --tail 2 " + number)["lines"];
  ASSERT_EQ(last.size(), 2u);
  EXPECT_EQ(last[1], all.back());
  uint32_t newest = 0;
  for (const auto& line : all) newest = std::max(newest, line["attempt"].get<uint32_t>());
  ASSERT_GT(newest, 1u);
  const json previous = RunJson("job logs --previous " + number)["lines"];
  ASSERT_FALSE(previous.empty());
  for (const auto& line : previous) EXPECT_EQ(line["attempt"], newest - 1);
  // Of a job that is over, following ends at once; a line is a value.
  const Said followed = Run("job logs -f --output json " + number);
  EXPECT_EQ(followed.code, 0) << followed.err;
  EXPECT_EQ(std::count(followed.out.begin(), followed.out.end(), '\n'), static_cast<long>(all.size()));
  EXPECT_EQ(Run("job logs -f --previous " + number).code, 2);
}

TEST_F(JobCommands, JobsAreWatched) {
  std::thread later([&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(700));
    SubmitOne("echo", R"({"text": "x"})");
  });
  const Said said = Run("jobs --watch --timeout 3 --output json");
  later.join();
  EXPECT_EQ(said.code, 0) << said.err;
  const json first = json::parse(said.out.substr(0, said.out.find('\n')), nullptr, false);
  EXPECT_EQ(first["id"], 1) << said.out;
  EXPECT_EQ(first["state"], "queued");
  EXPECT_EQ(Run("jobs --timeout 3").code, 2) << "only with --watch";
}

TEST_F(JobCommands, ThePromotedVersionIsCurrentUntilTheLatestIsAgain) {
  service_.StartWorker("a");
  const int64_t first = Parameters("arm", 1.0);
  Parameters("arm", 2.0);
  Parameters("leg", 3.0);
  const auto current = [&] { return RunJson("params history --robot arm")["current"]; };
  EXPECT_EQ(current(), 2);
  EXPECT_EQ(RunJson("params promote 1 --robot arm")["current"], 1);
  EXPECT_EQ(current(), 1);
  EXPECT_EQ(service_.client().CurrentParameters("arm")->version(), 1u);
  service_.KillCoordinator();
  service_.StartCoordinator();
  Parameters("arm", 4.0);
  EXPECT_EQ(current(), 1) << "over a restart, and whatever is identified later";
  EXPECT_NE(Run("params history --robot arm").out.find("1*"), std::string::npos);
  EXPECT_EQ(RunJson("params promote --latest --robot arm")["current"], 3);
  EXPECT_EQ(service_.client().CurrentParameters("arm")->version(), 3u);
  EXPECT_EQ(Run("params promote 9 --robot arm").code, 1);
  EXPECT_EQ(Run("params promote --robot arm").code, 2);
  EXPECT_EQ(Run("params promote 1 --latest --robot arm").code, 2);

  // Across jobs and robots.
  EXPECT_EQ(RunJson("params history --all")["robots"].size(), 2u);
  const json of_job = RunJson("params history --robot arm --job " + std::to_string(first))["versions"];
  ASSERT_EQ(of_job.size(), 1u);
  EXPECT_EQ(of_job[0]["version"], 1);
  const json diff = RunJson("params diff 1 1 --robot arm --to-robot leg");
  ASSERT_EQ(diff["rows"].size(), 1u);
  EXPECT_EQ(diff["rows"][0]["from"], 1.0);
  EXPECT_EQ(diff["rows"][0]["to"], 3.0);
  const json plot = RunJson("params plot mass --html " + (scratch_ / "p.html"));
  EXPECT_EQ(plot["parameters"], json::array({"mass.arm"}));
  const std::string page = *ReadFile(scratch_ / "p.html");
  EXPECT_NE(page.find("mass.arm"), std::string::npos);
  EXPECT_NE(page.find("leg"), std::string::npos);
  EXPECT_EQ(Run("params plot nothing --html " + (scratch_ / "q.html")).code, 1);
  EXPECT_FALSE(std::filesystem::exists(scratch_ / "q.html"));
}

TEST_F(JobCommands, ASubmitSaysWhenItMayStartAndForHowLong) {
  const int64_t before = SubmitOne("echo", "{}");
  const Said said = Run("submit trajectories --model nominal --trajectories 4 --name n --label arm=left --label x=1 "
                        "--priority 3 --time-limit 90 --after " + std::to_string(before) + " --output quiet");
  ASSERT_EQ(said.code, 0) << said.err;
  const std::string id = said.out.substr(0, said.out.find('\n'));
  json job = RunJson("job show " + id);
  EXPECT_EQ(job["priority"], 3);
  EXPECT_EQ(job["after"], json::array({before}));
  EXPECT_EQ(job["waits_for"], json::array({before}));
  EXPECT_EQ(job["time_limit_s"], 90.0);
  EXPECT_EQ(job["labels"], json({{"arm", "left"}, {"robot", "mico2"}, {"x", "1"}}));
  EXPECT_EQ(RunJson("jobs --label arm=left")["jobs"].size(), 1u);
  EXPECT_NE(Run("job explain " + id).out.find("comes after " + std::to_string(before)), std::string::npos);
  EXPECT_NE(Run("job show " + id).out.find("comes after job " + std::to_string(before)), std::string::npos);
  EXPECT_NE(Run("job describe " + id).out.find("limit     1 min 30 s"), std::string::npos);
  EXPECT_EQ(RunJson("job priority " + id + " -4")["priority"], -4);
  EXPECT_EQ(Run("job priority " + id).code, 2) << "which one is to be said";
  EXPECT_EQ(Run("submit trajectories --model nominal --label wrong").code, 2);
  EXPECT_EQ(Run("submit trajectories --model nominal --time-limit -1").code, 2);
  EXPECT_EQ(Run("submit trajectories --model nominal --after soon").code, 2);
}

TEST_F(JobCommands, CompletionKnowsCommandsFlagsAndJobsInABash) {
  const int64_t id = SubmitOne("echo", "{}");
  const std::string script = scratch_ / "completion.bash";
  ASSERT_TRUE(WriteFileAtomically(script, Run("completion bash").out).ok());
  const auto complete = [&](const std::string& words) {
    // The last word is the one that is being typed.
    const std::string program =
        "source " + script + "; COMP_WORDS=(" + words +
        "); COMP_CWORD=$((${#COMP_WORDS[@]}-1)); _realitygrad; printf '%s\\n' \"${COMPREPLY[@]}\"";
    const std::string file = scratch_ / "ask.bash";
    EXPECT_TRUE(WriteFileAtomically(file, program).ok());
    const std::string command =
        "REALITYGRAD_COMPLETION_S=60 REALITYGRAD_COORDINATOR=" + service_.endpoint() + " bash " + file + " > " + (scratch_ / "words");
    EXPECT_EQ(std::system(command.c_str()), 0);
    return *ReadFile(scratch_ / "words");
  };
  const std::string program = BinDir() + "/realitygrad";
  EXPECT_EQ(complete(program + " compl"), "completion\n");
  EXPECT_EQ(complete(program + " job desc"), "describe\n");
  EXPECT_EQ(complete(program + " job show --ta"), "--tasks\n");
  EXPECT_EQ(complete(program + " --output js"), "json\n");
  EXPECT_EQ(complete(program + " job logs " + std::to_string(id)), std::to_string(id) + "\n");
  EXPECT_EQ(complete(program + " params prom"), "promote\n");
  EXPECT_EQ(complete(program + " job prio"), "priority\n");
  EXPECT_EQ(complete(program + " submit train --time"), "--time-limit\n--timeout\n");
}

TEST_F(JobCommands, CompletionIsAScriptThatZshTakes) {
  const Said zsh = Run("completion zsh");
  EXPECT_EQ(zsh.out.rfind("#compdef realitygrad", 0), 0u);
  if (std::system("command -v zsh >/dev/null") != 0) GTEST_SKIP() << "zsh is not installed";
  ASSERT_TRUE(WriteFileAtomically(scratch_ / "_realitygrad", zsh.out).ok());
  EXPECT_EQ(std::system(("zsh -n " + (scratch_ / "_realitygrad")).c_str()), 0);
}

TEST_F(JobCommands, AResultThatDidNotGoAsAskedIsSaidAndItsVersionHeldBack) {
  service_.StartWorker("a");
  Parameters("arm", 1.0);
  const std::string end = "stopped by velocity_limit after 1.44 of 6 s";
  const json early = {{"robot", "arm"}, {"value", 2.0}, {"rollout", end}, {"held_back", true}, {"remark", end + "\x1b[2J"}};
  const int64_t id = SubmitOne("parameters", early.dump());
  const Said waited = Run("job wait " + std::to_string(id));
  EXPECT_EQ(waited.code, 0);
  service_.KillCoordinator();
  service_.StartCoordinator();
  const json job = RunJson("job show " + std::to_string(id));
  EXPECT_EQ(job["state"], "succeeded");
  EXPECT_EQ(job["reason"], end + "\\x1b[2J") << "nothing that a terminal obeys";
  EXPECT_EQ(job["task_list"][0]["reason"], job["reason"]);
  EXPECT_NE(Run("jobs").out.find(end), std::string::npos);
  const json history = RunJson("params history");
  EXPECT_EQ(history["current"], 1);
  EXPECT_EQ(history["versions"][0]["rollout"], end);
  EXPECT_EQ(history["versions"][0]["held_back"], true);
  const Said table = Run("params history");
  EXPECT_NE(table.out.find("1*"), std::string::npos) << table.out;
  EXPECT_NE(table.out.find("2-"), std::string::npos) << table.out;
  EXPECT_NE(table.out.find(end), std::string::npos) << table.out;
  EXPECT_EQ(RunJson("params promote 2")["current"], 2);
  EXPECT_EQ(RunJson("params promote --latest")["current"], 1);
}

}  // namespace
}  // namespace rg
