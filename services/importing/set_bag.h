// A recording in a ROS 1 bag, as an export writes it: everything that the set holds of it.
//
//   /joint_states               sensor_msgs/JointState: position, velocity if there, effort_measured if there
//   /joint_command              sensor_msgs/JointState: effort_command, if there
//   /realitygrad/columns        std_msgs/Float64MultiArray: all other columns; the label of its dimension is
//   a
//                               JSON list of their names
//   /realitygrad/manifest       std_msgs/String: manifest.json
//   /realitygrad/urdf           std_msgs/String: robot.urdf
//   /realitygrad/recording      std_msgs/String: {"format", "file", "time_offset_ns"}
//
// Messages of a row share its stamp, in the header and in the bag: the row's time in ns, plus an offset where
// that is not positive (ROS has no such times). A time that is not a multiple of 1 ns has its exact value in
// the column "time" of /realitygrad/columns.
#pragma once

#include <string>
#include <vector>

#include "common/base/progress.h"
#include "common/base/status.h"
#include "common/recordings/recording_set.h"
#include "services/importing/inventory.h"
#include "services/importing/log_file.h"

namespace rg::importing {

inline constexpr char kStateTopic[] = "/joint_states";
inline constexpr char kCommandTopic[] = "/joint_command";
inline constexpr char kColumnsTopic[] = "/realitygrad/columns";
inline constexpr char kManifestTopic[] = "/realitygrad/manifest";
inline constexpr char kUrdfTopic[] = "/realitygrad/urdf";
inline constexpr char kRecordingTopic[] = "/realitygrad/recording";
inline constexpr char kRecordingFormat[] = "realitygrad.bag/1";
inline constexpr char kExactTime[] = "time";

// A time in ns, and back to the double next to it.
int64_t NsOf(double seconds);
double SecondsOf(int64_t ns);

// Whether a log was written by an export.
bool IsSetBag(const Inventory& log);

// The set that the bag is of (settings, URDF, joints) with its one recording.
Result<recordings::RecordingSet> ReadSetBag(const LogFile& file, const Inventory& log,
                                            const ProgressFn& progress);

// Writes one recording of `set` (bag_writer.cc, through librosbag-storage). The file is written beside `path`
// and renamed. Error: times that ROS has no place for, two rows within 1 ns.
Status WriteSetBag(const std::string& path, const recordings::RecordingSet& set,
                   const recordings::Recording& recording, const std::string& manifest_json);

// Every recording of the set as FOLDER/<name>.bag; returns the paths. Error: two recordings of one name.
Result<std::vector<std::string>> WriteSetBags(const std::string& folder, const recordings::RecordingSet& set,
                                              const std::string& manifest_json, const ProgressFn& progress);

}  // namespace rg::importing
