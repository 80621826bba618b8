// The page's pure parts: who is let in, what is told.
#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "coordinator/client/as_json.h"
#include "coordinator/web/feed_json.h"
#include "coordinator/web/gate.h"
#include "coordinator/web/metrics.h"
#include "coordinator/web/web_server.h"

namespace rg::coordinator::web {
namespace {

using nlohmann::json;

TEST(ListenAddress, IsNumericAndKnowsWhoReachesIt) {
  const auto v4 = ParseListenAddress("127.0.0.1:7342");
  ASSERT_TRUE(v4.ok());
  EXPECT_EQ(v4->port, 7342);
  EXPECT_TRUE(v4->loopback);
  EXPECT_TRUE(ParseListenAddress("localhost:0")->loopback);
  EXPECT_TRUE(ParseListenAddress("[::1]:80")->loopback);
  EXPECT_FALSE(ParseListenAddress("0.0.0.0:80")->loopback);
  EXPECT_FALSE(ParseListenAddress("[::]:80")->loopback);
  for (const char* wrong : {"", "80", ":80", "127.evil.com:80", "127.0.0.1:", "127.0.0.1:80x",
                            "127.0.0.1:65536", "127.0.0.1:-1", "[]:80", "example.com:80"}) {
    EXPECT_EQ(ParseListenAddress(wrong).status().code(), StatusCode::kInvalid) << wrong;
  }
}

TEST(Gate, LetsThisMachineInByItsNamesOnly) {
  const Gate gate(*ParseListenAddress("127.0.0.1:7342"), "");
  for (const char* host : {"127.0.0.1:7342", "localhost", "localhost:7342", "127.0.0.2", "[::1]:7342"})
    EXPECT_TRUE(gate.Admits({host, "", ""})) << host;
  for (const char* host : {"", "evil.example", "127.evil.com", "localhost.evil.example:7342", "10.0.0.1"})
    EXPECT_FALSE(gate.Admits({host, "", ""})) << host;
}

TEST(Gate, AsksForTheWholeToken) {
  const Gate gate(*ParseListenAddress("0.0.0.0:7342"), "0123456789abcdef");
  EXPECT_TRUE(gate.Admits({"anything", "Bearer 0123456789abcdef", ""}));
  EXPECT_TRUE(gate.Admits({"anything", "", "x=y; rg_token=0123456789abcdef; z=1"}));
  for (const char* wrong :
       {"", "Bearer ", "Bearer 0123456789abcde", "0123456789abcdef", "Bearer 0123456789abcdeg"})
    EXPECT_FALSE(gate.Admits({"127.0.0.1", wrong, ""})) << wrong;
  for (const char* wrong : {"rg_token=", "rg_token", "xrg_token=0123456789abcdef", "=;;;", ";"})
    EXPECT_FALSE(gate.Admits({"127.0.0.1", "", wrong})) << wrong;
}

TEST(Endpoint, OfAnyAddressIsReachedHere) {
  EXPECT_EQ(EndpointFromHere("tcp://0.0.0.0:7341"), "tcp://127.0.0.1:7341");
  EXPECT_EQ(EndpointFromHere("tcp://10.0.0.1:7341"), "tcp://10.0.0.1:7341");
  EXPECT_EQ(EndpointFromHere("ipc:///tmp/s"), "ipc:///tmp/s");
}

TEST(Demand, LeavesOutRobotsAndTags) {
  pb::StatusReply status;
  const auto add = [&](const char* kind, uint64_t ready, uint64_t running, bool robot, const char* tag) {
    auto* demand = status.add_demand();
    demand->set_kind(kind);
    demand->set_ready(ready);
    demand->set_running(running);
    demand->set_robot(robot);
    if (*tag != 0) demand->add_tags(tag);
  };
  add("trajectories", 5, 2, false, "");
  add("rollout", 1, 0, true, "robot:arm");
  add("train", 1, 0, false, "gpu");
  EXPECT_EQ(SlotsWanted(status), 7u);
  const std::string text = MetricsText(status, 1.5);
  EXPECT_NE(text.find("realitygrad_worker_slots_wanted 7\n"), std::string::npos) << text;
  EXPECT_NE(text.find("realitygrad_demand_tasks_ready{kind=\"train\",tags=\"gpu\"} 1\n"), std::string::npos)
      << text;
  EXPECT_NE(text.find("realitygrad_uptime_seconds 1.5\n"), std::string::npos) << text;
  EXPECT_EQ(text.find("allocations"), std::string::npos);
  auto* seconds = status.add_seconds();
  seconds->set_kind("train");
  seconds->add_at_most(1.0);
  seconds->add_count(2);
  seconds->add_count(3);
  seconds->set_sum(7.5);
  status.add_holds()->set_robot("mico2");
  pb::WorkerInfo agent;
  agent.set_name("arm");
  agent.set_connected(true);
  agent.set_tasks_failed(4);
  agent.set_robot_state("waits for mico2, which is latched (stop not confirmed): realitygrad agent clear");
  const std::string told = MetricsText(status, 1.5, "", {agent});
  for (const char* line :
       {"realitygrad_task_seconds_bucket{kind=\"train\",le=\"1\"} 2\n", "realitygrad_task_seconds_bucket{kind=\"train\",le=\"+Inf\"} 3\n",
        "realitygrad_task_seconds_sum{kind=\"train\"} 7.5\n", "realitygrad_worker_tasks_failed_total{worker=\"arm\"} 4\n",
        "realitygrad_robot_armed{worker=\"arm\"} 0\n", "realitygrad_robot_latched{worker=\"arm\"} 1\n",
        "realitygrad_robot_held{robot=\"mico2\"} 1\n"})
    EXPECT_NE(told.find(line), std::string::npos) << line << told;
  const std::string more =
      MetricsText(status, 1.5, R"({"autoscale": {"running": 2, "pending": 1, "in_vain": 6}})");
  EXPECT_NE(more.find("realitygrad_allocations_in_vain 6\n"), std::string::npos) << more;
}

TEST(BestResidual, IsTheSmallestOfTheNewestStageThatHasOne) {
  pb::GetJobReply reply;
  EXPECT_TRUE(std::isnan(BestResidual(reply)));
  for (const char* stage : {"round 1", "round 2", "conclusion"}) reply.add_stages()->set_name(stage);
  const auto say = [&](const char* stage, const char* summary) {
    auto* task = reply.add_tasks();
    task->set_stage(stage);
    task->set_summary_json(summary);
  };
  say("round 1", R"({"best_cost": 0.5})");
  say("round 1", R"({"best_cost": 0.7})");
  EXPECT_EQ(BestResidual(reply), 0.5);
  say("round 2", R"({"best_cost": 3.0})");  // on another scale
  say("round 2", R"({"best_cost": 2.0})");
  say("conclusion", R"({"residual_after": 1})");
  say("round 2", "broken {");
  say("round 2", R"({"best_cost": "low"})");
  EXPECT_EQ(BestResidual(reply), 2.0);
}

TEST(Diagnosis, OfAnyBytesIsShownAsFarAsItGoes) {
  pb::ArtifactInfo info;
  info.set_sha256("ab");
  for (const char* bytes : {"", "nonsense", "[]", "null", "{}", R"({"findings": 3, "fit": []})",
                            R"({"findings": [1, {"joints": "j"}, {"confidence": "x"}], "verdict": 7})"}) {
    EXPECT_EQ(DiagnosisJson(bytes, info)["sha256"], "ab") << bytes;
  }
  const json good = DiagnosisJson(
      R"({"verdict": "unexplained", "findings": [{"effect": "e", "statement": "s", "joints": ["a", 1], "confidence": 0.5}],
          "fit": {"holdout": {"before_rms": 2, "after_rms": 1}}})",
      info);
  EXPECT_EQ(good["verdict"], "unexplained");
  EXPECT_EQ(good["findings"][0]["joints"], json::array({"a"}));
  EXPECT_EQ(good["before"], 2);
}

TEST(Dump, ReplacesBytesThatAreNoText) {
  EXPECT_EQ(json::parse(Dump({{"x", "a\xff"}}))["x"], "a\xEF\xBF\xBD");
}

}  // namespace
}  // namespace rg::coordinator::web
