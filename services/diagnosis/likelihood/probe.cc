// The plant with probing torques of lineariser.h.

#include <string>

#include "common/base/check.h"
#include "common/effects/inference.h"
#include "services/diagnosis/likelihood/candidate.h"
#include "services/diagnosis/likelihood/lineariser.h"

namespace rg::diagnosis {

namespace {

constexpr double kAlways = 1e15;  // s, beyond epoch times in seconds

struct ZeroTorque {
  EffectSpec spec;
  std::string parameter;
  int joint;
};

// A pulse without end, or a ripple of no cycles. One of the whole robot excludes further ones.
std::vector<ZeroTorque> ZeroTorquesOf(const sim::Plant& plant) {
  const std::string &push = effects::LawOf(effects::Regressor::kPulse).id,
                    &wave = effects::LawOf(effects::Regressor::kSine).id;
  std::vector<ZeroTorque> pushes;
  for (int j = 0; j < plant.num_joints(); ++j) {
    const std::string& joint = plant.joint_names()[j];
    if (plant.IsPrescribed(j)) continue;
    if (!Contains(plant.effects(), push, joint)) {
      pushes.push_back(
          {effects::MakeSpec(push, {joint}, {{"start", -kAlways}, {"end", kAlways}, {"torque", 0.0}}),
           push + "." + joint + ".torque", j});
    } else if (!Contains(plant.effects(), wave, joint)) {
      pushes.push_back(
          {effects::MakeSpec(wave, {joint}, {{"amplitude", 0.0}, {"cycles_per_rev", 0.0}, {"phase", M_PI_2}}),
           wave + "." + joint + ".amplitude", j});
    }
  }
  return pushes;
}

}  // namespace

Probe MakeProbe(const FitModel& model, bool with_torque) {
  Probe probe{model.plant, model.values, std::vector<int>(model.plant.num_joints(), -1)};
  if (!with_torque) return probe;
  std::vector<ZeroTorque> pushes = ZeroTorquesOf(model.plant);
  const auto with = [&](const std::vector<ZeroTorque>& some) {
    std::vector<EffectSpec> specs = model.plant.effects();
    for (const ZeroTorque& push : some) specs.push_back(push.spec);
    return sim::Plant::Create(model.plant.shared_model(), model.plant.options(), specs);
  };
  auto plant = with(pushes);
  if (!plant.ok()) {
    std::erase_if(pushes, [&](const ZeroTorque& push) { return !with({push}).ok(); });
    plant = with(pushes);
  }
  RG_CHECK(plant.ok()) << plant.status().ToString();
  probe.plant = *plant;
  probe.values = probe.plant.ValuesFrom(model.plant.parameters(), model.values);
  for (const ZeroTorque& push : pushes)
    probe.torque[push.joint] = probe.plant.parameters().Find(push.parameter);
  return probe;
}

}  // namespace rg::diagnosis
