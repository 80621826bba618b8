// Who may do what, over the server's own doors: names, kinds, rollouts, texts, revoked keys, large replies.
#include <gtest/gtest.h>

#include "tests/support/service/server_bench.h"

namespace rg::testing {
namespace {

std::string RefusalIn(const std::vector<pb::CoordinatorMessage>& mail) {
  for (const auto& message : mail) {
    if (!message.refused().empty()) return message.refused();
  }
  return "";
}

// What the server answers to a submit.
Status SubmitStatus(ServerBench& bench, Peer& peer, const pb::JobSpec& job, const std::string& id,
                    uint64_t lease = 0) {
  peer.Submit(job, id, lease);
  EXPECT_TRUE(bench.Turn().ok());
  return peer.Reply<pb::SubmitReply>().status();
}

TEST(Roles, AWorkersKeyIsNoAgentsAndAnAgentsNoWorkers) {
  ServerBench bench;
  const auto worker = bench.Connect("w1", pb::ROLE_WORKER, "host7");
  const auto agent = bench.Connect("a1", pb::ROLE_AGENT, "arm");
  worker->Hello({"echo", "rollout"});
  ASSERT_TRUE(bench.Turn().ok());
  EXPECT_EQ(RefusalIn(worker->Mail()),
            "the key 'host7' is no agent's: tasks of kind 'rollout' are not for it");
  worker->Hello({"echo"}, "w", {"robot:mico2"});
  ASSERT_TRUE(bench.Turn().ok());
  EXPECT_EQ(RefusalIn(worker->Mail()),
            "the key 'host7' is no agent's: the tag 'robot:mico2' belongs to the agent beside that robot");
  agent->Hello({"rollout", "echo"}, "a");
  ASSERT_TRUE(bench.Turn().ok());
  EXPECT_EQ(RefusalIn(agent->Mail()), "the key 'arm' is an agent's: tasks of kind 'echo' are for workers");
  EXPECT_TRUE(bench.state().workers.empty());
  worker->Hello({"echo"});
  agent->Hello({"rollout"}, "a", {"robot:mico2"});
  ASSERT_TRUE(bench.Turn().ok());
  EXPECT_EQ(bench.state().workers.size(), 2u);
}

TEST(Roles, AKeyCannotTakeTheNameOfAnothersWorker) {
  ServerBench bench;
  const auto anna = bench.Connect("w1", pb::ROLE_WORKER, "anna"),
             ben = bench.Connect("w2", pb::ROLE_WORKER, "ben");
  anna->Hello({"echo"}, "big");
  ASSERT_TRUE(bench.Turn().ok());
  ben->Hello({"echo"}, "big");
  ASSERT_TRUE(bench.Turn().ok());
  EXPECT_EQ(RefusalIn(ben->Mail()), "the worker name 'big' belongs to another key, 'anna'");
  EXPECT_EQ(bench.state().workers.at("big").instance, "w1");
}

TEST(Roles, RolloutsAreSubmittedAndRetriedOnlyWithTheRightToRobots) {
  ServerBench bench;
  const auto without = bench.Connect("o1", pb::ROLE_OPERATOR, "anna"),
             with = bench.Connect("o2", pb::ROLE_OPERATOR, "ben", true),
             viewer = bench.Connect("v1", pb::ROLE_VIEWER, "eve"),
             agent = bench.Connect("a1", pb::ROLE_AGENT, "arm");
  const Status refused = SubmitStatus(bench, *without, OneTask("rollout"), "r1");
  EXPECT_EQ(refused.code(), StatusCode::kPermissionDenied);
  EXPECT_NE(refused.message().find("the key 'anna' may not have a robot moved"), std::string::npos);
  EXPECT_NE(refused.message().find("keys allow NAME --robots"), std::string::npos);
  EXPECT_TRUE(SubmitStatus(bench, *without, OneTask("echo"), "r2").ok());
  EXPECT_EQ(SubmitStatus(bench, *viewer, OneTask("echo"), "r3").code(), StatusCode::kPermissionDenied);
  ASSERT_TRUE(SubmitStatus(bench, *with, OneTask("rollout"), "r4").ok());
  agent->Hello({"rollout"}, "a");
  ASSERT_TRUE(bench.Turn().ok());
  const auto assignment = AssignmentIn(agent->Mail());
  ASSERT_NE(assignment.token(), 0u);
  pb::WorkerMessage failed;
  failed.mutable_failed()->set_token(assignment.token());
  failed.mutable_failed()->set_task(assignment.task());
  failed.mutable_failed()->set_error("it hit the table");
  agent->Tell(failed);
  ASSERT_TRUE(bench.Turn().ok());
  pb::JobActionRequest retry;
  retry.set_job(assignment.job());
  retry.set_action(pb::JOB_ACTION_RETRY);
  bench.Pass(0.1);
  for (int attempts = 0; bench.state().FindJob(assignment.job()) != nullptr; ++attempts) {  // not over
    ASSERT_LT(attempts, 5);
    const auto again = AssignmentIn(agent->Mail());
    failed.mutable_failed()->set_token(again.token());
    agent->Tell(failed);
    ASSERT_TRUE(bench.Turn().ok());
  }
  without->Ask(retry);
  ASSERT_TRUE(bench.Turn().ok());
  EXPECT_EQ(without->Reply<pb::JobActionReply>().status().code(), StatusCode::kPermissionDenied);
  with->Ask(retry);
  ASSERT_TRUE(bench.Turn().ok());
  EXPECT_TRUE(with->Reply<pb::JobActionReply>().ok());
}

TEST(Roles, ActingOnAJobThatMovesARobotNeedsTheRightButForAPause) {
  ServerBench bench;
  const auto without = bench.Connect("o1", pb::ROLE_OPERATOR, "anna"),
             with = bench.Connect("o2", pb::ROLE_OPERATOR, "ben", true);
  ASSERT_TRUE(SubmitStatus(bench, *with, OneTask("rollout"), "r1").ok());
  const auto ask = [&](Peer& peer, pb::JobAction action) {
    pb::JobActionRequest request;
    request.set_job(1);
    request.set_action(action);
    peer.Ask(request);
    EXPECT_TRUE(bench.Turn().ok());
    return peer.Reply<pb::JobActionReply>().status();
  };
  EXPECT_TRUE(ask(*without, pb::JOB_ACTION_PAUSE).ok()) << "whoever sees it may stop it";
  for (const auto action : {pb::JOB_ACTION_RESUME, pb::JOB_ACTION_PRIORITY, pb::JOB_ACTION_CANCEL}) {
    const Status refused = ask(*without, action);
    EXPECT_EQ(refused.code(), StatusCode::kPermissionDenied) << action;
    EXPECT_NE(refused.message().find("the key 'anna'"), std::string::npos) << refused.message();
    EXPECT_TRUE(ask(*with, action).ok()) << action;
  }
  pb::PromoteParametersRequest promote;
  promote.set_robot("arm");
  promote.set_version(1);
  without->Ask(promote);
  ASSERT_TRUE(bench.Turn().ok());
  EXPECT_EQ(without->Reply<pb::PromoteParametersReply>().status().code(), StatusCode::kPermissionDenied);
  with->Ask(promote);
  ASSERT_TRUE(bench.Turn().ok());
  EXPECT_EQ(with->Reply<pb::PromoteParametersReply>().status().code(), StatusCode::kNotFound) << "it has none yet";
}

TEST(Roles, WhoItWasIsTheNameOfTheKeyInListingsAndEvents) {
  ServerBench bench;
  const auto anna = bench.Connect("o1", pb::ROLE_OPERATOR, "anna"), ben = bench.Connect("o2", pb::ROLE_OPERATOR, "ben");
  pb::JobSpec job = OneTask();
  job.set_submitted_by("root@lab7");
  ASSERT_TRUE(SubmitStatus(bench, *anna, job, "r1").ok());
  job.set_submitted_by("anna");
  ASSERT_TRUE(SubmitStatus(bench, *ben, job, "r2").ok());
  const auto list = [&](Peer& peer, const std::string& by, bool mine) {
    pb::ListJobsRequest request;
    request.set_by(by);
    request.set_mine(mine);
    peer.Ask(request);
    EXPECT_TRUE(bench.Turn().ok());
    return *peer.Reply<pb::ListJobsReply>();
  };
  const auto of_anna = list(*ben, "anna", false), of_ben = list(*ben, "anna", true);
  ASSERT_EQ(of_anna.jobs_size(), 1);
  EXPECT_EQ(of_anna.jobs(0).submitted_by(), "anna (root@lab7)");
  EXPECT_EQ(of_anna.you(), "ben");
  ASSERT_EQ(of_ben.jobs_size(), 1);
  EXPECT_EQ(of_ben.jobs(0).submitted_by(), "ben (anna)") << "what it says of itself is a remark";

  EXPECT_EQ(SubmitStatus(bench, *ben, OneTask("rollout"), "r3").code(), StatusCode::kPermissionDenied);
  pb::JobActionRequest cancel;
  cancel.set_job(1);
  cancel.set_action(pb::JOB_ACTION_CANCEL);
  cancel.set_reason("wrong goal");
  cancel.set_by("root@lab8");
  ben->Ask(cancel);
  ASSERT_TRUE(bench.Turn().ok());
  ASSERT_TRUE(ben->Reply<pb::JobActionReply>().ok());
  anna->Ask(pb::ListEventsRequest());
  ASSERT_TRUE(bench.Turn().ok());
  std::map<std::string, std::string> details;
  const auto events = anna->Reply<pb::ListEventsReply>();
  ASSERT_TRUE(events.ok());
  for (const auto& event : events->events()) details[event.kind()] = event.detail();
  EXPECT_EQ(details["job.cancelled"], "by ben (root@lab8): wrong goal");
  EXPECT_EQ(details["request.refused"].rfind("by ben: the key 'ben' may not have a robot moved", 0), 0u)
      << details["request.refused"];
}

TEST(Roles, ManyActionsAreOneTransactionAndEachIsAnswered) {
  ServerBench bench;
  const auto with = bench.Connect("o1", pb::ROLE_OPERATOR, "ben", true), without = bench.Connect("o2", pb::ROLE_OPERATOR, "anna");
  pb::SubmitManyRequest submits;
  for (const char* kind : {"echo", "rollout", "echo"}) {
    auto* submit = submits.add_submits();
    submit->set_request_id("r" + std::to_string(submits.submits_size()));
    *submit->mutable_job() = OneTask(kind);
  }
  without->Ask(submits);
  ASSERT_TRUE(bench.Turn().ok());
  const auto submitted = without->Reply<pb::SubmitManyReply>();
  ASSERT_TRUE(submitted.ok()) << submitted.status().ToString();
  EXPECT_EQ(submitted->jobs(0), 1);
  EXPECT_NE(submitted->errors(1).find("may not have a robot moved"), std::string::npos);
  EXPECT_EQ(submitted->jobs(2), 2);
  pb::ManyJobActionsRequest actions;
  for (const int64_t id : {1, 2, 3}) {
    actions.add_actions()->set_job(id);
    actions.mutable_actions()->rbegin()->set_action(pb::JOB_ACTION_CANCEL);
  }
  with->Ask(actions);
  ASSERT_TRUE(bench.Turn().ok());
  const auto acted = with->Reply<pb::ManyJobActionsReply>();
  ASSERT_TRUE(acted.ok()) << acted.status().ToString();
  EXPECT_EQ(acted->jobs(0).state(), pb::JOB_STATE_CANCELLED);
  EXPECT_EQ(acted->jobs(1).state(), pb::JOB_STATE_CANCELLED);
  EXPECT_EQ(acted->errors(2), "there is no job 3");
}

TEST(Roles, WhetherATaskRunsAtMostOnceIsNotTheClientsToSay) {
  ServerBench bench;
  const auto client = bench.Connect("o1", pb::ROLE_OPERATOR);
  pb::JobSpec job;
  AddTask(&job, "arm", "rollout")->set_at_most_once(false);
  AddTask(&job, "sum", "echo")->set_at_most_once(true);
  ASSERT_TRUE(SubmitStatus(bench, *client, job, "r").ok());
  const auto& plan = *bench.state().jobs.at(1).plan;
  EXPECT_TRUE(plan.tasks[0].at_most_once);
  EXPECT_FALSE(plan.tasks[1].at_most_once);
  const auto agent = bench.Connect("a1", pb::ROLE_AGENT);
  agent->Hello({"rollout"}, "a");
  ASSERT_TRUE(bench.Turn().ok());
  EXPECT_TRUE(AssignmentIn(agent->Mail()).at_most_once());
}

TEST(Roles, ATaskSubmitsWhatItsKindMayAndNothingElse) {
  coordinator::ServerOptions options;
  options.policy.may_submit = {{"lead", {"part"}}};
  ServerBench bench(options);
  const auto client = bench.Connect("o1", pb::ROLE_OPERATOR),
             worker = bench.Connect("w1", pb::ROLE_WORKER, "host7");
  worker->Hello({"lead", "echo"});
  for (const std::string kind : {"lead", "echo"}) {
    ASSERT_TRUE(SubmitStatus(bench, *client, OneTask(kind), kind).ok());
    const auto assignment = AssignmentIn(worker->Mail());
    ASSERT_NE(assignment.token(), 0u) << kind;
    const bool leads = kind == "lead";
    EXPECT_EQ(SubmitStatus(bench, *worker, OneTask("part"), "p", assignment.token()).ok(), leads) << kind;
    const Status rollout = SubmitStatus(bench, *worker, OneTask("rollout"), "q", assignment.token());
    EXPECT_EQ(rollout.code(), StatusCode::kPermissionDenied);
    EXPECT_EQ(rollout.message(), "a task of kind '" + kind + "' may not submit one of kind 'rollout'");
    EXPECT_EQ(SubmitStatus(bench, *worker, OneTask("part"), "p").code(), StatusCode::kPermissionDenied)
        << "without a lease";
    worker->Tell(FinishedMessage(assignment));
    ASSERT_TRUE(bench.Turn().ok());
    worker->Mail();
  }
}

TEST(Roles, ARequestIdIsNotReusedForAnotherJob) {
  ServerBench bench;
  const auto client = bench.Connect("o1", pb::ROLE_OPERATOR);
  pb::JobSpec job = OneTask();
  (*job.mutable_labels())["a"] = "1";
  (*job.mutable_labels())["b"] = "2";
  ASSERT_TRUE(SubmitStatus(bench, *client, job, "same").ok());
  job.set_submitted_by("the same person elsewhere");
  EXPECT_TRUE(SubmitStatus(bench, *client, job, "same").ok());
  job.mutable_tasks(0)->set_payload("other");
  const Status other = SubmitStatus(bench, *client, job, "same");
  EXPECT_EQ(other.code(), StatusCode::kFailedPrecondition);
  EXPECT_NE(other.message().find("was used for job 1"), std::string::npos);
  EXPECT_EQ(bench.state().jobs.size(), 1u);
}

TEST(Roles, NamesThatATerminalWouldObeyAreRefused) {
  ServerBench bench;
  const auto client = bench.Connect("o1", pb::ROLE_OPERATOR), worker = bench.Connect("w1", pb::ROLE_WORKER);
  const std::string evil = "x\x1b]0;owned\x07";
  std::vector<pb::JobSpec> jobs(6, OneTask());
  jobs[0].set_name(evil);
  jobs[1].mutable_tasks(0)->set_name(evil);
  jobs[2].mutable_tasks(0)->set_stage(evil);
  jobs[3].set_submitted_by(evil);
  (*jobs[4].mutable_labels())[evil] = "";
  jobs[5].mutable_tasks(0)->add_required_tags(evil);
  for (size_t i = 0; i < jobs.size(); ++i) {
    const Status refused = SubmitStatus(bench, *client, jobs[i], "r" + std::to_string(i));
    EXPECT_EQ(refused.code(), StatusCode::kInvalid) << i;
    EXPECT_NE(refused.message().find("'x\\x1b]0;owned\\x07'"), std::string::npos) << refused.message();
  }
  worker->Hello({"echo"}, evil);
  ASSERT_TRUE(bench.Turn().ok());
  EXPECT_NE(RefusalIn(worker->Mail()).find("characters that a terminal would obey"), std::string::npos);
  EXPECT_TRUE(bench.state().jobs.empty());
  EXPECT_TRUE(bench.state().workers.empty());
}

TEST(Roles, ARevokedKeysSessionIsOverAtOnce) {
  ServerBench bench;
  transport::AllowList allowed;
  const std::string key = transport::GenerateKeyPair().public_key;
  ASSERT_TRUE(allowed.Add(key, pb::ROLE_WORKER, "host7").ok());
  ASSERT_TRUE(allowed.Add(transport::GenerateKeyPair().public_key, pb::ROLE_WORKER, "host8").ok());
  const auto client = bench.Connect("o1", pb::ROLE_OPERATOR);
  const auto revoked = bench.Connect("w7", pb::ROLE_WORKER, "host7"),
             other = bench.Connect("w8", pb::ROLE_WORKER, "host8");
  revoked->Hello({"echo"}, "seven");
  ASSERT_TRUE(SubmitStatus(bench, *client, OneTask(), "r").ok());
  ASSERT_NE(AssignmentIn(revoked->Mail()).token(), 0u);
  other->Hello({"echo"}, "eight");
  ASSERT_TRUE(bench.Turn().ok());
  ASSERT_TRUE(allowed.Remove(key));
  bench.server_->SetAllowedKeys(allowed);
  ASSERT_TRUE(bench.Turn().ok());
  EXPECT_TRUE(revoked->Mail().empty());
  EXPECT_EQ(bench.state().workers.count("seven"), 0u);
  EXPECT_NE(AssignmentIn(other->Mail()).token(), 0u) << "its work goes to another";
}

// --- replies that would be too large -----------------------------------------------------------------------

TEST(LargeReplies, AJobsTasksComeInPagesAndNoneIsMissing) {
  coordinator::ServerOptions options;
  options.page_bytes = 2'000;
  ServerBench bench(options);
  const auto client = bench.Connect("o1", pb::ROLE_OPERATOR);
  pb::JobSpec job;
  constexpr int kTasks = 2'500;
  for (int i = 0; i < kTasks; ++i) AddTask(&job, "t" + std::to_string(i), "echo");
  ASSERT_TRUE(SubmitStatus(bench, *client, job, "r").ok());
  pb::GetJobRequest request;
  request.set_job(1);
  request.set_with_tasks(true);
  int seen = 0, pages = 0;
  do {
    client->Ask(request);
    ASSERT_TRUE(bench.Turn().ok());
    const auto page = client->Reply<pb::GetJobReply>();
    ASSERT_TRUE(page.ok()) << page.status().ToString();
    EXPECT_LT(page->ByteSizeLong(), 2 * options.page_bytes);
    for (const auto& task : page->tasks()) EXPECT_EQ(task.name(), "t" + std::to_string(seen++));
    request.set_first_task(page->next_task());
    ++pages;
  } while (request.first_task() > 0);
  EXPECT_EQ(seen, kTasks);
  EXPECT_GT(pages, 20);
}

TEST(LargeReplies, OneThatCannotBeSentIsAnErrorAndNotSilence) {
  coordinator::ServerOptions options;
  options.max_reply_bytes = 100'000;
  ServerBench bench(options);
  const auto client = bench.Connect("o1", pb::ROLE_OPERATOR);
  pb::JobSpec job = OneTask();
  job.set_spec_json(std::string(200'000, ' '));
  ASSERT_TRUE(SubmitStatus(bench, *client, job, "r").ok());
  pb::GetJobRequest request;
  request.set_job(1);
  client->Ask(request);
  ASSERT_TRUE(bench.Turn().ok());
  const auto reply = client->Reply<pb::GetJobReply>();
  EXPECT_EQ(reply.status().code(), StatusCode::kResourceExhausted);
  EXPECT_NE(reply.status().message().find("above the limit"), std::string::npos);
}

TEST(ListJobs, IsFilteredByStateLabelAndTimeAndPaged) {
  ServerBench bench;
  const auto client = bench.Connect("o1", pb::ROLE_OPERATOR);
  for (int i = 1; i <= 6; ++i) {
    pb::JobSpec job = OneTask();
    (*job.mutable_labels())["robot"] = i % 2 == 0 ? "arm" : "leg";
    if (i == 6) (*job.mutable_labels())["night"] = "yes";
    ASSERT_TRUE(SubmitStatus(bench, *client, job, std::to_string(i)).ok());
    bench.Pass(10.0);
  }
  const auto ids = [&](const pb::ListJobsRequest& request, bool* more = nullptr) {
    client->Ask(request);
    EXPECT_TRUE(bench.Turn().ok());
    const auto reply = client->Reply<pb::ListJobsReply>();
    std::vector<int64_t> found;
    for (const auto& job : reply->jobs()) found.push_back(job.id());
    if (more != nullptr) *more = reply->more();
    return found;
  };
  using Ids = std::vector<int64_t>;
  pb::ListJobsRequest arm, night, since, page, failed;
  (*arm.mutable_labels())["robot"] = "arm";
  EXPECT_EQ(ids(arm), (Ids{6, 4, 2}));
  (*night.mutable_labels())["night"] = "";
  EXPECT_EQ(ids(night), (Ids{6}));
  since.set_since_ns(bench.state().jobs.at(5).record.submitted_ns);
  EXPECT_EQ(ids(since), (Ids{6, 5}));
  failed.add_states(pb::JOB_STATE_FAILED);
  EXPECT_EQ(ids(failed), Ids{});
  page.set_limit(4);
  bool more = false;
  EXPECT_EQ(ids(page, &more), (Ids{6, 5, 4, 3}));
  EXPECT_TRUE(more);
  page.set_before_id(3);
  EXPECT_EQ(ids(page, &more), (Ids{2, 1}));
  EXPECT_FALSE(more);
}

}  // namespace
}  // namespace rg::testing
