// A chain of basin hopping as workers run it: what it leaves depends on its payload and inputs alone.
#include "services/jobs/identify_tasks.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <nlohmann/json.hpp>

#include "common/base/file.h"
#include "common/base/rng.h"
#include "common/model/urdf_loader.h"
#include "common/recordings/csv.h"
#include "common/sim/model_file.h"
#include "common/sim/simulator.h"
#include "realitygrad/v1/payloads.pb.h"
#include "services/jobs/kinds.h"
#include "services/rollouts/recording_bundle.h"

namespace rg::jobs {
namespace {

namespace pb = realitygrad::v1;
using Eigen::MatrixXd;
using Eigen::VectorXd;
using nlohmann::json;

std::string UrdfPath() {
  const char* source = std::getenv("RG_SOURCE_DIR");
  return std::string(source ? source : ".") + "/deploy/robots/arm2.urdf";
}

// arm2 with heavier links and more damping than its URDF says, a second at 25 Hz.
struct Loop {
  sim::Plant plant =
      *sim::Plant::Create(std::make_shared<const model::RobotModel>(*model::LoadUrdf(UrdfPath(), {})));
  worker::InputArtifact model{.name = kInputModel,
                              .sha256 = std::string(64, 'a'),
                              .bytes = sim::ModelToJson(plant, plant.parameters().Nominal(), 1)};
  worker::InputArtifact recording{.name = kInputRecording, .sha256 = std::string(64, 'b')};

  Loop() {
    VectorXd truth = plant.parameters().Nominal();
    for (const int i : plant.parameters().OfKind(sim::ParameterKind::kDamping)) truth[i] = 0.9;
    for (const int i : plant.parameters().OfKind(sim::ParameterKind::kMass)) truth[i] *= 1.2;
    recordings::Recording r;
    r.joints = plant.joint_names();
    r.t = VectorXd::LinSpaced(26, 0.0, 1.0);
    r.effort_command = MatrixXd(2, 26);
    for (int k = 0; k < 26; ++k) {
      r.effort_command.col(k) << 3.0 * std::sin(1.7 * r.t[k]), 1.2 * std::sin(2.9 * r.t[k] + 0.4);
    }
    const std::vector<double> times(r.t.data(), r.t.data() + 26);
    const auto command = *sim::CommandSignal::Create(times, r.effort_command, sim::Hold::kZeroOrder);
    sim::Simulator simulator(plant);
    simulator.SetParameters(truth);
    const auto out =
        simulator.Simulate(simulator.MakeState(VectorXd::Zero(2), VectorXd::Zero(2)), command, times);
    Rng rng(3);
    r.q = out.position;
    for (double& q : r.q.reshaped()) q += 1e-3 * rng.Normal();
    r.v = out.velocity;
    rollouts::Bundle bundle;
    bundle["manifest.json"] =
        R"({"format": "realitygrad.recordings/1", "robot": "robot.urdf", "joints": ["shoulder", "elbow"],
            "recordings": [{"file": "rec_000.csv", "split": "fit"}]})";
    bundle["robot.urdf"] = ReadFile(UrdfPath()).value();
    bundle["rec_000.csv"] = recordings::FormatCsv(r);
    recording.bytes = rollouts::PackBundle(bundle);
  }

  worker::TaskInput Input(int chain, int round, int hops,
                          std::vector<worker::InputArtifact> chains = {}) const {
    pb::IdentifyPayload payload;
    payload.set_seed(5);
    payload.set_chain(static_cast<uint32_t>(chain));
    payload.set_round(static_cast<uint32_t>(round));
    payload.set_rounds(2);
    payload.set_hops(static_cast<uint32_t>(hops));
    payload.set_window(pb::IDENTIFY_WINDOW_WHOLE);
    payload.set_parametrisation(pb::IDENTIFY_PARAMETRISATION_LOG_CHOLESKY);
    payload.set_alpha(1e-4);
    worker::TaskInput input;
    input.kind = kKindIdentify, input.task_name = "identify";
    payload.SerializeToString(&input.payload);
    input.inputs = {model, recording};
    for (worker::InputArtifact& c : chains) input.inputs.push_back(std::move(c));
    return input;
  }
};

// The chain that a task leaves.
std::string Chain(const worker::TaskInput& input, worker::RecordingTaskContext* context) {
  const auto done = RunIdentify(input, *context);
  RG_CHECK(done.ok()) << done.status().ToString();
  RG_CHECK(done->artifacts.front().name == kOutputChain);
  return done->artifacts.front().bytes;
}

std::string Chain(const worker::TaskInput& input) {
  worker::RecordingTaskContext context("");
  return Chain(input, &context);
}

worker::InputArtifact As(const char* name, const std::string& chain) {
  return {.name = name, .sha256 = std::string(64, 'c'), .bytes = chain};
}

