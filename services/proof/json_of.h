// Numbers and shares as JSON.
#pragma once

#include <cmath>
#include <nlohmann/json.hpp>

#include "services/proof/statistics.h"

namespace rg::proof {

inline nlohmann::json NumberOrNull(double x) {
  return std::isfinite(x) ? nlohmann::json(x) : nlohmann::json(nullptr);
}

inline nlohmann::json ShareJson(const Share& s) {
  return {{"value", NumberOrNull(s.value)}, {"low", s.low}, {"high", s.high}, {"n", s.n}};
}

}  // namespace rg::proof
