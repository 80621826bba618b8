#include "services/importing/import_map.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <set>

#include "services/importing/log.h"

namespace rg::importing {
namespace {

using Json = nlohmann::json;

// Of the recordings' contract: they make a manifest with what "manifest" adds.
const char* const kOwnManifestKeys[] = {"format", "robot", "joints", "recordings"};

std::string ShownJson(const Json& value) {
  const std::string text = value.dump(-1, ' ', true, Json::error_handler_t::replace);
  return text.size() > 60 ? text.substr(0, 57) + "..." : text;
}

bool IsColumnName(const std::string& name) {
  return !name.empty() && name != "time" && std::all_of(name.begin(), name.end(), [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_';
  });
}

class MapParser {
 public:
  explicit MapParser(std::string source) : source_(std::move(source)) {}

  Result<ImportMap> Parse(std::string_view text) {
    if (text.substr(0, 3) == "\xEF\xBB\xBF") text.remove_prefix(3);
    Json json;
    try {
      json = Json::parse(text);
    } catch (const Json::exception& e) {
      std::string what = e.what();
      what = what.substr(0, what.find('\n'));
      if (what.starts_with('[') && what.find("] ") != std::string::npos) what.erase(0, what.find("] ") + 2);
      return InvalidError(source_ + ": not JSON: " + what);
    }
    if (!json.is_object()) return InvalidError(source_ + ": not a JSON object");
    RefuseUnknown(json, MapKeys(), "");
    const std::string format = Text(json, "format", "", true);
    if (status_.ok() && format != kImportMapFormat)
      Fail("format", "'" + format + "' is not known, this program reads " + kImportMapFormat);
    map_.note = Text(json, "note", "", false);
    ReadTime(json);
    ReadManifest(json);
    ReadColumns(json);
    if (!status_.ok()) return status_;
    return std::move(map_);
  }

 private:
  void Fail(const std::string& field, const std::string& what) {
    if (status_.ok()) status_ = InvalidError(source_ + ": " + field + ": " + what);
  }

  void RefuseUnknown(const Json& object, const std::vector<std::string>& known, const std::string& path) {
    std::string list;
    for (const std::string& key : known) list += (list.empty() ? "" : ", ") + key;
    for (const auto& [key, value] : object.items()) {
      if (std::find(known.begin(), known.end(), key) == known.end())
        Fail(path + key, "unknown key (known: " + list + ")");
    }
  }

  std::string Text(const Json& object, const std::string& key, const std::string& path, bool required) {
    const auto found = object.find(key);
    if (found == object.end()) {
      if (required) Fail(path + key, "is missing");
      return "";
    }
    if (!found->is_string() || (required && found->get_ref<const std::string&>().empty())) {
      Fail(path + key, ShownJson(*found) + " is not a text");
      return "";
    }
    return found->get<std::string>();
  }

  double Number(const Json& object, const std::string& key, const std::string& path, double fallback) {
    const auto found = object.find(key);
    if (found == object.end()) return fallback;
    if (!found->is_number() || !std::isfinite(found->get<double>())) {
      Fail(path + key, ShownJson(*found) + " is not a number");
      return fallback;
    }
    return found->get<double>();
  }

  // A text, or a list of texts that are there once each.
  std::vector<std::string> Texts(const Json& object, const std::string& key, const std::string& path,
                                 bool required) {
    const auto found = object.find(key);
    if (found == object.end()) {
      if (required) Fail(path + key, "is missing");
      return {};
    }
    const Json list = found->is_array() ? *found : Json::array({*found});
    std::vector<std::string> texts;
    for (const Json& text : list) {
      if (!text.is_string() || text.get_ref<const std::string&>().empty()) {
        Fail(path + key, ShownJson(text) + " is not a text");
        return {};
      }
      if (std::find(texts.begin(), texts.end(), text.get<std::string>()) != texts.end())
        Fail(path + key, ShownJson(text) + " is there twice");
      texts.push_back(text.get<std::string>());
    }
    if (texts.empty()) Fail(path + key, "is empty");
    return texts;
  }

  void ReadTime(const Json& json) {
    const auto found = json.find("time");
    if (found == json.end()) return;
    if (!found->is_object()) return Fail("time", ShownJson(*found) + " is not an object");
    RefuseUnknown(*found, {"column", "unit"}, "time.");
    TimeColumn time;
    time.column = Text(*found, "column", "time.", true);
    if (found->contains("unit")) time.unit = Text(*found, "unit", "time.", true);
    if (TimeUnitNs(time.unit) == 0.0) Fail("time.unit", "'" + time.unit + "' is not known (s, ms, us, ns)");
    map_.time = time;
  }

  void ReadManifest(const Json& json) {
    const auto found = json.find("manifest");
    if (found == json.end()) return;
    if (!found->is_object()) return Fail("manifest", ShownJson(*found) + " is not an object");
    for (const char* key : kOwnManifestKeys) {
      if (found->contains(key)) Fail(std::string("manifest.") + key, "is written by the import");
    }
    map_.manifest_json = found->dump();
  }

  void ReadColumns(const Json& json) {
    const auto found = json.find("columns");
    if (found == json.end()) return Fail("columns", "is missing");
    if (!found->is_array() || found->empty()) return Fail("columns", "is not a list of at least one column");
    for (size_t i = 0; i < found->size() && status_.ok(); ++i) {
      const std::string path = "columns[" + std::to_string(i) + "]";
      if (!(*found)[i].is_object()) return Fail(path, ShownJson((*found)[i]) + " is not an object");
      ReadEntry((*found)[i], path + ".");
    }
  }

