#include "common/sim/model_file.h"

#include <algorithm>
#include <nlohmann/json.hpp>

#include "common/base/check.h"
#include "common/base/file.h"
#include "common/effects/effect_catalog.h"
#include "common/model/urdf_loader.h"

namespace rg::sim {
namespace {

using nlohmann::json;

constexpr const char* kFormat = "realitygrad.model/1";
constexpr const char *kHeld = "held", *kFirstCommand = "first command";  // before_recordings

// The effects with the values that they have now, for people and as nominal values; a value that a fit has
// taken outside its physical bounds stands in "parameters" only.
json EffectsToJson(const Plant& plant, const Eigen::VectorXd& values) {
  json list = json::array();
  for (const auto& spec : plant.effects()) {
    const effects::EffectInfo& info = *effects::FindEffect(spec.id);
    json parameters = json::object();
    auto owners = spec.joints;
    if (owners.empty() || info.scope == effects::Scope::kJointPair) owners = {"*"};
    for (const auto& owner : owners) {
      for (const auto& p : info.parameters) {
        const int i = plant.parameters().Find(spec.id + "." + owner + "." + p.name);
        if (i >= 0) parameters[owner][p.name] = std::clamp(values[i], p.lower, p.upper);
      }
    }
    json row = {{"effect", spec.id}, {"joints", spec.joints}, {"parameters", parameters}};
    if (!spec.options.empty()) row["options"] = spec.options;
    list.push_back(std::move(row));
  }
  return list;
}

// Reads fields of one JSON object; errors name the source and the path.
class Reader {
 public:
  Reader(const json& object, std::string where) : object_(object), where_(std::move(where)) {}

  Status Wrong(const std::string& field, const std::string& what) const {
    return InvalidError(where_ + ": " + field + " " + what);
  }
  Result<json> Get(const std::string& field, json::value_t type, const char* type_name) const {
    const auto it = object_.find(field);
    if (it == object_.end()) return Wrong(field, "is missing");
    const bool number = type == json::value_t::number_float && it->is_number();
    if (it->type() != type && !number) return Wrong(field, std::string("must be ") + type_name);
    return *it;
  }
  Result<std::string> String(const std::string& field) const {
    RG_ASSIGN_OR_RETURN(const json value, Get(field, json::value_t::string, "a string"));
    return value.get<std::string>();
  }
  Result<std::vector<std::string>> Strings(const std::string& field) const {
    RG_ASSIGN_OR_RETURN(const json value, Get(field, json::value_t::array, "a list of strings"));
    std::vector<std::string> out;
    for (const json& item : value) {
      if (!item.is_string()) return Wrong(field, "must be a list of strings");
      out.push_back(item.get<std::string>());
    }
    return out;
  }
  Result<std::map<std::string, double>> Numbers(const std::string& field) const {
    RG_ASSIGN_OR_RETURN(const json value, Get(field, json::value_t::object, "an object of numbers"));
    std::map<std::string, double> out;
    for (const auto& [key, item] : value.items()) {
      if (!item.is_number()) return Wrong(field + "." + key, "must be a number");
      out[key] = item.get<double>();
    }
    return out;
  }
  bool Has(const std::string& field) const { return object_.contains(field); }

