#include "services/trajectories/aggregation.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/unit/trajectories/test_plants.h"

namespace rg::trajectories {
namespace {

AggregationSpec SmallSpec() {
  AggregationSpec spec;
  spec.shard.seed = 11;
  spec.shard.count = 3;
  return spec;
}

// An expert of its own, asked anew in every state.
class MpcLearner {
 public:
  MpcLearner(const sim::Plant& plant, const MpcOptions& options)
      : mpc_(*MpcController::Create(plant, plant.parameters().Nominal(), options)) {}
  Learner Make() {
    return [this](const auto& q, const auto& v, const auto& goal, Eigen::VectorXd* effort) {
      return mpc_->Solve(q, v, goal, effort).ok;
    };
  }

 private:
  std::unique_ptr<MpcController> mpc_;
};

TEST(Aggregation, ALearnerThatIsTheExpertIsToldWhatItDid) {
  const sim::Plant plant = MakePlant("arm2");
  const AggregationSpec spec = SmallSpec();
  MpcLearner expert(plant, spec.shard.mpc);
  const auto shard = AggregateShard(plant, plant.parameters().Nominal(), spec, expert.Make());
  ASSERT_TRUE(shard.ok()) << shard.status().ToString();
  ASSERT_EQ(shard->trajectories.size(), 3u);
  sim::Simulator simulator(plant, spec.shard.mpc.simulation);
  for (const Trajectory& t : shard->trajectories) {
    EXPECT_LT(t.goal_error, 0.02);
    // The answers lead from each visited state to the next, for the learner did just that.
    for (int k = 0; k + 1 < t.num_samples(); ++k) {
      sim::State state = simulator.MakeState(t.q.col(k), t.v.col(k));
      ASSERT_TRUE(simulator.Advance(state, t.torque.col(k), shard->interval_s).ok());
      EXPECT_LT((state.q - t.q.col(k + 1)).norm(), 2e-3);
    }
  }
}

TEST(Aggregation, TheExpertShowsTheWayBackFromWhereABadLearnerWent) {
  const sim::Plant plant = MakePlant("arm2");
  AggregationSpec spec = SmallSpec();
  const Learner idle = [](const auto& q, const auto&, const auto&, Eigen::VectorXd* effort) {
    effort->setZero(q.size());
    return true;
  };
  const auto shard = AggregateShard(plant, plant.parameters().Nominal(), spec, idle);
  ASSERT_TRUE(shard.ok()) << shard.status().ToString();
  ASSERT_FALSE(shard->trajectories.empty());
  for (const Trajectory& t : shard->trajectories) {
    EXPECT_GT(t.torque.norm(), 0.1) << "the answers are the expert's, not the learner's";
    EXPECT_FALSE(t.goal_error < 0.02);
  }
  spec.expert_share = 1.0;
  const auto helped = AggregateShard(plant, plant.parameters().Nominal(), spec, idle);
  ASSERT_TRUE(helped.ok());
  for (const Trajectory& t : helped->trajectories) EXPECT_LT(t.goal_error, 0.02);
}

TEST(Aggregation, SlotsDoNotDependOnHowTheyAreSplit) {
  const sim::Plant plant = MakePlant("arm2");
  AggregationSpec spec = SmallSpec();
  spec.expert_share = 0.5;
  const Learner weak = [](const auto& q, const auto& v, const auto& goal, Eigen::VectorXd* effort) {
    *effort = 2.0 * (goal - q) - 0.5 * v;
    return true;
  };
  const Eigen::VectorXd p = plant.parameters().Nominal();
  const auto whole = AggregateShard(plant, p, spec, weak);
  spec.shard.first = 2, spec.shard.count = 1;
  const auto last = AggregateShard(plant, p, spec, weak);
  ASSERT_TRUE(whole.ok() && last.ok());
  ASSERT_EQ(last->trajectories.size(), 1u);
  EXPECT_EQ(last->trajectories[0].slot, 2u);
  EXPECT_EQ(last->trajectories[0].q, whole->trajectories[2].q);
  EXPECT_EQ(last->trajectories[0].torque, whole->trajectories[2].torque);
}

TEST(Examination, PutsLearnerAndMpcOnTheSamePairs) {
  const sim::Plant plant = MakePlant("arm2");
  const ShardSpec spec = SmallSpec().shard;
  MpcLearner expert(plant, spec.mpc);
  const auto same = Examine(plant, plant.parameters().Nominal(), spec, expert.Make());
  ASSERT_TRUE(same.ok());
  ASSERT_EQ(same->pairs(), 3);
  for (int i = 0; i < 3; ++i) EXPECT_NEAR(same->learner[i], same->mpc[i], 5e-3);
  const Learner lost = [](const auto&, const auto&, const auto&, Eigen::VectorXd*) { return false; };
  const auto none = Examine(plant, plant.parameters().Nominal(), spec, lost);
  ASSERT_TRUE(none.ok());
  EXPECT_TRUE(std::isnan(none->learner[0]));
  EXPECT_TRUE(std::isinf(Quantile(none->learner, 0.5)));
  EXPECT_FALSE(none->Passed());
  EXPECT_FALSE(none->WorthTrainingOn()) << "no loop holds";
}

TEST(Examination, IsPassedWithinTwiceMpcAndByNoneThatDiverges) {
  Examination e{.learner = {0.003, 0.004, 0.005, 0.006}, .mpc = {0.002, 0.002, 0.003, 0.004}};
  EXPECT_TRUE(e.Passed());
  EXPECT_FALSE(e.WorthTrainingOn());
  e.learner[3] = 0.05;
  EXPECT_FALSE(e.Passed()) << "the 90th percentile is above twice MPC's";
  EXPECT_TRUE(e.WorthTrainingOn());
  e.learner[3] = 7.0;
  EXPECT_EQ(e.diverged(), 1);
  EXPECT_FALSE(e.Passed());
  EXPECT_TRUE(e.WorthTrainingOn());
  EXPECT_FALSE(Examination().Passed());
}

TEST(Quantile, InterpolatesAndCountsTheUnfinishedAsInfinite) {
  EXPECT_DOUBLE_EQ(Quantile({3, 1, 2}, 0.5), 2);
  EXPECT_DOUBLE_EQ(Quantile({1, 2}, 0.5), 1.5);
  EXPECT_TRUE(std::isinf(Quantile({1, std::nan("")}, 0.9)));
}

}  // namespace
}  // namespace rg::trajectories
