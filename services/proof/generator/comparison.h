// How far models are off on a recording: predictions over windows of 1 s, each restarted, against the
// noise-free truth.
#pragma once

#include <dart/dynamics/Skeleton.hpp>
#include <string>
#include <vector>

#include "services/proof/generator/set_files.h"
#include "services/proof/generator/truth.h"

namespace rg::proof {

enum class Start {
  kRow,        // from the recorded row, at rest in hidden states
  kRowHidden,  // from the recorded row, with the true hidden states
  kTrue        // from the true state
};

struct Rival {
  dart::dynamics::SkeletonPtr bodies;
  Truth truth;
  Start start = Start::kRowHidden;
};

// Mean squares over the joints at each row but those that windows start at; a row is capped at 1e6.
struct WindowSquares {
  std::vector<double> oracle;  // the true model's, from the recorded rows
  std::vector<std::vector<double>> rivals;
};

struct Comparison {
  dart::dynamics::SkeletonPtr bodies;  // of the true robot without its effects
  std::vector<std::string> joints;
  double dt = 2e-4, rate_hz = 100;

  // Adds the squares over one recording, which has regular rows.
  void Add(const Truth& truth, const Track& track, const std::vector<Rival>& rivals,
           WindowSquares* squares) const;
};

double Rms(const std::vector<double>& squares);

}  // namespace rg::proof
