// Fields of a configuration's JSON object. The first error stays, with field, value and limit; later reads do
// nothing.
#pragma once

#include <limits>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "common/base/status.h"

namespace rg {

class JsonFields {
 public:
  // `known`: names with blanks between; any other field is refused. `where` begins every message ("sensors:
  // ").
  JsonFields(const nlohmann::json& object, std::string_view known, std::string where = "");

  // Absent: *value stays, and is checked too where there are limits.
  template <class T>
  void Read(const char* field, T* value) {
    if (!status_.ok() || !object_.contains(field)) return;
    try {
      object_.at(field).get_to(*value);
    } catch (const nlohmann::json::exception& error) {
      Fail(std::string(field) + " is " + object_.at(field).dump() + ": " + error.what());
    }
  }
  // `what` says in the refusal what a missing one is.
  template <class T>
  void Require(const char* field, T* value, const std::string& what = "") {
    if (!object_.contains(field))
      Fail("\"" + std::string(field) + "\" is missing" + (what.empty() ? "" : ": ") + what);
    Read(field, value);
  }
  // Finite, from `least` to `most`.
  template <class T>
  void Number(const char* field, double least, double most, T* value) {
    Read(field, value);
    Check(field, "is", static_cast<double>(*value), least, most);
  }
  void Positive(const char* field, double* value, double most = std::numeric_limits<double>::infinity());
  // n values.
  template <class T>
  void Values(const char* field, int n, std::vector<T>* values) {
    Read(field, values);
    if (static_cast<int>(values->size()) == n) return;
    Fail(values->empty() ? std::string(field) + " is missing"
                         : std::string(field) + " has " + std::to_string(values->size()) + " entries for " +
                               std::to_string(n) + " joints");
  }
  void Numbers(const char* field, int n, double least, double most, std::vector<double>* values);
  // The field `format` is this.
  void Format(const std::string& format);

  void Fail(const std::string& what);
  const Status& status() const { return status_; }

 private:
  void Check(const char* field, const char* is, double value, double least, double most);

  const nlohmann::json& object_;
  const std::string where_;
  Status status_;
};

}  // namespace rg
