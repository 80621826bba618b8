#include "services/report/sysid_page.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include "common/model/robot_model.h"
#include "services/report/page.h"

namespace rg::report {
namespace {

using sysid::SysidReport;
using sysid::Verdict;

constexpr size_t kPlots = 6;
constexpr Eigen::Index kPoints = 700;  // a page is looked at, not computed with

std::string Unit(std::string unit) {
  for (size_t at; (at = unit.find('*')) != std::string::npos;) unit.replace(at, 1, "·");
  for (size_t at; (at = unit.find("^2")) != std::string::npos;) unit.replace(at, 2, "²");
  return unit == "-" ? "" : unit;
}

std::string VerdictText(Verdict verdict) {
  switch (verdict) {
    case Verdict::kDetermined:
      return "determined";
    case Verdict::kWeak:
      return "weak";
    case Verdict::kUnseen:
      return "prior only";
    case Verdict::kAtBound:
      return "at a bound";
  }
  return "";
}

void Summary(const SysidReport& r, Page* page) {
  const std::string kind = r.judged_on_fit ? "the fitted recordings" : "recordings that were not fitted";
  if (r.chosen == "nominal" && r.stopped_early) {
    page->Lead("Stopped before a fit was found that predicts " + kind + " better than the model as given.");
  } else if (r.chosen == "nominal") {
    page->Lead("The model as given predicts " + kind + " as well as any fit: it was left alone.");
  } else if (std::isnan(r.before_rms)) {
    page->Lead("The model as given cannot be simulated; errors on " + kind + " are " +
               FormatNumber(r.after_rms) + " (RMS) by fitting: " + r.chosen + ".");
  } else {
    page->Lead("Errors on " + kind + " fall from " + FormatNumber(r.before_rms) + " to " +
               FormatNumber(r.after_rms) + " (RMS) by fitting: " + r.chosen + ".");
  }
  const sysid::IdentifiabilityReport& id = r.identifiability;
  std::vector<Card> cards{
      std::isnan(r.before_rms) ? Card{"error before", "cannot run", "the model as given"}
                               : Card{"error before", FormatNumber(r.before_rms),
                                      "median window " + FormatNumber(r.before_median)},
      {"error after", FormatNumber(r.after_rms), "median window " + FormatNumber(r.after_median)}};
  if (!id.parameters.empty()) {
    cards.push_back({"determined", std::to_string(id.determined), "combinations, by the data"});
    cards.push_back({"weak", std::to_string(id.weak), "data and prior"});
    cards.push_back({"prior only", std::to_string(id.unseen),
                     "of " + std::to_string(id.parameters.size()) + " parameters' combinations"});
  }
  page->Cards(cards);
  for (const std::string& warning : r.warnings) page->Note(warning, true);
}

std::vector<double> Thinned(const Eigen::VectorXd& x) {
  const Eigen::Index stride = std::max<Eigen::Index>(1, x.size() / kPoints);
  std::vector<double> out;
  for (Eigen::Index k = 0; k < x.size(); k += stride) out.push_back(x[k]);
  return out;
}

// Joints by what identification gained on them.
std::vector<int> JointsByGain(const SysidReport& r) {
  Eigen::VectorXd gain = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(r.joints.size()));
  for (const sysid::HoldoutScore& h : r.holdout) {
    gain -= h.after_joint_rms;
    if (h.before_joint_rms.allFinite()) gain += h.before_joint_rms;
  }
  std::vector<int> order(r.joints.size());
  std::iota(order.begin(), order.end(), 0);
  std::stable_sort(order.begin(), order.end(), [&](int a, int b) { return gain[a] > gain[b]; });
  return order;
}

std::string PositionUnit(const SysidReport& r, int joint) {
  return r.plant->model().joint(joint).type == model::JointType::kPrismatic ? "m" : "rad";
}

// The axis fits what was measured, with room for a model that is somewhat wrong.
Plot TracePlot(const SysidReport& r, const sysid::HoldoutTrace& trace, int joint) {
  const std::vector<double> t = Thinned(trace.t), measured = Thinned(trace.measured.row(joint));
  Plot plot{r.joints[static_cast<size_t>(joint)] + ", " + trace.recording,
            "time [s]",
            "position [" + PositionUnit(r, joint) + "]",
            {{"measured", t, measured}, {"after", t, Thinned(trace.after.row(joint))}}};
  if (trace.before.size() > 0) {
    plot.series.insert(plot.series.begin() + 1,
                       {"before", t, Thinned(trace.before.row(joint)), SeriesStyle::kDashed});
  }
  const auto [low, high] = std::minmax_element(measured.begin(), measured.end());
  const double room = 0.6 * std::max(1e-9, *high - *low);
  plot.y_low = *low - room;
  plot.y_high = *high + room;
  return plot;
}

std::string BeforeOf(double x) { return std::isnan(x) ? "cannot run" : FormatNumber(x); }

void BeforeAfter(const SysidReport& r, Page* page) {
  page->Heading(r.judged_on_fit ? "Before and after"
                                : "Before and after, on recordings that were not fitted");
  page->Paragraph("Windows of " + FormatNumber(r.window_s) +
                  " s, each restarted from what was measured, the recorded effort open loop.");
  Table table{{"recording", "RMS before", "RMS after", "median window before", "median window after"},
              {},
              "RMS error of the joint positions [rad or m].",
              {0}};
  for (const sysid::HoldoutScore& h : r.holdout) {
    table.rows.push_back({h.recording, BeforeOf(h.before_rms), FormatNumber(h.after_rms),
                          BeforeOf(h.before_median), FormatNumber(h.after_median)});
  }
  page->AddTable(table);
  const std::vector<int> joints = JointsByGain(r);
  std::vector<Plot> plots;
  for (const sysid::HoldoutTrace& trace : r.traces) {
    const size_t each = std::max<size_t>(1, kPlots / r.traces.size());
    for (size_t j = 0; j < std::min(each, joints.size()); ++j) {
      plots.push_back(TracePlot(r, trace, joints[j]));
    }
  }
  if (!plots.empty()) page->AddPlots(plots);
}

void Models(const SysidReport& r, Page* page) {
  page->Heading("Models that were tried");
  Table table{{"model", "parameters", "RMS, fit recordings", "RMS, held out", "seconds", ""},
              {},
              "A richer model is chosen only where held-out windows are better by more than chance.",
              {0, 5}};
  for (const sysid::CandidateScore& c : r.candidates) {
    table.rows.push_back({c.name, std::to_string(c.parameters), FormatNumber(c.fit_rms),
                          FormatNumber(c.holdout_rms), FormatNumber(c.seconds),
                          c.name == r.chosen ? "chosen" : ""});
  }
  page->AddTable(table);
}

void Windows(const SysidReport& r, Page* page) {
  if (r.windows.empty()) return;
  page->Heading("Windows that were fitted");
  Table table{{"recording", "from [s]", "length [s]", "gain [nats]"},
              {},
              r.window_choice == sysid::WindowChoice::kInformation
                  ? "Chosen by what the model says they tell of the parameters, before any fit."
                  : std::string("Chosen: ") + std::string(sysid::WindowChoiceName(r.window_choice)) + ".",
              {0}};
  for (size_t i = 0; i < r.windows.size(); ++i) {
    const sysid::FitWindow& w = r.windows[i];
    table.rows.push_back({r.window_recordings[i], FormatNumber(w.start_s, 4), FormatNumber(w.length_s),
                          w.gain_nats > 0.0 ? FormatNumber(w.gain_nats) : "–"});
  }
  page->AddTable(table);
}

void Base(const SysidReport& r, Page* page) {
  const sysid::BaseParameters& base = r.identifiability.base;
  if (r.identifiability.parameters.empty()) return;
  page->Heading("What the data determine");
  if (r.identifiability_of != r.chosen) page->Note("Of the model " + r.identifiability_of + ".");
  page->Paragraph(
      "Base parameters: the combinations that these recordings tell, with their standard deviations. "
      "moment is mass times centre of mass, I the inertia about the origin of the link's frame.");
  Table table{{"combination", "value", "± sd", "as given", "unit", "verdict"}, {}, {}, {0, 4, 5}};
  for (const sysid::BaseParameter& b : base.parameters) {
    table.rows.push_back({b.expression, FormatNumber(b.value, 5), FormatNumber(b.stddev, 2),
                          FormatNumber(b.nominal, 5), Unit(b.unit),
                          VerdictText(sysid::VerdictOfShrink(b.shrink))});
  }
  page->AddTable(table);
  if (base.prior_only.empty()) return;
  std::string names;
  for (const std::string& name : base.prior_only) names += (names.empty() ? "" : ", ") + name;
  page->Subheading("What only the prior determines");
  page->Paragraph("No combination above holds them; no motion in these recordings shows them: " + names +
                  ".");
}

void Parameters(const SysidReport& r, Page* page) {
  if (r.identifiability.parameters.empty()) return;
  page->Heading("Parameter by parameter");
  page->Paragraph(std::string("Inertial parameters of a link are fitted ") +
                  (r.consistent_inertias ? "in log-Cholesky form: only bodies that can exist."
                                         : "raw: nothing keeps them from values that no body can have."));
  Table table{
      {"parameter", "value", "± sd", "as given", "unit", "sd / prior sd", "verdict"}, {}, {}, {0, 4, 6}};
  for (const sysid::ParameterVerdict& p : r.identifiability.parameters) {
    table.rows.push_back({p.name, FormatNumber(p.value, 5), FormatNumber(p.stddev, 2),
                          FormatNumber(p.nominal, 5), Unit(p.unit), FormatNumber(p.shrink, 2),
                          VerdictText(p.verdict)});
  }
  page->AddTable(table);
  if (r.identifiability.correlations.empty()) return;
  page->Subheading("Correlations above 0.95");
  Table correlations{{"parameter", "and", "correlation"}, {}, {}, {0, 1}};
  for (const sysid::Correlation& c : r.identifiability.correlations) {
    correlations.rows.push_back({r.identifiability.parameters[static_cast<size_t>(c.a)].name,
                                 r.identifiability.parameters[static_cast<size_t>(c.b)].name,
                                 FormatNumber(c.value, 3)});
  }
  page->AddTable(correlations);
}

}  // namespace

std::string SysidPage(const SysidReport& r) {
  Page page("Identification of " + r.robot, r.chosen + "; " + std::to_string(r.joints.size()) +
                                                " joints, in " + FormatNumber(r.seconds) + " s");
  Summary(r, &page);
  BeforeAfter(r, &page);
  Base(r, &page);
  Parameters(r, &page);
  Models(r, &page);
  Windows(r, &page);
  return page.Html();
}

}  // namespace rg::report
