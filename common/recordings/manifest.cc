#include "common/recordings/manifest.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <set>

#include "common/base/printf.h"

namespace rg::recordings {
namespace {

using Json = nlohmann::json;

constexpr double kLeastGravity = 1.5,
                 kMostGravity = 12.0;  // m/s^2: between the Moon's and more than the Earth's

std::string Shown(const Json& value) {
  const std::string text = value.dump(-1, ' ', true, Json::error_handler_t::replace);
  return text.size() > 60 ? text.substr(0, 57) + "..." : text;
}

// Reads fields of one JSON object; the first error stays, later reads do nothing.
class Fields {
 public:
  Fields(const Json& object, std::string source, std::string path, Status* status)
      : object_(object), source_(std::move(source)), path_(std::move(path)), status_(*status) {}

  void Fail(const std::string& field, const std::string& what) {
    if (status_.ok()) status_ = InvalidError(source_ + ": " + path_ + field + ": " + what);
  }

  const Json* Find(const std::string& field, bool required) {
    known_.insert(field);
    const auto found = object_.find(field);
    if (found != object_.end()) return &*found;
    if (required) Fail(field, "is missing");
    return nullptr;
  }

  std::string String(const std::string& field, const std::string& fallback, bool required) {
    const Json* value = Find(field, required);
    if (!value) return fallback;
    if (!value->is_string() || value->get_ref<const std::string&>().empty()) {
      Fail(field, value->is_string() ? "is empty" : Shown(*value) + " is not a text");
      return fallback;
    }
    return value->get<std::string>();
  }

  bool Bool(const std::string& field, bool fallback) {
    const Json* value = Find(field, false);
    if (!value) return fallback;
    if (!value->is_boolean()) Fail(field, Shown(*value) + " is neither true nor false");
    return value->is_boolean() ? value->get<bool>() : fallback;
  }

  std::optional<double> Number(const std::string& field, double above, bool or_equal) {
    const Json* value = Find(field, false);
    if (!value) return std::nullopt;
    if (!value->is_number()) {
      Fail(field, Shown(*value) + " is not a number");
      return std::nullopt;
    }
    const double number = value->get<double>();
    if (!std::isfinite(number) || number < above || (number == above && !or_equal)) {
      Fail(field, Shown(*value) + ", must be " + (or_equal ? "at least " : "above ") + Printf("%g", above));
    }
    return number;
  }

  const Json* Array(const std::string& field, bool required) {
    const Json* value = Find(field, required);
    if (value && !value->is_array()) Fail(field, Shown(*value) + " is not a list");
    return value && value->is_array() ? value : nullptr;
  }

  const Json* Object(const std::string& field) {
    const Json* value = Find(field, false);
    if (value && !value->is_object()) Fail(field, Shown(*value) + " is not an object");
    return value && value->is_object() ? value : nullptr;
  }

  bool ok() const { return status_.ok(); }

  // One line for each key that nobody asked for: a typing error, or meant for someone else.
  void WarnOfUnknown(std::vector<std::string>* warnings) const {
    std::string known;
    for (const std::string& name : known_) known += (known.empty() ? "" : ", ") + name;
    for (const auto& [name, value] : object_.items()) {
      if (known_.count(name) > 0) continue;
      warnings->push_back(source_ + ": " + path_ + name + ": unknown key, left alone (known: " + known + ")");
    }
  }

