#include "services/sysid/identifiability.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "common/base/check.h"
#include "common/base/printf.h"
#include "common/model/robot_model.h"
#include "common/sim/plant.h"
#include "services/sysid/drive_signal.h"

namespace rg::sysid {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using nlohmann::json;

bool AtBound(double value, double lower, double upper, double prior) {
  const double tolerance = 1e-6 * std::max({prior, std::abs(value), 1e-300});
  return value <= lower + tolerance || value >= upper - tolerance;
}

std::vector<std::pair<int, double>> LargestLoadings(const VectorXd& v) {
  std::vector<std::pair<int, double>> loadings;
  for (int i = 0; i < v.size(); ++i) {
    if (std::abs(v[i]) > 0.1) loadings.emplace_back(i, v[i]);
  }
  std::sort(loadings.begin(), loadings.end(),
            [](const auto& a, const auto& b) { return std::abs(a.second) > std::abs(b.second); });
  if (loadings.size() > 6) loadings.resize(6);
  return loadings;
}

void FillDirections(const MatrixXd& scaled_information, IdentifiabilityReport* report) {
  const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(scaled_information);
  const int P = static_cast<int>(scaled_information.rows());
  for (int k = P - 1; k >= 0; --k) {
    Direction d;
    d.shrink = 1.0 / std::sqrt(1.0 + std::max(0.0, eigen.eigenvalues()[k]));
    d.verdict = VerdictOfShrink(d.shrink);
    d.loadings = LargestLoadings(eigen.eigenvectors().col(k));
    (d.verdict == Verdict::kDetermined ? report->determined
     : d.verdict == Verdict::kWeak     ? report->weak
                                       : report->unseen) += 1;
    report->directions.push_back(std::move(d));
  }
}

void FillCorrelations(IdentifiabilityReport* report) {
  const MatrixXd& C = report->covariance;
  for (int a = 0; a < C.rows(); ++a) {
    for (int b = a + 1; b < C.rows(); ++b) {
      const double rho = C(a, b) / std::sqrt(C(a, a) * C(b, b));
      if (std::abs(rho) > kStrongCorrelation) report->correlations.push_back({a, b, rho});
    }
  }
  std::sort(report->correlations.begin(), report->correlations.end(),
            [](const Correlation& x, const Correlation& y) { return std::abs(x.value) > std::abs(y.value); });
}

ParameterVerdict VerdictFor(const IdentifiabilityInput& in, int i, double variance) {
  ParameterVerdict v{in.names[i], in.units[i], in.value[i], in.nominal[i], in.prior_stddev[i]};
  v.stddev = std::sqrt(variance);
  v.shrink = v.stddev / v.prior_stddev;
  const bool fixed = in.lower[i] == in.upper[i];
  v.verdict = !fixed && AtBound(in.value[i], in.lower[i], in.upper[i], in.prior_stddev[i])
                  ? Verdict::kAtBound
                  : VerdictOfShrink(v.shrink);
  return v;
}

std::string DirectionLine(const IdentifiabilityReport& report, const Direction& d) {
  std::string line = Printf("  %-10s %8.3g  ", std::string(VerdictName(d.verdict)).c_str(), d.shrink);
  for (const auto& [i, w] : d.loadings) line += Printf(" %+.2f", w) + " " + report.parameters[i].name;
  return line + "\n";
}

std::string BaseLine(const BaseParameter& b) {
  return Printf("  %12.5g +- %-10.3g %-8s %-10s  ", b.value, b.stddev, b.unit.c_str(),
                std::string(VerdictName(VerdictOfShrink(b.shrink))).c_str()) +
         b.expression + "\n";
}

// Names in lines of about 100 characters.
std::string Listed(const std::vector<std::string>& names) {
  std::string out, line = "  ";
  for (size_t i = 0; i < names.size(); ++i) {
    const std::string word = names[i] + (i + 1 < names.size() ? ", " : "");
    if (line.size() + word.size() > 100) {
      out += line + "\n";
      line = "  ";
    }
    line += word;
  }
  return out + line + "\n";
}

// Some base parameter is no parameter of the table above.
bool HasSums(const IdentifiabilityReport& report) {
  return std::any_of(report.base.parameters.begin(), report.base.parameters.end(),
                     [&](const BaseParameter& b) {
                       return std::none_of(report.parameters.begin(), report.parameters.end(),
                                           [&](const ParameterVerdict& p) { return p.name == b.expression; });
                     });
}

json BaseToJson(const BaseParameters& base) {
  json out = json::array();
  for (const BaseParameter& b : base.parameters) {
    json terms = json::object();
    for (const auto& [name, factor] : b.terms) terms[name] = factor;
    out.push_back({{"expression", b.expression},
                   {"unit", b.unit},
                   {"value", b.value},
                   {"stddev", b.stddev},
                   {"nominal", b.nominal},
                   {"prior_stddev", b.prior_stddev},
                   {"verdict", VerdictName(VerdictOfShrink(b.shrink))},
                   {"terms", terms}});
  }
  return out;
}

}  // namespace

Verdict VerdictOfShrink(double shrink) {
  if (shrink <= kDeterminedShrink) return Verdict::kDetermined;
  return shrink >= kUnseenShrink ? Verdict::kUnseen : Verdict::kWeak;
}

std::string_view VerdictName(Verdict verdict) {
  switch (verdict) {
    case Verdict::kDetermined:
      return "determined";
    case Verdict::kWeak:
      return "weak";
    case Verdict::kUnseen:
      return "prior_only";
    case Verdict::kAtBound:
      return "at_bound";
  }
  return "prior_only";
}

