// How a recording set looks on disk: which recordings it has, how regular its rows are, what its manifest
// says and leaves out.
#pragma once

#include <Eigen/Core>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "common/base/rng.h"

namespace rg::proof {

struct Noise {
  double position = 0, velocity = 0, resolution = 0;
};

struct Track {
  Eigen::VectorXd t;                        // K
  Eigen::MatrixXd q, v, u, true_q, true_v;  // n × K
  bool ok = true;
};

enum class Rows { kRegular, kJittered, kMissing };

struct SetStyle {
  Rows rows = Rows::kRegular;  // of the set's own recordings; concealed ones are regular
  int rows_per_command = 1;    // the controller may be slower than the recorder
  bool with_velocity = true;
  bool says_position_noise = true, says_velocity_noise = true, says_resolution = true;
  bool says_gravity = true, says_rate = true, says_control = true, says_splits = true;
};

// A tenth with irregular rows, a tenth with a slower controller, two fifths with gaps in the manifest.
SetStyle DrawStyle(double rate_hz, bool with_velocity, Rng rng);

struct PlannedRecording {
  std::string split, kind;  // "fit", "holdout" or "hidden"; a kind of references.h
  double duration_s = 7;
};
// Five recordings to fit, two held out, two concealed; every third set has other numbers and kinds.
std::vector<PlannedRecording> DrawPlan(Rng rng);

struct RowPlan {
  std::vector<double> time;
  std::vector<bool> commands, written;  // a new command is computed; the row is in the file
};
// Rows of a recording on a grid of `tick` seconds. What is not written carries no new command, so that
// every row's command holds until the next row.
RowPlan PlanRows(const SetStyle& style, bool regular, double duration_s, double rate_hz, double tick,
                 Rng rng);

// RECORDINGS' columns; `concealed` adds true_position and true_velocity.
std::string Csv(const Track& track, const std::vector<std::string>& joints, bool with_velocity,
                bool concealed);
nlohmann::json Manifest(const SetStyle& style, const std::vector<std::string>& joints,
                        const std::vector<PlannedRecording>& plan, const Noise& noise, double rate_hz);

}  // namespace rg::proof
