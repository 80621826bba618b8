// A trained policy: from a state and a goal to torques.
//
//   f = encode(x);  y = output_mean + output_scale ∘ network((f − input_mean) ∘ input_scale⁻¹)
//
// x is in the units of the data it was trained on (SI); the normalisation is part of the policy. For
// the policy of the paper x = (q, q̇, q_goal), 3n × 1, and y the n torques [N·m or N]. The encoding
// replaces periodic inputs, angles of continuous joints, by sine and cosine, so that one turn more
// changes nothing. A feature or output that was constant in training stays at its mean.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.h"
#include "services/policy/network.h"

namespace rg::policy {

inline constexpr int kMaxInputs = 512;
inline constexpr int kMaxOutputs = 512;
inline constexpr int kMaxHidden = 2048;  // per layer

struct EpochLoss {
  double train = 0.0;       // mean square error over the epoch's batches, normalised units
  double validation = 0.0;  // after the epoch, on trajectories that are not trained on; NaN if there are none
};

// How a policy came to be.
struct TrainingRecord {
  uint64_t seed = 0;
  int epochs = 0;  // run, not planned
  int points = 0;  // trained on
  int validation_points = 0;
  std::vector<EpochLoss> curve;  // one per epoch run
};

// Turns inputs into features; see the top of this file.
struct InputEncoding {
  int inputs = 0;
  std::vector<int> periodic;  // indices of inputs, ascending
  int features() const { return inputs + static_cast<int>(periodic.size()); }
  // x: inputs, f: features().
  void Encode(const double* x, double* f) const;
};

// NaN is an outcome: where it came in, or where it came out.
struct EvaluateOutcome {
  enum class Kind { kOk, kBadInput, kBadOutput };
  Kind kind = Kind::kOk;
  int index = -1;  // of the first value that is not finite
  bool ok() const { return kind == Kind::kOk; }
  std::string ToString() const;  // "policy input 3 is not finite"
};

class Policy {
 public:
  struct Parts {
    std::vector<std::string> joints;  // may be empty: names were not given
    InputEncoding encoding;
    // Features and outputs; a scale of 0 marks a constant.
    std::vector<double> input_mean, input_scale, output_mean, output_scale;
    Network network{{1, 1}};
    TrainingRecord record;
  };
  // The parts fit together (checked).
  explicit Policy(Parts parts);

  int input_size() const { return parts_.encoding.inputs; }
  int output_size() const { return parts_.network.sizes().back(); }
  const std::vector<std::string>& joints() const { return parts_.joints; }
  const Parts& parts() const { return parts_; }
  const TrainingRecord& record() const { return parts_.record; }

  // Allocates nothing; thread-safe. in: input_size, out: output_size. When the input is not finite,
  // `out` is left as it was.
  EvaluateOutcome Evaluate(std::span<const double> in, std::span<double> out) const;

 private:
  Parts parts_;
};

// "realitygrad.policy/1": little-endian, weights as float32, SHA-256 at the end. Parsing refuses what is
// truncated, changed, of another version, too large or not finite.
std::string SerializePolicy(const Policy& policy);
Result<Policy> ParsePolicy(std::string_view bytes, const std::string& source_name);

}  // namespace rg::policy
