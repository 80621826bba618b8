// What a URDF says of kinematics, inertia, limits, dynamics, mimic or safety and nobody reads. Internal
// to the loader.
#pragma once

#include <tinyxml.h>

#include <string>
#include <vector>

namespace rg::model {

// One line for each unknown attribute, element or text inside <robot>, <link>, <joint> and the elements
// that the loader reads, each line once, in the order of the document:
//   "arm.urdf: joint 'elbow': <dynamics stiction> is not read"
// Silent: visual, collision, material, transmission, gazebo, ros2_control, sensor and what is inside
// them; comments; name spaces' declarations; axis, and limits and dynamics that are all 0, of a fixed
// joint.
std::vector<std::string> UrdfLeftovers(const TiXmlElement& robot, const std::string& source_name);

}  // namespace rg::model