 private:
  std::set<std::string> known_;
  const Json& object_;
  std::string source_, path_;
  Status& status_;
};

void ReadJoints(Fields& fields, Manifest* manifest) {
  const Json* joints = fields.Array("joints", true);
  if (!joints) return;
  std::set<std::string> seen;
  for (size_t i = 0; i < joints->size(); ++i) {
    const Json& joint = (*joints)[i];
    const std::string place = "joints[" + std::to_string(i) + "]";
    if (!joint.is_string() || joint.get<std::string>().empty()) {
      return fields.Fail(place, Shown(joint) + " is not a joint's name");
    }
    manifest->joints.push_back(joint.get<std::string>());
    if (!seen.insert(manifest->joints.back()).second)
      return fields.Fail(place, Shown(joint) + " is there twice");
  }
  if (manifest->joints.empty()) fields.Fail("joints", "is empty");
}

void ReadGravity(Fields& fields, RecordingSet* set) {
  const Json* gravity = fields.Array("gravity", false);
  if (!gravity) return;
  if (gravity->size() != 3) return fields.Fail("gravity", Shown(*gravity) + ", must be 3 numbers in m/s^2");
  for (size_t i = 0; i < 3; ++i) {
    const Json& g = (*gravity)[i];
    const std::string place = "gravity[" + std::to_string(i) + "]";
    if (!g.is_number() || !std::isfinite(g.get<double>()))
      return fields.Fail(place, Shown(g) + " is not a number");
    set->gravity[static_cast<Eigen::Index>(i)] = g.get<double>();
  }
  const double size = set->gravity.norm();
  if (size > 0 && (size < kLeastGravity || size > kMostGravity))
    set->warnings.push_back("gravity in the manifest is " + Printf("%g", size) +
                            " m/s^2; on Earth it is 9.81");
  if (set->gravity.z() > 0.5 * size)
    set->warnings.push_back(
        "gravity in the manifest points up (+z of the URDF's base): a robot that hangs from a ceiling, or a "
        "sign");
}

void ReadLocked(Fields& fields, RecordingSet* set) {
  const Json* locked = fields.Object("locked");
  if (!locked) return;
  for (const auto& [joint, q] : locked->items()) {
    if (!q.is_number() || !std::isfinite(q.get<double>())) {
      return fields.Fail("locked." + joint, Shown(q) + " is not a position");
    }
    set->locked[joint] = q.get<double>();
  }
}

// Names among the manifest's joints; nothing where the field is missing.
std::optional<std::vector<std::string>> ReadSomeJoints(Fields& fields, const std::string& field,
                                                       const Manifest& manifest) {
  const Json* list = fields.Array(field, false);
  if (!list) return std::nullopt;
  std::vector<std::string> some;
  for (size_t i = 0; i < list->size(); ++i) {
    const Json& joint = (*list)[i];
    const std::string place = field + "[" + std::to_string(i) + "]";
    const bool known = joint.is_string() && std::count(manifest.joints.begin(), manifest.joints.end(),
                                                       joint.get<std::string>()) > 0;
    if (!known) {
      fields.Fail(place, Shown(joint) + " is not among joints: it needs columns");
    } else if (std::count(some.begin(), some.end(), joint.get<std::string>()) > 0) {
      fields.Fail(place, Shown(joint) + " is there twice");
    } else {
      some.push_back(joint.get<std::string>());
    }
  }
  return some;
}

// Joints that move as measured, and joints without a drive: no joint is both.
void ReadRoles(Fields& fields, Manifest* manifest) {
  RecordingSet& set = manifest->settings;
  const auto prescribed = ReadSomeJoints(fields, "prescribed", *manifest);
  set.prescribed_listed = prescribed.has_value();
  set.prescribed = prescribed.value_or(std::vector<std::string>{});
  set.passive = ReadSomeJoints(fields, "passive", *manifest);
  if (set.passive) std::sort(set.passive->begin(), set.passive->end());
  if (set.prescribed.size() == manifest->joints.size() && !manifest->joints.empty())
    fields.Fail("prescribed", "names every joint, nothing is left to model");
  for (const std::string& joint : set.passive.value_or(std::vector<std::string>{})) {
    if (std::count(set.prescribed.begin(), set.prescribed.end(), joint) > 0)
      fields.Fail("passive", "'" + joint + "' is among prescribed too");
  }
}

void ReadControl(Fields& fields, const std::string& source, Status* status, RecordingSet* set) {
  const Json* object = fields.Object("control");
  if (!object) return;
  Fields control(*object, source, "control.", status);
  set->control_rate_hz = control.Number("rate_hz", 0.0, false);
  const std::string hold = control.String("hold", "zero_order", false);
  if (hold == "linear") {
    set->control_hold = CommandHold::kLinear;
  } else if (hold != "zero_order") {
    control.Fail("hold", "'" + hold + "', must be zero_order or linear");
  }
  control.WarnOfUnknown(&set->warnings);
}

void ReadNoise(Fields& fields, const std::string& source, Status* status, RecordingSet* set) {
  const Json* object = fields.Object("noise");
  if (!object) return;
  Fields noise(*object, source, "noise.", status);
  set->noise.position_stddev = noise.Number("position_stddev", 0.0, true);
  set->noise.velocity_stddev = noise.Number("velocity_stddev", 0.0, true);
  set->noise.position_resolution = noise.Number("position_resolution", 0.0, true);
  noise.WarnOfUnknown(&set->warnings);
}

void ReadDrive(Fields& fields, RecordingSet* set) {
  const std::string drive = fields.String("drive", "", false);
  if (drive.empty()) return;
  if (drive == "effort_command") {
    set->drive = EffortKind::kCommand;
  } else if (drive == "effort_measured") {
    set->drive = EffortKind::kMeasured;
  } else {
    fields.Fail("drive", "'" + drive + "', must be effort_command or effort_measured");
  }
}

void ReadRecordings(Fields& fields, const std::string& source, Status* status, Manifest* manifest) {
  const Json* list = fields.Array("recordings", true);
  if (!list) return;
  if (list->empty()) return fields.Fail("recordings", "is empty");
  std::set<std::string> seen;
  for (size_t i = 0; i < list->size() && fields.ok(); ++i) {
    const std::string place = "recordings[" + std::to_string(i) + "]";
    if (!(*list)[i].is_object())
      return fields.Fail(
          place,
          Shown((*list)[i]) + " is not an object; write {\"file\": \"rec_000.csv\", \"split\": \"fit\"}");
    Fields entry((*list)[i], source, place + ".", status);
    ManifestEntry read;
    read.file = entry.String("file", "", true);
    const std::string split = entry.String("split", "fit", false);
    if (split != "fit" && split != "holdout") entry.Fail("split", "'" + split + "', must be fit or holdout");
    read.split = split == "holdout" ? Split::kHoldout : Split::kFit;
    if (!seen.insert(std::filesystem::path(read.file).lexically_normal().string()).second)
      entry.Fail("file", "'" + read.file + "' is there twice");
    manifest->recordings.push_back(read);
    entry.WarnOfUnknown(&manifest->settings.warnings);
  }
}

// No key twice: which of the values was meant, nobody knows.
Result<Json> ParseJson(std::string_view text, const std::string& source) {
  if (text.substr(0, 2) == "\xFF\xFE" || text.substr(0, 2) == "\xFE\xFF")
    return InvalidError(source + ": is UTF-16 text: save it as UTF-8");
  if (text.substr(0, 3) == "\xEF\xBB\xBF") text.remove_prefix(3);
  if (text.find_first_not_of(" \t\r\n") == std::string_view::npos)
    return InvalidError(source + ": the file is empty");
  std::vector<std::set<std::string>> keys;
  std::string twice;
  const auto watch = [&](int depth, Json::parse_event_t event, Json& parsed) {
    const auto at = static_cast<size_t>(depth);
    if (event == Json::parse_event_t::object_start) {
      keys.resize(at + 1);
      keys[at].clear();
    } else if (event == Json::parse_event_t::key && at >= 1 && at <= keys.size() &&
               !keys[at - 1].insert(parsed.get<std::string>()).second && twice.empty()) {
      twice = parsed.get<std::string>();
    }
    return true;
  };
  try {
    Json json = Json::parse(text, watch);
    if (!twice.empty()) return InvalidError(source + ": " + Shown(twice) + ": the key is there twice");
    return json;
  } catch (const Json::exception& e) {
    std::string what = e.what();
    what = what.substr(0, what.find('\n'));
    if (what.starts_with('[') && what.find("] ") != std::string::npos) what.erase(0, what.find("] ") + 2);
    return InvalidError(source + ": not JSON: " + what);
  }
}

}  // namespace

Result<Manifest> ParseManifest(std::string_view text, const std::string& source) {
  RG_ASSIGN_OR_RETURN(const Json json, ParseJson(text, source));
  if (!json.is_object()) return InvalidError(source + ": not a JSON object");
  Status status;
  Manifest manifest;
  Fields fields(json, source, "", &status);
  const std::string format = fields.String("format", "", true);
  if (status.ok() && format != kSetFormat) {
    fields.Fail("format", "'" + format + "' is not known, this program reads " + kSetFormat);
  }
  manifest.robot = fields.String("robot", "", true);
  if (manifest.robot.find("://") != std::string::npos)
    fields.Fail("robot", "'" + manifest.robot + "' is an address: name a URDF file, beside the manifest as a rule");
  ReadJoints(fields, &manifest);
  ReadGravity(fields, &manifest.settings);
  ReadLocked(fields, &manifest.settings);
  for (const std::string& joint : manifest.joints) {
    if (manifest.settings.locked.count(joint))
      fields.Fail("locked." + joint, "is one of joints, cannot be locked");
  }
  ReadRoles(fields, &manifest);
  manifest.settings.sample_rate_hz = fields.Number("sample_rate_hz", 0.0, false);
  ReadControl(fields, source, &status, &manifest.settings);
  ReadNoise(fields, source, &status, &manifest.settings);
  ReadDrive(fields, &manifest.settings);
  manifest.settings.effort_excludes_gravity = fields.Bool("effort_excludes_gravity", false);
  manifest.settings.effort_excludes_gravity_given = json.contains("effort_excludes_gravity");
  ReadRecordings(fields, source, &status, &manifest);
  if (!status.ok()) return status;
  fields.WarnOfUnknown(&manifest.settings.warnings);
  return manifest;
}

std::string FormatManifest(const RecordingSet& set, const std::string& robot_file) {
  nlohmann::ordered_json json;
  json["format"] = kSetFormat;
  json["robot"] = robot_file;
  json["joints"] = set.joints;
  json["gravity"] = {set.gravity.x(), set.gravity.y(), set.gravity.z()};
  if (!set.locked.empty()) json["locked"] = set.locked;
  if (set.sample_rate_hz) json["sample_rate_hz"] = *set.sample_rate_hz;
  if (set.control_rate_hz) {
    json["control"] = {{"rate_hz", *set.control_rate_hz},
                       {"hold", set.control_hold == CommandHold::kLinear ? "linear" : "zero_order"}};
  }
  const auto noise = [&](const char* name, const std::optional<double>& value) {
    if (value) json["noise"][name] = *value;
  };
  noise("position_stddev", set.noise.position_stddev);
  noise("velocity_stddev", set.noise.velocity_stddev);
  noise("position_resolution", set.noise.position_resolution);
  if (set.drive) json["drive"] = *set.drive == EffortKind::kMeasured ? "effort_measured" : "effort_command";
  if (set.prescribed_listed || !set.prescribed.empty()) json["prescribed"] = set.prescribed;
  if (set.passive) json["passive"] = *set.passive;
  if (set.effort_excludes_gravity || set.effort_excludes_gravity_given)
    json["effort_excludes_gravity"] = set.effort_excludes_gravity;
  json["recordings"] = nlohmann::ordered_json::array();
  for (const Recording& r : set.recordings) {
    json["recordings"].push_back(
        {{"file", r.name}, {"split", r.split == Split::kHoldout ? "holdout" : "fit"}});
  }
  return json.dump(1) + "\n";
}

}  // namespace rg::recordings
