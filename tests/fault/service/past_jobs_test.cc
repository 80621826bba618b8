// Jobs that are over leave memory, and are still there: listed, shown, known by their request, retried,
// archived.
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>

#include "common/base/hash.h"
#include "common/base/ids.h"
#include "tests/support/service/server_bench.h"

namespace rg::testing {
namespace {

class PastJobs : public ::testing::Test {
 protected:
  PastJobs() : folder_("/tmp/rg-past-" + RandomHex(6)) {
    std::filesystem::create_directories(folder_);
    Open();
  }
  ~PastJobs() override {
    bench_.reset();
    std::filesystem::remove_all(folder_);
  }

  // The whole service anew, on the same database.
  void Open() {
    bench_.reset();
    coordinator::ServerOptions options;
    options.database_path = folder_ + "/service.db";
    options.archive_after_ns = 0;
    bench_ = std::make_unique<ServerBench>(options);
    client_ = bench_->Connect("client", pb::ROLE_OPERATOR);
    worker_ = bench_->Connect("worker", pb::ROLE_WORKER);
    worker_->Hello({"echo"});
    Turn();
  }
  void Turn() { ASSERT_TRUE(bench_->Turn().ok()); }
  template <class Body, class Request>
  Result<Body> Call(const Request& request) {
    client_->Ask(request);
    for (int i = 0; i < 20'000; ++i) {  // a thread of its own may answer, as time goes outside of this test
      const Status turned = bench_->server_->RunOnce(0);
      if (!turned.ok()) return turned;
      auto reply = client_->Reply<Body>();
      if (reply.ok() || reply.status().message() != "no reply") return reply;
      usleep(2'000);
    }
    return UnavailableError("no reply");
  }
  pb::JobSpec Chain(int tasks) {
    pb::JobSpec job;
    for (int i = 0; i < tasks; ++i) {
      pb::TaskSpec* task = AddTask(&job, "t" + std::to_string(i), "echo");
      task->set_stage(i == 0 ? "first" : "rest");
      if (i > 0) task->add_after("t" + std::to_string(i - 1));
    }
    return job;
  }
  // Submits and runs it to its end; the last message of its last task.
  pb::WorkerMessage Run(const pb::JobSpec& job, const std::string& request, bool fails = false) {
    client_->Submit(job, request);
    Turn();
    EXPECT_TRUE(client_->Reply<pb::SubmitReply>().ok());
    pb::WorkerMessage last;
    while (true) {
      const auto assignment = AssignmentIn(worker_->Mail());
      if (assignment.token() == 0) return last;
      last = FinishedMessage(assignment);
      last.mutable_finished()->set_summary_json("{\"n\":1}");
      if (fails) {
        last.Clear();
        last.mutable_failed()->set_token(assignment.token());
        last.mutable_failed()->set_task(assignment.task());
        last.mutable_failed()->set_outcome(pb::ATTEMPT_OUTCOME_FAILED);
        last.mutable_failed()->set_error("it was told to");
      }
      worker_->Tell(last);
      Turn();
    }
  }
  pb::GetJobReply Show(int64_t id, bool attempts = true) {
    pb::GetJobRequest request;
    request.set_job(id);
    request.set_with_tasks(true);
    request.set_with_attempts(attempts);
    const auto reply = Call<pb::GetJobReply>(request);
    EXPECT_TRUE(reply.ok()) << reply.status().ToString();
    return reply.ok() ? *reply : pb::GetJobReply();
  }
  void Archive() {
    pb::ArchiveJobsRequest request;
    pb::ArchiveJobsReply reply;
    do {
      auto part = Call<pb::ArchiveJobsReply>(request);
      ASSERT_TRUE(part.ok()) << part.status().ToString();
      reply = *part;
    } while (reply.more());
  }
  const coordinator::State& state() const { return bench_->state(); }

  std::string folder_;
  std::unique_ptr<ServerBench> bench_;
  std::unique_ptr<Peer> client_, worker_;
};

TEST_F(PastJobs, LeaveMemoryAndAreStillListedAndShown) {
  Run(Chain(3), "r1");
  Run(Chain(2), "r2");
  EXPECT_TRUE(state().jobs.empty());
  EXPECT_TRUE(state().job_by_request.empty());
  EXPECT_TRUE(state().class_index.empty());
  const auto list = Call<pb::ListJobsReply>(pb::ListJobsRequest());
  ASSERT_EQ(list->jobs_size(), 2);
  EXPECT_EQ(list->jobs(0).id(), 2);
  EXPECT_EQ(list->jobs(1).state(), pb::JOB_STATE_SUCCEEDED);
  EXPECT_EQ(list->jobs(1).tasks_total(), 3u);
  EXPECT_EQ(list->jobs(1).tasks_done(), 3u);
  EXPECT_EQ(list->jobs(1).progress(), 1.0);
  const auto show = Show(1);
  ASSERT_EQ(show.tasks_size(), 3);
  EXPECT_EQ(show.tasks(2).name(), "t2");
  EXPECT_EQ(show.tasks(2).state(), pb::TASK_STATE_SUCCEEDED);
  EXPECT_EQ(show.tasks(2).summary_json(), "{\"n\":1}");
  EXPECT_EQ(show.tasks(2).attempt_list_size(), 1);
  ASSERT_EQ(show.stages_size(), 2);
  EXPECT_EQ(show.stages(1).name(), "rest");
  EXPECT_EQ(show.stages(1).done(), 2u);
  pb::GetJobRequest newest;
  EXPECT_EQ(Call<pb::GetJobReply>(newest)->job().id(), 2);
  newest.set_job(77);
  EXPECT_EQ(Call<pb::GetJobReply>(newest).status().code(), StatusCode::kNotFound);
}

TEST_F(PastJobs, AreKnownByTheirRequestAndNotRunAgain) {
  Run(Chain(1), "r1");
  Open();
  EXPECT_TRUE(state().jobs.empty()) << "a restart reads what is live only";
  client_->Submit(Chain(1), "r1");
  Turn();
  const auto same = client_->Reply<pb::SubmitReply>();
  EXPECT_EQ(same->job(), 1);
  EXPECT_TRUE(same->already_known());
  client_->Submit(Chain(2), "r1");
  Turn();
  EXPECT_EQ(client_->Reply<pb::SubmitReply>().status().code(), StatusCode::kFailedPrecondition);
  client_->Submit(Chain(1), "r2");
  Turn();
  EXPECT_EQ(client_->Reply<pb::SubmitReply>()->job(), 2) << "ids go on";
}

TEST_F(PastJobs, ARepeatOfTheLastResultIsAccepted) {
  const auto last = Run(Chain(2), "r1");
  ASSERT_TRUE(state().jobs.empty());
  worker_->Mail();
  worker_->Tell(last);
  Turn();
  auto mail = worker_->Mail();
  ASSERT_EQ(mail.size(), 1u);
  EXPECT_TRUE(mail[0].result_reply().accepted()) << "its answer was lost, perhaps";
  auto other = last;
  other.mutable_finished()->set_token(last.finished().token() + 1);
  worker_->Tell(other);
  Turn();
  mail = worker_->Mail();
  ASSERT_EQ(mail.size(), 1u);
  EXPECT_FALSE(mail[0].result_reply().accepted());
  EXPECT_EQ(state().counters.results_refused, 1u);
}

TEST_F(PastJobs, ComeBackForARetryAndLeaveAgain) {
  Run(Chain(2), "r1", /*fails=*/true);
  ASSERT_TRUE(state().jobs.empty());
  Open();
  pb::JobActionRequest retry;
  retry.set_job(1);
  retry.set_action(pb::JOB_ACTION_CANCEL);
  EXPECT_EQ(Call<pb::JobActionReply>(retry).status().code(), StatusCode::kFailedPrecondition);
  EXPECT_TRUE(state().jobs.empty());
  retry.set_action(pb::JOB_ACTION_RETRY);
  const auto again = Call<pb::JobActionReply>(retry);
  ASSERT_TRUE(again.ok()) << again.status().ToString();
  EXPECT_EQ(again->job().state(), pb::JOB_STATE_RUNNING);
  EXPECT_EQ(again->job().tasks_total(), 2u);
  for (int i = 0; i < 2; ++i) {
    const auto assignment = AssignmentIn(worker_->Mail());
    ASSERT_NE(assignment.token(), 0u);
    worker_->Tell(FinishedMessage(assignment));
    Turn();
  }
  EXPECT_TRUE(state().jobs.empty());
  EXPECT_EQ(Show(1).job().state(), pb::JOB_STATE_SUCCEEDED);
  EXPECT_GT(Show(1).tasks(0).attempt_list_size(), 1);
}

TEST_F(PastJobs, AnArchivedJobIsShownAsBeforeAndIsNotRunAgain) {
  Run(Chain(3), "r1");
  Run(Chain(2), "r2", /*fails=*/true);
  const auto tokens = state().last_token;
  auto before = Show(2);
  Archive();
  const auto after = Show(2);
  EXPECT_GT(after.job().archived_ns(), 0);
  before.mutable_job()->set_archived_ns(after.job().archived_ns());
  EXPECT_EQ(after.SerializeAsString(), before.SerializeAsString());
  EXPECT_EQ(Show(1, false).tasks(1).attempt_list_size(), 0);
  pb::ExplainRequest why;
  why.set_job(2);
  EXPECT_EQ(Call<pb::ExplainReply>(why)->task(), "t0");
  EXPECT_NE(Call<pb::ExplainReply>(why)->reasons(0).find("it was told to"), std::string::npos);
  why.set_task("t1");
  EXPECT_EQ(Call<pb::ExplainReply>(why)->state(), pb::TASK_STATE_CANCELLED);
  {
    auto left = *bench_->server_->database().Prepare(
        "SELECT (SELECT count(*) FROM tasks) + (SELECT count(*) FROM attempts) + (SELECT count(*) FROM "
        "results) "
        "+ (SELECT count(*) FROM task_specs)");
    ASSERT_TRUE(*left.Step());
    EXPECT_EQ(left.Int(0), 0);
  }
  pb::JobActionRequest retry;
  retry.set_job(2);
  retry.set_action(pb::JOB_ACTION_RETRY);
  const auto refused = Call<pb::JobActionReply>(retry);
  EXPECT_EQ(refused.status().code(), StatusCode::kFailedPrecondition);
  EXPECT_NE(refused.status().message().find("is archived"), std::string::npos);
  Open();
  EXPECT_EQ(state().last_token, tokens) << "no fencing token is given twice";
  EXPECT_EQ(state().last_job, 2);
  client_->Submit(Chain(3), "r1");
  Turn();
  EXPECT_TRUE(client_->Reply<pb::SubmitReply>()->already_known());
}

TEST_F(PastJobs, ADryRunSaysWhatWouldBeArchivedAndDoesNothing) {
  Run(Chain(3), "r1");
  pb::ArchiveJobsRequest request;
  request.set_dry_run(true);
  auto reply = Call<pb::ArchiveJobsReply>(request);
  ASSERT_EQ(reply->jobs_size(), 1);
  EXPECT_EQ(reply->tasks(), 3u);
  request.set_older_than_ns(int64_t{3600} * 1'000'000'000);
  EXPECT_EQ(Call<pb::ArchiveJobsReply>(request)->jobs_size(), 0) << "it ended just now";
  EXPECT_EQ(Show(1).job().archived_ns(), 0);
}

TEST_F(PastJobs, AnArchivedJobKeepsItsArtefacts) {
  pb::JobSpec job = Chain(1);
  client_->Submit(job, "r1");
  Turn();
  ASSERT_TRUE(client_->Reply<pb::SubmitReply>().ok());
  auto finished = FinishedMessage(AssignmentIn(worker_->Mail()));
  auto* output = finished.mutable_finished()->add_outputs();
  output->set_name("out");
  output->set_kind("text");
  output->set_inline_bytes("precious");
  output->set_size(8);
  output->set_sha256(Sha256Hex("precious"));
  worker_->Tell(finished);
  Turn();
  Archive();
  EXPECT_EQ(Show(1).tasks(0).outputs_size(), 1);
  bench_->Pass(10.0);
  const auto gone = Call<pb::GcArtifactsReply>(pb::GcArtifactsRequest());
  ASSERT_TRUE(gone.ok()) << gone.status().ToString();
  EXPECT_EQ(gone->removed_size(), 0);
}

}  // namespace
}  // namespace rg::testing