  void ReadEntry(const Json& json, const std::string& path) {
    RefuseUnknown(json, MapEntryKeys(), path);
    MapEntry entry;
    entry.topic = Text(json, "topic", path, false);
    entry.fields = Texts(json, "field", path, true);
    entry.joints = Texts(json, "joint", path, false);
    entry.column = Text(json, "column", path, true);
    entry.scale = Number(json, "scale", path, 1.0);
    entry.offset = Number(json, "offset", path, 0.0);
    entry.clock = Text(json, "clock", path, false);
    entry.note = Text(json, "note", path, false);
    if (json.contains("unit")) {
      const auto unit = ParseUnit(Text(json, "unit", path, true));
      if (unit.ok()) {
        entry.unit = *unit;
      } else {
        Fail(path + "unit", unit.status().message());
      }
    }
    if (json.contains("hold")) {
      const std::string hold = Text(json, "hold", path, true);
      if (hold != "linear" && hold != "zero_order")
        Fail(path + "hold", "'" + hold + "', must be linear or zero_order");
      entry.hold = hold == "linear" ? Hold::kLinear : Hold::kZeroOrder;
    }
    CheckEntry(entry, path);
    map_.entries.push_back(std::move(entry));
  }

  void CheckEntry(const MapEntry& entry, const std::string& path) {
    if (!status_.ok()) return;
    const std::string& column = entry.column;
    if (!IsColumnName(column))
      Fail(path + "column", Shown(column) + " must be made of letters, digits and _, and not be time");
    if (IsDrivenKind(column) && entry.joints.empty())
      Fail(path + "joint", "is missing: a " + column + " is a joint's");
    if (entry.scale == 0.0) Fail(path + "scale", "0 makes every value 0");
    const bool star = entry.fields.size() == 1 && entry.fields[0].find("[*]") != std::string::npos;
    for (const std::string& field : entry.fields) {
      if (!star && field.find("[*]") != std::string::npos) Fail(path + "field", "[*] in a list of fields");
    }
    if (star && entry.joints.empty()) Fail(path + "joint", "is missing: [*] takes an element for each joint");
    if (!star && entry.joints == std::vector<std::string>{"*"})
      Fail(path + "joint", "* needs a field with [*]");
    if (entry.joints.size() > 1 &&
        std::find(entry.joints.begin(), entry.joints.end(), "*") != entry.joints.end())
      Fail(path + "joint", "* in a list of joints");
    const size_t takes = std::max<size_t>(entry.joints.size(), 1);
    if (!star && entry.fields.size() != takes) {
      Fail(path + "field", std::to_string(entry.fields.size()) + " fields for " + std::to_string(takes) +
                               (entry.joints.empty() ? " column" : " joints"));
    }
  }

  static bool IsDrivenKind(const std::string& column) {
    return column == "position" || column == "velocity" || column == "effort_command" ||
           column == "effort_measured";
  }

  std::string source_;
  Status status_;
  ImportMap map_;
};

Json OneOrMany(const std::vector<std::string>& texts) {
  return texts.size() == 1 ? Json(texts[0]) : Json(texts);
}

}  // namespace

std::vector<std::string> MapKeys() { return {"format", "note", "time", "columns", "manifest"}; }
std::vector<std::string> MapEntryKeys() {
  return {"topic", "field", "joint", "column", "unit", "clock", "scale", "offset", "hold", "note"};
}

double TimeUnitNs(const std::string& unit) {
  return unit == "s" ? 1e9 : unit == "ms" ? 1e6 : unit == "us" ? 1e3 : unit == "ns" ? 1.0 : 0.0;
}

Hold HoldOf(const MapEntry& entry) {
  if (entry.hold) return *entry.hold;
  const auto ends_in = [&](std::string_view end) {
    return entry.column.size() >= end.size() &&
           entry.column.compare(entry.column.size() - end.size(), end.size(), end) == 0;
  };
  return ends_in("_command") || ends_in("_reference") ? Hold::kZeroOrder : Hold::kLinear;
}

Result<ImportMap> ParseImportMap(std::string_view text, const std::string& source_name) {
  return MapParser(source_name).Parse(text);
}

std::string FormatImportMap(const ImportMap& map) {
  nlohmann::ordered_json json;
  json["format"] = kImportMapFormat;
  if (!map.note.empty()) json["note"] = map.note;
  if (map.time) json["time"] = {{"column", map.time->column}, {"unit", map.time->unit}};
  json["columns"] = nlohmann::ordered_json::array();
  for (const MapEntry& entry : map.entries) {
    nlohmann::ordered_json column;
    if (!entry.topic.empty()) column["topic"] = entry.topic;
    column["field"] = OneOrMany(entry.fields);
    if (!entry.joints.empty()) column["joint"] = OneOrMany(entry.joints);
    column["column"] = entry.column;
    if (entry.unit) column["unit"] = entry.unit->name;
    if (!entry.clock.empty()) column["clock"] = entry.clock;
    if (entry.scale != 1.0) column["scale"] = entry.scale;
    if (entry.offset != 0.0) column["offset"] = entry.offset;
    if (entry.hold) column["hold"] = *entry.hold == Hold::kLinear ? "linear" : "zero_order";
    if (!entry.note.empty()) column["note"] = entry.note;
    json["columns"].push_back(column);
  }
  const Json manifest = Json::parse(map.manifest_json);
  if (!manifest.empty()) json["manifest"] = nlohmann::ordered_json::parse(map.manifest_json);
  return json.dump(1) + "\n";
}

}  // namespace rg::importing
