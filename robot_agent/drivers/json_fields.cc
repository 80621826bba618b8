#include "robot_agent/drivers/json_fields.h"

#include <cmath>
#include <cstdio>

namespace rg::robot_agent {
namespace {

Status CheckNumber(const char* field, const char* is, double value, double least, double most) {
  if (std::isfinite(value) && value >= least && value <= most) return Status::Ok();
  char text[160];
  std::snprintf(text, sizeof text, "%s %s %g, needs %g to %g", field, is, value, least, most);
  return InvalidError(text);
}

}  // namespace

Status ReadNumber(const nlohmann::json& object, const char* field, double least, double most, double* value) {
  *value = object.value(field, *value);
  return CheckNumber(field, "is", *value, least, most);
}

Status CheckNumbers(const char* field, const std::vector<double>& values, int n, double least, double most) {
  if (static_cast<int>(values.size()) != n)
    return InvalidError(std::string(field) + " has " + std::to_string(values.size()) + " entries for " +
                        std::to_string(n) + " joints");
  for (const double value : values) RG_RETURN_IF_ERROR(CheckNumber(field, "holds", value, least, most));
  return Status::Ok();
}

}  // namespace rg::robot_agent
