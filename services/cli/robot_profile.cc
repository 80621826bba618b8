#include "services/cli/robot_profile.h"

#include <algorithm>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "common/base/file.h"
#include "common/base/json_fields.h"

namespace rg::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr char kSuffix[] = ".robot.json";

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
  RobotProfile profile;
  JsonFields fields(file, "name urdf joints home end_effector peak_torque truth", path + ": ");
  fields.Require("name", &profile.name);
  fields.Require("urdf", &profile.urdf);
  fields.Read("joints", &profile.joints);
  fields.Read("home", &profile.home);
  fields.Read("end_effector", &profile.end_effector);
  fields.Read("peak_torque", &profile.peak_torque);
  fields.Read("truth", &profile.truth);
  RG_RETURN_IF_ERROR(fields.status());
  profile.folder = fs::path(path).parent_path();
  for (std::string* beside : {&profile.urdf, &profile.truth}) {
    if (!beside->empty()) *beside = fs::path(profile.folder) / *beside;
  }
  if (!profile.joints.empty() && !profile.home.empty() && profile.home.size() != profile.joints.size()) {
    return InvalidError(path + ": 'home' has " + std::to_string(profile.home.size()) + " numbers for " +
                        std::to_string(profile.joints.size()) + " joints");
  }
  return profile;
}

}  // namespace rg::cli
