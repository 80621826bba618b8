// The coordinator was stopped, or slow: the silence is its own, and costs no worker its lease.
#include <gtest/gtest.h>

#include "tests/support/service/server_bench.h"

namespace rg::testing {
namespace {

class Stall : public ::testing::Test {
 protected:
  Stall()
      : client_(bench_.Connect("client", pb::ROLE_OPERATOR)), worker_(bench_.Connect("w1", pb::ROLE_WORKER)) {
    client_->Submit(OneTask(), "r1");
    worker_->Hello({"echo"});
    EXPECT_TRUE(bench_.Turn().ok());
    token_ = AssignmentIn(worker_->Mail()).token();
    EXPECT_NE(token_, 0u);
  }
  void Turns(int n) {
    for (int i = 0; i < n; ++i) ASSERT_TRUE(bench_.Turn().ok());
  }
  void ExpectStillLeased() {
    EXPECT_EQ(bench_.state().counters.workers_lost, 0u);
    EXPECT_EQ(bench_.state().counters.attempts_lost, 0u);
    EXPECT_EQ(bench_.state().leases.count(token_), 1u);
  }

  ServerBench bench_;
  std::unique_ptr<Peer> client_, worker_;
  uint64_t token_ = 0;
};

TEST_F(Stall, BeatsThatWaitBehindAThousandMessagesAreReadBeforeLeasesAreJudged) {
  for (int i = 0; i < 2'500; ++i) client_->Ask(pb::ListWorkersRequest());
  worker_->Beat({token_});
  bench_.Pass(3.9);  // no longer than a lease, and then the queue takes its time
  for (int i = 0; i < 3; ++i) {
    ASSERT_TRUE(bench_.Turn().ok());
    bench_.Pass(0.2);
  }
  ExpectStillLeased();
}

TEST_F(Stall, AWorkerIsHeardAfterwardsBeforeItIsJudged) {
  bench_.Pass(60.0);
  Turns(2);  // what it said meanwhile is still on its way
  ExpectStillLeased();
  bench_.Pass(0.9);
  worker_->Beat({token_});
  Turns(20);
  ExpectStillLeased();
}

TEST_F(Stall, AWorkerThatIsSilentAfterwardsIsLostAllTheSame) {
  bench_.Pass(60.0);
  Turns(1);
  for (int i = 0; i < 30; ++i) {
    bench_.Pass(0.2);
    Turns(1);
  }
  EXPECT_EQ(bench_.state().counters.workers_lost, 1u);
  EXPECT_EQ(bench_.state().leases.count(token_), 0u);
}

TEST_F(Stall, ALongStallWithAFullQueueCostsNothingEither) {
  for (int i = 0; i < 2'500; ++i) client_->Ask(pb::ListWorkersRequest());
  worker_->Beat({token_});
  bench_.Pass(300.0);
  for (int i = 0; i < 4; ++i) {
    ASSERT_TRUE(bench_.Turn().ok());
    bench_.Pass(0.7);  // each part of the queue takes its time, beyond the interval of grace
  }
  ExpectStillLeased();
}

TEST_F(Stall, ACoordinatorThatIsAlwaysLateStillFindsWhoIsLost) {
  for (int i = 0; i < 15; ++i) {
    bench_.Pass(1.2);
    Turns(1);
  }
  EXPECT_EQ(bench_.state().counters.workers_lost, 1u);
}

TEST_F(Stall, AQueueThatNeverEndsDelaysTheJudgementButNotForEver) {
  for (int second = 0; second < 40; ++second) {
    for (int i = 0; i < 1'100; ++i) client_->Ask(pb::ListWorkersRequest());
    bench_.Pass(0.9);
    Turns(1);
  }
  EXPECT_EQ(bench_.state().counters.workers_lost, 1u);
}

}  // namespace
}  // namespace rg::testing
