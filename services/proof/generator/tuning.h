// A URDF whose parameters were tuned on recordings by somebody who did not know of the concealed effect:
// least squares over the torque that rigid bodies and damping leave unexplained, so that they absorb of it
// what they can.
#pragma once

#include <Eigen/Core>
#include <dart/dynamics/Skeleton.hpp>
#include <map>
#include <string>
#include <vector>

#include "services/proof/generator/truth.h"

namespace rg::proof {

enum class TunedPart { kDamping, kBodies };

// Which of the two can hide this effect best: friction goes into damping, torque into bodies.
TunedPart PartThatHides(const std::string& effect);

struct Motion {  // of n joints at K times
  Eigen::MatrixXd q, v, a, u;
};

struct Tuning {
  std::vector<double> damping;              // of each joint, what the URDF then declares
  std::map<std::string, LinkChange> links;  // against the true robot's nominal
};

// Of each link a factor of its mass, one of its inertia and a shift of its centre of mass; priors of 25 % and
// of 3 cm.
constexpr int kPerLink = 5;
Eigen::VectorXd LinkPriors(size_t links);
LinkChange ChangeOf(const Eigen::VectorXd& theta, size_t link);

// A link changed twice.
LinkChange Changed(const LinkChange& first, const LinkChange& then);

// Of `links`, of which link i hangs on joint i of `joints`: that of the first joint of `on` (of none: the
// last) and its neighbours.
std::vector<std::string> LinksBeside(const std::vector<std::string>& on,
                                     const std::vector<std::string>& joints,
                                     const std::vector<std::string>& links);

// Bodies: of the named links; damping: of every joint, never negative.
Tuning Tune(const dart::dynamics::SkeletonPtr& nominal, const std::vector<std::string>& joints,
            const std::vector<std::string>& links, const Motion& motion, TunedPart part);

// The URDF text with what was tuned in it.
std::string WithTuning(const std::string& urdf, const dart::dynamics::SkeletonPtr& nominal,
                       const std::vector<std::string>& joints, const Tuning& tuning);

}  // namespace rg::proof
