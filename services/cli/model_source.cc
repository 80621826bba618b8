#include "services/cli/model_source.h"

#include <filesystem>

#include "common/base/file.h"
#include "common/model/robot_model.h"
#include "common/model/urdf_loader.h"
#include "common/sim/model_file.h"
#include "common/sim/plant.h"
#include "coordinator/client/client.h"
#include "realitygrad/v1/artifact.pb.h"
#include "services/jobs/kinds.h"

namespace rg::cli {
namespace {

namespace pb = ::realitygrad::v1;

Result<std::string> Upload(coordinator::Client& client, const std::string& model_json) {
  pb::ArtifactInfo info;
  info.set_kind(jobs::kArtifactModel);
  info.set_metadata_json("{}");
  return client.PutArtifact(model_json, info);
}

// Of the robot's current version (Client::CurrentParameters). Empty: it has none.
Result<std::string> CurrentModel(coordinator::Client& client, const std::string& robot) {
  const auto version = client.CurrentParameters(robot);
  if (!version.ok() && version.status().code() == StatusCode::kNotFound) return std::string();
  if (!version.ok()) return version.status();
  return version->model_sha256();
}

// A driven link without inertia moves by its drive's rotor alone, which only recordings tell.
Status CheckRuns(const sim::Plant& plant, const std::string& urdf) {
  for (const int i : plant.parameters().OfKind(sim::ParameterKind::kArmature)) {
    const sim::Parameter& rotor = plant.parameters()[i];
    if (rotor.nominal > 0) continue;
    return InvalidError(urdf + ": the link on joint '" + rotor.owner +
                        "' has no inertia about its axis and cannot be simulated: give it an <inertial>, or the model "
                        "that `realitygrad sysid` makes of recordings, with the rotor inertia of its drive (" +
                        rotor.name + ")");
  }
  return Status::Ok();
}

}  // namespace

Result<std::shared_ptr<const model::RobotModel>> LoadRobot(const RobotProfile& profile) {
  model::LoadOptions options;
  options.joints = profile.joints;
  options.end_effector = profile.end_effector;
  RG_ASSIGN_OR_RETURN(model::RobotModel robot, model::LoadUrdf(profile.urdf, options));
  if (!profile.home.empty() && static_cast<int>(profile.home.size()) != robot.num_joints()) {
    return InvalidError(profile.name + ": 'home' has " + std::to_string(profile.home.size()) +
                        " numbers for " + std::to_string(robot.num_joints()) + " joints");
  }
  return std::make_shared<const model::RobotModel>(std::move(robot));
}

Result<std::string> NominalModelJson(const RobotProfile& profile) {
  RG_ASSIGN_OR_RETURN(auto robot, LoadRobot(profile));
  RG_ASSIGN_OR_RETURN(const sim::Plant plant, sim::Plant::Create(robot));
  RG_RETURN_IF_ERROR(CheckRuns(plant, profile.urdf));
  return sim::ModelToJson(plant, plant.parameters().Nominal());
}

Result<std::string> ChooseModel(coordinator::Client& client, const RobotProfile& profile,
                                const std::string& choice) {
  if (choice == "latest") {
    RG_ASSIGN_OR_RETURN(const std::string current, CurrentModel(client, profile.name));
    if (!current.empty()) return current;
  }
  if (choice == "latest" || choice == "nominal") {
    RG_ASSIGN_OR_RETURN(const std::string nominal, NominalModelJson(profile));
    return Upload(client, nominal);
  }
  if (std::filesystem::exists(choice)) return PutModelFile(client, choice);
  RG_ASSIGN_OR_RETURN(const auto info, client.ShowArtifact(choice));
  if (info.kind() != jobs::kArtifactModel) {
    return InvalidError("artefact " + info.sha256().substr(0, 12) + " is a " + info.kind() + ", not a model");
  }
  return info.sha256();
}

Result<std::string> PutModelFile(coordinator::Client& client, const std::string& path) {
  RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  RG_RETURN_IF_ERROR(sim::ModelFromJson(text, path).status());
  return Upload(client, text);
}

Result<std::string> FindArtifact(coordinator::Client& client, const std::string& named,
                                 const std::string& kind) {
  if (named.empty() || named == "latest") {
    RG_ASSIGN_OR_RETURN(const auto newest, client.ListArtifacts(kind, 0, 1));
    if (newest.empty()) return NotFoundError("no artefact of kind '" + kind + "' yet");
    return newest.front().sha256();
  }
  RG_ASSIGN_OR_RETURN(const auto info, client.ShowArtifact(named));
  if (info.kind() != kind) {
    return InvalidError("artefact " + named + " is a " + info.kind() + ", not a " + kind);
  }
  return info.sha256();
}

}  // namespace rg::cli