 private:
  const json& object_;
  std::string where_;
};

Result<effects::EffectSpec> ReadEffect(const json& object, const std::string& where) {
  if (!object.is_object()) return InvalidError(where + " must be an object");
  const Reader reader(object, where);
  effects::EffectSpec spec;
  RG_ASSIGN_OR_RETURN(spec.id, reader.String("effect"));
  RG_ASSIGN_OR_RETURN(spec.joints, reader.Strings("joints"));
  RG_ASSIGN_OR_RETURN(const json owners, reader.Get("parameters", json::value_t::object, "an object"));
  const Reader by_owner(owners, where + ".parameters");
  for (const auto& item : owners.items()) {
    RG_ASSIGN_OR_RETURN(spec.values[item.key()], by_owner.Numbers(item.key()));
  }
  if (reader.Has("options")) {
    RG_ASSIGN_OR_RETURN(const json options, reader.Get("options", json::value_t::object, "an object"));
    for (const auto& [key, value] : options.items()) {
      if (!value.is_string()) return reader.Wrong("options." + key, "must be a string");
      spec.options[key] = value.get<std::string>();
    }
  }
  return spec;
}

Result<Eigen::Vector3d> ReadGravity(const Reader& reader) {
  RG_ASSIGN_OR_RETURN(const json value, reader.Get("gravity", json::value_t::array, "three numbers"));
  Eigen::Vector3d gravity;
  if (value.size() != 3) return reader.Wrong("gravity", "must be three numbers");
  for (int i = 0; i < 3; ++i) {
    if (!value[i].is_number()) return reader.Wrong("gravity", "must be three numbers");
    gravity[i] = value[i].get<double>();
  }
  return gravity;
}

Result<ModelFile> Read(const json& root, const std::string& source) {
  if (!root.is_object()) return InvalidError(source + ": not a JSON object");
  const Reader reader(root, source);
  RG_ASSIGN_OR_RETURN(const std::string format, reader.String("format"));
  if (format != kFormat) return reader.Wrong("format", "is " + format + ", this program reads " + kFormat);
  RG_ASSIGN_OR_RETURN(const std::string urdf, reader.String("urdf"));
  model::LoadOptions options;
  RG_ASSIGN_OR_RETURN(options.joints, reader.Strings("joints"));
  if (reader.Has("locked")) {
    RG_ASSIGN_OR_RETURN(options.locked, reader.Numbers("locked"));
  }
  if (reader.Has("end_effector")) {
    RG_ASSIGN_OR_RETURN(options.end_effector, reader.String("end_effector"));
  }
  auto model = model::ParseUrdf(urdf, source + ": urdf", options);
  if (!model.ok()) return model.status();
  PlantOptions plant_options;
  RG_ASSIGN_OR_RETURN(plant_options.gravity, ReadGravity(reader));
  if (reader.Has("prescribed")) {
    RG_ASSIGN_OR_RETURN(plant_options.prescribed, reader.Strings("prescribed"));
  }
  if (reader.Has("passive")) {
    RG_ASSIGN_OR_RETURN(plant_options.passive, reader.Strings("passive"));
  }
  RG_ASSIGN_OR_RETURN(const json list, reader.Get("effects", json::value_t::array, "a list"));
  std::vector<effects::EffectSpec> specs;
  for (size_t i = 0; i < list.size(); ++i) {
    RG_ASSIGN_OR_RETURN(effects::EffectSpec spec,
                        ReadEffect(list[i], source + ": effects[" + std::to_string(i) + "]"));
    specs.push_back(std::move(spec));
  }
  auto plant = Plant::Create(std::make_shared<const model::RobotModel>(std::move(model).value()),
                             plant_options, std::move(specs));
  if (!plant.ok()) return plant.status().WithPrefix(source);
  RG_ASSIGN_OR_RETURN(const auto parameters, reader.Numbers("parameters"));
  Eigen::VectorXd values = plant->parameters().Nominal();
  for (const auto& [name, value] : parameters) {
    const auto index = plant->parameters().IndexOf(name);
    if (!index.ok()) return index.status().WithPrefix(source + ": parameters");
    values[*index] = value;
  }
  if (!values.allFinite()) return reader.Wrong("parameters", "are not all finite");
  int version = 0;
  if (reader.Has("version")) {
    if (!root["version"].is_number_integer()) return reader.Wrong("version", "must be an integer");
    version = root["version"].get<int>();
  }
  bool held_before = true;
  if (reader.Has("before_recordings")) {
    RG_ASSIGN_OR_RETURN(const std::string before, reader.String("before_recordings"));
    held_before = before == kHeld;
    if (!held_before && before != kFirstCommand)
      return reader.Wrong("before_recordings",
                          std::string("must be \"") + kHeld + "\" or \"" + kFirstCommand + "\"");
  }
  return ModelFile{std::move(plant).value(), std::move(values), version, held_before};
}

}  // namespace

std::string ModelToJson(const Plant& plant, const Eigen::VectorXd& values, int version, bool held_before) {
  RG_CHECK(values.size() == plant.parameters().size()) << values.size();
  json parameters = json::object();
  for (int i = 0; i < values.size(); ++i) parameters[plant.parameters()[i].name] = values[i];
  const auto& gravity = plant.options().gravity;
  json root = {{"format", kFormat},
               {"version", version},
               {"robot", plant.model().name()},
               {"urdf", plant.model().urdf_text()},
               {"joints", plant.joint_names()},
               {"end_effector", plant.model().end_effector().name},
               {"gravity", {gravity[0], gravity[1], gravity[2]}},
               {"effects", EffectsToJson(plant, values)},
               {"parameters", std::move(parameters)}};
  if (!held_before) root["before_recordings"] = kFirstCommand;
  if (!plant.options().prescribed.empty()) root["prescribed"] = plant.options().prescribed;
  if (!plant.options().passive.empty()) root["passive"] = plant.options().passive;
  if (!plant.model().locked().empty()) root["locked"] = plant.model().locked();
  return root.dump(1, ' ', false, json::error_handler_t::replace) + "\n";
}

Result<ModelFile> ModelFromJson(std::string_view text, const std::string& source) {
  const json root = json::parse(text, nullptr, /*allow_exceptions=*/false);
  if (root.is_discarded()) return InvalidError(source + ": not valid JSON");
  return Read(root, source);
}

Result<ModelFile> LoadModelFile(const std::string& path) {
  RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  return ModelFromJson(text, path);
}

Status SaveModelFile(const std::string& path, const Plant& plant, const Eigen::VectorXd& values, int version,
                     bool held_before) {
  return WriteFileAtomically(path, ModelToJson(plant, values, version, held_before));
}

}  // namespace rg::sim
