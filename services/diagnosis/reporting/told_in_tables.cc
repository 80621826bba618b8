#include "services/diagnosis/reporting/told_in_tables.h"

#include <algorithm>
#include <cmath>

#include "common/base/printf.h"
#include "common/effects/effect_catalog.h"
#include "common/effects/inference.h"

namespace rg::diagnosis {
namespace {

// Value and standard deviation to the latter's two digits: "0.840 ± 0.021".
std::string WithError(double value, double stddev) {
  if (!(stddev > 0) || !std::isfinite(stddev)) return Printf("%.4g", value);
  const int digits = std::clamp(1 - static_cast<int>(std::floor(std::log10(stddev))), 0, 8);
  return std::abs(value) < 1e5 && digits <= 6 ? Printf("%.*f ± %.*f", digits, value, digits, stddev)
                                              : Printf("%.4g ± %.2g", value, stddev);
}

// "coulomb [N·m]", with the effect where another has a parameter of that name too.
std::string ColumnOf(const std::vector<Finding>& findings, const Finding& f, const ParameterEstimate& p) {
  std::string unit = p.unit == "-" ? "" : " [" + p.unit + "]";
  for (size_t at; (at = unit.find('*')) != std::string::npos;) unit.replace(at, 1, "·");
  const bool shared = std::ranges::any_of(findings, [&](const Finding& g) {
    return g.effect != f.effect &&
           std::ranges::any_of(g.parameters, [&](const ParameterEstimate& q) { return q.name == p.name; });
  });
  return p.name + unit + (shared ? " of " + f.effect : "");
}

}  // namespace

std::string GapInWords(const DiagnosisResult& r) {
  const HoldoutFit& h = r.holdout;
  if (r.verdict == "no_mismatch" || !(h.after_rms > 0) || !(h.noise_floor_rms > 0)) return "";
  const double left = h.after_rms / h.noise_floor_rms;
  if (!std::isfinite(h.before_rms) || !(h.before_rms > 0))
    return Printf("the remaining error is %.2g × the noise floor", left);
  const double explained = 100 * (1 - h.after_rms / h.before_rms);
  return Printf("explains %.*f %% of the error; %.2g × the noise floor remains", explained > 99 ? 2 : 0,
                explained, left);
}

JointTable ParametersOfJoints(const DiagnosisResult& r) {
  JointTable out;
  out.joints = r.joints;
  out.cells.resize(r.joints.size());
  for (const Finding& f : r.findings) {
    // The weights of an unnamed force have no meaning by themselves.
    if (effects::FindEffect(f.effect) == nullptr || effects::InferenceOf(f.effect).unnamed) continue;
    for (const ParameterEstimate& p : f.parameters) {
      const auto at = std::ranges::find(r.joints, p.owner);
      if (at == r.joints.end()) continue;
      const std::string name = ColumnOf(r.findings, f, p);
      auto column = std::ranges::find(out.columns, name);
      if (column == out.columns.end()) {
        column = out.columns.insert(column, name);
        for (auto& row : out.cells) row.push_back("–");
      }
      out.cells[static_cast<size_t>(at - r.joints.begin())]
               [static_cast<size_t>(column - out.columns.begin())] = WithError(p.value, p.stddev);
    }
  }
  return out;
}

}  // namespace rg::diagnosis
