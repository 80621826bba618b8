#include "services/importing/import.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "common/base/file.h"
#include "common/base/printf.h"
#include "common/model/urdf_document.h"
#include "common/model/urdf_loader.h"
#include "common/recordings/manifest.h"
#include "common/recordings/recording_set.h"
#include "services/importing/align.h"
#include "services/importing/csv_table.h"
#include "services/importing/exact_set.h"
#include "services/importing/guess_map.h"
#include "services/importing/inventory.h"
#include "services/importing/log_file.h"
#include "services/importing/set_bag.h"
#include "services/importing/tracks.h"

namespace rg::importing {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using recordings::Recording;
using recordings::RecordingSet;

constexpr size_t kRowsToSeeTime = 50;
// Later than that (11 days) a time is a clock's, and a recording begins at 0 instead.
constexpr int64_t kClockTimeNs = 1'000'000'000'000'000;

bool IsCsv(const LogFile& file) {
  return file.containers.size() == 1 && file.containers[0] == Container::kCsv;
}

// ---- one file: opened, looked through, read ----

// A log, or a CSV, before its columns are read.
struct Source {
  LogFile file;
  Inventory inventory;  // of a log
  CsvHeader header;     // of a CSV
};

Result<Source> OpenSource(const std::string& path, const ProgressFn& progress) {
  Source source;
  RG_ASSIGN_OR_RETURN(source.file, OpenLog(path));
  if (IsCsv(source.file)) {
    RG_ASSIGN_OR_RETURN(const MappedFile mapped, MappedFile::Open(path));
    RG_ASSIGN_OR_RETURN(source.header, ReadCsvHeader(mapped.bytes(), path));
  } else {
    RG_ASSIGN_OR_RETURN(source.inventory, TakeInventory(source.file, progress));
  }
  return source;
}

Result<GuessedMap> GuessOf(const Source& source, const std::vector<RobotJoint>& robot) {
  const std::string& path = source.file.name;
  if (!IsCsv(source.file)) return GuessMap(source.inventory, path, robot);
  std::vector<double> times;
  const size_t column = FindTimeColumn(source.header.columns);
  if (column < source.header.columns.size()) {
    RG_ASSIGN_OR_RETURN(const MappedFile mapped, MappedFile::Open(path));
    RG_ASSIGN_OR_RETURN(const CsvTable first,
                        ReadCsvTable(mapped.bytes(), source.header, path, column, 1.0, {}, kRowsToSeeTime));
    times = first.time;
  }
  return GuessCsvMap(source.header.columns, times, path, robot);
}

struct MapInUse {
  ImportMap map;
  std::string name;  // of its file, or what stands for one
};

Result<Track> ReadCsvTrack(const Source& source, const MapInUse& use, const std::vector<WantedColumn>& wanted,
                           std::vector<std::string>* notes) {
  const std::string& path = source.file.name;
  const std::vector<std::string>& columns = source.header.columns;
  const TimeColumn time = use.map.time.value_or(TimeColumn{"", "s"});
  const size_t found =
      static_cast<size_t>(std::find(columns.begin(), columns.end(), time.column) - columns.begin());
  const size_t time_column = time.column.empty() ? FindTimeColumn(columns) : found;
  if (time_column == columns.size()) {
    return InvalidError(use.name + ": time.column: " + path +
                        (time.column.empty() ? " has no column that is a time by its name"
                                             : " has no column " + Shown(time.column)));
  }
  std::vector<size_t> places;
  for (const WantedColumn& column : wanted)
    places.push_back(
        static_cast<size_t>(std::find(columns.begin(), columns.end(), column.field) - columns.begin()));
  RG_ASSIGN_OR_RETURN(const MappedFile mapped, MappedFile::Open(path));
  RG_ASSIGN_OR_RETURN(CsvTable table, ReadCsvTable(mapped.bytes(), source.header, path, time_column,
                                                   TimeUnitNs(time.unit), places));
  if (table.last_row_cut) notes->push_back(path + ": its last row is cut, left out");
  Track track;
  track.stamps_ns = std::move(table.time_ns);
  track.values = std::move(table.columns);
  for (size_t i = 0; i < wanted.size(); ++i) {
    track.columns.push_back(i);
    for (double& value : track.values[i]) value = value * wanted[i].factor + wanted[i].offset;
  }
  return track;
}

struct ReadFileResult {
  std::vector<WantedColumn> wanted;
  Aligned aligned;
};

Result<ReadFileResult> ReadSource(const Source& source, const MapInUse& use,
                                  const std::vector<RobotJoint>& robot, const ProgressFn& progress,
                                  std::vector<std::string>* notes) {
  ReadFileResult result;
  const std::string& path = source.file.name;
  std::vector<Track> tracks;
  if (IsCsv(source.file)) {
    RG_ASSIGN_OR_RETURN(result.wanted,
                        ResolveCsvColumns(use.map, use.name, source.header.columns, path, robot));
    RG_ASSIGN_OR_RETURN(Track track, ReadCsvTrack(source, use, result.wanted, notes));
    tracks.push_back(std::move(track));
  } else {
    RG_ASSIGN_OR_RETURN(result.wanted, ResolveColumns(use.map, use.name, source.inventory, path, robot));
    RG_ASSIGN_OR_RETURN(tracks, ReadTracks(source.file, source.inventory, result.wanted, progress));
  }
  RG_ASSIGN_OR_RETURN(result.aligned, Align(result.wanted, std::move(tracks), path));
  return result;
}

// ---- columns to a recording ----

// The joints that have positions, in the robot's order.
std::vector<std::string> JointsOf(const std::vector<WantedColumn>& wanted,
                                  const std::vector<RobotJoint>& robot) {
  std::vector<std::string> joints;
  for (const RobotJoint& joint : robot) {
    const bool there = std::any_of(wanted.begin(), wanted.end(), [&](const WantedColumn& c) {
      return c.joint == joint.name && c.kind == "position";
    });
    if (there) joints.push_back(joint.name);
  }
  return joints;
}

Status CheckKinds(const std::vector<WantedColumn>& wanted, const std::vector<std::string>& joints,
                  const std::string& map_name) {
  bool effort = false, reference = false;
  for (const WantedColumn& column : wanted) {
    effort = effort || column.kind == "effort_command" || column.kind == "effort_measured";
    reference = reference || (column.kind.find("position") == 0 && column.kind != "position");
    if (!column.IsRequired() || std::find(joints.begin(), joints.end(), column.joint) != joints.end())
      continue;
    return InvalidError(map_name + ": columns[" + std::to_string(column.entry) + "]: " + column.Name() +
                        " is mapped, position." + column.joint + " is not");
  }
  if (effort) return Status::Ok();
  if (reference)
    return InvalidError(map_name +
                        ": columns: position commands and no effort: position-commanded drives are not "
                        "modelled yet");
  return InvalidError(map_name +
                      ": columns: no effort_command or effort_measured: nothing says what drives the robot");
}

Recording RecordingOf(const ReadFileResult& read, const std::vector<std::string>& joints, int64_t zero_ns) {
  const Aligned& aligned = read.aligned;
  const auto rows = static_cast<Eigen::Index>(aligned.stamps_ns.size());
  Recording recording;
  recording.joints = joints;
  recording.t.resize(rows);
  for (Eigen::Index k = 0; k < rows; ++k)
    recording.t[k] = SecondsOf(aligned.stamps_ns[static_cast<size_t>(k)] - zero_ns);
  for (size_t i = 0; i < read.wanted.size(); ++i)
    recording.other[read.wanted[i].Name()] =
        Eigen::Map<const Eigen::VectorXd>(aligned.columns[i].data(), rows);
  GatherKinds(&recording);
  return recording;
}

// A kind of which a joint lacks a column: velocities are left out, efforts of some joints are for the reader
// of the set (a joint without one is prescribed).
void LeaveOutSomeVelocities(Recording* recording, std::vector<std::string>* notes) {
  const size_t before = recording->other.size();
  std::erase_if(recording->other, [](const auto& column) { return column.first.rfind("velocity.", 0) == 0; });
  if (recording->other.size() < before)
    notes->push_back(recording->name + ": velocities are not mapped for every joint: left out");
}

// ---- what was taken and what was not ----

void TellTaken(const ReadFileResult& read, const MapInUse& use, ImportedFile* file) {
  for (size_t i = 0; i < read.wanted.size(); ++i) {
    const WantedColumn& column = read.wanted[i];
    std::string unit = column.unit;
    const MapEntry& entry = use.map.entries[column.entry];
    if (entry.scale != 1.0) unit += Printf(" × %.6g", entry.scale);
    if (entry.offset != 0.0) unit += Printf(" %+.6g", entry.offset);
    file->taken.push_back({column.topic, column.field, column.Name(), unit, column.clock,
                           read.aligned.use[i].rate_hz, read.aligned.use[i].samples});
  }
  const WantedColumn& base = read.wanted[read.aligned.base_column];
  file->base = base.topic.empty() ? base.field : base.topic + " (" + base.clock + ")";
}

std::string FirstPart(const std::string& field) { return field.substr(0, field.find_first_of(".[")); }

void TellNotTakenOfLog(const Source& source, const std::vector<WantedColumn>& wanted,
                       std::vector<NotTaken>* list) {
  for (const TopicInfo& info : source.inventory.topics) {
    std::set<std::string> used = {"header", "name", "joint_names", "layout"};
    bool any = false;
    for (const WantedColumn& column : wanted) {
      if (column.topic != info.topic.name || source.inventory.Find(column.topic) != &info) continue;
      any = true;
      used.insert(FirstPart(column.field));
    }
    std::string why =
        !info.unreadable.empty() ? info.unreadable : std::to_string(info.messages) + " messages";
    if (any) {
      std::vector<std::string> unused;
      for (const std::string& field : info.fields) {
        if (!used.contains(field)) unused.push_back(field);
      }
      if (unused.empty()) continue;
      why = "fields " + Joined(unused);
    }
    list->push_back({info.topic.name, info.topic.type, why});
  }
}

void TellNotTakenOfCsv(const Source& source, const MapInUse& use, const std::vector<WantedColumn>& wanted,
                       std::vector<NotTaken>* list) {
  for (const std::string& name : source.header.columns) {
    const bool used =
        (use.map.time && use.map.time->column == name) ||
        std::any_of(wanted.begin(), wanted.end(), [&](const WantedColumn& c) { return c.field == name; });
    if (!used) list->push_back({name, "column", ""});
  }
}

// ---- the set ----

// A name in the set: the file's own, as far as a file system anywhere can hold it, and none twice.
std::string RecordingName(const std::string& path, std::set<std::string>* taken) {
  fs::path file(path);
  if (file.filename().empty()) file = file.parent_path();  // a folder with a slash behind it
  std::error_code error;
  std::string stem = fs::is_directory(file, error) ? file.filename().string() : file.stem().string();
  for (char& c : stem) {
    const bool plain = std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '_' || c == '-' || c == '.';
    if (!plain) c = '_';
  }
  if (stem.empty() || stem[0] == '.') stem = "rec" + stem;
  std::string name = stem + ".csv";
  for (int k = 2; !taken->insert(name).second; ++k) name = stem + "_" + std::to_string(k) + ".csv";
  return name;
}

// A recording that is fitted cannot be one to judge by.
Status CheckNoneTwice(const std::vector<std::string>& files) {
  std::set<std::string> seen;
  for (const std::string& file : files) {
    if (!seen.insert(fs::path(file).lexically_normal().string()).second)
      return InvalidError(file + ": is given twice");
  }
  return Status::Ok();
}

// The last third of the files is kept aside.
void ChooseSplits(std::vector<Recording>* all, std::vector<std::string>* notes) {
  if (all->size() < 2) {
    notes->push_back("a single file: all of it is fitted, none is kept aside to judge by");
    return;
  }
  const size_t aside = std::max<size_t>(1, all->size() / 3);
  for (size_t i = all->size() - aside; i < all->size(); ++i) (*all)[i].split = recordings::Split::kHoldout;
}

// Settings of the set, as the mapping's "manifest" says; checked as any manifest is.
Result<RecordingSet> SettingsOf(const MapInUse& use, const std::vector<std::string>& joints) {
  json manifest = json::parse(use.map.manifest_json);
  manifest["format"] = recordings::kSetFormat;
  manifest["robot"] = "robot.urdf";
  manifest["joints"] = joints;
  manifest["recordings"] = {{{"file", "x.csv"}}};
  RG_ASSIGN_OR_RETURN(recordings::Manifest parsed,
                      recordings::ParseManifest(manifest.dump(), use.name + ": manifest"));
  parsed.settings.joints = joints;
  return std::move(parsed.settings);
}

Status CheckOut(const std::string& out) {
  if (out.empty()) return InvalidError("--out is missing: the folder to write the recording set to");
  std::error_code error;
  if (fs::exists(out, error) && !(fs::is_directory(out, error) && fs::is_empty(out, error)))
    return AlreadyExistsError(out + ": is there already, and not empty");
  return Status::Ok();
}

// Writes beside `out`, reads the set as its user will, and renames.
Status WriteWhole(const std::string& out, const RecordingSet& set, const std::string& manifest_json,
                  const std::string& map_json, std::vector<std::string>* notes) {
  const fs::path target = fs::path(out).lexically_normal();
  const std::string folder = (target.has_filename() ? target : target.parent_path()).string();
  const std::string partial = folder + ".partial";
  std::error_code error;
  fs::remove_all(partial, error);
  const auto write = [&]() -> Status {
    RG_RETURN_IF_ERROR(WriteExactSet(partial, set, manifest_json));
    if (!map_json.empty()) RG_RETURN_IF_ERROR(WriteFileAtomically(partial + "/import_map.json", map_json));
    RG_ASSIGN_OR_RETURN(const RecordingSet read, recordings::LoadSet(partial));
    for (const std::string& warning : read.warnings) notes->push_back(warning);
    fs::remove(folder, error);  // an empty one
    fs::rename(partial, folder, error);
    if (error) return UnavailableError(folder + ": " + error.message());
    return Status::Ok();
  };
  const Status written = write();
  if (written.ok()) return written;
  fs::remove_all(partial, error);
  // The set that the message names is not there.
  std::string what = written.message();
  for (size_t at = what.find(partial + "/"); at != std::string::npos; at = what.find(partial + "/"))
    what.erase(at, partial.size() + 1);
  if (what.find("degree") != std::string::npos || what.find("millimetre") != std::string::npos)
    what += "; a mapping says units: \"unit\": \"deg\" or \"mm\"";
  return {written.code(), "what was read makes no set: " + what};
}

ImportedFile About(const std::string& path, const Recording& r) {
  ImportedFile file;
  file.path = path;
  file.recording = r.name;
  file.holdout = r.split == recordings::Split::kHoldout;
  file.rows = r.rows();
  file.duration_s = r.rows() > 1 ? r.t[r.rows() - 1] - r.t[0] : 0.0;
  return file;
}

// ---- bags that an export wrote ----

Status SameSet(const RecordingSet& a, const RecordingSet& b, const std::string& name_a,
               const std::string& name_b) {
  const auto differ = [&](const char* what) {
    return InvalidError(name_b + ": its " + what + " differs from " + name_a + "'s: not of one set");
  };
  if (a.joints != b.joints) return differ("list of joints");
  if (a.urdf_text != b.urdf_text) return differ("URDF");
  return Status::Ok();
}

Result<ImportReport> ImportSetBags(const ImportOptions& options, const Source& first,
                                   const ProgressFn& progress) {
  ImportReport report;
  RecordingSet all;
  std::vector<std::string> paths;
  for (size_t i = 0; i < options.files.size(); ++i) {
    RG_ASSIGN_OR_RETURN(const Source source,
                        i == 0 ? Result<Source>(first) : OpenSource(options.files[i], progress));
    if (IsCsv(source.file) || !IsSetBag(source.inventory))
      return InvalidError(options.files[i] + ": was not written by an export, " + options.files[0] +
                          " was: import them apart");
    for (const std::string& note : source.inventory.notes) report.notes.push_back(note);
    RG_ASSIGN_OR_RETURN(RecordingSet set, ReadSetBag(source.file, source.inventory, progress));
    if (i == 0) {
      all = std::move(set);
      continue;
    }
    RG_RETURN_IF_ERROR(SameSet(all, set, options.files[0], options.files[i]));
    for (const Recording& r : all.recordings) {
      if (r.name == set.recordings[0].name)
        return InvalidError(options.files[i] + ": holds " + r.name + ", which an earlier file holds too");
    }
    all.recordings.push_back(std::move(set.recordings[0]));
  }
  if (!options.urdf.empty()) {
    RG_ASSIGN_OR_RETURN(all.urdf_text, ReadFile(options.urdf));
  }
  if (all.urdf_text.empty()) return InvalidError(options.files[0] + ": holds no URDF: give one with --urdf");
  for (size_t i = 0; i < options.files.size(); ++i)
    report.files.push_back(About(options.files[i], all.recordings[i]));
  RG_RETURN_IF_ERROR(
      WriteWhole(options.out, all, first.inventory.Find(kManifestTopic)->text, "", &report.notes));
  report.out = options.out;
  return report;
}

Result<MapInUse> ChooseMap(const ImportOptions& options, const Source& first,
                           const std::vector<RobotJoint>& robot, ImportReport* report) {
  if (!options.map.empty()) {
    RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(options.map));
    RG_ASSIGN_OR_RETURN(ImportMap map, ParseImportMap(text, options.map));
    return MapInUse{std::move(map), options.map};
  }
  RG_ASSIGN_OR_RETURN(GuessedMap guessed, GuessOf(first, robot));
  if (!guessed.questions.empty()) {
    return InvalidError(guessed.questions[0] +
                        ": write the guess with --map guess, look at it, and give it with --map FILE");
  }
  report->guessed = true;
  report->reasons = guessed.reasons;
  return MapInUse{std::move(guessed.map), "guessed mapping"};
}

}  // namespace

