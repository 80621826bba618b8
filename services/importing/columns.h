// A mapping made definite for one log: each column that is taken, by its path in its topic.
#pragma once

#include <string>
#include <vector>

#include "common/base/status.h"
#include "services/importing/import_map.h"
#include "services/importing/inventory.h"

namespace rg::importing {

// A joint of the robot, as far as an import cares.
struct RobotJoint {
  std::string name;
  bool prismatic = false;
  bool continuous = false;
};

struct WantedColumn {
  size_t entry = 0;   // of the mapping
  std::string topic;  // empty in a CSV
  std::string field;  // a path, or a CSV's column
  std::string joint;  // empty: of no joint
  std::string kind;   // "position"
  std::string clock;  // "header", "log" or a path; empty in a CSV
  std::string unit;   // for people
  double factor = 1.0, offset = 0.0;
  Hold hold = Hold::kLinear;
  bool wraps = false;  // an angle of a continuous joint: between neighbours the short way round is meant

  // "position.elbow"
  std::string Name() const { return joint.empty() ? kind : kind + "." + joint; }
  bool IsRequired() const;  // of the kinds whose values must all be there
};

// Errors name the entry of the mapping: a topic or joint that is not there, a unit that is none of the
// column's, a column twice.
Result<std::vector<WantedColumn>> ResolveColumns(const ImportMap& map, const std::string& map_name,
                                                 const Inventory& log, const std::string& log_name,
                                                 const std::vector<RobotJoint>& robot);
// The same for a CSV with these columns.
Result<std::vector<WantedColumn>> ResolveCsvColumns(const ImportMap& map, const std::string& map_name,
                                                    const std::vector<std::string>& header,
                                                    const std::string& csv_name,
                                                    const std::vector<RobotJoint>& robot);

// The names with commas between them.
std::string Joined(const std::vector<std::string>& names);

}  // namespace rg::importing
