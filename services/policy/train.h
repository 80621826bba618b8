// Regression of a policy on a dataset: mean squared error, Adam, He start, mini-batches.
//
// Deterministic: same dataset, options and instruction set, same bits. One thread. Inputs and outputs
// are normalised to mean 0 and variance 1 over the training points, so the units of the data change
// nothing.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "common/base/progress.h"
#include "common/base/status.h"
#include "services/policy/dataset.h"
#include "services/policy/kernels.h"
#include "services/policy/policy.h"

namespace rg::policy {

enum class Schedule {
  kConstant,
  kCosine,  // from learning_rate to final_rate_share of it along half a cosine over the epochs
};

// Defaults are the paper's where it says so (layers, ReLU, He, Adam, mean squared error, 100 epochs).
struct TrainOptions {
  std::vector<int> hidden = {128, 128};  // each 1 … kMaxHidden
  int epochs = 100;                      // ≥ 1
  int batch = 32;                        // ≥ 1
  double learning_rate = 1e-3;           // > 0
  Schedule schedule = Schedule::kCosine;
  double final_rate_share = 0.02;     // of learning_rate, in (0, 1]
  double beta1 = 0.9, beta2 = 0.999;  // in [0, 1)
  double epsilon = 1e-8;              // > 0
  double weight_decay = 0.0;          // ≥ 0, decoupled (Loshchilov & Hutter 2019)
  double validation_fraction = 0.1;   // of the trajectories, in [0, 1)
  bool keep_best = false;             // the weights of the best validation loss, not the last
  std::vector<int> periodic_inputs;   // inputs that are angles of continuous joints, see policy.h
  std::vector<std::string> joints;    // names kept in the policy; may be empty
  uint64_t seed = 1;
  const Kernels* kernels = nullptr;  // null: the best this processor has
};

enum class Termination {
  kCompleted,
  kCancelled,  // the policy is what had been reached
  kDiverged,   // the loss was not finite in epoch `diverged_epoch`; the policy is of the epoch before
};

struct TrainResult {
  Policy policy;  // carries the learning curve in its record
  Termination termination = Termination::kCompleted;
  int diverged_epoch = -1;
  double train_loss = 0.0;       // of the policy returned, over all training points, normalised units
  double validation_loss = 0.0;  // the same over the validation points; NaN if there are none
  // Root mean square error per output in the data's units, training points then validation points.
  std::vector<double> train_rms, validation_rms;
  std::string Message() const;  // one line
};

// Error: options out of range, an empty or non-finite dataset. Progress counts epochs.
Result<TrainResult> Train(const Dataset& dataset, const TrainOptions& options,
                          const ProgressFn& progress = {}, const CancelToken* cancel = nullptr);

// The inputs of (q, q̇, q_goal) that are angles of continuous joints: q and q_goal of each.
std::vector<int> PeriodicInputs(const std::vector<bool>& joint_is_continuous);

// Which points go to validation: whole trajectories, chosen by seed; none if the fraction is 0 or
// there is only one trajectory. Indices of points, ascending in each part.
struct DataSplit {
  std::vector<int> train, validation;
};
DataSplit SplitByTrajectory(const std::vector<uint64_t>& trajectory, double validation_fraction,
                            uint64_t seed);

}  // namespace rg::policy
