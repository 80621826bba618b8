#include "services/trajectories/shard.h"

#include <gtest/gtest.h>

#include "tests/unit/trajectories/test_plants.h"

namespace rg::trajectories {
namespace {

ShardSpec SmallSpec(const char* robot) {
  ShardSpec spec;
  spec.seed = 7;
  spec.count = 4;
  if (std::string(robot) == "mico2") {
    spec.sampling.home = Candle();
    spec.mpc.peak_torque = KnownPeakTorques(*LoadRobot("mico2"));
  }
  return spec;
}

Shard Generate(const sim::Plant& plant, const ShardSpec& spec) {
  auto shard = GenerateShard(plant, plant.parameters().Nominal(), spec);
  EXPECT_TRUE(shard.ok()) << shard.status().ToString();
  return std::move(shard).value();
}

bool Same(const Trajectory& a, const Trajectory& b) {
  return a.slot == b.slot && a.draw == b.draw && a.goal == b.goal && a.q == b.q && a.v == b.v &&
         a.torque == b.torque && a.final_q == b.final_q && a.final_v == b.final_v &&
         a.goal_error == b.goal_error && a.iterations == b.iterations;
}

TEST(Shard, StoredTrajectoriesReachTheirGoalInsideEveryBox) {
  const sim::Plant plant = MakePlant("mico2");
  const ShardSpec spec = SmallSpec("mico2");
  const Shard shard = Generate(plant, spec);
  const MotionLimits limits = MotionLimits::FromModel(plant.model(), spec.mpc.peak_torque);
  EXPECT_EQ(shard.trajectories.size() + shard.unfilled.size(), 4u);
  EXPECT_EQ(shard.num_samples(), 100);  // 25 per second
  for (const Trajectory& t : shard.trajectories) {
    EXPECT_LE((t.final_q - t.goal).lpNorm<Eigen::Infinity>(), 0.02);
    for (int k = 0; k < t.num_samples(); ++k) {
      EXPECT_TRUE((t.torque.col(k).cwiseAbs().array() <= limits.torque.array()).all());
      EXPECT_TRUE((t.v.col(k).cwiseAbs().array() <= limits.velocity.array()).all());
      EXPECT_TRUE((t.q.col(k).array() <= limits.position_upper.array()).all());
      EXPECT_TRUE((t.q.col(k).array() >= limits.position_lower.array()).all());
    }
  }
}

TEST(Shard, TrajectoryIsWhatTheSimulatorDoesUnderItsTorque) {
  const sim::Plant plant = MakePlant("mico2");
  const ShardSpec spec = SmallSpec("mico2");
  const Shard shard = Generate(plant, spec);
  sim::Simulator simulator(plant, spec.mpc.simulation);
  for (const Trajectory& t : shard.trajectories) {
    sim::State state = simulator.MakeState(t.q.col(0), t.v.col(0));
    for (int k = 0; k < t.num_samples(); ++k) {
      EXPECT_EQ(state.q, t.q.col(k));
      ASSERT_TRUE(simulator.Advance(state, t.torque.col(k), shard.interval_s).ok());
    }
    EXPECT_EQ(state.q, t.final_q);
  }
}

// What the plan's coarse steps cost: one interval from the states of real trajectories, against a
// reference that is a hundred times finer.
TEST(Shard, DefaultStepIsMoreAccurateThanThePapersEulerAtOneMillisecond) {
  const sim::Plant plant = MakePlant("mico2");
  const ShardSpec spec = SmallSpec("mico2");
  const Shard shard = Generate(plant, spec);
  auto simulate = [&](const sim::SimulatorOptions& options) {
    sim::Simulator simulator(plant, options);
    Eigen::MatrixXd out(12, shard.num_samples());
    int column = 0;
    for (const Trajectory& t : shard.trajectories) {
      for (int k = 0; k < t.num_samples(); ++k) {
        sim::State state = simulator.MakeState(t.q.col(k), t.v.col(k));
        EXPECT_TRUE(simulator.Advance(state, t.torque.col(k), shard.interval_s).ok());
        out.col(column++) << state.q, state.v;
      }
    }
    return out;
  };
  const Eigen::MatrixXd reference = simulate({.step_s = 1e-4});
  const Eigen::MatrixXd ours = simulate(spec.mpc.simulation) - reference;
  const Eigen::MatrixXd euler =
      simulate({.integrator = sim::Integrator::kSemiImplicitEuler, .step_s = 1e-3}) - reference;
  EXPECT_LT(ours.topRows(6).norm(), euler.topRows(6).norm());
  EXPECT_LT(ours.bottomRows(6).norm(), euler.bottomRows(6).norm());
}

// The acceptance figure of the paper-sized set is made by tests/benchmarks/trajectories.
TEST(Shard, MicoReachesGoalsWithinTwoSeconds) {
  const sim::Plant plant = MakePlant("mico2");
  ShardSpec spec = SmallSpec("mico2");
  spec.duration_s = 2.0;
  spec.count = 20;
  const Shard shard = Generate(plant, spec);
  EXPECT_EQ(shard.trajectories.size(), 20u);
  EXPECT_LE(shard.num_failures(), 1u) << shard.FailureSummary();  // ≥ 95 %
}

// Friction on joints almost without damping and rotors, as the model has that a first rollout leaves.
TEST(Shard, ASoftStartPlansWhereDryFrictionStopsAColdOne) {
  const double coulomb[] = {1.53, 0.27, 0.11, 0.053, 0.058, 0.41},
               rotor[] = {1e-4, 0.064, 0.116, 0.0, 0.064, 0.0064};
  const double damping[] = {0.027, 11.8, 16.5, 0.0, 0.0, 0.0};
  std::vector<effects::EffectSpec> added;
  const std::vector<std::string> joints = MakePlant("mico2").joint_names();
  for (size_t j = 0; j < joints.size(); ++j) {
    added.push_back(effects::MakeSpec("coulomb_friction", {joints[j]}, {{"coulomb", coulomb[j]}}));
    added.push_back(effects::MakeSpec("rotor_inertia", {joints[j]}, {{"armature", rotor[j]}}));
  }
  const sim::Plant plant = MakePlant("mico2", added);
  Eigen::VectorXd values = plant.parameters().Nominal();
  for (size_t j = 0; j < joints.size(); ++j)
    values[plant.parameters().Find("damping." + joints[j])] = damping[j];
  ShardSpec spec = SmallSpec("mico2");
  spec.sampling.home_range = 0.6;
  spec.count = 12;
  const auto soft = GenerateShard(plant, values, spec);
  spec.mpc.soft_start = 1.0;
  const auto cold = GenerateShard(plant, values, spec);
  ASSERT_TRUE(soft.ok() && cold.ok());
  EXPECT_EQ(soft->trajectories.size(), 12u);
  EXPECT_LE(2 * soft->num_failures(), cold->num_failures())
      << soft->FailureSummary() << "; " << cold->FailureSummary();
  EXPECT_GT(cold->num_failures(), 1u);
}

TEST(Shard, SlotsDoNotDependOnTheSplit) {
  const sim::Plant plant = MakePlant("arm2");
  ShardSpec spec = SmallSpec("arm2");
  spec.count = 6;
  const Shard whole = Generate(plant, spec);
  std::vector<Shard> parts;
  for (const auto& [first, count] : {std::pair(0, 1), std::pair(1, 2), std::pair(3, 3)}) {
    spec.first = first;
    spec.count = count;
    parts.push_back(Generate(plant, spec));
  }
  Shard joined = parts[0];
  joined.count = whole.count;
  for (size_t p = 1; p < parts.size(); ++p) {
    for (int i = 0; i < kFailureKinds; ++i) joined.failures[i] += parts[p].failures[i];
    std::ranges::copy(parts[p].unfilled, std::back_inserter(joined.unfilled));
    std::ranges::copy(parts[p].trajectories, std::back_inserter(joined.trajectories));
  }
  EXPECT_EQ(SerializeShard(joined), SerializeShard(whole));
}

TEST(Shard, FailedDrawsAreCountedAndReplaced) {
  const sim::Plant plant = MakePlant("arm2");
  ShardSpec spec = SmallSpec("arm2");
  spec.count = 6;
  spec.goal_tolerance = 0.03;
  spec.mpc.bandwidth = 6.0;  // too slow for some
  spec.duration_s = 0.88;
  const Shard shard = Generate(plant, spec);
  EXPECT_GT(shard.failures[static_cast<int>(Failure::kGoalNotReached)], 0u) << shard.FailureSummary();
  uint64_t draws = 0;
  for (const Trajectory& t : shard.trajectories) {
    EXPECT_LE(t.goal_error, 0.03);
    draws += t.draw;
  }
  EXPECT_EQ(draws, shard.num_failures() - shard.unfilled.size() * spec.max_draws);
  EXPECT_NE(shard.FailureSummary().find("goal_not_reached"), std::string::npos);
}

TEST(Shard, ARobotThatCannotHoldItselfIsSaidToBeInfeasible) {
  const sim::Plant plant = MakePlant("mico2");
  ShardSpec spec = SmallSpec("mico2");
  spec.mpc.peak_torque = Eigen::VectorXd::Constant(6, 1e-3);
  spec.max_draws = 5;
  const auto shard = GenerateShard(plant, plant.parameters().Nominal(), spec);
  ASSERT_FALSE(shard.ok());
  EXPECT_EQ(shard.status().code(), StatusCode::kFailedPrecondition);
  EXPECT_NE(shard.status().message().find("infeasible 10"), std::string::npos) << shard.status().message();
  EXPECT_NE(shard.status().message().find("joint_"), std::string::npos);
}

TEST(Shard, ReportsProgressAndStopsWhenCancelled) {
  const sim::Plant plant = MakePlant("pendulum");
  ShardSpec spec = SmallSpec("pendulum");
  CancelToken cancel;
  int calls = 0;
  const auto shard = GenerateShard(
      plant, plant.parameters().Nominal(), spec,
      [&](const ProgressUpdate& update) {
        EXPECT_EQ(update.total, 4.0);
        EXPECT_EQ(update.done, ++calls);
        if (calls == 2) cancel.Cancel();
      },
      &cancel);
  EXPECT_EQ(shard.status().code(), StatusCode::kCancelled);
  EXPECT_EQ(calls, 2);
}

Shard HandMade() {
  Shard shard;
  shard.seed = 3;
  shard.first = 10;
  shard.count = 2;
  shard.joints = {"shoulder", "elbow"};
  shard.failures[4] = 2;
  shard.unfilled = {11};
  Trajectory t;
  t.slot = 10;
  t.draw = 2;
  t.iterations = 55;
  t.goal_error = 0.25;
  t.goal = t.final_q = t.final_v = Eigen::Vector2d(1.0, -0.5);
  t.q = t.v = t.torque = Eigen::MatrixXd::Random(2, 7);
  shard.trajectories = {t};
  return shard;
}

TEST(ShardBytes, RoundTripIsExact) {
  const Shard shard = HandMade();
  const std::string bytes = SerializeShard(shard);
  const auto back = ParseShard(bytes, "test");
  ASSERT_TRUE(back.ok()) << back.status().ToString();
  EXPECT_TRUE(Same(back.value().trajectories[0], shard.trajectories[0]));
  EXPECT_EQ(back.value().joints, shard.joints);
  EXPECT_EQ(back.value().unfilled, shard.unfilled);
  EXPECT_EQ(SerializeShard(back.value()), bytes);
}

TEST(ShardBytes, EveryFlippedByteAndEveryTruncationIsRefused) {
  const std::string bytes = SerializeShard(HandMade());
  for (size_t i = 0; i < bytes.size(); ++i) {
    std::string bad = bytes;
    bad[i] ^= 0x10;
    EXPECT_FALSE(ParseShard(bad, "s").ok()) << i;
    EXPECT_FALSE(ParseShard(std::string_view(bytes).substr(0, i), "s").ok()) << i;
  }
  EXPECT_FALSE(ParseShard(bytes + "x", "s").ok());
  const auto refused = ParseShard("hello", "file.rgs");
  EXPECT_EQ(refused.status().message(), "file.rgs: not a shard of trajectories");
}

}  // namespace
}  // namespace rg::trajectories
