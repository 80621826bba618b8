// Fields of a configuration's JSON object; a refusal names field, value and limit. Wrong types throw
// nlohmann::json::exception, which whoever parsed the text catches.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "common/base/status.h"

namespace rg::robot_agent {

// A finite number from `least` to `most`; absent: *value stays, and is checked too.
Status ReadNumber(const nlohmann::json& object, const char* field, double least, double most, double* value);

// n numbers from `least` to `most` each.
Status CheckNumbers(const char* field, const std::vector<double>& values, int n, double least, double most);

// n values; absent: n times `otherwise`.
template <class T>
Status ReadVector(const nlohmann::json& object, const char* field, int n, T otherwise,
                  std::vector<T>* values) {
  *values = object.value(field, std::vector<T>(n, otherwise));
  if (static_cast<int>(values->size()) == n) return Status::Ok();
  return InvalidError(std::string(field) + " has " + std::to_string(values->size()) + " entries for " +
                      std::to_string(n) + " joints");
}

}  // namespace rg::robot_agent
