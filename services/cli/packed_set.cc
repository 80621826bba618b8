#include "services/cli/packed_set.h"

#include <nlohmann/json.hpp>

#include "common/base/file.h"
#include "common/recordings/csv.h"
#include "common/recordings/recording_set.h"
#include "services/rollouts/recording_bundle.h"

namespace rg::cli {

using nlohmann::json;

namespace {

// What the manifest names, and the manifest; the set is read first, so that a bad one is refused here.
Result<std::string> Packed(const std::string& folder) {
  RG_RETURN_IF_ERROR(recordings::LoadSet(folder).status());
  RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(folder + "/manifest.json"));
  const json manifest = json::parse(text);
  rollouts::Bundle bundle = {{"manifest.json", text}};
  const auto add = [&](const std::string& name) -> Status {
    RG_ASSIGN_OR_RETURN(bundle[name], ReadFile(folder + "/" + name));
    return Status::Ok();
  };
  RG_RETURN_IF_ERROR(add(manifest.at("robot").get<std::string>()));
  for (const json& recording : manifest.at("recordings"))
    RG_RETURN_IF_ERROR(add(recording.at("file").get<std::string>()));
  for (const auto& [name, bytes] : bundle) {
    if (name.find('/') != std::string::npos)
      return InvalidError(folder + "/manifest.json: " + name + " is not in the set's own folder");
  }
  return rollouts::PackBundle(bundle);
}

}  // namespace

Result<std::string> PackedSet(const SetArguments& arguments) {
  if (arguments.is_one_plain_folder()) return Packed(arguments.sets.front());
  RG_ASSIGN_OR_RETURN(const recordings::RecordingSet set, arguments.Load(/*keep_whole=*/true));
  rollouts::Bundle bundle = {{"manifest.json", recordings::FormatManifest(set, "robot.urdf")},
                             {"robot.urdf", set.urdf_text}};
  for (const recordings::Recording& recording : set.recordings)
    bundle[recording.name] = recordings::FormatCsv(recording);
  return rollouts::PackBundle(bundle);
}

}  // namespace rg::cli
