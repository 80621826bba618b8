#include "services/sysid/fit_parameters.h"

#include <algorithm>
#include <cmath>

#include "common/model/robot_model.h"

namespace rg::sysid {
namespace {

constexpr double kMassShare = 0.25, kMassLower = 0.1, kMassUpper = 4.0;
constexpr double kComShare = 0.25, kComFloor = 0.005, kComBound = 6.0;           // of r, m, stddev
constexpr double kInertiaShare = 0.5, kInertiaArm = 0.01, kInertiaLower = 0.02;  // of max I, m, of nominal
constexpr double kRotorPrior = 3.0, kRotorLower = 0.01, kRotorUpper = 100.0;     // of the start
constexpr double kInertiaBound = 8.0;                                            // stddev

FitParameter Row(const sim::Plant& plant, int index) {
  const sim::Parameter& p = plant.parameters()[index];
  return {index, p.name, p.unit, p.nominal, p.lower, p.upper, p.prior_stddev};
}

// The heaviest link of each moving body; a body whose links are all massless gives its first link.
std::vector<int> PrincipalLinks(const model::RobotModel& model) {
  std::vector<int> principal(model.num_bodies(), -1);
  for (int i = 0; i < model.num_links(); ++i) {
    const model::Link& link = model.link(i);
    if (link.body < 0 || !link.has_inertial) continue;
    int& best = principal[link.body];
    if (best < 0 || link.parameters[0] > model.link(best).parameters[0]) best = i;
  }
  return principal;
}

void AddLink(const sim::Plant& plant, const model::Link& link, std::vector<FitParameter>* out) {
  const auto nominal = [&](int k) {
    const int at = plant.parameters().Find(std::string(model::kLinkParameterNames[k]) + "." + link.name);
    RG_CHECK(at >= 0) << link.name;
    return plant.parameters()[at].nominal;
  };
  const double mass = nominal(0);
  const Eigen::Vector3d inertia(nominal(4), nominal(5), nominal(6));
  const double gyration = mass > 0.0 ? std::sqrt(std::max(0.0, inertia.sum() / (2.0 * mass))) : 0.0;
  const double largest = inertia.maxCoeff();
  for (int k = 0; k < model::kLinkParameters; ++k) {
    const std::string name = std::string(model::kLinkParameterNames[k]) + "." + link.name;
    const int index = plant.parameters().Find(name);
    RG_CHECK(index >= 0) << name;
    FitParameter p = Row(plant, index);
    if (k == 0) {
      p.prior_stddev = kMassShare * mass;
      p.lower = kMassLower * mass;
      p.upper = kMassUpper * mass;
    } else if (k <= 3) {
      p.prior_stddev = kComShare * gyration + kComFloor;
      p.lower = p.nominal - kComBound * p.prior_stddev;
      p.upper = p.nominal + kComBound * p.prior_stddev;
    } else {
      p.prior_stddev = kInertiaShare * largest + mass * kInertiaArm * kInertiaArm;
      p.lower = k <= 6 ? kInertiaLower * p.nominal : p.nominal - kInertiaBound * p.prior_stddev;
      p.upper = p.nominal + kInertiaBound * p.prior_stddev;
    }
    if (p.prior_stddev > 0.0) out->push_back(std::move(p));
  }
}

// Nothing on a prescribed joint shows.
bool HasEquation(const sim::Plant& plant, int parameter) {
  const int joint = plant.model().FindJoint(plant.parameters()[parameter].owner);
  return joint < 0 || !plant.IsPrescribed(joint);
}

}  // namespace

std::vector<FitParameter> InertialFitParameters(const sim::Plant& plant) {
  std::vector<FitParameter> out;
  for (const int link : PrincipalLinks(plant.model())) {
    if (link >= 0) AddLink(plant, plant.model().link(link), &out);
  }
  return out;
}

std::vector<FitParameter> DeclaredJointFitParameters(const sim::Plant& plant) {
  std::vector<FitParameter> out;
  for (const int i : plant.parameters().OfKind(sim::ParameterKind::kDamping)) {
    if (HasEquation(plant, i)) out.push_back(Row(plant, i));
  }
  for (const int i : plant.parameters().OfKind(sim::ParameterKind::kFriction)) {
    if (plant.parameters()[i].nominal != 0.0 && HasEquation(plant, i)) out.push_back(Row(plant, i));
  }
  return out;
}

std::vector<FitParameter> RotorFitParameters(const sim::Plant& plant) {
  std::vector<FitParameter> out;
  for (const int i : plant.parameters().OfKind(sim::ParameterKind::kArmature)) {
    if (!HasEquation(plant, i)) continue;
    FitParameter p = Row(plant, i);
    p.prior_stddev = kRotorPrior * p.nominal;
    p.lower = kRotorLower * p.nominal, p.upper = kRotorUpper * p.nominal;
    out.push_back(std::move(p));
  }
  return out;
}

std::vector<FitParameter> EffectFitParameters(const sim::Plant& plant) {
  return FitParametersAt(plant, plant.parameters().OfKind(sim::ParameterKind::kEffect));
}

std::vector<FitParameter> FitParametersAt(const sim::Plant& plant, const std::vector<int>& indices) {
  std::vector<FitParameter> out;
  for (const int i : indices) out.push_back(Row(plant, i));
  return out;
}

Result<std::vector<FitParameter>> NamedFitParameters(const sim::Plant& plant,
                                                     const std::vector<std::string>& names) {
  std::vector<FitParameter> out;
  for (const std::string& name : names) {
    RG_ASSIGN_OR_RETURN(const int index, plant.parameters().IndexOf(name));
    out.push_back(Row(plant, index));
  }
  return out;
}

Eigen::VectorXd PriorStddevs(const std::vector<FitParameter>& parameters) {
  Eigen::VectorXd out(parameters.size());
  for (size_t i = 0; i < parameters.size(); ++i) out[i] = parameters[i].prior_stddev;
  return out;
}

std::vector<int> Indices(const std::vector<FitParameter>& parameters) {
  std::vector<int> out;
  for (const FitParameter& p : parameters) out.push_back(p.index);
  return out;
}

Eigen::VectorXd WithFitted(const std::vector<FitParameter>& parameters, Eigen::VectorXd values,
                           const Eigen::VectorXd& theta) {
  for (size_t i = 0; i < parameters.size(); ++i) values[parameters[i].index] = theta[i];
  return values;
}

}  // namespace rg::sysid
