// Recording sets made by the simulator itself, sensors' noise included.
#pragma once

#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include "common/recordings/recording_set.h"
#include "tests/unit/sysid/simulated_recordings.h"

namespace rg::diagnosis::testing {

inline constexpr double kPositionNoise = 5e-4, kVelocityNoise = 8e-3;

struct Sampling {
  double rate_hz = 100.0;
  double finer = 1.0;       // by which the sensors' noise is divided
  double resolution = 0.0;  // of positions; 0: as fine as they come
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

}  // namespace rg::diagnosis::testing
