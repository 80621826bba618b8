#include "common/base/json_fields.h"

#include <cmath>

#include "common/base/printf.h"

namespace rg {

JsonFields::JsonFields(const nlohmann::json& object, std::string_view known, std::string where)
    : object_(object), where_(std::move(where)) {
  if (!object.is_object()) Fail("must be a JSON object");
  const std::string names = " " + std::string(known) + " ";
  for (const auto& [key, value] : object.items()) {
    if (object.is_object() && names.find(" " + key + " ") == std::string::npos)
      Fail("unknown field \"" + key + "\"");
  }
}

void JsonFields::Positive(const char* field, double* value, double most) {
  Read(field, value);
  if (!(*value > 0)) Fail(Printf("%s is %g, needs a positive number", field, *value));
  Check(field, "is", *value, 0, most);
}

void JsonFields::Numbers(const char* field, int n, double least, double most, std::vector<double>* values) {
  Values(field, n, values);
  for (const double value : *values) Check(field, "holds", value, least, most);
}

void JsonFields::Format(const std::string& format) {
  std::string said;
  Require("format", &said);
  if (said != format) Fail("format is \"" + said + "\", needs " + format);
}

void JsonFields::Fail(const std::string& what) {
  if (status_.ok()) status_ = InvalidError(where_ + what);
}

void JsonFields::Check(const char* field, const char* is, double value, double least, double most) {
  if (std::isfinite(value) && value >= least && value <= most) return;
  const std::string limits =
      std::isfinite(most) ? Printf("%g to %g", least, most) : Printf("at least %g", least);
  Fail(Printf("%s %s %g, needs %s", field, is, value, limits.c_str()));
}

}  // namespace rg
