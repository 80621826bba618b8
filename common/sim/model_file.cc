#include "common/sim/model_file.h"

#include <cmath>
#include <nlohmann/json.hpp>

#include "common/base/file.h"
#include "common/model/robot_model.h"
#include "common/model/urdf_loader.h"

namespace rg::sim {
namespace {

using nlohmann::json;

constexpr char kFormat[] = "realitygrad.model/1";

json EffectsJson(const Plant& plant) {
  json list = json::array();
  for (const effects::EffectSpec& spec : plant.effects()) {
    list.push_back(
        {{"effect", spec.id}, {"joints", spec.joints}, {"values", spec.values}, {"options", spec.options}});
  }
  return list;
}

json ParametersJson(const Plant& plant, const Eigen::VectorXd& values) {
  json list = json::array();
  for (int i = 0; i < plant.parameters().size(); ++i) {
    const Parameter& row = plant.parameters()[i];
    list.push_back({{"name", row.name}, {"value", values[i]}, {"unit", row.unit}});
  }
  return list;
}

Result<std::shared_ptr<const model::RobotModel>> RobotFrom(const json& robot, const std::string& source) {
  model::LoadOptions options;
  options.joints = robot.at("joints").get<std::vector<std::string>>();
  options.locked = robot.value("locked", std::map<std::string, double>{});
  options.end_effector = robot.value("end_effector", std::string());
  RG_ASSIGN_OR_RETURN(model::RobotModel loaded, model::ParseUrdf(robot.at("urdf").get<std::string>(),
                                                                 source + ": robot.urdf", options));
  return std::make_shared<const model::RobotModel>(std::move(loaded));
}

std::vector<effects::EffectSpec> EffectsFrom(const json& list) {
  std::vector<effects::EffectSpec> specs;
  for (const json& item : list) {
    effects::EffectSpec spec;
    item.at("effect").get_to(spec.id);
    spec.joints = item.value("joints", std::vector<std::string>{});
    spec.values = item.value("values", decltype(spec.values){});
    spec.options = item.value("options", decltype(spec.options){});
    specs.push_back(std::move(spec));
  }
  return specs;
}

Status TakeValues(const json& list, const Plant& plant, const std::string& source, Eigen::VectorXd* values) {
  for (const json& item : list) {
    const std::string name = item.at("name");
    const auto index = plant.parameters().IndexOf(name);
    if (!index.ok()) return InvalidError(source + ": parameters: " + index.status().message());
    const json& value = item.at("value");
    if (!value.is_number() || !std::isfinite(value.get<double>())) {
      return InvalidError(source + ": parameters: " + name + " is " + value.dump() +
                          ", must be a finite number");
    }
    (*values)[*index] = value;
  }
  return Status::Ok();
}

Result<ModelFile> FromJson(const json& file, const std::string& source) {
  if (!file.is_object()) return InvalidError(source + ": not a JSON object");
  if (file.value("format", json()) != kFormat) {
    return InvalidError(source + ": format is " + file.value("format", json()).dump() + ", must be \"" +
                        kFormat + "\"");
  }
  RG_ASSIGN_OR_RETURN(auto robot, RobotFrom(file.at("robot"), source));
  PlantOptions options;
  const auto gravity = file.at("gravity").get<std::vector<double>>();
  if (gravity.size() != 3)
    return InvalidError(source + ": gravity has " + std::to_string(gravity.size()) + " numbers, must have 3");
  options.gravity = Eigen::Vector3d(gravity[0], gravity[1], gravity[2]);
  auto plant = Plant::Create(std::move(robot), options, EffectsFrom(file.value("effects", json::array())));
  if (!plant.ok()) return plant.status().WithPrefix(source);
  Eigen::VectorXd values = plant->parameters().Nominal();
  RG_RETURN_IF_ERROR(TakeValues(file.value("parameters", json::array()), *plant, source, &values));
  return ModelFile{*std::move(plant), std::move(values), file.value("version", 0)};
}

}  // namespace

std::string ModelToJson(const Plant& plant, const Eigen::VectorXd& values, int version) {
  const Eigen::Vector3d& g = plant.options().gravity;
  const model::RobotModel& robot = plant.model();
  nlohmann::ordered_json file;
  file["format"] = kFormat;
  file["version"] = version;
  file["gravity"] = {g.x(), g.y(), g.z()};
  file["effects"] = EffectsJson(plant);
  file["parameters"] = ParametersJson(plant, values);
  file["robot"] = {{"name", robot.name()},
                   {"joints", plant.joint_names()},
                   {"locked", robot.locked()},
                   {"end_effector", robot.end_effector().name},
                   {"urdf", robot.urdf_text()}};
  return file.dump(1);
}

Result<ModelFile> ModelFromJson(std::string_view text, const std::string& source) {
  try {
    return FromJson(json::parse(text), source);
  } catch (const json::exception& error) {
    return InvalidError(source + ": " + error.what());
  }
}

Result<ModelFile> LoadModelFile(const std::string& path) {
  RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  return ModelFromJson(text, path);
}

Status SaveModelFile(const std::string& path, const Plant& plant, const Eigen::VectorXd& values,
                     int version) {
  return WriteFileAtomically(path, ModelToJson(plant, values, version));
}

}  // namespace rg::sim
