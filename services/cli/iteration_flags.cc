#include "services/cli/iteration_flags.h"

#include <CLI/CLI.hpp>

#include "services/cli/robot_profile.h"

namespace rg::cli {

void AddTrajectoryFlags(CLI::App* command, jobs::IterationOptions* options) {
  auto& o = options->trajectories;
  command->add_option("--trajectories", o.count, "How many")->capture_default_str();
  command->add_option("--shard-size", o.shard_size, "Trajectories per task")->capture_default_str();
  command->add_option("--trajectory-seconds", o.duration_s, "Length of each")->capture_default_str();
  command->add_option("--reach", o.reach, "Share of what the speed limit allows between start and goal")
      ->capture_default_str();
  command->add_option("--spread", o.spread, "Poses within this of home [rad]; 0: anywhere")
      ->capture_default_str();
}

void AddTrainFlags(CLI::App* command, jobs::IterationOptions* options) {
  auto& o = options->train;
  command->add_option("--epochs", o.epochs)->capture_default_str();
  command->add_option("--batch", o.batch)->capture_default_str();
  command->add_option("--learning-rate", o.learning_rate)->capture_default_str();
  command->add_option("--hidden", o.hidden, "Width of each hidden layer")
      ->delimiter(',')
      ->capture_default_str();
}

void AddLearningFlags(CLI::App* command, jobs::IterationOptions* options) {
  auto& o = options->train;
  command
      ->add_option("--aggregations", o.aggregations,
                   "Rounds in which the policy drives, MPC answers, and both train the next (DAgger)")
      ->capture_default_str();
  command
      ->add_option("--examination", o.examination_pairs,
                   "Start/goal pairs on which policy and MPC are compared; 0: none")
      ->capture_default_str();
  command->add_flag("--curriculum", options->curriculum.on,
                    "Near and slow goals first: reach, speed and spread grow over the iterations");
  command->add_option("--curriculum-first", options->curriculum.first, "Share in the first iteration")
      ->capture_default_str();
  command->add_option("--curriculum-growth", options->curriculum.growth, "Factor per iteration, up to 1")
      ->capture_default_str();
}

void AddLoopDiagnosisFlags(CLI::App* command, jobs::IterationOptions* options) {
  auto& o = options->diagnosis;
  command->add_flag("--diagnose", o.on,
                    "Diagnose the rollouts so far after each; the next iteration plans with what that found");
  command
      ->add_option("--diagnose-work", o.work_limit,
                   "Of the search for missing physics, about its seconds on one core, the same on any machine")
      ->capture_default_str();
  command->add_option("--diagnose-threads", o.threads, "Of a diagnosis; 0: all cores of its worker")
      ->capture_default_str();
}

void AddRolloutFlags(CLI::App* command, jobs::IterationOptions* options) {
  auto& o = options->rollout;
  command->add_option("--rollout-seconds", o.duration_s)->capture_default_str();
  command->add_option("--goal", o.goal_q, "Goal in joint space [rad]; default: drawn")->delimiter(',');
  command->add_option("--goal-position", o.goal_position, "Goal of the end effector x,y,z [m]")
      ->delimiter(',');
  command->add_option("--controller", o.controller, "policy or mpc")->capture_default_str();
  command
      ->add_option("--excitation", o.excitation,
                   "Torques on top of the controller's in the rollout's first half, as a share of each "
                   "joint's limit; default: as the agent is configured; `run` adds 0.15 to the first two rollouts, "
                   "with --diagnose to all while they tell too little of a joint")
      ->check(CLI::Range(0.0, 1.0));
  command
      ->add_option("--slower-attempts", o.slower_attempts,
                   "How often a rollout that the safety monitor ended is made again, each time at half the speed")
      ->capture_default_str();
}

void AddIdentifyFlags(CLI::App* command, jobs::IterationOptions* options) {
  auto& o = options->identify;
  command->add_option("--identify-seconds", o.budget_s, "The most that the search takes; it ends when hops agree; 0: --hops decides")
      ->capture_default_str();
  command->add_option("--hops", o.hops, "Hops of a chain; 0: as many as the budget allows")
      ->capture_default_str();
  command->add_option("--chains", o.chains, "Parallel chains of basin hopping")->capture_default_str();
  command->add_option("--rounds", o.rounds, "Chains exchange their best so often")->capture_default_str();
  command->add_flag_callback(
      "--single-window", [&o] { o.whole_recording = false; },
      "Fit one short window as in the paper, not the whole recording");
  command->add_option("--window", o.window_s, "Length of the windows that are fitted [s]; 0: 1, single 0.2")
      ->capture_default_str();
  command->add_option("--window-start", o.window_start_s, "Its start [s]")->capture_default_str();
  command->add_option("--solver", o.solver, "lm or lbfgs")->capture_default_str();
  command->add_option("--bounds", o.bounds, "physical, paper (±20 %) or none")->capture_default_str();
  command
      ->add_option("--parametrisation,--parametrization", o.parametrisation,
                   "Of a link's inertial parameters: log-cholesky (only bodies that can exist) or raw (the paper's)")
      ->check(CLI::IsMember({"log-cholesky", "raw"}))
      ->capture_default_str();
  command->add_flag_callback(
      "--paper-parameters", [&o] { o.friction = false; },
      "Without Coulomb friction and rotor inertia; with --parametrisation raw the paper's 71 parameters");
  command->add_option("--alpha", o.alpha, "Weight of the pull towards the present parameters")
      ->capture_default_str();
}

void AddPartialFlag(CLI::App* command, jobs::IterationOptions* options) {
  command->add_flag("--accept-partial", options->rollout.accept_partial,
                    "A rollout that did not end as asked counts as one that did: its job does not fail, its parameters "
                    "become current");
}

void TakeProfile(const RobotProfile& profile, jobs::IterationOptions* options) {
  options->robot = profile.name;
  options->home = profile.home;
  options->peak_torque = profile.peak_torque;
}

}  // namespace rg::cli
