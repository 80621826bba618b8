// Motions that a controller tracks while a proof case is recorded.
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "common/base/rng.h"

namespace rg::proof {

struct ReferenceLimits {
  Eigen::VectorXd home, amplitude, velocity;  // n: centre, reach to each side, fastest
};

struct Reference {
  Eigen::MatrixXd q, v;  // n × K at the control times
};

// kind: "multisine", "p2p", "ramps", "holds", "chirp", "sequential". Starts and ends slowly.
Reference MakeReference(const std::string& kind, const ReferenceLimits& limits, double duration_s,
                        double rate_hz, Rng rng);

}  // namespace rg::proof
