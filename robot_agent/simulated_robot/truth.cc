#include "robot_agent/simulated_robot/truth.h"

#include <filesystem>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>

#include "common/base/file.h"
#include "common/base/json_fields.h"
#include "common/model/urdf_loader.h"
#include "common/sim/model_file.h"

namespace rg::robot_agent {
namespace {

using nlohmann::json;

constexpr double kAny = std::numeric_limits<double>::infinity();

// One number per joint; absent: what `values` has.
void ReadJoints(JsonFields& fields, const char* field, int n, double least, Eigen::VectorXd* values) {
  std::vector<double> read(values->data(), values->data() + values->size());
  fields.Numbers(field, n, least, kAny, &read);
  *values = Eigen::Map<const Eigen::VectorXd>(read.data(), static_cast<Eigen::Index>(read.size()));
}

Result<effects::EffectSpec> ReadEffect(const json& entry) {
  JsonFields fields(entry, "effect joints parameters options", "effects: ");
  effects::EffectSpec spec;
  json parameters = json::object();
  fields.Require("effect", &spec.id);
  fields.Read("joints", &spec.joints);
  fields.Read("options", &spec.options);
  fields.Read("parameters", &parameters);
  RG_RETURN_IF_ERROR(fields.status());
  for (const auto& [name, value] : parameters.items()) {
    if (spec.joints.empty() || !value.is_array()) {
      for (const auto& joint : spec.joints) spec.values[joint][name] = value.get<double>();
      if (spec.joints.empty()) spec.values["*"][name] = value.get<double>();
      continue;
    }
    if (value.size() != spec.joints.size())
      return InvalidError("effects: " + spec.id + "." + name + " has " + std::to_string(value.size()) +
                          " values for " + std::to_string(spec.joints.size()) + " joints");
    for (size_t i = 0; i < value.size(); ++i) spec.values[spec.joints[i]][name] = value[i].get<double>();
  }
  return spec;
}

Result<std::vector<effects::EffectSpec>> ReadEffects(const json& root) {
  std::vector<effects::EffectSpec> effects;
  for (const char* list : {"effects", "more_effects"}) {
    for (const auto& entry : root.value(list, json::array())) {
      RG_ASSIGN_OR_RETURN(effects::EffectSpec spec, ReadEffect(entry));
      effects.push_back(std::move(spec));
    }
  }
  return effects;
}

// From "model": what a diagnosis or an identification wrote, and the effects beside it.
Result<sim::ModelFile> ReadModel(const json& root, const std::string& path) {
  for (const char* field : {"urdf", "joints", "locked", "gravity"})
    if (root.contains(field))
      return InvalidError("\"model\" holds the robot already: \"" + std::string(field) +
                          "\" is one too many");
  const auto file = std::filesystem::path(path).parent_path() / root.at("model").get<std::string>();
  RG_ASSIGN_OR_RETURN(sim::ModelFile model, sim::LoadModelFile(file.string()));
  RG_ASSIGN_OR_RETURN(const auto effects, ReadEffects(root));
  sim::Plant plant = model.plant;
  for (const effects::EffectSpec& spec : effects) {
    RG_ASSIGN_OR_RETURN(plant, plant.WithEffect(spec));
  }
  Eigen::VectorXd values = plant.ValuesFrom(model.plant.parameters(), model.values);
  return sim::ModelFile{std::move(plant), std::move(values), model.version};
}

Result<sim::Plant> ReadPlant(const json& root, const std::string& path) {
  const auto urdf = std::filesystem::path(path).parent_path() / root.at("urdf").get<std::string>();
  model::LoadOptions load;
  load.joints = root.value("joints", std::vector<std::string>{});
  load.locked = root.value("locked", std::map<std::string, double>{});
  RG_ASSIGN_OR_RETURN(auto model, model::LoadUrdf(urdf.string(), load));
  sim::PlantOptions options;
  if (root.contains("gravity")) {
    const auto gravity = root.at("gravity").get<std::vector<double>>();
    if (gravity.size() != 3) return InvalidError("gravity needs three numbers");
    options.gravity = Eigen::Vector3d(gravity[0], gravity[1], gravity[2]);
  }
  RG_ASSIGN_OR_RETURN(auto effects, ReadEffects(root));
  return sim::Plant::Create(std::make_shared<const model::RobotModel>(std::move(model)), options,
                            std::move(effects));
}

Status ReadParameters(const json& root, const std::string& list, const sim::Plant& plant,
                      Eigen::VectorXd* values) {
  const json departures = root.value(list, json::object());
  for (const auto& [name, departure] : departures.items()) {
    RG_RETURN_IF_ERROR(JsonFields(departure, "scale add value", list + "." + name + ": ").status());
    RG_ASSIGN_OR_RETURN(const int index, plant.parameters().IndexOf(name));
    if (departure.contains("value")) (*values)[index] = departure["value"].get<double>();
    (*values)[index] = (*values)[index] * departure.value("scale", 1.0) + departure.value("add", 0.0);
  }
  return plant.parameters().Validate(*values).WithPrefix(list);
}

Status ReadBase(const json& root, RobotTruth* truth) {
  const std::string compensation = root.value("gravity_compensation", "none");
  if (compensation == "nominal") {
    truth->compensation = GravityCompensation::kNominal;
  } else if (compensation == "true") {
    truth->compensation = GravityCompensation::kTrue;
  } else if (compensation == "given") {
    truth->compensation = GravityCompensation::kGiven;
    truth->compensation_values = truth->plant.parameters().Nominal();
    RG_RETURN_IF_ERROR(
        ReadParameters(root, "compensation_parameters", truth->plant, &truth->compensation_values));
  } else if (compensation != "none") {
    return InvalidError("gravity_compensation is \"" + compensation +
                        "\", needs none, nominal, true or given");
  }
  if (!root.contains("silence")) return Status::Ok();
  JsonFields silence(root.at("silence"), "timeout_s action", "silence: ");
  silence.Number("timeout_s", 0.01, 60, &truth->silence_timeout_s);
  std::string action = "position_mode";
  silence.Read("action", &action);
  if (action != "position_mode" && action != "zero_torque")
    silence.Fail("action is \"" + action + "\", needs position_mode or zero_torque");
  truth->silence_action = action == "zero_torque" ? SilenceAction::kZeroTorque : SilenceAction::kPositionMode;
  return silence.status();
}

Status ReadPositionController(const json& root, RobotTruth* truth) {
  JsonFields control(root.at("position_controller"), "stiffness damping speed", "position_controller: ");
  ReadJoints(control, "stiffness", truth->n(), 0, &truth->stiffness);
  ReadJoints(control, "damping", truth->n(), 0, &truth->damping);
  ReadJoints(control, "speed", truth->n(), 1e-3, &truth->speed);
  return control.status();
}

Status ReadSensors(const json& root, RobotTruth* truth) {
  truth->velocity_gain = Eigen::VectorXd::Ones(truth->n());
  if (!root.contains("sensors")) return Status::Ok();
  JsonFields sensors(root.at("sensors"),
                     "rate_hz latency_s position_stddev position_resolution velocity_stddev velocity_gain "
                     "effort_stddev effort_filter_s",
                     "sensors: ");
  sensors.Number("rate_hz", 1, 1000, &truth->rate_hz);
  sensors.Number("latency_s", 0, 1, &truth->latency_s);
  sensors.Number("position_stddev", 0, 1, &truth->position_stddev);
  sensors.Number("position_resolution", 0, 1, &truth->position_resolution);
  sensors.Number("velocity_stddev", 0, 10, &truth->velocity_stddev);
  sensors.Number("effort_stddev", 0, 100, &truth->effort_stddev);
  sensors.Number("effort_filter_s", 0, 10, &truth->effort_filter_s);
  ReadJoints(sensors, "velocity_gain", truth->n(), 0, &truth->velocity_gain);
  return sensors.status();
}

Result<RobotTruth> ReadTruth(const json& root, const std::string& path) {
  JsonFields fields(
      root,
      "format robot based_on more_effects compensation_parameters model urdf joints locked gravity "
      "parameters effects torque_limit gravity_compensation silence position_controller initial_pose "
      "sensors command_latency_s step_s physics_step_s");
  fields.Format("realitygrad.robot_truth/1");
  RG_RETURN_IF_ERROR(fields.status());
  std::optional<sim::ModelFile> model;
  if (root.contains("model")) {
    RG_ASSIGN_OR_RETURN(model, ReadModel(root, path));
  } else {
    RG_ASSIGN_OR_RETURN(sim::Plant plant, ReadPlant(root, path));
    Eigen::VectorXd nominal = plant.parameters().Nominal();
    model = sim::ModelFile{std::move(plant), std::move(nominal)};
  }
  RobotTruth truth{
      .robot = root.at("robot").get<std::string>(), .plant = model->plant, .values = model->values};
  RG_RETURN_IF_ERROR(ReadParameters(root, "parameters", truth.plant, &truth.values));
  ReadJoints(fields, "torque_limit", truth.n(), 0, &truth.torque_limit);
  ReadJoints(fields, "initial_pose", truth.n(), -1e3, &truth.initial_pose);
  fields.Number("command_latency_s", 0, 1, &truth.command_latency_s);
  fields.Number("step_s", 1e-4, 0.01, &truth.step_s);
  fields.Number("physics_step_s", 1e-5, 0.01, &truth.physics_step_s);
  RG_RETURN_IF_ERROR(fields.status());
  RG_RETURN_IF_ERROR(ReadBase(root, &truth));
  RG_RETURN_IF_ERROR(ReadPositionController(root, &truth));
  RG_RETURN_IF_ERROR(ReadSensors(root, &truth));
  return truth;
}

}  // namespace

namespace {

// The file's fields over those of the one it is based on; paths of that one become relative to this one.
Result<json> LoadFields(const std::string& path) {
  RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  json root = json::parse(text);
  if (!root.contains("based_on")) return root;
  const auto folder = std::filesystem::path(path).parent_path();
  const auto other = folder / root.at("based_on").get<std::string>();
  RG_ASSIGN_OR_RETURN(const std::string other_text, ReadFile(other.string()));
  json fields = json::parse(other_text);
  if (fields.contains("based_on"))
    return InvalidError("based_on: " + other.string() + " is based on another");
  for (const char* file : {"urdf", "model"}) {
    if (fields.contains(file))
      fields[file] =
          std::filesystem::absolute(other.parent_path() / fields[file].get<std::string>()).string();
  }
  for (const auto& [key, value] : root.items()) fields[key] = value;
  return fields;
}

}  // namespace

Result<RobotTruth> LoadRobotTruth(const std::string& path) {
  try {
    const auto fields = LoadFields(path);
    if (!fields.ok()) return fields.status().WithPrefix(path);
    auto truth = ReadTruth(*fields, path);
    if (!truth.ok()) return truth.status().WithPrefix(path);
    return truth;
  } catch (const json::exception& error) {
    return InvalidError(path + ": " + error.what());
  }
}

}  // namespace rg::robot_agent
