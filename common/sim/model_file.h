// model.json, "realitygrad.model/1": a plant with its parameter values, self-contained (the URDF text
// is inside). What `diagnose` writes and `predict`, `sysid`, trajectory generation and the simulated
// robot read.
#pragma once

#include <Eigen/Core>
#include <string>
#include <string_view>

#include "common/base/status.h"
#include "common/sim/plant.h"

namespace rg::sim {

struct ModelFile {
  Plant plant;
  Eigen::VectorXd values;  // plant.parameters().size()
  int version = 0;         // the parameter version it was exported from, 0 if none
  // What its drives follow, where they are late, before a recording of a robot at rest begins: the command
  // that held it there, or the first one of the recording.
  bool held_before = true;
};

std::string ModelToJson(const Plant& plant, const Eigen::VectorXd& values, int version = 0,
                        bool held_before = true);
// `source` names the text in errors, which also name the field.
Result<ModelFile> ModelFromJson(std::string_view text, const std::string& source);

Result<ModelFile> LoadModelFile(const std::string& path);
Status SaveModelFile(const std::string& path, const Plant& plant, const Eigen::VectorXd& values,
                     int version = 0, bool held_before = true);

}  // namespace rg::sim
