// Recording sets made by the simulator itself, sensors' noise included.
#pragma once

#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include "common/base/rng.h"
#include "common/recordings/recording_set.h"
#include "tests/unit/sysid/simulated_recordings.h"

namespace rg::diagnosis::testing {

inline constexpr double kPositionNoise = 5e-4, kVelocityNoise = 8e-3;

struct Sampling {
  double rate_hz = 100.0;
  double finer = 1.0;       // by which the sensors' noise is divided
  double resolution = 0.0;  // of positions; 0: as fine as they come
  double step_s = 1e-3;     // of the simulator
};

// Three fitted recordings and a held-out one of `robot` with the effects concealed.
inline recordings::RecordingSet MakeSet(const std::string& robot, std::vector<effects::EffectSpec> effects,
                                        uint64_t seed, double duration_s = 4.0,
                                        const Sampling& sampling = {}) {
  const sim::Plant truth = sysid::testing::LoadPlant(robot, std::move(effects));
  recordings::RecordingSet set;
  set.folder = ".";
  set.urdf_path = sysid::testing::RobotPath(robot);
  std::ifstream file(set.urdf_path);
  std::stringstream text;
  text << file.rdbuf();
  set.urdf_text = text.str();
  set.joints = truth.joint_names();
  set.noise.position_stddev = kPositionNoise / sampling.finer;
  set.noise.velocity_stddev = kVelocityNoise / sampling.finer;
  if (sampling.resolution > 0) set.noise.position_resolution = sampling.resolution;
  for (int k = 0; k < 4; ++k) {
    sysid::testing::MakeOptions options;
    options.duration_s = duration_s;
    options.rate_hz = sampling.rate_hz;
    options.step_s = sampling.step_s;
    options.position_noise = *set.noise.position_stddev;
    options.velocity_noise = *set.noise.velocity_stddev;
    options.amplitude = 1.2;
    recordings::Recording rec = sysid::testing::MakeRecording(truth, truth.parameters().Nominal(),
                                                              seed * 10 + static_cast<uint64_t>(k), options);
    if (sampling.resolution > 0)
      rec.q = ((rec.q / sampling.resolution).array().round() * sampling.resolution).matrix().eval();
    rec.name = "rec_00" + std::to_string(k) + ".csv";
    rec.split = k == 3 ? recordings::Split::kHoldout : recordings::Split::kFit;
    rec.joints = set.joints;
    set.recordings.push_back(std::move(rec));
  }
  return set;
}

// Makes commanded efforts measured ones: averages between rows, with a noise of their own that is correlated
// over 50 ms. effort_noise: of each effort's RMS.
inline void MeasureEffort(uint64_t seed, double effort_noise, recordings::RecordingSet* set) {
  constexpr double kCorrelation = 0.05;  // s
  Rng rng(seed);
  for (recordings::Recording& rec : set->recordings) {
    Eigen::MatrixXd u = rec.effort_command;
    for (int k = 1; k < rec.rows(); ++k)
      u.col(k) = 0.5 * (rec.effort_command.col(k - 1) + rec.effort_command.col(k));
    for (int j = 0; j < rec.n(); ++j) {
      const double size = effort_noise * std::sqrt(u.row(j).squaredNorm() / rec.rows());
      const double keep = std::exp(-rec.SamplePeriod() / kCorrelation);
      double state = 0;
      for (int k = 0; k < rec.rows(); ++k) {
        state = keep * state + std::sqrt(1 - keep * keep) * size * rng.Normal();
        u(j, k) += state;
      }
    }
    rec.effort_measured = u;
    rec.effort_command.resize(0, 0);
    rec.drive = recordings::EffortKind::kMeasured;
  }
}

}  // namespace rg::diagnosis::testing
