#include "services/cli/live_view.h"

#include <gtest/gtest.h>

#include <cmath>

#include "services/cli/output.h"

namespace rg::cli {
namespace {

namespace pb = realitygrad::v1;

TEST(ShardBar, HasACellPerTaskWhereTheyFit) {
  EXPECT_EQ(ShardBar(6, 3, 1, 1, 40), "###!>.");
  EXPECT_EQ(ShardBar(0, 0, 0, 0, 40), "");
  EXPECT_EQ(ShardBar(3, 3, 0, 0, 40), "###");
}

TEST(ShardBar, NeverLooksDoneBeforeItIsAndHidesNoFailure) {
  const std::string bar = ShardBar(1000, 999, 0, 1, 20);
  EXPECT_EQ(bar.size(), 20u);
  EXPECT_EQ(bar, "###################!");
  EXPECT_EQ(ShardBar(1000, 999, 1, 0, 20), "###################>");
  EXPECT_EQ(ShardBar(1000, 1000, 0, 0, 20), std::string(20, '#'));
  EXPECT_EQ(ShardBar(1000, 0, 1, 0, 20), ">" + std::string(19, '.'));
}

pb::GetJobReply SomeJob() {
  pb::GetJobReply reply;
  reply.mutable_job()->set_id(7);
  reply.mutable_job()->set_kind("iteration");
  reply.mutable_job()->set_name("\x1b[31mred");
  reply.mutable_job()->set_state(pb::JOB_STATE_RUNNING);
  reply.mutable_job()->set_progress(0.42);
  reply.mutable_job()->set_eta_s(90);
  auto* stage = reply.add_stages();
  stage->set_name("identification");
  stage->set_total(4), stage->set_done(2), stage->set_running(1);
  auto* task = reply.add_tasks();
  task->set_name("chain-1");
  task->set_stage("identification");
  task->set_state(pb::TASK_STATE_LEASED);
  task->set_worker("worker-1");
  task->mutable_progress()->set_done(3);
  task->mutable_progress()->set_total(10);
  for (const char* summary : {R"({"best_cost": 4.5})", R"({"best_cost": 2.25})", "no json"}) {
    auto* done = reply.add_tasks();
    done->set_stage("identification");
    done->set_state(pb::TASK_STATE_SUCCEEDED);
    done->set_summary_json(summary);
  }
  return reply;
}

TEST(LiveView, ShowsStagesWorkersBestResidualAndEta) {
  const auto lines = LiveView(SomeJob(), 120, 40);
  ASSERT_EQ(lines.size(), 3u);
  for (const char* part : {"job 7", "running", "42 %", "ETA 1 min 30 s", "best residual 2.25"})
    EXPECT_NE(lines[0].find(part), std::string::npos) << lines[0];
  EXPECT_EQ(lines[0].find('\x1b'), std::string::npos) << "a terminal obeys no name";
  EXPECT_NE(lines[1].find("[##>."), std::string::npos) << lines[1];
  EXPECT_NE(lines[1].find("2/4"), std::string::npos) << lines[1];
  EXPECT_EQ(lines[2], "  worker-1: chain-1 3/10");
}

TEST(LiveView, FitsTheTerminal) {
  pb::GetJobReply reply = SomeJob();
  for (int i = 0; i < 30; ++i) reply.add_stages()->set_name("stage");
  const auto lines = LiveView(reply, 50, 10);
  EXPECT_EQ(lines.size(), 10u);
  for (const std::string& line : lines) EXPECT_LE(DisplayWidth(line), 50) << line;
}

}  // namespace
}  // namespace rg::cli
