// The task kind `rollout` as a function: what services/jobs registers in the agent's worker.
//
// Runs in an executor child of the agent, one at a time (the spool's lock holds that too), at most
// once: a repeat with the same spec.id returns the recording that is in the spool and moves nothing.
// Recordings that a dead executor left are finished first and wait in the spool (spool_delivery.h).
#pragma once

#include <string>

#include "common/base/progress.h"
#include "common/base/status.h"
#include "robot_agent/agent_config.h"
#include "services/rollouts/rollout_end.h"
#include "services/rollouts/rollout_spec.h"

namespace rg::robot_agent {

struct RolloutTaskInput {
  std::string model_json;    // realitygrad.model/1: the belief
  std::string policy_bytes;  // for controller "policy"
  rollouts::RolloutSpec spec;
  double trust = 1.0;  // services/rollouts/trust.h
  // A rollout that the safety monitor ends is made again at half the speed at most this often, each with an
  // id of its own; the output is of the first that came to its end, else of the longest. The others'
  // recordings stay in the spool, to travel alone.
  int slower_attempts = 0;
  std::string database, job_id, task_id;  // where the recording belongs, should it travel alone
  std::string controller = "policy";      // "mpc", "trajectory"
  // For controller "trajectory": the motion (services/rollouts/reference_motion.h), which then says start,
  // goal and duration, whatever `spec` says of them. It is checked against the agent's boxes before anything
  // moves.
  std::string motion_csv;
};

struct RolloutTaskOutput {
  std::string bundle;  // artefact of kind rollouts::kBundleKind; `tar xf` gives a recording set
  // rollout.json on one line, the artefact's metadata: "end_reason", "detail", "goal", "goal_error",
  // "rows", "jitter", …
  std::string metadata_json;
  rollouts::RolloutEnd end;
  // {"ended", "end_reason", "rows", "ended_after_s", "goal_joint_norm", "goal_tip_m", "missed_deadlines",
  // "cycle_p99_us", "lateness_p99_us"}: the task's summary.
  std::string summary_json;
  // Not ok: it ended before there were two rows, and this tells why in one line. The recording counts all the
  // same.
  Status usable;
};

// Why no rollout may begin now though the agent is there: "waits for mico2 to be armed: …"; empty: one may.
std::string WaitsFor(const AgentConfig& config, const std::string& spool_folder);

// `stop`: cancelled by the operator or the coordinator: the arm stops as defined, the recording counts.
Result<RolloutTaskOutput> RunRolloutTask(const AgentConfig& config, const std::string& spool_folder,
                                         const RolloutTaskInput& input, const ProgressFn& progress,
                                         const CancelToken& stop);

}  // namespace rg::robot_agent
