// Survey of a recording set, in about a second: figures of each recording and joint, and the motion at some
// thousand instants with the torques that the URDF needs there. Notes, refusals and what such data can show
// are derived from it.
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "common/recordings/noise.h"
#include "common/recordings/recording_set.h"
#include "common/sim/plant.h"
#include "services/diagnosis/data/motion.h"

namespace rg::diagnosis {

// Of one file: the pieces between its gaps together.
struct FileFigures {
  std::string name;
  recordings::Split split = recordings::Split::kFit;
  int rows = 0;
  double start = 0, duration = 0, period = 0;   // s; period: median between the rows of its longest piece
  std::vector<std::pair<double, double>> gaps;  // [s], from the last row before to the first after
  double missing = 0;                           // rows that the period would have had, gaps left out
  std::vector<std::string> columns;             // kinds: "position", "effort_command", "temperature"
};

// Positions in rad or m, speeds in rad/s or m/s, efforts in N·m or N. `of all`: of every recording; the rest
// is of those to fit.
struct JointFigures {
  double low = 0, high = 0;       // of all
  double peak_speed = 0;          // of all; measured, or over blocks of rows
  double peak_effort = 0;         // of all
  double effort_rms = 0;          // of all
  bool prescribed = false;        // moves as measured: nothing is judged of it, its effort is 0 here
  bool moved = false;             // by kMovesBy of its noise
  double up = 0, down = 0;        // travel either way, beyond noise
  double speed = 0;               // RMS
  double spread = 0;              // stddev of the positions, the largest of any recording
  double slow = 0, fast = 0;      // speeds that a tenth and nine tenths of its motion stay below
  int slow_rows = 0;              // rows that move at less than kSlow of the usual speed
  double acceleration = 0;        // RMS
  double acceleration_noise = 0;  // stddev of the estimate
  double effort_stddev = 0, effort_least = 0, effort_most = 0;
  double load_mean = 0, load_stddev = 0;             // of |effort| while it moves
  double moving_s = 0;                               // the longest that a recording has of its motion
  double temperature_low = 0, temperature_high = 0;  // where there is a column; else both NaN
};
inline constexpr double kSlow = 0.1;

// Instants of one recording to fit. n × S each.
struct MotionSamples {
  std::vector<double> t;    // S
  MatrixXd q, v, a, u;      // u: the effort in the file, averaged over ±15 ms
  MatrixXd rigid, gravity;  // the URDF's torques for the motion; gravity's part of them
  MatrixXd needed;          // what of `rigid` the effort must bring, by the manifest
};

struct MotionSurvey {
  int n = 0;
  recordings::SensorNoise noise;      // that fits and judgements go by
  recordings::SensorNoise estimated;  // from the data, whatever the manifest says
  VectorXd speed_noise;               // n, of v in the samples
  std::vector<FileFigures> files;     // the set's order
  std::vector<JointFigures> joints;
  std::vector<MotionSamples> samples;  // of the recordings to fit
  VectorXd velocity_lag;               // n, s, of the first recording to fit; 0 where none shows

  long Samples() const;
  // A joint's row of one matrix of all samples, one recording behind the other.
  VectorXd Along(MatrixXd MotionSamples::*of, int joint) const;
  const FileFigures& FirstToFit() const;
};

// What the manifest says of noise, quantisation added, and what it does not say from `estimated`; floored.
recordings::SensorNoise WorkingNoise(recordings::SensorNoise estimated, const recordings::NoiseSpec& given);

// kInvalid, with one line: no recording to fit, a recording without effort or of fewer than 10 rows.
Result<MotionSurvey> Survey(const recordings::RecordingSet& set, const sim::Plant& plant);

// A joint that moved by no more than its sensor's noise, and is not prescribed.
struct StillJoint {
  int joint = 0;
  double missed = 0, needed = 0;  // RMS: effort less the torque that the URDF needs there, and that torque
  double withstood = 0;           // the largest of what it missed
  bool held = false;              // by something else than its effort
};
std::vector<StillJoint> StillJoints(const MotionSurvey& survey);

}  // namespace rg::diagnosis
