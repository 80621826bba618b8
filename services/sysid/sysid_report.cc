// How a SysidReport reads: the table for a person and the JSON for programs.
#include <cmath>
#include <nlohmann/json.hpp>

#include "services/sysid/sysid_on_set.h"

#include "common/base/printf.h"

namespace rg::sysid {
namespace {

using nlohmann::json;

std::string Ratio(double before, double after) {
  return after > 0.0 && std::isfinite(before / after) ? Printf("%.1f times less", before / after) : "";
}

std::string Before(double x) { return std::isnan(x) ? "cannot run" : Printf("%.5g", x); }

// JSON has no NaN or infinity.
json Number(double x) { return std::isfinite(x) ? json(x) : json(); }

json Numbers(const Eigen::VectorXd& x) {
  json out = json::array();
  for (const double value : x) out.push_back(Number(value));
  return out;
}

json HoldoutToJson(const SysidReport& report) {
  json recordings = json::array();
  for (const HoldoutScore& h : report.holdout) {
    recordings.push_back({{"file", h.recording},
                          {"before_rms", Number(h.before_rms)},
                          {"after_rms", Number(h.after_rms)},
                          {"before_median_window_rms", Number(h.before_median)},
                          {"after_median_window_rms", Number(h.after_median)},
                          {"before_joint_rms", Numbers(h.before_joint_rms)},
                          {"after_joint_rms", Numbers(h.after_joint_rms)}});
  }
  return {{"window_s", report.window_s},
          {"before_rms", Number(report.before_rms)},
          {"after_rms", Number(report.after_rms)},
          {"before_median_window_rms", Number(report.before_median)},
          {"after_median_window_rms", Number(report.after_median)},
          {"of_fitted_recordings", report.judged_on_fit},
          {"recordings", recordings}};
}

json WindowsToJson(const SysidReport& report) {
  json out = json::array();
  for (size_t i = 0; i < report.windows.size(); ++i) {
    const FitWindow& w = report.windows[i];
    out.push_back({{"recording", report.window_recordings[i]},
                   {"start_s", w.start_s},
                   {"length_s", w.length_s},
                   {"gain_nats", w.gain_nats}});
  }
  return out;
}

}  // namespace

std::string FormatSysid(const SysidReport& report) {
  std::string out =
      report.robot + ", " + std::to_string(report.joints.size()) + " joints: " + report.chosen + "\n\n";
  if (!report.identifiability.parameters.empty()) {
    if (report.identifiability_of != report.chosen) {
      out += "what the recordings would determine of " + report.identifiability_of + ":\n";
    }
    out += FormatIdentifiability(report.identifiability) + "\n";
  }
  out += Printf("%-36s %10s %12s %12s %8s\n", "model", "parameters", "fit rms", "held-out rms", "seconds");
  for (const CandidateScore& c : report.candidates) {
    out += Printf("%-36s %10d %12.5g %12.5g %8.1f%s\n", c.name.c_str(), c.parameters, c.fit_rms,
                  c.holdout_rms, c.seconds, c.name == report.chosen ? "  chosen" : "");
  }
  out += Printf("\n%-36s %12s %12s %14s %14s\n",
                report.judged_on_fit ? "fitted recording" : "held-out recording", "before rms", "after rms",
                "before median", "after median");
  for (const HoldoutScore& h : report.holdout) {
    out += Printf("%-36s %12s %12.5g %14s %14.5g\n", h.recording.c_str(), Before(h.before_rms).c_str(),
                  h.after_rms, Before(h.before_median).c_str(), h.after_median);
  }
  out += Printf("%-36s %12s %12.5g %14s %14.5g  ", "all", Before(report.before_rms).c_str(), report.after_rms,
                Before(report.before_median).c_str(), report.after_median) +
         Ratio(report.before_rms, report.after_rms) + "\n";
  for (size_t i = 0; i < report.windows.size(); ++i) {
    const FitWindow& w = report.windows[i];
    out += Printf("fitted: %.4g s from %.4g s of ", w.length_s, w.start_s) + report.window_recordings[i] +
           " (" + std::string(WindowChoiceName(report.window_choice)) +
           (w.gain_nats > 0.0 ? Printf(", %.3g nats", w.gain_nats) : "") + ")\n";
  }
  for (const std::string& warning : report.warnings) out += "warning: " + warning + "\n";
  out += Printf("windows of %.3g s, restarted from the measured state; steps of %.3g ms; %.1f s of work%s\n",
                report.window_s, 1e3 * report.step_s, report.seconds,
                report.stopped_early ? ", stopped early" : "");
  return out;
}

json SysidToJson(const SysidReport& report) {
  json candidates = json::array();
  for (const CandidateScore& c : report.candidates) {
    candidates.push_back({{"model", c.name},
                          {"parameters", c.parameters},
                          {"fit_rms", Number(c.fit_rms)},
                          {"holdout_rms", Number(c.holdout_rms)},
                          {"seconds", c.seconds}});
  }
  return {
      {"format", "realitygrad.sysid/1"},
      {"robot", report.robot},
      {"joints", report.joints},
      {"model", report.chosen},
      {"parametrisation", ParametrisationName(report.consistent_inertias)},
      {"window_choice", report.windows.empty() ? "all" : WindowChoiceName(report.window_choice)},
      {"windows", WindowsToJson(report)},
      {"holdout", HoldoutToJson(report)},
      {"fit", {{"before_rms", Number(report.fit_before_rms)}, {"after_rms", Number(report.fit_after_rms)}}},
      {"candidates", candidates},
      {"identifiability_of", report.identifiability_of},
      {"identifiability", IdentifiabilityToJson(report.identifiability)},
      {"warnings", report.warnings},
      {"stopped_early", report.stopped_early},
      {"elapsed_s", report.seconds}};
}

}  // namespace rg::sysid
