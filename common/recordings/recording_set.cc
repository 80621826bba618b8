#include "common/recordings/recording_set.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <set>

#include "common/base/file.h"
#include "common/base/printf.h"
#include "common/model/robot_model.h"
#include "common/model/urdf_document.h"
#include "common/model/urdf_loader.h"
#include "common/recordings/csv_advice.h"
#include "common/recordings/manifest.h"
#include "common/recordings/prescribed.h"
#include "common/recordings/time_stamps.h"

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

static CsvOptions OptionsOf(const ReadOptions& read) {
  CsvOptions options;
  options.dialect = read.dialect;
  options.time_unit_is_known = read.time_units_per_s.has_value();
  options.time_units_per_s = read.time_units_per_s.value_or(1.0);
  return options;
}

// All joints of the robot's URDF: those that move with all that is known of them, the others (fixed, locked
// or following) by name, for their columns are no error.
static std::vector<JointInfo> InfosOf(const model::RobotModel& robot) {
  std::vector<JointInfo> infos;
  for (const model::Joint& joint : robot.joints()) infos.push_back(InfoOf(joint));
  const auto document = model::ReadUrdfDocument(robot.urdf_text(), robot.name());
  if (!document.ok()) return infos;  // a model made without one
  for (const std::string& name : document->JointNames()) {
    if (robot.FindJoint(name) >= 0) continue;
    infos.emplace_back().name = name;
  }
  return infos;
}

CsvOptions CsvOptionsFor(const model::RobotModel& robot, const ReadOptions& read) {
  CsvOptions options = OptionsOf(read);
  for (const model::Joint& joint : robot.joints()) options.joints.push_back(joint.name);
  options.robot = InfosOf(robot);
  return options;
}

