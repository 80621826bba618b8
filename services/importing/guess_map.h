// A mapping guessed from what a log holds, with the reasons, and with the questions that a guess leaves
// open: where there is one, an import without a mapping is refused.
//
// Taken: positions, velocities and efforts of JointState topics whose names are the robot's joints (or end
// in them); efforts of topics that are commands by their name as effort_command; kinova_msgs; CSV columns
// that hold a joint's name and a kind. Never guessed: degrees, the order of unnamed lists.
#pragma once

#include <string>
#include <vector>

#include "common/base/status.h"
#include "services/importing/columns.h"
#include "services/importing/import_map.h"
#include "services/importing/inventory.h"

namespace rg::importing {

struct GuessedMap {
  ImportMap map;
  std::vector<std::string> reasons;    // what was taken and why, and what was not
  std::vector<std::string> questions;  // what only the user knows
};

// Error: no joint of the robot is found; positions are commanded and no effort is there (such drives are
// not modelled yet); no effort at all.
Result<GuessedMap> GuessMap(const Inventory& log, const std::string& log_name,
                            const std::vector<RobotJoint>& robot);

// `rows`: the first rows' text behind the header, from which the time's unit is seen.
Result<GuessedMap> GuessCsvMap(const std::vector<std::string>& header, const std::vector<double>& first_times,
                               const std::string& csv_name, const std::vector<RobotJoint>& robot);

// The header's column that holds the time by its name ("__time", "time", "t", "timestamp", "stamp"…); its
// size if there is none.
size_t FindTimeColumn(const std::vector<std::string>& header);

// "s", "ms", "us" or "ns", as the first times look; "" where they look like no clock at all.
std::string TimeUnitOf(const std::string& column, const std::vector<double>& first_times);

}  // namespace rg::importing
