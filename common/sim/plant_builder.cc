#include "common/sim/plant_builder.h"

#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

#include "common/base/check.h"
#include "common/effects/joint_coupling.h"
#include "common/effects/joint_law.h"
#include "common/effects/sloshing_payload.h"
#include "common/integrators/step_kernel.h"
#include "common/sim/parameter_values.h"

namespace rg::sim::internal {
namespace {

using effects::EffectInfo;
using effects::EffectSpec;
using effects::JointCoupling;
using effects::Role;
using Where = ParameterUse::Where;

constexpr double kInfinity = effects::kInf;

double EffortScale(const model::Joint& joint) {
  return std::isfinite(joint.effort) && joint.effort > 0 ? joint.effort : 10.0;
}

// The only option of most effects that have one.
int FirstOption(const EffectInfo& info, const EffectSpec& spec) {
  return info.options.empty() ? 0 : info.Option(info.options.begin()->first, spec);
}

// Whether it is a drive that turns with two joints.
bool IsDrive(const EffectSpec& spec) {
  const EffectInfo& info = *effects::FindEffect(spec.id);
  return info.id == "joint_coupling" && info.Option("form", spec) == JointCoupling::kKinematic;
}

ExtraBodies ExtraBodiesOf(const std::vector<EffectSpec>& effects) {
  ExtraBodies out;
  for (const EffectSpec& spec : effects) {
    const EffectInfo& info = *effects::FindEffect(spec.id);
    if (spec.id == "base_flexibility") out.flexible_base = true;
    if (spec.id != "sloshing_payload") continue;
    if (info.Option("form", spec) == effects::SloshingPayload::kRod) {
      out.rod_hinge = info.Option("hinge", spec);
    } else {
      out.mass_in_springs = true;
    }
  }
  return out;
}

Parameter Row(std::string name, ParameterKind kind, std::string owner, std::string field, std::string unit,
              double nominal, double lower, double upper, double prior) {
  return {std::move(name), kind, std::move(owner), std::move(field), "", std::move(unit), nominal, lower,
          upper,           prior};
}

}  // namespace

PlantBuilder::PlantBuilder(std::shared_ptr<const model::RobotModel> model, const PlantOptions& options,
                           std::vector<EffectSpec> effects)
    : data_(std::make_shared<PlantData>()) {
  data_->model = std::move(model);
  data_->options = options;
  data_->effects = std::move(effects);
}

std::shared_ptr<const PlantData> PlantBuilder::Take() { return std::move(data_); }

Status PlantBuilder::Build() {
  RG_RETURN_IF_ERROR(TakeRoles());
  RG_RETURN_IF_ERROR(CheckEffects());
  RG_RETURN_IF_ERROR(LayOutTree());
  AddBaseParameters();
  for (const EffectSpec& spec : data_->effects) RG_RETURN_IF_ERROR(AddEffect(spec));
  RG_RETURN_IF_ERROR(LayOutProgram());
  NameInternalStates();
  SetReferenceMasses();
  return Status::Ok();
}

// Which joints move as they are told, and which have no drive.
Status PlantBuilder::TakeRoles() {
  PlantData& d = *data_;
  d.passive.assign(static_cast<size_t>(d.model->num_joints()), 0);
  for (const std::vector<std::string>* names : {&d.options.prescribed, &d.options.passive}) {
    const bool prescribed = names == &d.options.prescribed;
    for (const std::string& name : *names) {
      const int joint = d.model->FindJoint(name);
      if (joint < 0)
        return InvalidError(std::string(prescribed ? "prescribed" : "passive") +
                            ": the model has no moving joint " + name);
      if (!prescribed) {
        d.passive[static_cast<size_t>(joint)] = 1;
      } else if (std::count(d.prescribed.begin(), d.prescribed.end(), joint) == 0) {
        d.prescribed.push_back(joint);
      }
    }
  }
  std::sort(d.prescribed.begin(), d.prescribed.end());
  d.without_inertia.assign(static_cast<size_t>(d.model->num_joints()), 0);
  for (const int joint : d.model->joints_without_inertia()) d.without_inertia[static_cast<size_t>(joint)] = 1;
  return Status::Ok();
}

Status PlantBuilder::CheckRole(const EffectSpec& spec, const std::string& joint) const {
  const EffectInfo& info = *effects::FindEffect(spec.id);
  const int j = data_->model->FindJoint(joint);
  // The first joint of such a pair is only looked at.
  const bool seen = info.scope == effects::Scope::kJointPair && !info.NeedsDrive() && joint == spec.joints[0];
  if (seen || data_->Takes(info, j)) return Status::Ok();
  return InvalidError("effect " + spec.id + ": " + joint +
                      (data_->IsPrescribed(j) ? " moves as it is told (prescribed), nothing acts on it"
                       : data_->passive[static_cast<size_t>(j)]
                           ? " has no drive (passive)"
                           : " has its rotor inertia as the parameter armature." + joint));
}

Status PlantBuilder::CheckEffects() const {
  const auto& specs = data_->effects;
  for (size_t i = 0; i < specs.size(); ++i) {
    RG_RETURN_IF_ERROR(effects::ValidateSpec(specs[i]));
    for (const auto& joint : specs[i].joints) {
      if (data_->model->FindJoint(joint) < 0) {
        return InvalidError("effect " + specs[i].id + ": the model has no moving joint " + joint);
      }
      RG_RETURN_IF_ERROR(CheckRole(specs[i], joint));
    }
    for (size_t j = 0; j < i; ++j) {
      if (specs[j].id != specs[i].id) continue;
      std::set<std::string> seen(specs[j].joints.begin(), specs[j].joints.end());
      const bool per_joint = !specs[i].joints.empty() && !specs[j].joints.empty() &&
                             specs[i].id != "joint_coupling" && specs[i].id != "unknown_field_pair";
      for (const auto& joint : specs[i].joints) {
        if (per_joint && seen.count(joint)) {
          return InvalidError("effect " + specs[i].id + " stands twice on " + joint);
        }
      }
      if (!per_joint) return InvalidError("effect " + specs[i].id + " stands twice");
    }
  }
  return Status::Ok();
}

// The link that point forces and a sloshing mass act on: one for all effects.
int PlantBuilder::ToolLink() const {
  const model::RobotModel& model = *data_->model;
  for (const EffectSpec& spec : data_->effects) {
    const auto point = spec.options.find("point");
    if (point != spec.options.end() && point->second == "last_link")
      return model.joint(model.num_joints() - 1).child_link;
  }
  return model.FindLink(model.end_effector().name);
}

Status PlantBuilder::LayOutTree() {
  PlantData& d = *data_;
  const ExtraBodies extra = ExtraBodiesOf(d.effects);
  const int tool_link = ToolLink();
  d.tree_model = WithExtraBodies(d.model, extra, tool_link);
  d.program.tree = dynamics::MakeTree(*d.tree_model);
  d.first_joint = extra.flexible_base ? kBaseJoints : 0;
  for (const auto& joint : d.model->joints()) d.joint_names.push_back(joint.name);
  const int n = d.num_joints();
  for (int j = 0; j < n; ++j) d.kernel.push_back(d.PlaceOf(d.first_joint + j));
  for (int k = 0; k < d.num_kernel_joints(); ++k) {
    const int own = d.program.tree.body[k];
    const bool follows = own >= d.tree_model->num_joints();
    if (!follows && (own < d.first_joint || own >= d.first_joint + n)) d.extra_joints.push_back(k);
  }
  for (const int j : d.prescribed) d.program.joints[d.kernel[j]].prescribed = true;
  d.program.all_free = d.prescribed.empty() && d.program.tree.num_ties == 0;
  RG_RETURN_IF_ERROR(LayOutDrives());
  ops_.resize(d.program.num_laws());
  joint_parameters_.assign(d.program.num_laws(), integrators::kFirstEffectParameter);
  d.command_delay.assign(n, -1);
  d.sensors.assign(n, {});
  const auto tool = d.tree_model->FindFrame(d.model->link(tool_link).name);
  d.program.point_body = d.PlaceOf(tool->body);
  for (int i = 0; i < 3; ++i) d.program.point[i] = tool->X_BF.translation[i];
  if (extra.rod_hinge < 0) return Status::Ok();
  d.rod.hinge = extra.rod_hinge;
  d.rod.link = d.tree_model->num_links() - 1;
  d.rod.tool = *d.model->FindFrame(d.model->link(tool_link).name);
  d.rod.arm = std::make_shared<const dynamics::Mechanism>(*d.model);
  return Status::Ok();
}

// Drives that turn with two joints.
Status PlantBuilder::LayOutDrives() {
  PlantData& d = *data_;
  for (const EffectSpec& spec : d.effects) {
    if (!IsDrive(spec)) continue;
    const int from = d.model->FindJoint(spec.joints[0]), to = d.model->FindJoint(spec.joints[1]);
    if (d.program.num_laws() == integrators::kMaxJoints || d.program.num_drives == integrators::kMaxDrives) {
      return InvalidError("effect joint_coupling, form kinematic: no room beside " +
                          std::to_string(d.program.tree.n) + " moving bodies, at most " +
                          std::to_string(integrators::kMaxJoints - 1));
    }
    d.program.drives[d.program.num_drives++] = {
        d.kernel[to], d.kernel[from],
        int{integrators::kFirstEffectParameter} + int{JointCoupling::kCoefficient}};
  }
  return Status::Ok();
}

void PlantBuilder::Add(Parameter row, std::vector<ParameterUse> uses) {
  const auto other = data_->options.nominal.find(row.name);
  if (row.kind != ParameterKind::kEffect && other != data_->options.nominal.end())
    row.nominal = other->second;
  data_->table.Add(std::move(row));
  data_->uses.push_back(std::move(uses));
}

void PlantBuilder::AddBaseParameters() {
  const model::RobotModel& model = *data_->model;
  constexpr const char* kAxes[] = {"x", "y", "z"};
  for (int i = 0; i < 3; ++i) {
    Add(Row(std::string("gravity.") + kAxes[i], ParameterKind::kGravity, "*", kAxes[i], "m/s^2",
            data_->options.gravity[i], -kInfinity, kInfinity, 0.2),
        {{Where::kGravity, i, 0}});
  }
  auto add_links = [&](int first, int last, ParameterKind kind, const char* unit, bool signed_values) {
    for (int l = 0; l < model.num_links(); ++l) {
      for (int c = first; c <= last; ++c) {
        const model::Link& link = model.link(l);
        const double nominal = link.parameters[c];
        const double prior = kind == ParameterKind::kCenterOfMass ? 0.03
                             : kind == ParameterKind::kMass       ? std::max(0.3 * nominal, 0.05)
                                                                  : std::max(0.5 * std::abs(nominal), 1e-4);
        const std::string field(model::kLinkParameterNames[c]);
        Add(Row(field + "." + link.name, kind, link.name, field, unit, nominal,
                signed_values || c > 6 ? -kInfinity : 0.0, kInfinity, prior),
            {{Where::kLink, l, c}});
      }
    }
  };
  add_links(0, 0, ParameterKind::kMass, "kg", false);
  add_links(1, 3, ParameterKind::kCenterOfMass, "m", true);
  add_links(4, 9, ParameterKind::kInertia, "kg*m^2", false);
  auto add_joints = [&](const char* field, ParameterKind kind, int local, auto&& values) {
    for (int j = 0; j < model.num_joints(); ++j) {
      const model::Joint& joint = model.joint(j);
      const auto [nominal, lower, prior, unit] = values(joint);
      Add(Row(std::string(field) + "." + joint.name, kind, joint.name, field, unit, nominal, lower, kInfinity,
              prior),
          {{Where::kLaw, data_->kernel[j], local}});
    }
  };
  using Values = std::tuple<double, double, double, const char*>;
  add_joints("damping", ParameterKind::kDamping, integrators::kDamping, [](const model::Joint& j) {
    return Values(j.damping, 0.0, std::max(j.damping, 0.1 * EffortScale(j)),
                  j.is_revolute() ? "N*m*s/rad" : "N*s/m");
  });
  add_joints("friction", ParameterKind::kFriction, integrators::kFriction, [](const model::Joint& j) {
    return Values(j.friction, 0.0, std::max(j.friction, 0.1 * EffortScale(j)), j.is_revolute() ? "N*m" : "N");
  });
  // What a file says of an effort where there is no drive moves nothing.
  add_joints("force_gain", ParameterKind::kForceGain, integrators::kForceGain, [&](const model::Joint& j) {
    const bool passive = data_->passive[static_cast<size_t>(model.FindJoint(j.name))] != 0;
    return Values(passive ? 0.0 : 1.0, -kInfinity, 0.2, "-");
  });
  for (const int j : model.joints_without_inertia()) {
    const model::Joint& joint = model.joint(j);
    const int row = data_->table.size();
    Add(Row("armature." + joint.name, ParameterKind::kArmature, joint.name, "armature",
            joint.is_revolute() ? "kg*m^2" : "kg", 0.0, 0.0, kInfinity, 0.1),
        {});
    AddLaw(data_->kernel[j], effects::KindOf("rotor_inertia"), 0, {row});
  }
}

Status PlantBuilder::AddEffect(const EffectSpec& spec) {
  const int kind = effects::KindOf(spec.id);
  const EffectInfo& info = effects::Catalog()[kind];
  if (IsDrive(spec)) {
    AddDrive(spec, kind);
    return Status::Ok();
  }
  if (info.scope == effects::Scope::kJointPair) {
    const int from = data_->model->FindJoint(spec.joints[0]), to = data_->model->FindJoint(spec.joints[1]);
    const auto rows = AddRows(spec, kind, "*", to);
    AddLaw(data_->kernel[to], kind, 0, rows, data_->kernel[from]);
    return Status::Ok();
  }
  if (spec.joints.empty()) {
    AddRobotEffect(spec, kind);
    return Status::Ok();
  }
  for (const auto& name : spec.joints)
    RG_RETURN_IF_ERROR(AddJointEffect(spec, kind, data_->model->FindJoint(name)));
  return Status::Ok();
}

void PlantBuilder::AddDrive(const EffectSpec& spec, int kind) {
  const PlantData& d = *data_;
  const int to = d.model->FindJoint(spec.joints[1]);
  for (int drive = 0; drive < d.program.num_drives; ++drive) {
    if (d.program.drives[drive].joint == d.kernel[to])
      AddLaw(d.program.tree.n + drive, kind, JointCoupling::kKinematic, AddRows(spec, kind, "*", to));
  }
}

std::vector<int> PlantBuilder::AddRows(const EffectSpec& spec, int kind, const std::string& owner,
                                       int joint) {
  const EffectInfo& info = effects::Catalog()[kind];
  const auto given = spec.values.find(owner);
  std::vector<int> rows;
  for (size_t i = 0; i < info.parameters.size(); ++i) {
    const effects::ParameterInfo& p = info.parameters[i];
    if (!info.Applies(static_cast<int>(i), spec)) {
      rows.push_back(-1);
      continue;
    }
    const bool prismatic = joint >= 0 && !data_->model->joint(joint).is_revolute();
    const double effort = joint >= 0 ? EffortScale(data_->model->joint(joint)) : 10.0;
    double nominal = p.default_is_effort ? effort : p.default_value;
    if (given != spec.values.end()) {
      const auto value = given->second.find(p.name);
      if (value != given->second.end()) nominal = value->second;
    }
    Parameter row = Row(info.id + "." + owner + "." + p.name, ParameterKind::kEffect, owner, p.name,
                        prismatic ? p.unit_prismatic : p.unit, nominal, p.lower, p.upper,
                        p.prior_stddev * (p.prior_of_effort ? effort : 1.0));
    row.effect = info.id;
    rows.push_back(data_->table.size());
    Add(std::move(row), {});
  }
  return rows;
}

void PlantBuilder::AddLaw(int law, int kind, int option, const std::vector<int>& rows, int coupled_to) {
  int& next = joint_parameters_[law];
  ops_[law].push_back({effects::TraitsOf(kind).PhaseOf(option), kind, option, next, coupled_to});
  for (const int row : rows) {
    if (row >= 0) data_->uses[row].push_back({Where::kLaw, law, next});
    ++next;
  }
}

Status PlantBuilder::AddJointEffect(const EffectSpec& spec, int kind, int joint) {
  const EffectInfo& info = effects::Catalog()[kind];
  const int k = data_->kernel[joint];
  const auto rows = AddRows(spec, kind, spec.joints.empty() ? "*" : data_->joint_names[joint], joint);
  JointSensor& sensor = data_->sensors[joint];
  switch (effects::TraitsOf(kind).role) {
    case Role::kJointLaw:
    case Role::kJointOrPointForce: {
      const int option = FirstOption(info, spec);
      const bool transmission =
          effects::TraitsOf(kind).PhaseOf(option) == static_cast<int>(effects::Phase::kTransmission);
      if (transmission) {
        for (const PendingOp& op : ops_[k]) {
          if (op.phase == static_cast<int>(effects::Phase::kTransmission)) {
            return InvalidError("effect " + spec.id + ": joint " + data_->joint_names[joint] +
                                " already has an elastic transmission");
          }
        }
        if (info.Option("sensor", spec) == 1) sensor.motor_state = 0;  // found in LayOutProgram
      }
      AddLaw(k, kind, option, rows);
      return Status::Ok();
    }
    case Role::kCommandDelay:
      data_->command_delay[joint] = rows[0];
      data_->has_command_delay = true;
      data_->uses[rows[0]].push_back({Where::kCommandDelay, joint, 0});
      return Status::Ok();
    case Role::kSensorDelay: {
      const int signal = info.Option("signal", spec);
      sensor.delay = rows[0];
      sensor.delays_position = signal != 2;
      sensor.delays_velocity = signal != 1;
      data_->has_sensor_delay = true;
      data_->uses[rows[0]].push_back({Where::kSensorDelay, joint, 0});
      return Status::Ok();
    }
    case Role::kSensorOffset:
      sensor.offset = rows[0];
      data_->uses[rows[0]].push_back({Where::kSensorOffset, joint, 0});
      return Status::Ok();
    case Role::kBodyInertia:
    case Role::kGravity:
    case Role::kExtraBodies:
      break;
  }
  RG_CHECK(false) << spec.id << " takes no joints";
  return Status::Ok();
}

void PlantBuilder::AddRobotEffect(const EffectSpec& spec, int kind) {
  const EffectInfo& info = effects::Catalog()[kind];
  const auto rows = AddRows(spec, kind, "*", -1);
  PlantData& d = *data_;
  switch (effects::TraitsOf(kind).role) {
    case Role::kBodyInertia:
      d.payload = rows[0];
      for (size_t i = 0; i < rows.size(); ++i)
        d.uses[rows[i]].push_back({Where::kPayload, 0, static_cast<int>(i)});
      return;
    case Role::kGravity:
      d.gravity_turn = rows[0];
      for (size_t i = 0; i < rows.size(); ++i)
        d.uses[rows[i]].push_back({Where::kGravityTurn, 0, static_cast<int>(i)});
      return;
    case Role::kJointOrPointForce: {
      const int force = d.program.num_point_forces++;
      const int option = FirstOption(info, spec);
      const int count = static_cast<int>(rows.size());
      RG_CHECK(force < integrators::kMaxPointForces && count <= integrators::kMaxPointParameters);
      d.program.point_forces[force] = {kind, option, count, d.num_point_parameters};
      for (int i = 0; i < count; ++i) {
        if (rows[i] >= 0) d.uses[rows[i]].push_back({Where::kPoint, force, i});
      }
      d.num_point_parameters += count;
      return;
    }
    case Role::kExtraBodies: {
      const bool base = info.id == "base_flexibility";
      for (const int k : d.extra_joints) {
        if ((d.program.tree.body[k] < d.first_joint) == base) AddLaw(k, kind, FirstOption(info, spec), rows);
      }
      if (!base) AddMovingMass(rows);
      return;
    }
    case Role::kJointLaw:
    case Role::kCommandDelay:
    case Role::kSensorDelay:
    case Role::kSensorOffset:
      break;
  }
  RG_CHECK(false) << spec.id << " needs joints";
}

void PlantBuilder::AddMovingMass(const std::vector<int>& rows) {
  using effects::SloshingPayload;
  PlantData& d = *data_;
  if (d.rod.hinge < 0) {
    d.uses[rows[SloshingPayload::kMass]].push_back({Where::kLink, d.tree_model->num_links() - 1, 0});
    return;
  }
  d.rod.parameters = {rows[SloshingPayload::kMass], rows[SloshingPayload::kLength],
                      rows[SloshingPayload::kRadius]};
  for (int i = 0; i < 3; ++i) d.uses[d.rod.parameters[i]].push_back({Where::kRod, 0, i});
}

Status PlantBuilder::LayOutProgram() {
  PlantData& d = *data_;
  int next_op = 0;
  for (int k = 0; k < d.program.num_laws(); ++k) {
    auto& pending = ops_[k];
    std::stable_sort(pending.begin(), pending.end(),
                     [](const PendingOp& a, const PendingOp& b) { return a.phase < b.phase; });
    integrators::JointProgram& joint = d.program.joints[k];
    joint.first_op = next_op;
    joint.num_ops = static_cast<int>(pending.size());
    joint.first_state = d.program.num_states;
    joint.first_parameter = d.num_joint_parameters;
    joint.num_parameters = joint_parameters_[k];
    const std::string& name = d.LawName(k);
    if (next_op + joint.num_ops > integrators::kMaxOps) return InvalidError("too many effects");
    for (const PendingOp& op : pending) {
      if (op.coupled_to >= 0) {
        if (joint.coupled_to >= 0 || joint.sees >= 0) {
          return InvalidError("effects joint_coupling, unknown_field_pair: two couplings end at " + name);
        }
        const bool drive = op.phase == static_cast<int>(effects::Phase::kCoupling);
        (drive ? joint.coupled_to : joint.sees) = op.coupled_to;
      }
      if (op.phase < static_cast<int>(effects::Phase::kCoupling)) ++joint.num_actuator_ops;
      d.program.ops[next_op++] = {op.kind, op.first_parameter, joint.num_states, op.option};
      const auto& states = effects::TraitsOf(op.kind).state_names;
      const auto user = std::find(d.kernel.begin(), d.kernel.end(), k) - d.kernel.begin();
      if (op.phase == static_cast<int>(effects::Phase::kTransmission) && user < d.num_joints()) {
        if (joint.coupled_to >= 0 || d.HasCoupledDrive(k)) {
          return InvalidError("effect joint_coupling cannot end at " + name +
                              ", whose transmission is elastic");
        }
        JointSensor& sensor = d.sensors[user];
        if (sensor.motor_state >= 0) sensor.motor_state = d.program.num_states + joint.num_states;
      }
      joint.num_states += static_cast<int>(states.size());
    }
    d.program.num_states += joint.num_states;
    d.program.max_states = std::max(d.program.max_states, joint.num_states);
    d.num_joint_parameters += joint.num_parameters;
    if (joint.num_locals() > integrators::kMaxLocals || joint.num_states > integrators::kMaxStates) {
      return InvalidError("joint " + name + " has too many effects at once");
    }
  }
  for (int k = 0; k < d.num_kernel_joints(); ++k) {
    const int source = d.program.joints[k].coupled_to;
    if (source >= 0 && d.program.joints[source].coupled_to >= 0) {
      return InvalidError("effect joint_coupling: " + d.KernelJoint(source).name +
                          " is both the end and the start of a coupling");
    }
  }
  return Status::Ok();
}

void PlantBuilder::NameInternalStates() {
  PlantData& d = *data_;
  for (int k = 0; k < d.num_kernel_joints(); ++k) {
    const integrators::JointProgram& joint = d.program.joints[k];
    for (int o = joint.first_op; o < joint.first_op + joint.num_ops; ++o) {
      for (const auto& state : effects::TraitsOf(d.program.ops[o].kind).state_names) {
        d.internal_state_names.push_back(state + "." + d.KernelJoint(k).name);
      }
    }
  }
  for (const int k : d.extra_joints) {
    d.internal_state_names.push_back("position." + d.KernelJoint(k).name);
    d.internal_state_names.push_back("velocity." + d.KernelJoint(k).name);
  }
}

}  // namespace rg::sim::internal