namespace {

namespace fs = std::filesystem;

constexpr int kHoldoutEvery = 4;
constexpr double kBeyondLimit = 0.35;  // rad or m
constexpr int kFewestRows = 10;        // of a piece between gaps that a fit can use

bool Contains(const std::vector<std::string>& names, const std::string& name) {
  return std::find(names.begin(), names.end(), name) != names.end();
}

// The order of the model's joints, and what the CSV reader wants to know of the robot.
struct RobotView {
  std::vector<JointInfo> joints;  // the manifest's, in model order
  std::vector<JointInfo> all;     // and the URDF's other joints, names only
  std::vector<std::string> warnings;
};

Status CheckJointsExist(const Manifest& manifest, const std::string& manifest_path,
                        const std::vector<std::string>& known) {
  const auto error = [&](const std::string& field, const std::string& joint) {
    return InvalidError(manifest_path + ": " + field + ": the robot (" + manifest.robot + ") has no joint '" +
                        joint + "'" + UnknownJointAdvice(joint, known));
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
  view.all = InfosOf(robot);
  view.warnings = robot.warnings();
  for (const model::UrdfJoint& joint : document.joints) {
    const auto locked = manifest.settings.locked.find(joint.name);
    if (locked == manifest.settings.locked.end() || joint.is_fixed ||
        joint.type == model::JointType::kContinuous)
      continue;
    if (locked->second >= joint.lower - kBeyondLimit && locked->second <= joint.upper + kBeyondLimit)
      continue;
    view.warnings.push_back("\"locked\" has " + joint.name + " at " + Printf("%g", locked->second) +
                            ", outside the URDF's limits " + Printf("%.4g", joint.lower) + " to " +
                            Printf("%.4g", joint.upper) + ": positions are in rad, or m");
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

namespace {

// Every recording by its pieces between gaps; what is too short to fit is left out unless nothing else is
// there.
void SplitRecordingsAtGaps(RecordingSet* set) {
  std::vector<Recording> all;
  for (Recording& r : set->recordings) {
    const std::vector<Gap> gaps = FindGaps(r.t);
    if (gaps.empty()) {
      all.push_back(std::move(r));
      continue;
    }
    double longest = 0.0;
    for (const Gap& gap : gaps) longest = std::max(longest, gap.seconds);
    std::vector<Recording> pieces = SplitAtGaps(r);
    const auto is_short = [](const Recording& piece) { return piece.rows() < kFewestRows; };
    const auto short_ones = std::count_if(pieces.begin(), pieces.end(), is_short);
    if (short_ones < static_cast<long>(pieces.size())) std::erase_if(pieces, is_short);
    set->warnings.push_back(r.name + ": " + std::to_string(gaps.size()) +
                            (gaps.size() == 1 ? " gap" : " gaps") + ", the longest " +
                            Printf("%.3g", longest) + " s: fits go round " +
                            (gaps.size() == 1 ? "it" : "them") +
                            (short_ones > 0 ? ", " + std::to_string(short_ones) + " pieces of less than " +
                                                  std::to_string(kFewestRows) + " rows are left out"
                                            : ""));
    for (Recording& piece : pieces) all.push_back(std::move(piece));
  }
  set->recordings = std::move(all);
}

// What readers noted, once each, with the recordings it is true of.
void WarnOfNotes(RecordingSet* set) {
  std::vector<std::string> notes;
  std::map<std::string, std::vector<std::string>> of;
  for (const Recording& r : set->recordings) {
    for (const std::string& note : r.notes) {
      if (!of.contains(note)) notes.push_back(note);
      of[note].push_back(r.name);
    }
  }
  for (const std::string& note : notes) {
    const std::vector<std::string>& names = of[note];
    set->warnings.push_back((names.size() == 1 ? names[0]
                             : names.size() == set->recordings.size()
                                 ? "all recordings"
                                 : names[0] + " and " + std::to_string(names.size() - 1) + " more") +
                            ": " + note);
  }
}

// Efforts that one recording has as 0 throughout and another does not.
void WarnOfSilentEfforts(RecordingSet* set) {
  for (size_t j = 0; j < set->joints.size(); ++j) {
    std::vector<std::string> silent;
    for (const Recording& r : set->recordings) {
      if (r.drive_effort().size() > 0 && r.drive_effort().row(static_cast<Eigen::Index>(j)).isZero(0.0))
        silent.push_back(r.name);
    }
    if (silent.empty() || silent.size() == set->recordings.size()) continue;
    set->warnings.push_back(
        silent[0] + (silent.size() > 1 ? " and " + std::to_string(silent.size() - 1) + " more" : "") +
        ": the effort of " + set->joints[j] + " is 0 throughout, in other recordings it is not");
  }
}

// Notes as warnings of the set; then gaps.
void FinishReading(const ReadOptions& read, RecordingSet* set) {
  WarnOfNotes(set);
  WarnOfSilentEfforts(set);
  if (!read.keep_whole) SplitRecordingsAtGaps(set);
}

// A manifest from Windows may write data\\rec.csv.
std::string PathOf(const std::string& folder, const std::string& file) {
  std::error_code error;
  const fs::path path = fs::path(folder) / file;
  if (file.find('\\') == std::string::npos || fs::exists(path, error)) return path.string();
  std::string with_slashes = file;
  std::replace(with_slashes.begin(), with_slashes.end(), '\\', '/');
  return (fs::path(folder) / with_slashes).string();
}

}  // namespace

Result<RecordingSet> LoadSet(const std::string& folder, const ReadOptions& read) {
  const std::string manifest_path = (fs::path(folder) / "manifest.json").string();
  std::error_code error;
  if (!fs::is_directory(folder, error)) return NotFoundError(folder + ": no such folder");
  if (!fs::exists(manifest_path, error) && !fs::is_symlink(manifest_path, error)) {
    return NotFoundError(folder +
                         ": has no manifest.json (docs/recordings.md); without one, give the files: --urdf " +
                         "arm.urdf a.csv b.csv ...");
  }
  RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(manifest_path));
  RG_ASSIGN_OR_RETURN(Manifest manifest, ParseManifest(text, manifest_path));
  RecordingSet set = manifest.settings;
  set.folder = folder;
  set.urdf_path = manifest.settings.urdf_path = (fs::path(folder) / manifest.robot).string();
  RG_ASSIGN_OR_RETURN(set.urdf_text, ReadFile(set.urdf_path));
  RG_ASSIGN_OR_RETURN(const RobotView robot, ReadRobot(manifest, manifest_path, set.urdf_text));
  set.joint_info = robot.joints;
  set.warnings.insert(set.warnings.end(), robot.warnings.begin(), robot.warnings.end());
  for (const JointInfo& joint : robot.joints) set.joints.push_back(joint.name);

  CsvOptions options = OptionsOf(read);
  options.joints = set.joints;
  options.robot = robot.all;
  options.sample_rate_hz = set.sample_rate_hz;
  if (set.prescribed_listed) options.prescribed = set.prescribed;
  for (const ManifestEntry& entry : manifest.recordings) {
    const std::string path = PathOf(folder, entry.file);
    RG_ASSIGN_OR_RETURN(Recording recording, LoadCsv(path, options));
    RG_RETURN_IF_ERROR(ChooseDrive(set, path, &recording));
    recording.name = entry.file;
    recording.split = entry.split;
    set.recordings.push_back(std::move(recording));
  }
  RG_RETURN_IF_ERROR(ResolvePrescribed(&set));
  set.holdout_was_chosen = ChooseHoldout(set.recordings);
  FinishReading(read, &set);
  return set;
}

namespace {

// The joints that a file has positions of, as far as they move by themselves in the robot.
Result<std::vector<std::string>> JointsOfFile(const std::string& file, const model::RobotModel& robot,
                                              const CsvOptions& options) {
  CsvOptions any = options;
  any.joints.clear();
  any.require_effort = false;
  RG_ASSIGN_OR_RETURN(Recording r, LoadCsv(file, any));
  std::erase_if(r.joints, [&](const std::string& joint) { return robot.FindJoint(joint) < 0; });
  if (r.joints.empty()) return InvalidError(file + ": no position column of a joint that moves");
  return r.joints;
}

// Rows up to `time` after the first, and those behind it, as two recordings of the same name.
Result<std::vector<Recording>> CutInTime(const Recording& r, double time) {
  const double duration = r.t[r.rows() - 1] - r.t[0];
  if (std::isinf(time)) time = duration * 2.0 / 3.0;
  const auto first =
      static_cast<int>(std::upper_bound(r.t.data(), r.t.data() + r.rows(), r.t[0] + time) - r.t.data());
  if (first < kFewestRows || r.rows() - first < kFewestRows) {
    return InvalidError(r.name + ": --split-time " + Printf("%.3g", time) + ": leaves " +
                        std::to_string(first) + " and " + std::to_string(r.rows() - first) + " rows of " +
                        Printf("%.3g", duration) + " s, at least 10 are needed on either side");
  }
  std::vector<Recording> parts = {Slice(r, 0, first), Slice(r, first, r.rows() - first)};
  parts[1].split = Split::kHoldout;
  parts[1].notes.clear();
  return parts;
}

}  // namespace

Result<RecordingSet> SetFromFiles(const std::string& urdf_path, const std::vector<std::string>& files,
                                  std::optional<double> split_time_s, const ReadOptions& read) {
  if (files.empty()) return InvalidError("no recording was given");
  if (files.size() == 1 && !split_time_s) {
    return InvalidError(
        files[0] +
        ": a single recording leaves none to judge by: give another one, or keep its last third "
        "aside with --split-time");
  }
  RecordingSet set;
  set.folder = fs::path(files[0]).parent_path().string();
  set.urdf_path = urdf_path;
  RG_ASSIGN_OR_RETURN(set.urdf_text, ReadFile(urdf_path));
  RG_ASSIGN_OR_RETURN(const model::RobotModel whole, model::ParseUrdf(set.urdf_text, urdf_path));
  CsvOptions options = CsvOptionsFor(whole, read);
  Manifest manifest;
  manifest.robot = urdf_path;
  manifest.settings.urdf_path = urdf_path;
  RG_ASSIGN_OR_RETURN(manifest.joints, JointsOfFile(files[0], whole, options));
  RG_ASSIGN_OR_RETURN(const RobotView robot, ReadRobot(manifest, files[0], set.urdf_text));
  set.joint_info = robot.joints;
  set.warnings.insert(set.warnings.end(), robot.warnings.begin(), robot.warnings.end());
  for (const JointInfo& joint : robot.joints) set.joints.push_back(joint.name);
  options.joints = set.joints;
  options.robot = robot.all;
  std::set<std::string> taken;
  std::set<std::string> given;
  for (const std::string& file : files) {
    if (!given.insert(fs::path(file).lexically_normal().string()).second)
      return InvalidError(file + ": is given twice");
    RG_ASSIGN_OR_RETURN(Recording r, LoadCsv(file, options));
    r.name = fs::path(file).filename().string();
    if (taken.contains(r.name)) r.name = file;
    taken.insert(r.name);
    set.recordings.push_back(std::move(r));
  }
  RG_RETURN_IF_ERROR(ResolvePrescribed(&set));
  set.holdout_was_chosen = true;
  if (files.size() == 1) {
    RG_ASSIGN_OR_RETURN(set.recordings, CutInTime(set.recordings[0], *split_time_s));
  } else {
    const size_t aside = std::max<size_t>(1, files.size() / 3);
    for (size_t i = files.size() - aside; i < files.size(); ++i) set.recordings[i].split = Split::kHoldout;
  }
  FinishReading(read, &set);
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
  if (a.prescribed != b.prescribed) return differ("which joints are prescribed");
  if (a.passive != b.passive) return differ("\"passive\"");
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
    std::map<std::string, std::string> names;  // pieces of one recording keep one name
    for (const Recording& r : set.recordings) {
      if (names.contains(r.name)) continue;
      names[r.name] = FreeName(r.name, folder.empty() ? std::to_string(i + 1) : folder, taken);
      taken.insert(names[r.name]);
    }
    for (Recording& r : set.recordings) {
      r.name = names[r.name];
      all.recordings.push_back(std::move(r));
    }
    all.warnings.insert(all.warnings.end(), set.warnings.begin(), set.warnings.end());
    all.holdout_was_chosen = all.holdout_was_chosen || set.holdout_was_chosen;
  }
  return all;
}

Result<RecordingSet> LoadSets(const std::vector<std::string>& folders, const ReadOptions& read) {
  std::vector<RecordingSet> sets;
  for (const std::string& folder : folders) {
    RG_ASSIGN_OR_RETURN(RecordingSet set, LoadSet(folder, read));
    sets.push_back(std::move(set));
  }
  return MergeSets(std::move(sets));
}

Status WriteSet(const std::string& folder, const RecordingSet& given) {
  RecordingSet set = given;
  set.recordings = JoinPieces(std::move(set.recordings));
  for (const Recording& r : set.recordings) {
    RG_RETURN_IF_ERROR(WriteCsv((fs::path(folder) / r.name).string(), r));
  }
  RG_RETURN_IF_ERROR(WriteFileAtomically((fs::path(folder) / "robot.urdf").string(), set.urdf_text));
  // Last: a folder with a manifest is a whole set.
  return WriteFileAtomically((fs::path(folder) / "manifest.json").string(),
                             FormatManifest(set, "robot.urdf"));
}

}  // namespace rg::recordings