Result<std::vector<RobotJoint>> RobotJoints(const std::string& urdf_text, const std::string& urdf_path) {
  RG_ASSIGN_OR_RETURN(const model::UrdfDocument document, model::ReadUrdfDocument(urdf_text, urdf_path));
  std::vector<RobotJoint> joints;
  Status why;
  for (const std::string& name : document.JointNames()) {
    model::LoadOptions options;
    options.joints = {name};
    const auto robot = model::ParseUrdf(urdf_text, urdf_path, options);
    if (!robot.ok()) why = robot.status();
    // Joints that are fixed, or follow another, are none.
    const int k = robot.ok() ? robot->FindJoint(name) : -1;
    if (k < 0) continue;
    const model::JointType type = robot->joint(k).type;
    joints.push_back({name, type == model::JointType::kPrismatic, type == model::JointType::kContinuous});
  }
  if (joints.empty()) return why.ok() ? InvalidError(urdf_path + ": has no joint that moves") : why;
  return joints;
}

Result<GuessReport> Guess(const ImportOptions& options, const ProgressFn& progress) {
  if (options.urdf.empty())
    return InvalidError("--urdf is missing: the robot's joints are matched by their names");
  RG_ASSIGN_OR_RETURN(const std::string urdf_text, ReadFile(options.urdf));
  RG_ASSIGN_OR_RETURN(const std::vector<RobotJoint> robot, RobotJoints(urdf_text, options.urdf));
  RG_ASSIGN_OR_RETURN(const Source source, OpenSource(options.files[0], progress));
  RG_ASSIGN_OR_RETURN(GuessedMap guessed, GuessOf(source, robot));
  return GuessReport{FormatImportMap(guessed.map), std::move(guessed.reasons), std::move(guessed.questions)};
}

