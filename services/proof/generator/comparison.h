// How far models are off on a recording: predictions over windows of 1 s, each restarted, against the
// noise-free truth.
#pragma once

#include <Eigen/Core>
#include <dart/dynamics/Skeleton.hpp>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "services/proof/generator/engine.h"
#include "services/proof/generator/set_files.h"
#include "services/proof/generator/truth.h"

namespace rg::proof {

enum class Start {
  kRow,        // from the recorded row, at rest in hidden states
  kRowHidden,  // from the recorded row, with the true hidden states
  kTrue        // from the true state
};

constexpr double kBeside = 1e-4;  // rad, m, rad/s or m/s

struct Rival {
  dart::dynamics::SkeletonPtr bodies;
  Truth truth;
  Start start = Start::kRowHidden;
  int beside = -1;  // of positions, then speeds, the one that it begins beside, by kBeside
};

// Mean squares over the joints at each row but those that windows start at; a row is capped at 1e6.
struct WindowSquares {
  std::vector<double> oracle;  // the true model's, from the recorded rows
  std::vector<std::vector<double>> rivals;
};

class Comparison {
 public:
  Comparison(dart::dynamics::SkeletonPtr bodies, std::vector<std::string> joints, double dt, double rate_hz)
      : bodies_(std::move(bodies)), joints_(std::move(joints)), dt_(dt), rate_hz_(rate_hz) {}

  const dart::dynamics::SkeletonPtr& bodies() const { return bodies_; }  // of the robot without its effects
  double rate_hz() const { return rate_hz_; }

  // Adds the squares over one recording, which has regular rows.
  void Add(const Truth& truth, const Track& track, const std::vector<Rival>& rivals,
           WindowSquares* squares) const;

  // Of each rival's predictions from the truth, rad or m; one row per rival, one column per joint and row.
  Eigen::MatrixXd Deviations(const Truth& truth, const Track& track, const std::vector<Rival>& rivals) const;

 private:
  using Engines = std::vector<std::unique_ptr<Engine>>;
  int LastRow(const Track& track) const;  // at which the last whole window ends
  // Runs the true model from the recorded rows (first) and the rivals; visit(engines, k) at each row k but
  // those that windows start at.
  void Run(const Truth& truth, const Track& track, const std::vector<Rival>& rivals,
           const std::function<void(const Engines&, int)>& visit) const;

  dart::dynamics::SkeletonPtr bodies_;
  std::vector<std::string> joints_;
  double dt_, rate_hz_;
};

double Rms(const std::vector<double>& squares);

}  // namespace rg::proof
