// What people are told of a worker's slots.
#include <gtest/gtest.h>

#include "tests/support/service/server_bench.h"

namespace rg::testing {
namespace {

TEST(BusySlots, AreNoMoreThanThereAreThoughMoreTasksAreAtHand) {
  ServerBench bench;
  const auto client = bench.Connect("client", pb::ROLE_OPERATOR),
             worker = bench.Connect("w1", pb::ROLE_WORKER);
  pb::JobSpec job;
  for (int i = 0; i < 20; ++i) AddTask(&job, "t" + std::to_string(i), "echo");
  client->Submit(job, "r1");
  worker->Hello({"echo"});
  ASSERT_TRUE(bench.Turn().ok());
  pb::WorkerMessage finished = FinishedMessage(AssignmentIn(worker->Mail()));
  finished.mutable_finished()->set_seconds(0.4);
  worker->Tell(finished);
  client->Ask(pb::ListWorkersRequest());
  ASSERT_TRUE(bench.Turn().ok());
  EXPECT_EQ(bench.state().leases.size(), 2u) << "one runs, one is at hand";
  EXPECT_TRUE(client->Reply<pb::SubmitReply>().ok());
  EXPECT_EQ(client->Reply<pb::ListWorkersReply>()->workers(0).busy(), 1u);
  client->Ask(pb::StatusRequest());
  ASSERT_TRUE(bench.Turn().ok());
  EXPECT_EQ(client->Reply<pb::StatusReply>()->slots_busy(), 1u);
}

}  // namespace
}  // namespace rg::testing
