// Plants of the robots of deploy/robots.
#pragma once

#include "common/sim/plant.h"
#include "tests/unit/trajectories/test_robots.h"

namespace rg::trajectories {

inline sim::Plant MakePlant(const std::string& name, std::vector<effects::EffectSpec> effects = {}) {
  auto plant = sim::Plant::Create(LoadRobot(name), {}, std::move(effects));
  EXPECT_TRUE(plant.ok()) << plant.status().ToString();
  return std::move(plant).value();
}

}  // namespace rg::trajectories
