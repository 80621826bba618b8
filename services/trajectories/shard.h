// Shards: trajectories by the dozen, reproducible on any host.
//
// A shard is a range of slots of a seed. Slot i draws start and goal from its own random stream
// (seed, i, draw), runs the MPC in closed loop on its own model for `duration_s` and is kept when
//   every solve was usable, max |goal − q(T)| ≤ goal_tolerance, |u| ≤ torque limit exactly, and q, v inside
//   the limits exactly at every knot;
// otherwise the reason is counted and the slot draws again. So slot i is the same trajectory whoever
// makes it and however slots are split over workers (bit for bit on one instruction set, to rounding
// across), and failures are never stored as good.
#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/progress.h"
#include "common/base/status.h"
#include "common/sim/plant.h"
#include "services/trajectories/mpc_controller.h"
#include "services/trajectories/sampling.h"

namespace rg::trajectories {

struct ShardSpec {
  uint64_t seed = 0;
  uint64_t first = 0;       // slot
  uint32_t count = 0;       // slots
  double duration_s = 1.0;  // T, whole control intervals; 1 s is the paper's
  MpcOptions mpc;
  SamplingOptions sampling;
  // On max_i |q_i(T) − goal_i| [rad or m]. Reaching 0.6·v_max·T takes 0.6 T at full speed; in the rest the
  // default bandwidth settles to a few thousandths of a radian at T = 1 s and a few ten-thousandths at 2 s.
  double goal_tolerance = 0.02;
  int max_draws = 100;  // per slot
};

// Why a draw was thrown away. Numbers are frozen: they are stored.
enum class Failure : uint8_t {
  kSampling = 0,        // no admissible start and goal
  kInfeasible = 1,      // the torque box cannot hold start or goal, or a joint box cannot be met
  kNonFinite = 2,       // the model left the finite numbers
  kSolver = 3,          // no usable plan
  kGoalNotReached = 4,  // outside the tolerance at T
  kJointBox = 5,        // a position or velocity limit was crossed
  kTorqueBox = 6,       // a torque limit was crossed (never, unless there is a bug)
};
inline constexpr int kFailureKinds = 7;
std::string_view FailureName(Failure failure);

// K samples at k·interval, k = 0 … K−1, of n joints; torque(:, k) acts from sample k to k + 1.
// In a shard q, final_q and goal are as the encoders would say them, which is what a policy will be given.
struct Trajectory {
  uint64_t slot = 0;
  uint32_t draw = 0;                 // draws before this one failed
  Eigen::VectorXd goal;              // n
  Eigen::MatrixXd q, v, torque;      // n × K
  Eigen::VectorXd final_q, final_v;  // n, at T
  double goal_error = 0.0;           // max |final_q − goal|
  uint32_t iterations = 0;           // of all solves

  int num_samples() const { return static_cast<int>(q.cols()); }
};

struct Shard {
  uint64_t seed = 0;
  uint64_t first = 0;
  uint32_t count = 0;
  double interval_s = 0.04;
  std::vector<std::string> joints;
  std::vector<Trajectory> trajectories;  // by slot
  std::vector<uint64_t> unfilled;        // slots whose max_draws all failed
  std::array<uint64_t, kFailureKinds> failures{};

  uint64_t num_failures() const;
  int num_samples() const;
  // "goal_not_reached 3, joint_box 1"; "none"
  std::string FailureSummary() const;
};

// From true positions to measured ones. offset: n, measured minus true.
void AsMeasured(const Eigen::VectorXd& encoder_offset, Trajectory* trajectory);

// One closed loop from a given start, in true positions; `failure` says why it is not good.
struct Attempt {
  bool good = false;
  Failure failure = Failure::kSolver;
  std::string message;
  Trajectory trajectory;
};
Attempt RunRecedingHorizon(MpcController& controller, const StartGoal& draw, int intervals,
                           double goal_tolerance);

// values: plant.parameters().size(). Progress in slots, stage "trajectories". Errors: invalid (options,
// named), cancelled, failed_precondition when the first slots tried find no trajectory at all.
Result<Shard> GenerateShard(const sim::Plant& plant, const Eigen::VectorXd& values, const ShardSpec& spec,
                            const ProgressFn& progress = {}, const CancelToken* cancel = nullptr);

// Little-endian, versioned, with a SHA-256 over everything before it.
std::string SerializeShard(const Shard& shard);
// Refuses other formats, newer versions, truncated or altered bytes and impossible sizes; `source` names
// the bytes in errors.
Result<Shard> ParseShard(std::string_view bytes, const std::string& source);

}  // namespace rg::trajectories
