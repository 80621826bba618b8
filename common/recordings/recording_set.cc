#include "common/recordings/recording_set.h"

#include <algorithm>
#include <filesystem>
#include <set>

#include "common/base/file.h"
#include "common/model/robot_model.h"
#include "common/model/urdf_document.h"
#include "common/model/urdf_loader.h"
#include "common/recordings/manifest.h"

namespace rg::recordings {

static JointInfo InfoOf(const model::Joint& joint) {
  JointInfo info;
  info.name = joint.name;
  info.type = joint.type == model::JointType::kPrismatic    ? JointInfo::Type::kPrismatic
              : joint.type == model::JointType::kContinuous ? JointInfo::Type::kContinuous
                                                            : JointInfo::Type::kRevolute;
  info.lower = joint.lower;
  info.upper = joint.upper;
  info.velocity = joint.velocity;
  return info;
}

CsvOptions CsvOptionsFor(const model::RobotModel& robot) {
  CsvOptions options;
  for (const model::Joint& joint : robot.joints()) {
    options.joints.push_back(joint.name);
    options.robot.push_back(InfoOf(joint));
  }
  return options;
}

namespace {

namespace fs = std::filesystem;

constexpr int kHoldoutEvery = 4;

bool Contains(const std::vector<std::string>& names, const std::string& name) {
  return std::find(names.begin(), names.end(), name) != names.end();
}

// The order of the model's joints, and what the CSV reader wants to know of the robot.
struct RobotView {
  std::vector<JointInfo> joints;  // the manifest's, in model order
  std::vector<JointInfo> all;     // and the URDF's other joints, names only
};

Status CheckJointsExist(const Manifest& manifest, const std::string& manifest_path,
                        const std::vector<std::string>& known) {
  const auto error = [&](const std::string& field, const std::string& joint) {
    return InvalidError(manifest_path + ": " + field + ": the robot (" + manifest.robot + ") has no joint '" +
                        joint + "'");
  };
  for (size_t i = 0; i < manifest.joints.size(); ++i) {
    if (!Contains(known, manifest.joints[i]))
      return error("joints[" + std::to_string(i) + "]", manifest.joints[i]);
  }
  for (const auto& [joint, q] : manifest.settings.locked) {
    if (!Contains(known, joint)) return error("locked." + joint, joint);
  }
  return Status::Ok();
}

Result<RobotView> ReadRobot(const Manifest& manifest, const std::string& manifest_path,
                            const std::string& urdf_text) {
  const std::string& path = manifest.settings.urdf_path;
  RG_ASSIGN_OR_RETURN(const model::UrdfDocument document, model::ReadUrdfDocument(urdf_text, path));
  RG_RETURN_IF_ERROR(CheckJointsExist(manifest, manifest_path, document.JointNames()));
  model::LoadOptions options;
  options.joints = manifest.joints;
  options.locked = manifest.settings.locked;
  RG_ASSIGN_OR_RETURN(const model::RobotModel robot, model::ParseUrdf(urdf_text, path, options));
  RobotView view;
  for (const model::Joint& joint : robot.joints()) view.joints.push_back(InfoOf(joint));
  view.all = view.joints;
  // Columns of joints that are locked or follow others are no error.
  for (const std::string& name : document.JointNames()) {
    if (robot.FindJoint(name) >= 0) continue;
    JointInfo info;
    info.name = name;
    view.all.push_back(info);
  }
  return view;
}

Status ChooseDrive(const RecordingSet& set, const std::string& path, Recording* r) {
  if (!set.drive) return Status::Ok();
  r->drive = *set.drive;
  if (r->drive_effort().size() > 0) return Status::Ok();
  const std::string kind = r->drive == EffortKind::kMeasured ? "effort_measured" : "effort_command";
  return InvalidError(path + ": header (line 1): column " + kind + "." + set.joints[0] +
                      " is missing, the manifest's drive is " + kind);
}

}  // namespace

std::vector<const Recording*> RecordingSet::Of(Split split) const {
  std::vector<const Recording*> some;
  for (const Recording& r : recordings) {
    if (r.split == split) some.push_back(&r);
  }
  return some;
}

void RecordingSet::KeepForFit(const std::vector<uint32_t>& places) {
  for (Recording& r : recordings) r.split = Split::kHoldout;
  for (const uint32_t place : places) {
    if (place < recordings.size()) recordings[place].split = Split::kFit;
  }
}

bool ChooseHoldout(std::vector<Recording>& recordings) {
  const bool has_one = std::any_of(recordings.begin(), recordings.end(),
                                   [](const Recording& r) { return r.split == Split::kHoldout; });
  if (has_one || recordings.size() < 2) return false;
  for (size_t i = kHoldoutEvery - 1; i < recordings.size(); i += kHoldoutEvery) {
    recordings[i].split = Split::kHoldout;
  }
  if (recordings.size() < kHoldoutEvery) recordings.back().split = Split::kHoldout;
  return true;
}

Result<RecordingSet> LoadSet(const std::string& folder) {
  const std::string manifest_path = (fs::path(folder) / "manifest.json").string();
  if (!fs::is_directory(folder)) return NotFoundError(folder + ": no such folder");
  RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(manifest_path));
  RG_ASSIGN_OR_RETURN(Manifest manifest, ParseManifest(text, manifest_path));
  RecordingSet set = manifest.settings;
  set.folder = folder;
  set.urdf_path = manifest.settings.urdf_path = (fs::path(folder) / manifest.robot).string();
  RG_ASSIGN_OR_RETURN(set.urdf_text, ReadFile(set.urdf_path));
  RG_ASSIGN_OR_RETURN(const RobotView robot, ReadRobot(manifest, manifest_path, set.urdf_text));
  set.joint_info = robot.joints;
  for (const JointInfo& joint : robot.joints) set.joints.push_back(joint.name);

