#include "services/cli/robot_profile.h"

#include <algorithm>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "common/base/file.h"

namespace rg::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr char kSuffix[] = ".robot.json";

Status ReadStrings(const json& value, const std::string& where, std::vector<std::string>* out) {
  if (!value.is_array()) return InvalidError(where + ": must be a list of names");
  for (const json& item : value) {
    if (!item.is_string()) return InvalidError(where + ": " + item.dump() + " is not a name");
    out->push_back(item);
  }
  return Status::Ok();
}

Status ReadNumbers(const json& value, const std::string& where, std::vector<double>* out) {
  if (!value.is_array()) return InvalidError(where + ": must be a list of numbers");
  for (const json& item : value) {
    if (!item.is_number()) return InvalidError(where + ": " + item.dump() + " is not a number");
    out->push_back(item);
  }
  return Status::Ok();
}

Status ReadField(const std::string& path, const std::string& key, const json& value, RobotProfile* profile) {
  const std::string where = path + ": '" + key + "'";
  if (key == "joints") return ReadStrings(value, where, &profile->joints);
  if (key == "home") return ReadNumbers(value, where, &profile->home);
  if (key == "peak_torque") return ReadNumbers(value, where, &profile->peak_torque);
  if (!value.is_string()) return InvalidError(where + ": must be a string");
  const std::string beside = fs::path(path).parent_path() / value.get<std::string>();
  if (key == "name") {
    profile->name = value;
  } else if (key == "urdf") {
    profile->urdf = beside;
  } else if (key == "end_effector") {
    profile->end_effector = value;
  } else if (key == "truth") {
    profile->truth = beside;
  } else {
    return InvalidError(path + ": unknown field '" + key + "'");
  }
  return Status::Ok();
}

}  // namespace

Result<std::vector<std::string>> ListRobotProfiles(const std::string& folder) {
  std::error_code error;
  std::vector<std::string> names;
  for (const auto& entry : fs::directory_iterator(folder, error)) {
    const std::string file = entry.path().filename();
    if (file.size() > sizeof(kSuffix) - 1 && file.ends_with(kSuffix))
      names.push_back(file.substr(0, file.size() - (sizeof(kSuffix) - 1)));
  }
  if (error) return NotFoundError(folder + ": " + error.message());
  std::sort(names.begin(), names.end());
  return names;
}

Result<RobotProfile> LoadRobotProfile(const std::string& folder, const std::string& name) {
  const bool is_path = name.find('/') != std::string::npos || name.ends_with(".json");
  const std::string path = is_path ? name : folder + "/" + name + kSuffix;
  auto text = ReadFile(path);
  if (!text.ok()) {
    std::string known;
    const auto names = ListRobotProfiles(folder);
    if (names.ok()) {
      for (const std::string& n : *names) known += " " + n;
    }
    return NotFoundError("robot '" + name + "': " + path + " is not there (known robots:" + known + ")");
  }
  const json file = json::parse(*text, nullptr, false);
  if (!file.is_object()) return InvalidError(path + ": not a JSON object");
  RobotProfile profile;
  profile.folder = fs::path(path).parent_path();
  for (const auto& [key, value] : file.items()) RG_RETURN_IF_ERROR(ReadField(path, key, value, &profile));
  if (profile.urdf.empty()) return InvalidError(path + ": 'urdf' is missing");
  if (profile.name.empty()) return InvalidError(path + ": 'name' is missing");
  if (!profile.joints.empty() && !profile.home.empty() && profile.home.size() != profile.joints.size()) {
    return InvalidError(path + ": 'home' has " + std::to_string(profile.home.size()) + " numbers for " +
                        std::to_string(profile.joints.size()) + " joints");
  }
  return profile;
}

}  // namespace rg::cli
