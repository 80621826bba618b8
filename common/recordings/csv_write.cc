#include <algorithm>
#include <charconv>
#include <cmath>

#include "common/base/file.h"
#include "common/recordings/csv.h"

namespace rg::recordings {
namespace {

void AppendNumber(std::string* out, double value, int digits) {
  char buffer[40];
  const auto end =
      digits > 0 ? std::to_chars(buffer, buffer + sizeof buffer, value, std::chars_format::general, digits)
                 : std::to_chars(buffer, buffer + sizeof buffer, value);
  out->append(buffer, end.ptr);
}

}  // namespace

std::string FormatCsv(const Recording& r, int digits) {
  std::string out = "time";
  const std::pair<const char*, const Eigen::MatrixXd*> kinds[] = {{"position", &r.q},
                                                                  {"velocity", &r.v},
                                                                  {"effort_command", &r.effort_command},
                                                                  {"effort_measured", &r.effort_measured}};
  const auto written = [&](const Eigen::MatrixXd* x, Eigen::Index i) {
    if (x == &r.v) {
      const auto& without = r.without_velocity;
      return std::find(without.begin(), without.end(), i) == without.end();
    }
    return x == &r.q || !r.IsPrescribed(static_cast<int>(i));
  };
  for (const auto& [kind, x] : kinds) {
    for (Eigen::Index i = 0; i < x->rows(); ++i) {
      if (written(x, i)) out += std::string(",") + kind + "." + r.joints[static_cast<size_t>(i)];
    }
  }
  for (const auto& [name, column] : r.other) out += "," + name;
  out += '\n';
  for (int k = 0; k < r.rows(); ++k) {
    AppendNumber(&out, r.t[k] + r.time_offset, 0);
    for (const auto& [kind, x] : kinds) {
      for (Eigen::Index i = 0; i < x->rows(); ++i) {
        if (!written(x, i)) continue;
        out += ',';
        AppendNumber(&out, (*x)(i, k), digits);
      }
    }
    for (const auto& [name, column] : r.other) {
      out += ',';
      if (!std::isnan(column[k])) AppendNumber(&out, column[k], digits);
    }
    out += '\n';
  }
  return out;
}

Status WriteCsv(const std::string& path, const Recording& recording, int digits) {
  return WriteFileAtomically(path, FormatCsv(recording, digits));
}

}  // namespace rg::recordings