TEST(IdentifyTask, ByHopsTheSameSeedLeavesTheSameBytes) {
  const Loop loop;
  const std::string once = Chain(loop.Input(1, 0, 3));
  EXPECT_EQ(once, Chain(loop.Input(1, 0, 3)));
  EXPECT_NE(once, Chain(loop.Input(0, 0, 3))) << "another chain draws other starts";
  EXPECT_EQ(sysid::ParseHopState(once)->hops, 3);
}

TEST(IdentifyTask, GoesOnFromItsCheckpointAsIfItHadNotBeenCut) {
  const Loop loop;
  worker::RecordingTaskContext first("");
  Chain(loop.Input(0, 0, 2), &first);
  EXPECT_EQ(first.checkpoints_saved, 2);
  worker::RecordingTaskContext second("", first.checkpoint);
  EXPECT_EQ(Chain(loop.Input(0, 0, 5), &second), Chain(loop.Input(0, 0, 5)));
  EXPECT_EQ(second.checkpoints_saved, 3) << "what was done is not done again";
}

TEST(IdentifyTask, ChainsTakeTheBestOfTheOthers) {
  const Loop loop;
  const std::string good = Chain(loop.Input(0, 0, 2));
  sysid::HopState worse = *sysid::ParseHopState(Chain(loop.Input(1, 0, 2)));
  worse.best_cost *= 2;
  worker::RecordingTaskContext context("");
  Chain(loop.Input(1, 1, 1,
                   {As(kInputChain, sysid::SerializeHopState(worse)), As(kInputOthers, good),
                    As(kInputOthers, sysid::SerializeHopState(worse))}),
        &context);
  EXPECT_EQ(std::count(context.lines.begin(), context.lines.end(), "took the best of chain 0"), 1);
}

// 1000 s allowed, of which they take a fraction of one.
TEST(IdentifyTask, ChainsThatMayStopEarlyExchangeAfterTwoHopsEach) {
  const Loop loop;
  const auto round = [&](int chain, int number, std::vector<worker::InputArtifact> chains) {
    worker::TaskInput input = loop.Input(chain, number, 0, std::move(chains));
    pb::IdentifyPayload payload;
    RG_CHECK(payload.ParseFromString(input.payload));
    payload.set_rounds(3), payload.set_chains(2), payload.set_budget_s(1000);
    payload.SerializeToString(&input.payload);
    return Chain(input);
  };
  const std::string first[2] = {round(0, 0, {}), round(1, 0, {})};
  EXPECT_EQ(sysid::ParseHopState(first[0])->hops, 2);
  EXPECT_EQ(sysid::ParseHopState(first[1])->hops, 2);
  const sysid::HopState second =
      *sysid::ParseHopState(round(0, 1, {As(kInputChain, first[0]), As(kInputOthers, first[1])}));
  EXPECT_TRUE(sysid::Agrees(second));
  EXPECT_EQ(second.hops, 2) << "four hops to one minimum say enough";
}

// Two chains of two rounds, of which the last weighs the whole recording too.
TEST(Conclusion, HasTheHopsOfAllChainsOverTheirTime) {
  const Loop loop;
  std::vector<worker::InputArtifact> chains;
  for (int round = 0; round < 2; ++round) {
    std::vector<worker::InputArtifact> next;
    for (int chain = 0; chain < 2; ++chain) {
      std::vector<worker::InputArtifact> inputs;
      if (round > 0) {
        inputs = chains;
        for (worker::InputArtifact& other : inputs) other.name = kInputOthers;
        inputs.push_back(chains[static_cast<size_t>(chain)]);
      }
      worker::RecordingTaskContext context("");
      const auto done = RunIdentify(loop.Input(chain, round, 2, inputs), context);
      ASSERT_TRUE(done.ok()) << done.status().ToString();
      next.push_back(As(kInputChain, done->artifacts.front().bytes));
      next.back().metadata_json = done->artifacts.front().metadata_json;
    }
    chains = next;
  }
  pb::ConcludePayload payload;
  payload.mutable_identify()->ParseFromString(loop.Input(0, 1, 2).payload);
  payload.mutable_identify()->set_chains(2);
  payload.set_robot("arm2");
  worker::TaskInput input;
  input.kind = kKindConclude, input.task_name = "conclusion";
  payload.SerializeToString(&input.payload);
  input.inputs = {loop.model, loop.recording, chains[0], chains[1]};
  worker::RecordingTaskContext context("");
  const auto concluded = RunConclude(input, context);
  ASSERT_TRUE(concluded.ok()) << concluded.status().ToString();
  const auto result = std::ranges::find(concluded->artifacts, kOutputResult, &worker::OutputArtifact::name);
  ASSERT_NE(result, concluded->artifacts.end());
  const json search = json::parse(result->bytes).at("identification").at("search");
  ASSERT_EQ(search.size(), 2u);
  for (const json& chain : search) {
    const auto seconds = chain.at("seconds").get<std::vector<double>>();
    ASSERT_EQ(seconds.size(), 4u) << chain.dump();
    EXPECT_TRUE(std::ranges::is_sorted(seconds)) << "rounds go on where the one before ended";
    EXPECT_EQ(chain.at("search_seconds"), seconds.back());
    EXPECT_EQ(chain.at("whole_from"), 2);
    EXPECT_EQ(chain.at("accepted").size(), 4u);
    EXPECT_TRUE(chain.at("start")[1].is_null()) << "a perturbed start";
    EXPECT_GE(chain.at("start")[2].get<double>(), chain.at("cost")[2].get<double>());
  }
}

