// The recordings of one diagnosis, made ready: motions, windows and nodes, noise.
#pragma once

#include <algorithm>
#include <cstdint>
#include <memory>
#include <vector>

#include "common/recordings/noise.h"
#include "services/diagnosis/data/motion.h"
#include "services/sysid/initial_regression.h"

namespace rg::diagnosis {

// What all fits of one diagnosis share.
struct FitData {
  int n = 0;
  bool use_velocity = true;
  recordings::SensorNoise noise;  // of one row, quantisation included
  std::vector<sysid::FitRecording> recordings;
  std::vector<uint32_t> places;  // indices of the recordings in their set
  std::vector<SmoothMotion> motions;
  std::vector<FineMotion> fine;
  std::vector<NodeWindow> windows;
  NodeOptions nodes;
  std::shared_ptr<const FitData> held_out;  // held-out recordings; null: none
  std::vector<int> prescribed;              // joints that move as measured: they have no residuals
  int judged() const { return n - static_cast<int>(prescribed.size()); }
  bool Judged(int joint) const { return std::ranges::find(prescribed, joint) == prescribed.end(); }
  // The other of two judged joints; -1 where there are not two, or the joint is none of them.
  int OtherOfTwo(int joint) const {
    for (int j = 0; judged() == 2 && joint >= 0 && Judged(joint) && j < n; ++j) {
      if (j != joint && Judged(j)) return j;
    }
    return -1;
  }
  // Noise of the residual rows: infinite for prescribed joints.
  recordings::SensorNoise RowNoise() const;
  int Rows() const;        // residual rows of all windows, of judged joints
  double Seconds() const;  // of motion in all windows
  // About how many windows hold as much motion as `count` whole ones: those between gaps of rows are short.
  size_t WindowsFor(size_t count) const;
  // The same with the windows at these places alone.
  FitData OnWindows(const std::vector<uint32_t>& places) const;
};

}  // namespace rg::diagnosis
