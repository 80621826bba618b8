// What all fits of one diagnosis share.
#pragma once

#include "common/sim/plant.h"
#include "services/diagnosis/data/fit_data.h"
#include "services/diagnosis/likelihood/features.h"

namespace rg::diagnosis {

struct FitSetting {
  const FitData& data;
  const sim::Plant& nominal;
  const MotionScales& scales;
};

}  // namespace rg::diagnosis
