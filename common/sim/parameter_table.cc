#include "common/sim/parameter_table.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "common/base/check.h"

namespace rg::sim {
namespace {

// Levenshtein distance, for the "did you mean" of a mistyped name.
size_t EditDistance(std::string_view a, std::string_view b) {
  std::vector<size_t> row(b.size() + 1);
  for (size_t j = 0; j <= b.size(); ++j) row[j] = j;
  for (size_t i = 1; i <= a.size(); ++i) {
    size_t diagonal = row[0];
    row[0] = i;
    for (size_t j = 1; j <= b.size(); ++j) {
      const size_t change = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
      diagonal = row[j];
      row[j] = std::min({row[j] + 1, row[j - 1] + 1, change});
    }
  }
  return row[b.size()];
}

std::string Number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.6g", value);
  return text;
}

}  // namespace

int ParameterTable::Find(std::string_view name) const {
  const auto it = by_name_.find(std::string(name));
  return it == by_name_.end() ? -1 : it->second;
}

Result<int> ParameterTable::IndexOf(std::string_view name) const {
  const int index = Find(name);
  if (index >= 0) return index;
  std::string message = "no parameter " + std::string(name);
  const auto closest =
      std::min_element(rows_.begin(), rows_.end(), [&](const Parameter& a, const Parameter& b) {
        return EditDistance(a.name, name) < EditDistance(b.name, name);
      });
  if (closest != rows_.end()) message += "; the closest is " + closest->name;
  return NotFoundError(std::move(message));
}

std::vector<int> ParameterTable::OfKind(ParameterKind kind) const {
  std::vector<int> indices;
  for (int i = 0; i < size(); ++i) {
    if (rows_[i].kind == kind) indices.push_back(i);
  }
  return indices;
}

Eigen::VectorXd ParameterTable::Nominal() const {
  Eigen::VectorXd values(size());
  for (int i = 0; i < size(); ++i) values[i] = rows_[i].nominal;
  return values;
}

Status ParameterTable::Validate(const Eigen::VectorXd& values) const {
  if (values.size() != size()) {
    return InvalidError(std::to_string(values.size()) + " parameter values, the table has " +
                        std::to_string(size()));
  }
  for (int i = 0; i < size(); ++i) {
    const Parameter& row = rows_[i];
    if (!std::isfinite(values[i])) return InvalidError("parameter " + row.name + " is not finite");
    if (values[i] < row.lower || values[i] > row.upper) {
      return InvalidError("parameter " + row.name + " = " + Number(values[i]) + " is outside [" +
                          Number(row.lower) + ", " + Number(row.upper) + "] " + row.unit);
    }
  }
  return Status::Ok();
}

void ParameterTable::Add(Parameter row) {
  RG_CHECK(by_name_.emplace(row.name, size()).second) << row.name;
  rows_.push_back(std::move(row));
}

}  // namespace rg::sim
