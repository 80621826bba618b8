#include "common/sim/direction_plan.h"

#include <algorithm>

#include "common/base/check.h"

namespace rg::sim::internal {
namespace {

using Where = ParameterUse::Where;

bool UsedIn(const PlantData& plant, int parameter, std::initializer_list<Where> where) {
  return std::any_of(plant.uses[parameter].begin(), plant.uses[parameter].end(),
                     [&](const ParameterUse& use) {
                       return std::find(where.begin(), where.end(), use.where) != where.end();
                     });
}

// The kernel joint that moves it.
int BodyOf(const PlantData& plant, int parameter) {
  const auto of = [&](int link) { return plant.PlaceOf(plant.tree_model->link(link).body); };
  for (const ParameterUse& use : plant.uses[parameter]) {
    if (use.where == Where::kLink) return of(use.a);
    if (use.where == Where::kRod) return of(plant.rod.link);
    if (use.where == Where::kPayload) return of(plant.PayloadLink());
  }
  return -1;
}

}  // namespace

DirectionPlan::DirectionPlan(const PlantData& plant, Leading leading, std::vector<int> parameters)
    : plant_(plant), leading_(leading), parameters_(std::move(parameters)) {
  const int n = plant.num_joints();
  const int nx = 2 * n + plant.num_internal_states();
  if (leading_.initial_state) leading_columns_ += nx;
  directions_.first_direct = leading_columns_;
  int next = leading_columns_;
  if (leading_.commands) {
    for (int j = 0; j < n; ++j) commands_.push_back({plant.kernel[j], next + j});
    next += n;
    leading_columns_ += n;
  }
  terms_.resize(parameters_.size());
  output_column_.assign(plant.table.size(), -1);
  body_members_.resize(plant.num_kernel_joints());
  for (size_t k = 0; k < parameters_.size(); ++k) {
    const int parameter = parameters_[k];
    RG_CHECK(parameter >= 0 && parameter < plant.table.size()) << parameter;
    RG_CHECK(output_column_[parameter] < 0) << plant.table[parameter].name << " is asked for twice";
    output_column_[parameter] = leading_columns_ + static_cast<int>(k);
    if (UsedIn(plant, parameter, {Where::kGravity, Where::kGravityTurn})) {
      gravity_members_.push_back(static_cast<int>(k));
    }
    const int body = BodyOf(plant, parameter);
    if (body >= 0) body_members_[body].push_back(static_cast<int>(k));
    // Parameters of laws, points and command delays have a column of their own.
    int column = -1;
    auto own = [&] {
      if (column < 0) {
        column = next++;
        terms_[k].push_back({column, 1.0});
      }
      return column;
    };
    for (const ParameterUse& use : plant.uses[parameter]) {
      if (use.where == Where::kLaw) {
        const auto& joint = plant.program.joints[use.a];
        locals_.push_back({use.a, integrators::kFirstState + joint.num_states + use.b, own()});
        if (use.b == integrators::kFriction) directions_.friction[use.a] = true;
      } else if (use.where == Where::kPoint) {
        points_.push_back({use.a, use.b, own()});
      } else if (use.where == Where::kCommandDelay) {
        commands_.push_back({plant.kernel[use.a], own()});
      }
    }
  }
  if (!gravity_members_.empty()) {
    directions_.gravity = next;
    next += 3;
    for (const int k : gravity_members_) {
      for (int i = 0; i < 3; ++i) terms_[k].push_back({directions_.gravity + i, 0.0});
    }
  }
  for (int b = 0; b < plant.num_kernel_joints(); ++b) {
    const int members = static_cast<int>(body_members_[b].size());
    directions_.first_body[b] = next;
    directions_.num_body[b] = std::min(members, 10);
    for (const int k : body_members_[b]) {
      if (members <= 10) {
        const int place = static_cast<int>(std::find(body_members_[b].begin(), body_members_[b].end(), k) -
                                           body_members_[b].begin());
        terms_[k].push_back({next + place, 1.0});
      } else {
        for (int i = 0; i < 10; ++i) terms_[k].push_back({next + i, 0.0});
      }
    }
    next += directions_.num_body[b];
  }
  for (const auto& l : locals_) directions_.used_locals[l.joint] |= uint64_t{1} << l.local;
  for (const auto& c : commands_) directions_.used_locals[c.joint] |= uint64_t{1} << integrators::kCommand;
  directions_.columns = next;
  directions_.locals = locals_.data();
  directions_.num_locals = static_cast<int>(locals_.size());
  directions_.commands = commands_.data();
  directions_.num_commands = static_cast<int>(commands_.size());
  directions_.points = points_.data();
  directions_.num_points = static_cast<int>(points_.size());
}

void DirectionPlan::Update(const ParameterValues& values) {
  for (const int k : gravity_members_) {
    const Eigen::Vector3d direction = values.GravityDirection(parameters_[k]);
    for (Term& term : terms_[k]) {
      const int axis = term.direction - directions_.gravity;
      if (axis >= 0 && axis < 3) term.weight = direction[axis];
    }
  }
  for (int b = 0; b < plant_.num_kernel_joints(); ++b) {
    if (!body_members_[b].empty()) FillBody(values, b);
  }
}

void DirectionPlan::FillBody(const ParameterValues& values, int body) {
  const auto& members = body_members_[body];
  double* basis = directions_.basis[body];
  const bool own = members.size() <= 10;
  if (!own) {
    std::fill(basis, basis + 100, 0.0);
    for (int i = 0; i < 10; ++i) basis[11 * i] = 1.0;
  }
  for (size_t m = 0; m < members.size(); ++m) {
    Eigen::Matrix<double, 10, 1> direction;
    values.InertiaDirection(parameters_[members[m]], &direction);
    if (own) {
      std::copy(direction.data(), direction.data() + 10, basis + 10 * m);
      continue;
    }
    for (Term& term : terms_[members[m]]) {
      const int i = term.direction - directions_.first_body[body];
      if (i >= 0 && i < 10) term.weight = direction[i];
    }
  }
}

void DirectionPlan::Start(const SensitivityLayout& layout, int lane, integrators::Sensitivity* s) const {
  const size_t size = layout.column_size();
  for (double* x = s->columns + lane; x < s->columns + directions_.columns * size; x += layout.lanes)
    *x = 0.0;
  if (!leading_.initial_state) return;
  double* column = s->columns;
  // A prescribed joint's start is not free.
  const auto own = [&](int row, int joint) {
    if (!plant_.program.joints[joint].prescribed) column[layout.Offset(row, joint, lane)] = 1.0;
    column += size;
  };
  const int n = plant_.num_joints();
  for (int row = 0; row < 2; ++row) {
    for (int i = 0; i < n; ++i) own(row, plant_.kernel[i]);
  }
  for (int i = 0; i < plant_.num_kernel_joints(); ++i) {
    for (int k = 0; k < plant_.program.joints[i].num_states; ++k) own(2 + k, i);
  }
  for (const int k : plant_.extra_joints) {
    own(0, k);
    own(1, k);
  }
}

void DirectionPlan::Combine(const double* row, double* out) const {
  std::copy(row, row + leading_columns_, out);
  for (size_t k = 0; k < terms_.size(); ++k) {
    double sum = 0.0;
    for (const Term& term : terms_[k]) sum += term.weight * row[term.direction];
    out[leading_columns_ + k] = sum;
  }
}

int DirectionPlan::OutputColumn(int parameter) const {
  return parameter < 0 ? -1 : output_column_[parameter];
}

}  // namespace rg::sim::internal
