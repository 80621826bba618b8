// Which model or other artefact a job starts from, and how a model gets to the coordinator.
#pragma once

#include <memory>
#include <string>

#include "common/base/status.h"
#include "services/cli/robot_profile.h"

namespace rg::coordinator {
class Client;
}
namespace rg::model {
class RobotModel;
}

namespace rg::cli {

Result<std::shared_ptr<const model::RobotModel>> LoadRobot(const RobotProfile& profile);
// The profile's URDF with its own parameters, as model.json.
Result<std::string> NominalModelJson(const RobotProfile& profile);

// Artefact of the model to use: `choice` is "nominal", "latest" (the robot's current version: the
// promoted one, else the newest that is not held back; nominal if there is none), a model.json file, or the hash of
// a model artefact.
Result<std::string> ChooseModel(coordinator::Client& client, const RobotProfile& profile,
                                const std::string& choice);

// Artefact of a model.json, which must be one.
Result<std::string> PutModelFile(coordinator::Client& client, const std::string& path);

// Full hash of an artefact of the kind, named by hash or prefix; "latest" or nothing: the newest one.
Result<std::string> FindArtifact(coordinator::Client& client, const std::string& named,
                                 const std::string& kind);

}  // namespace rg::cli
