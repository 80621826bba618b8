// Which joints of a recording set are not ordinary driven ones: prescribed (recordings/prescribed.h) and
// passive, without a drive.
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "common/recordings/recording_set.h"
#include "common/sim/plant.h"

namespace rg::sysid {

// Share of the work |tau·v| along a motion that the torque `tau` does on the joint, against what the motion
// does on it. A joint without a drive can only lose energy: of its needed torque next to nothing does work.
double WorkPutIn(const Eigen::VectorXd& tau, const Eigen::VectorXd& v);
inline constexpr double kDriven = 0.3;  // share from which a joint was driven

// Whether the effort that drives the model is zero throughout all recordings; n.
std::vector<char> ZeroEfforts(const recordings::RecordingSet& set);

// The manifest's, or those whose effort is zero throughout while they move and whose motion the rigid bodies
// of `nominal` (of the set, no joint passive) explain without a drive. In the order of set.joints.
std::vector<std::string> PassiveJoints(const recordings::RecordingSet& set, const sim::Plant& nominal);

// What a reader should know of the joints' roles: which are prescribed or passive, and why.
std::vector<std::string> NotesOnRoles(const recordings::RecordingSet& set, const sim::Plant& nominal);

}  // namespace rg::sysid