  CsvOptions options;
  options.joints = set.joints;
  options.robot = robot.all;
  for (const ManifestEntry& entry : manifest.recordings) {
    const std::string path = (fs::path(folder) / entry.file).string();
    RG_ASSIGN_OR_RETURN(Recording recording, LoadCsv(path, options));
    RG_RETURN_IF_ERROR(ChooseDrive(set, path, &recording));
    recording.name = entry.file;
    recording.split = entry.split;
    set.recordings.push_back(std::move(recording));
  }
  set.holdout_was_chosen = ChooseHoldout(set.recordings);
  return set;
}

namespace {

Status SameRobot(const RecordingSet& a, const RecordingSet& b) {
  const auto differ = [&](const std::string& what) {
    return InvalidError(b.folder + ": " + what + " differs from " + a.folder +
                        ": not one robot's recordings");
  };
  if (a.joints != b.joints) return differ("the list of joints");
  if (a.urdf_text != b.urdf_text) return differ("the URDF");
  if (a.locked != b.locked) return differ("\"locked\"");
  if (a.gravity != b.gravity) return differ("\"gravity\"");
  if (a.drive != b.drive) return differ("\"drive\"");
  if (a.effort_excludes_gravity != b.effort_excludes_gravity) return differ("\"effort_excludes_gravity\"");
  return Status::Ok();
}

void TakeLarger(const std::optional<double>& other, std::optional<double>* value) {
  if (!other || !*value) {
    value->reset();  // estimated from the data, then
  } else {
    *value = std::max(**value, *other);
  }
}

// A name of its own among `taken`.
std::string FreeName(const std::string& name, const std::string& prefix, const std::set<std::string>& taken) {
  if (!taken.contains(name)) return name;
  std::string free = prefix + "_" + name;
  for (int k = 2; taken.contains(free); ++k) free = prefix + "_" + std::to_string(k) + "_" + name;
  return free;
}

}  // namespace

Result<RecordingSet> MergeSets(std::vector<RecordingSet> sets) {
  if (sets.empty()) return InvalidError("no recording set was given");
  RecordingSet all = std::move(sets.front());
  std::set<std::string> taken;
  for (const Recording& r : all.recordings) taken.insert(r.name);
  for (size_t i = 1; i < sets.size(); ++i) {
    RecordingSet& set = sets[i];
    RG_RETURN_IF_ERROR(SameRobot(all, set));
    TakeLarger(set.noise.position_stddev, &all.noise.position_stddev);
    TakeLarger(set.noise.velocity_stddev, &all.noise.velocity_stddev);
    TakeLarger(set.noise.position_resolution, &all.noise.position_resolution);
    if (all.sample_rate_hz != set.sample_rate_hz) all.sample_rate_hz.reset();
    const std::string folder = fs::path(set.folder).filename().string();
    for (Recording& r : set.recordings) {
      r.name = FreeName(r.name, folder.empty() ? std::to_string(i + 1) : folder, taken);
      taken.insert(r.name);
      all.recordings.push_back(std::move(r));
    }
    all.warnings.insert(all.warnings.end(), set.warnings.begin(), set.warnings.end());
    all.holdout_was_chosen = all.holdout_was_chosen || set.holdout_was_chosen;
  }
  return all;
}

Result<RecordingSet> LoadSets(const std::vector<std::string>& folders) {
  std::vector<RecordingSet> sets;
  for (const std::string& folder : folders) {
    RG_ASSIGN_OR_RETURN(RecordingSet set, LoadSet(folder));
    sets.push_back(std::move(set));
  }
  return MergeSets(std::move(sets));
}

Status WriteSet(const std::string& folder, const RecordingSet& set) {
  for (const Recording& r : set.recordings) {
    RG_RETURN_IF_ERROR(WriteCsv((fs::path(folder) / r.name).string(), r));
  }
  RG_RETURN_IF_ERROR(WriteFileAtomically((fs::path(folder) / "robot.urdf").string(), set.urdf_text));
  // Last: a folder with a manifest is a whole set.
  return WriteFileAtomically((fs::path(folder) / "manifest.json").string(),
                             FormatManifest(set, "robot.urdf"));
}

}  // namespace rg::recordings