IdentifiabilityReport Identify(const IdentifiabilityInput& in) {
  const int P = static_cast<int>(in.names.size());
  RG_CHECK(in.information.rows() == P && in.information.cols() == P);
  RG_CHECK(in.value.size() == P && in.nominal.size() == P && in.prior_stddev.size() == P);
  RG_CHECK(in.lower.size() == P && in.upper.size() == P && static_cast<int>(in.units.size()) == P);
  RG_CHECK(P == 0 || in.prior_stddev.minCoeff() > 0.0) << "a prior stddev that is not positive";
  IdentifiabilityReport report;
  if (P == 0) return report;
  const auto D = in.prior_stddev.asDiagonal();
  const MatrixXd scaled = D * in.information * D / in.residual_variance;
  FillDirections(scaled, &report);
  const MatrixXd posterior = (scaled + MatrixXd::Identity(P, P)).llt().solve(MatrixXd::Identity(P, P));
  report.covariance = D * posterior * D;
  for (int i = 0; i < P; ++i) report.parameters.push_back(VerdictFor(in, i, report.covariance(i, i)));
  FillCorrelations(&report);
  report.base = FindBaseParameters({&in.names, &in.units, in.value, in.nominal, in.prior_stddev,
                                    in.information / in.residual_variance, report.covariance});
  return report;
}

MatrixXd InformationOf(const Eigen::Ref<const MatrixXd>& jacobian) { return jacobian.transpose() * jacobian; }

std::vector<std::string> ImpossibleInertias(const std::vector<LinkInertia>& links) {
  std::vector<std::string> warnings;
  for (const LinkInertia& link : links) {
    if (link.mass < 0.0)
      warnings.push_back("link " + link.link + ": negative mass " + Printf("%.4g kg", link.mass));
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> eigen(link.inertia, Eigen::EigenvaluesOnly);
    const Eigen::Vector3d I = eigen.eigenvalues();  // ascending
    const double slack = 1e-9 * std::max(std::abs(I[0]), std::abs(I[2]));
    if (I[0] < -slack) {
      warnings.push_back("link " + link.link + ": negative principal inertia " + Printf("%.4g kg·m²", I[0]));
    } else if (I[2] > I[0] + I[1] + slack) {
      warnings.push_back("link " + link.link + ": principal inertias " +
                         Printf("%.4g, %.4g, %.4g kg·m² break the triangle inequality", I[0], I[1], I[2]));
    }
  }
  return warnings;
}

std::vector<std::string> ImpossibleInertias(const sim::Plant& plant, const VectorXd& values) {
  const auto parameters = LinkParametersOf(plant, values);
  std::vector<LinkInertia> links;
  for (int i = 0; i < plant.model().num_links(); ++i) {
    const model::LinkParameters link = parameters.col(i);
    if (plant.model().link(i).has_inertial) {
      links.push_back({plant.model().link(i).name, link[0], model::InertiaMatrix(link)});
    }
  }
  return ImpossibleInertias(links);
}

std::string FormatIdentifiability(const IdentifiabilityReport& report) {
  std::string out = Printf("%-40s %12s %12s %12s  %-10s %8s\n", "parameter", "value", "stddev", "nominal",
                           "verdict", "shrink");
  for (const ParameterVerdict& p : report.parameters) {
    out += Printf("%-40s %12.5g %12.3g %12.5g  %-10s %8.3g", p.name.c_str(), p.value, p.stddev, p.nominal,
                  std::string(VerdictName(p.verdict)).c_str(), p.shrink) +
           "  " + p.unit + "\n";
  }
  out += Printf("combinations: %d determined by the data, %d weakly, %d by the prior alone\n",
                report.determined, report.weak, report.unseen);
  if (HasSums(report)) {
    out += "what the data determine (moment: mass times com, I: about the origin of the link's frame):\n";
    for (const BaseParameter& b : report.base.parameters) out += BaseLine(b);
  }
  if (!report.base.prior_only.empty()) {
    out += "what only the prior determines:\n" + Listed(report.base.prior_only);
  }
  if (report.weak > 0) out += "weak combinations, in units of the prior:\n";
  for (const Direction& d : report.directions) {
    if (d.verdict == Verdict::kWeak) out += DirectionLine(report, d);
  }
  for (const Correlation& c : report.correlations) {
    out += Printf("correlation %+.3f  ", c.value) + report.parameters[c.a].name + "  " +
           report.parameters[c.b].name + "\n";
  }
  for (const std::string& warning : report.warnings) out += "warning: " + warning + "\n";
  return out;
}

json IdentifiabilityToJson(const IdentifiabilityReport& report) {
  json parameters = json::array();
  for (const ParameterVerdict& p : report.parameters) {
    parameters.push_back({{"name", p.name},
                          {"unit", p.unit},
                          {"value", p.value},
                          {"nominal", p.nominal},
                          {"stddev", p.stddev},
                          {"prior_stddev", p.prior_stddev},
                          {"shrink", p.shrink},
                          {"verdict", VerdictName(p.verdict)}});
  }
  json directions = json::array();
  for (const Direction& d : report.directions) {
    json loadings = json::object();
    for (const auto& [i, w] : d.loadings) loadings[report.parameters[i].name] = w;
    directions.push_back({{"shrink", d.shrink}, {"verdict", VerdictName(d.verdict)}, {"loadings", loadings}});
  }
  json correlations = json::array();
  for (const Correlation& c : report.correlations) {
    correlations.push_back(
        {{"a", report.parameters[c.a].name}, {"b", report.parameters[c.b].name}, {"value", c.value}});
  }
  return {{"base_parameters", BaseToJson(report.base)},
          {"prior_only_parameters", report.base.prior_only},
          {"parameters", parameters},
          {"directions", directions},
          {"determined", report.determined},
          {"weak", report.weak},
          {"prior_only", report.unseen},
          {"correlations", correlations},
          {"warnings", report.warnings}};
}

}  // namespace rg::sysid
