// What to record so that two effects can be told apart which the recordings at hand cannot: in words, beside
// the motion that separating_motion.h proposes.
#pragma once

#include <string>
#include <vector>

namespace rg::diagnosis {

// Of effects `a` and `b` on the joints; none: on the robot as a whole.
std::string ExperimentFor(const std::string& a, const std::string& b, const std::vector<std::string>& joints);

// Of a robot whose readings are all old by the time that its commands could be late by.
inline constexpr const char* kClockExperiment =
    "no motion can: command and reading stamped by one clock, or a step of the command whose effect another "
    "sensor sees at once";

// Of a robot whose masses and efforts are known up to one factor.
inline constexpr const char* kScaleExperiment =
    "no motion can: a known mass in the hand, or a force gauge against the tool";

}  // namespace rg::diagnosis