TEST(ConcludeTask, ParametersOfARolloutThatWasStoppedAreHeldBackUnlessItIsAccepted) {
  Loop loop;
  const std::string chain = Chain(loop.Input(0, 0, 1));
  const auto conclude = [&](const std::string& rollout, bool accept) {
    worker::TaskInput input = loop.Input(0, 0, 1, {As(kInputChain, chain)});
    input.inputs[1].metadata_json = rollout;
    pb::ConcludePayload payload;
    RG_CHECK(payload.mutable_identify()->ParseFromString(input.payload));
    payload.set_robot("arm2");
    payload.set_accept_partial(accept);
    payload.SerializeToString(&input.payload);
    worker::RecordingTaskContext context("");
    return RunConclude(input, context).value();
  };
  const auto made = [](const worker::TaskOutputs& outputs, const char* name) {
    for (const worker::OutputArtifact& artifact : outputs.artifacts)
      if (artifact.name == name) return artifact;
    return worker::OutputArtifact();
  };
  const auto metadata = [&](const worker::TaskOutputs& outputs) {
    return nlohmann::json::parse(made(outputs, kOutputParameters).metadata_json);
  };
  const std::string stopped =
      R"({"end_reason": "velocity_limit", "ended_after_s": 0.6, "duration_s": 1, "held": true})";
  const worker::TaskOutputs early = conclude(stopped, false);
  EXPECT_EQ(early.remark,
            "rollout stopped by velocity_limit after 0.6 of 1 s; its parameters are not current until promoted");
  EXPECT_EQ(metadata(early)["rollout"], "stopped by velocity_limit after 0.6 of 1 s");
  EXPECT_EQ(metadata(early)["held_back"], true);
  const auto result = nlohmann::json::parse(made(early, kOutputResult).bytes)["rollout"];
  EXPECT_EQ(result["ended"], "stopped by velocity_limit after 0.6 of 1 s");
  EXPECT_EQ(result["held_back"], true);
  const worker::TaskOutputs accepted = conclude(stopped, true);
  EXPECT_EQ(metadata(accepted)["held_back"], false);
  EXPECT_EQ(accepted.remark, "rollout stopped by velocity_limit after 0.6 of 1 s; accepted");
  const worker::TaskOutputs whole = conclude(R"({"end_reason": "completed", "held": true})", false);
  EXPECT_EQ(whole.remark, "");
  EXPECT_EQ(metadata(whole)["rollout"], "complete");
  EXPECT_EQ(metadata(whole)["held_back"], false);
}

TEST(IdentifyTask, CancelledItHasNoResult) {
  const Loop loop;
  worker::RecordingTaskContext context("");
  context.cancel.Cancel();
  const auto done = RunIdentify(loop.Input(0, 0, 3), context);
  ASSERT_FALSE(done.ok());
  EXPECT_EQ(done.status().code(), StatusCode::kCancelled);
}

TEST(IdentifyTask, ARolloutThatEndedTooEarlyFailsItWithTheRolloutsOwnReason) {
  Loop loop;
  rollouts::Bundle bundle = rollouts::UnpackBundle(loop.recording.bytes).value();
  bundle["rollout.json"] =
      R"({"rows": 3, "end_reason": "velocity_limit", "detail": "elbow: velocity 2.1 beyond its limit 2",
                               "ended_after_s": 0.12})";
  loop.recording.bytes = rollouts::PackBundle(bundle);
  worker::RecordingTaskContext context("");
  const auto failed = RunIdentify(loop.Input(0, 0, 1), context);
  ASSERT_FALSE(failed.ok());
  EXPECT_NE(failed.status().message().find(
                "the rollout was stopped by velocity_limit (elbow: velocity 2.1 beyond its limit 2) "
                "after 0.12 s and left 3 rows"),
            std::string::npos)
      << failed.status().message();
}

}  // namespace
}  // namespace rg::jobs