Result<ImportReport> Import(const ImportOptions& options, const ProgressFn& progress) {
  RG_RETURN_IF_ERROR(CheckOut(options.out));
  RG_RETURN_IF_ERROR(CheckNoneTwice(options.files));
  RG_ASSIGN_OR_RETURN(Source source, OpenSource(options.files[0], progress));
  if (options.map.empty() && !IsCsv(source.file) && IsSetBag(source.inventory))
    return ImportSetBags(options, source, progress);

  if (options.urdf.empty())
    return InvalidError("--urdf is missing: the robot's joints are matched by their names");
  RG_ASSIGN_OR_RETURN(const std::string urdf_text, ReadFile(options.urdf));
  RG_ASSIGN_OR_RETURN(const std::vector<RobotJoint> robot, RobotJoints(urdf_text, options.urdf));
  ImportReport report;
  RG_ASSIGN_OR_RETURN(const MapInUse use, ChooseMap(options, source, robot, &report));
  report.map_json = FormatImportMap(use.map);

  RecordingSet set;
  std::set<std::string> names;
  for (size_t i = 0; i < options.files.size(); ++i) {
    if (i > 0) {
      RG_ASSIGN_OR_RETURN(source, OpenSource(options.files[i], progress));
    }
    for (const std::string& note : source.inventory.notes) report.notes.push_back(note);
    RG_ASSIGN_OR_RETURN(const ReadFileResult read, ReadSource(source, use, robot, progress, &report.notes));
    const std::vector<std::string> joints = JointsOf(read.wanted, robot);
    RG_RETURN_IF_ERROR(CheckKinds(read.wanted, joints, use.name));
    if (i == 0) {
      RG_ASSIGN_OR_RETURN(set, SettingsOf(use, joints));
      set.urdf_text = urdf_text;
    } else if (joints != set.joints) {
      return InvalidError(options.files[i] + ": has positions of " + Joined(joints) + ", " +
                          options.files[0] + " of " + Joined(set.joints));
    }
    const int64_t start = read.aligned.stamps_ns.front();
    const int64_t zero = std::abs(start) > kClockTimeNs ? start : 0;
    Recording recording = RecordingOf(read, joints, zero);
    recording.name = RecordingName(options.files[i], &names);
    LeaveOutSomeVelocities(&recording, &report.notes);
    ImportedFile file = About(options.files[i], recording);
    file.start_ns = start;
    TellTaken(read, use, &file);
    for (const std::string& note : read.aligned.notes) report.notes.push_back(note);
    if (i == 0 && IsCsv(source.file)) TellNotTakenOfCsv(source, use, read.wanted, &report.not_taken);
    if (i == 0 && !IsCsv(source.file)) TellNotTakenOfLog(source, read.wanted, &report.not_taken);
    report.files.push_back(std::move(file));
    set.recordings.push_back(std::move(recording));
  }
  ChooseSplits(&set.recordings, &report.notes);
  for (size_t i = 0; i < set.recordings.size(); ++i)
    report.files[i].holdout = set.recordings[i].split == recordings::Split::kHoldout;
  RG_RETURN_IF_ERROR(WriteWhole(options.out, set, use.map.manifest_json, report.map_json, &report.notes));
  report.out = options.out;
  return report;
}

}  // namespace rg::importing
