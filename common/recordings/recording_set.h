// A recording set: a folder with manifest.json ("realitygrad.recordings/1"), the robot's URDF and one
// CSV per recording.
#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "common/recordings/csv.h"
#include "common/recordings/recording.h"

namespace rg::model {
class RobotModel;
}

namespace rg::recordings {

// How files are read where their user says more than they do.
struct ReadOptions {
  std::optional<CsvDialect> dialect;       // --csv-dialect
  std::optional<double> time_units_per_s;  // --time-unit; none: seconds, refused where they visibly are not
  // Recordings with gaps stay one, and pieces too short to fit are kept: to write them again, or to show.
  bool keep_whole = false;
};

// For a CSV by itself: every joint of the robot has columns.
CsvOptions CsvOptionsFor(const model::RobotModel& robot, const ReadOptions& read = {});

inline constexpr const char* kSetFormat = "realitygrad.recordings/1";

// What the sensors' data sheet says; what is missing is estimated from the data (noise.h).
struct NoiseSpec {
  std::optional<double> position_stddev;      // rad or m
  std::optional<double> velocity_stddev;      // rad/s or m/s
  std::optional<double> position_resolution;  // rad or m
};

enum class CommandHold { kZeroOrder, kLinear };

struct RecordingSet {
  std::string folder;
  std::string urdf_path;
  std::string urdf_text;
  std::vector<std::string> joints;       // the joints with columns, in model (topological) order
  std::vector<JointInfo> joint_info;     // of `joints`
  std::map<std::string, double> locked;  // as in the manifest; movable joints in neither are locked at 0
  Eigen::Vector3d gravity{0.0, 0.0, -9.81};
  std::optional<double> sample_rate_hz;
  std::optional<double> control_rate_hz;
  CommandHold control_hold = CommandHold::kZeroOrder;
  NoiseSpec noise;
  std::optional<EffortKind> drive;  // what the manifest says; each recording's own choice is in it
  // The drive adds its own gravity compensation to the effort in the file.
  bool effort_excludes_gravity = false;
  bool effort_excludes_gravity_given = false;  // the manifest says so, either way
  // Joints that move as measured, in the order of `joints`: the manifest's, or, where it lists none, those
  // without an effort column in any recording. In each recording too.
  std::vector<std::string> prescribed;
  bool prescribed_listed = false;  // the manifest says which, none perhaps
  // Joints without a drive, as the manifest lists them; nothing: whether an effort of zero throughout means
  // that is for the model to say (services/sysid/joint_roles.h).
  std::optional<std::vector<std::string>> passive;
  // The manifest had no holdout split, and LoadSet chose whole recordings for it.
  bool holdout_was_chosen = false;
  // What was odd but not wrong, one line each: keys of the manifest that nobody knows, what was done to
  // columns, gaps.
  std::vector<std::string> warnings;
  std::vector<Recording> recordings;  // in the manifest's order, joints in the order of `joints`

  std::vector<const Recording*> Fit() const { return Of(Split::kFit); }
  std::vector<const Recording*> Holdout() const { return Of(Split::kHoldout); }
  std::vector<const Recording*> Of(Split split) const;
  // Makes the recordings at these places the split to fit, and all others that are kept aside.
  void KeepForFit(const std::vector<uint32_t>& places);
};

// Reads and checks everything; the error names file, row, column and value. A set without a holdout
// split gets one: every fourth recording of the manifest, or the last if there are two or three. A
// set of one recording has no holdout. Recordings with gaps (time_stamps.h) become several of the same name,
// one behind the other; pieces too short to fit are left out with a warning.
Result<RecordingSet> LoadSet(const std::string& folder, const ReadOptions& read = {});

// A set without a manifest: the URDF, and CSV files whose position columns name the joints. The last third of
// the files, at least one, is kept aside. A single file is cut in time where `split_time_s` says: what comes
// later than that after its first row is kept aside (infinity: its last third); without it, it is refused.
Result<RecordingSet> SetFromFiles(const std::string& urdf_path, const std::vector<std::string>& files,
                                  std::optional<double> split_time_s, const ReadOptions& read = {});

// Marks recordings as holdout by the rule above if none is; true if it did.
bool ChooseHoldout(std::vector<Recording>& recordings);

// Sets of one robot as one: same joints, URDF, locked joints, gravity and meaning of effort, else an error
// that names what differs. Of noise and resolution the larger counts; what one of them does not say is
// estimated. Recordings are renamed <set's folder or number>_<name> where two have one name; splits stay as
// they are.
Result<RecordingSet> MergeSets(std::vector<RecordingSet> sets);

// LoadSet of one folder, or of several as one set.
Result<RecordingSet> LoadSets(const std::vector<std::string>& folders, const ReadOptions& read = {});

// Writes manifest.json, the URDF text as robot.urdf, and every recording, into `folder`. Pieces of one
// recording (neighbours of the same name) become one file again.
Status WriteSet(const std::string& folder, const RecordingSet& set);
// The text of manifest.json for a set whose URDF lies in the folder as `robot_file`.
std::string FormatManifest(const RecordingSet& set, const std::string& robot_file);

}  // namespace rg::recordings
