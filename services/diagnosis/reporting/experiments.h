// Experiments that separate two effects, in words; separating_motion.h designs the motion itself.
#pragma once

#include <string>
#include <vector>

namespace rg::diagnosis {

// For effects `a` and `b` on the joints; no joints: on the robot as a whole.
std::string ExperimentFor(const std::string& a, const std::string& b, const std::vector<std::string>& joints);

// For equal delays of all sensors and of all drives.
inline constexpr const char* kClockExperiment =
    "no motion can: command and reading stamped by one clock, or a step of the command whose effect another "
    "sensor sees at once";

// For masses and efforts known up to one factor.
inline constexpr const char* kScaleExperiment =
    "no motion can: a known mass in the hand, or a force gauge against the tool";

}  // namespace rg::diagnosis
