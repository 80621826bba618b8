// What users ask for, compiled to graphs of tasks. Pure: options in, JobSpec out.
//
// A stage's tasks read earlier stages by name, so that a graph needs no hash but those of the
// artefacts it starts from. Kinds and payloads: payloads.proto, task_kinds.h.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "realitygrad/v1/job.pb.h"
#include "realitygrad/v1/payloads.pb.h"

namespace rg::jobs {

struct TrajectoriesOptions {
  int count = 450;      // PAPER.md: K
  int shard_size = 15;  // trajectories per task
  double duration_s = 1.0;
  double reach = 0.6;   // |Δq| <= reach · v_max · duration
  double spread = 0.6;  // rad round the home pose; 0: the whole range
};

// Epochs of an iteration's policies before the last, as a share of TrainOptions::epochs: they only drive.
inline constexpr double kDriverEpochs = 0.4;
// Pairs of a round of aggregation, as a share of the trajectories, and how much longer than these each holds its goal.
inline constexpr double kAggregatedPairs = 0.75, kHeldShare = 0.5;
// Rounds more than TrainOptions::aggregations for a policy that does not pass its examination.
inline constexpr int kFurtherAggregations = 2;

struct TrainOptions {
  int epochs = 100;
  int batch = 32;
  double learning_rate = 1e-3;
  std::vector<int> hidden = {128, 128};
  // Rounds in which the policy drives, the expert answers, and both together train the next one
  // (services/trajectories/aggregation.h); an iteration's only.
  int aggregations = 2;
  int examination_pairs = 60;  // start/goal pairs of the closed-loop examination; 0: none
};

// Short and slow first: the share of reach, speed and distance that iteration i is given,
// min(1, first · growth^(i − 1)).
struct CurriculumOptions {
  bool on = false;
  double first = 0.4;
  double growth = 1.6;
};
double CurriculumShare(const CurriculumOptions& options, int iteration);

struct RolloutOptions {
  double duration_s = 6.0;
  double rate_hz = 25.0;
  std::vector<double> goal_q;         // empty: drawn
  std::vector<double> goal_position;  // task space
  double reach_s = 1.0;               // a drawn goal lies within 0.6 · v_max · reach_s of the start
  std::string controller = "policy";  // "mpc"; "trajectory": IterationInputs::motion, a rollout's only
  // Torques on top of the controller's, as a share of each joint's limit; negative: as the agent is configured.
  double excitation = -1.0;
  // How often a rollout that the safety monitor ended is made again, each time at half the speed, 0 to 10. To ask for
  // it is the consent that an arm needs to move again.
  int slower_attempts = 0;
  // A rollout that did not end as asked is taken as one that did: its job does not fail, and parameters identified
  // from it become current.
  bool accept_partial = false;
};

// What `run` adds to the first rollouts of a loop, and with a diagnosis to all while rollouts tell too little of a joint.
inline constexpr double kLoopExcitation = 0.15;
inline constexpr int kExcitedRollouts = 2;
inline constexpr int kSlowerAttempts = 3;  // RolloutOptions::slower_attempts of `run`
inline constexpr int kMostSlowerAttempts = 10;

struct IdentifyOptions {
  int chains = 2;
  int rounds = 3;        // chains exchange their best between rounds
  double budget_s = 30;  // at most, wall time of one chain over all rounds; 0: hops decides
  int hops = 0;          // of one chain over all rounds
  bool whole_recording = true;
  double window_s = 0.0;  // 0: 0.2 s for the single window (PAPER.md), else IdentifyProblemOptions' own
  double window_start_s = 0.0;
  std::string solver = "lm";        // "lm" or "lbfgs"
  std::string bounds = "physical";  // "physical", "paper" or "none"; lbfgs knows none
  std::string parametrisation = "log-cholesky";  // of a link's inertial parameters, or "raw"
  bool friction = true;  // beyond the paper's: Coulomb friction and rotor inertia of every joint
  double alpha = 1e-6;   // of the order of the squared residual that is left, rad²
};

// Whether each rollout is diagnosed, and the model of the next iteration is what that found, identified
// further. Identification alone goes on beside it, for comparison.
struct LoopDiagnosisOptions {
  bool on = false;
  double work_limit = 30.0;  // about seconds on one thread (diagnosis::DiagnosisOptions), the same on any machine
  double window_s = 1.0;
  int threads = 0;  // 0: all cores of the worker
};

struct IterationOptions {
  uint64_t seed = 1;
  std::string robot = "mico2";
  std::vector<double> home;         // candle pose; empty: zero
  std::vector<double> peak_torque;  // N·m; empty: the model's effort limits
  int iteration = 1;
  TrajectoriesOptions trajectories;
  TrainOptions train;
  RolloutOptions rollout;
  IdentifyOptions identify;
  CurriculumOptions curriculum;
  LoopDiagnosisOptions diagnosis;
};

// Every option inside its range; the line names option, value and limit.
Status Validate(const IterationOptions& options);

// Artefacts that a graph starts from, by hash.
struct IterationInputs {
  std::string model;                // always
  std::string policy;               // rollout only
  std::string motion;               // rollout with controller "trajectory" only
  std::string recording;            // identify only
  std::vector<std::string> shards;  // train only
  // With a diagnosis only: the model without effects, the models that identification alone (empty: `model`) and the
  // last diagnosis (empty: none) have come to, and the recordings of the iterations before, oldest first.
  std::string nominal, identified, diagnosed;
  std::vector<std::string> earlier;
};

realitygrad::v1::JobSpec CompileIteration(const IterationOptions& options, const IterationInputs& inputs);
realitygrad::v1::JobSpec CompileTrajectories(const IterationOptions& options, const IterationInputs& inputs);
realitygrad::v1::JobSpec CompileTrain(const IterationOptions& options, const IterationInputs& inputs);
realitygrad::v1::JobSpec CompileRollout(const IterationOptions& options, const IterationInputs& inputs);
realitygrad::v1::JobSpec CompileIdentify(const IterationOptions& options, const IterationInputs& inputs);

struct DiagnoseOptions {
  double window_s = 1.0;
  uint64_t seed = 1;
  int threads = 0;  // 0: all cores of the worker
  bool trust_effort = false;  // go on where the sign or the unit of an effort looks wrong
};
// set: artefact of kind "recording-set"; model: of the model to start from, empty: the set's URDF.
realitygrad::v1::JobSpec CompileDiagnose(const DiagnoseOptions& options, const std::string& set,
                                         const std::string& model = {});

// The stage names of an iteration in order, as people see them; the last three with a diagnosis only.
const std::vector<std::string>& IterationStages();

}  // namespace rg::jobs
