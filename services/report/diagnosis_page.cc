#include "services/report/diagnosis_page.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <cstdio>

#include "common/effects/inference.h"
#include "services/diagnosis/reporting/told_in_tables.h"
#include "services/report/page.h"

namespace rg::report {
namespace {

using diagnosis::DiagnosisResult;
using diagnosis::Finding;
using diagnosis::ForcePlot;

std::string Percent(double x) { return FormatNumber(100 * x, 3) + " %"; }

std::string Joined(const std::vector<std::string>& parts) {
  std::string out;
  for (const std::string& p : parts) out += (out.empty() ? "" : ", ") + p;
  return out;
}

std::string WithDots(std::string units) {
  for (size_t at; (at = units.find('*')) != std::string::npos;) units.replace(at, 1, "·");
  return units;
}

// "coulomb_friction (joint_1, joint_2) + payload" with long lists of joints counted.
std::string ShortName(const std::string& name) {
  std::string out;
  size_t at = 0;
  while (at < name.size()) {
    const size_t open = name.find('(', at), close = name.find(')', open);
    if (open == std::string::npos || close == std::string::npos) break;
    const std::string inside = name.substr(open + 1, close - open - 1);
    const auto commas = std::count(inside.begin(), inside.end(), ',');
    out += name.substr(at, open - at);
    out += "(" + (commas > 0 ? std::to_string(commas + 2) + " joints" : inside) + ")";
    at = close + 1;
  }
  return out + name.substr(at);
}

// The sentence with how sure it is, and with what it may be instead.
std::string Claim(const Finding& f, bool motion) {
  std::string text = WithDots(f.statement) + " (confidence " + FormatNumber(f.confidence, 2) + ")";
  if (f.effect_class.size() < 2) return text;
  const std::vector<std::string> others(f.effect_class.begin() + 1, f.effect_class.end());
  return text + " Or it is " + Joined(others) + ": these recordings cannot tell" +
         (motion ? "; motion.csv would (see “What to record next”)." : ".");
}

// The unit of an error over all joints; empty where they have different ones.
std::string ErrorUnit(const DiagnosisResult& r) {
  const bool one = std::all_of(r.units.begin(), r.units.end(),
                               [&](const std::string& unit) { return unit == r.units.front(); });
  return one && !r.units.empty() ? " " + r.units.front() : "";
}

std::string InWords(const std::string& verdict) {
  if (verdict == "no_mismatch") return "nothing is missing from the model";
  if (verdict == "parameters_only") return "the structure is right, parameters are off";
  if (verdict == "unmodelled_physics") return "the model leaves physics out";
  if (verdict == "unexplained") return "something is missing that no named effect explains";
  return verdict;
}

void Summary(const DiagnosisResult& r, Page* page) {
  if (r.verdict == "no_mismatch") {
    page->Lead("Nothing is missing: the model explains the recordings to the noise of the sensors.");
  } else if (r.findings.empty()) {
    page->Lead("Something is missing that was not found.");
  }
  if (const std::string gap = diagnosis::GapInWords(r); !gap.empty())
    page->Lead("The model with what was found " + gap + ".");
  for (const Finding& f : r.findings) page->Lead(Claim(f, r.motion.has_value()));
  const auto& h = r.holdout;
  const std::string unit = ErrorUnit(r);
  const bool runs = !std::isnan(h.before_rms);
  page->Cards(
      {{"error before", runs ? FormatNumber(h.before_rms) + unit : "cannot run",
        h.judged_on_fit ? "model as given, the fitted recordings" : "model as given, held-out recordings"},
       {"calibrated", FormatNumber(h.calibrated_rms) + unit, "rigid-body parameters alone"},
       {"after", FormatNumber(h.after_rms) + unit, "augmented model"},
       {"noise floor", FormatNumber(h.noise_floor_rms) + unit, "if the augmented model were true"},
       runs ? Card{"improvement", Percent(1 - h.after_rms / std::max(1e-300, h.before_rms)),
                   "95 %: " + Percent(h.improvement_low) + " to " + Percent(h.improvement_high)}
            : Card{"improvement", "–", "the model as given cannot be simulated"}});
  if (h.judged_on_fit) page->Note("The set has no held-out recording: errors are of the fitted ones.", true);
  for (const std::string& note : r.notes) page->Note(note, true);
}

void FindingsTable(const DiagnosisResult& r, Page* page) {
  if (r.findings.empty()) return;
  Table table{{"effect", "joints", "confidence", "equation", "cannot be told from", "share of mismatch"},
              {},
              {},
              {0, 1, 3, 4}};
  Table values{{"effect", "owner", "parameter", "value", "stddev", "unit"}, {}, {}, {0, 1, 2, 5}};
  const auto of_joint = [&](const std::string& owner) {
    return std::find(r.joints.begin(), r.joints.end(), owner) != r.joints.end();
  };
  for (const Finding& f : r.findings) {
    const std::vector<std::string> others(f.effect_class.begin() + (f.effect_class.empty() ? 0 : 1),
                                          f.effect_class.end());
    table.rows.push_back({f.effect, Joined(f.joints), FormatNumber(f.confidence, 2), f.equation,
                          others.empty() ? "–" : Joined(others),
                          f.share_of_mismatch > 0 ? Percent(f.share_of_mismatch) : "–"});
    // Base parameters stand below, weights of a force without a name say nothing by themselves.
    if (f.effect == "parameters_only" || effects::InferenceOf(f.effect).unnamed) continue;
    for (const auto& p : f.parameters) {
      if (of_joint(p.owner)) continue;  // in the table of joints
      values.rows.push_back({f.effect, p.owner, p.name, FormatNumber(p.value, 4), FormatNumber(p.stddev, 2),
                             p.unit == "-" ? "" : WithDots(p.unit)});
    }
  }
  page->Heading("What is missing");
  page->AddTable(table);
  if (!values.rows.empty()) page->AddTable(values);
  const diagnosis::JointTable joints = diagnosis::ParametersOfJoints(r);
  if (joints.columns.empty()) return;
  Table of_joints{{"joint"}, {}, {}, {0}};
  of_joints.columns.insert(of_joints.columns.end(), joints.columns.begin(), joints.columns.end());
  for (size_t j = 0; j < joints.joints.size(); ++j) {
    of_joints.rows.push_back({joints.joints[j]});
    of_joints.rows.back().insert(of_joints.rows.back().end(), joints.cells[j].begin(), joints.cells[j].end());
  }
  page->AddTable(of_joints);
}

// Joints worth a plot: those of the findings, else the loudest.
std::vector<int> PlottedJoints(const DiagnosisResult& r) {
  std::vector<int> out;
  const auto add = [&](int j) {
    if (std::find(out.begin(), out.end(), j) == out.end() && out.size() < 4) out.push_back(j);
  };
  for (const Finding& f : r.findings) {
    for (const std::string& name : f.joints) {
      add(static_cast<int>(std::find(r.joints.begin(), r.joints.end(), name) - r.joints.begin()));
    }
  }
  if (!out.empty()) return out;
  std::vector<std::pair<double, int>> loud;
  for (int j = 0; j < r.joint_share.size(); ++j) loud.push_back({r.joint_share[j], j});
  std::sort(loud.rbegin(), loud.rend());
  for (size_t i = 0; i < std::min<size_t>(2, loud.size()); ++i) add(loud[i].second);
  return out;
}

std::vector<double> RowOf(const Eigen::MatrixXd& m, int row) {
  std::vector<double> out(static_cast<size_t>(m.cols()));
  for (Eigen::Index k = 0; k < m.cols(); ++k) out[static_cast<size_t>(k)] = m(row, k);
  return out;
}

// Every so manieth of a long row: a page is looked at, not computed with.
std::vector<double> Thinned(const std::vector<double>& x) {
  const size_t stride = std::max<size_t>(1, x.size() / 700);
  std::vector<double> out;
  for (size_t i = 0; i < x.size(); i += stride) out.push_back(x[i]);
  return out;
}

Plot OverTime(const DiagnosisResult& r, const ForcePlot& f, int joint) {
  return {
      "Missing force on " + r.joints[joint] + ", " + f.recording,
      "time [s]",
      r.units[joint] == "m" ? "N" : "N·m",
      {{"estimated", Thinned(f.t), Thinned(RowOf(f.force, joint))},
       {"explained by the findings", Thinned(f.t), Thinned(RowOf(f.explained, joint)), SeriesStyle::kDashed}},
      "Estimated from the recording with the rigid-body model alone, in stairs of 50 ms."};
}

// Over what the finding's force shows over best.
Plot OverVariable(const DiagnosisResult& r, int joint, effects::Variable variable) {
  std::vector<std::array<double, 3>> points;
  for (const ForcePlot& f : r.force_plots) {
    const Eigen::MatrixXd& x = variable == effects::Variable::kPosition ? f.q
                               : variable == effects::Variable::kEffort ? f.u
                                                                        : f.v;
    for (Eigen::Index k = 0; k < f.force.cols(); ++k) {
      if (f.stddev(joint, k) > 0.7 * f.stddev.row(joint).maxCoeff() && k % 2 == 1) continue;
      const double at = variable == effects::Variable::kTime ? f.t[static_cast<size_t>(k)] : x(joint, k);
      points.push_back({at, f.force(joint, k), f.explained(joint, k)});
    }
  }
  std::sort(points.begin(), points.end());
  const size_t stride = std::max<size_t>(1, points.size() / 500);
  Series raw{"estimated", {}, {}, SeriesStyle::kPoints},
      law{"explained by the findings", {}, {}, SeriesStyle::kPoints};
  double last = -1e300;
  for (size_t i = 0; i < points.size(); i += stride) {
    if (points[i][0] <= last) continue;
    last = points[i][0];
    raw.x.push_back(points[i][0]), raw.y.push_back(points[i][1]);
    law.x.push_back(points[i][0]), law.y.push_back(points[i][2]);
  }
  const std::string force = r.units[joint] == "m" ? "N" : "N·m", name(effects::VariableName(variable));
  const std::string unit = variable == effects::Variable::kPosition   ? r.units[joint]
                           : variable == effects::Variable::kVelocity ? r.units[joint] + "/s"
                           : variable == effects::Variable::kEffort   ? force
                                                                      : "s";
  return {"Over the " + name + " of " + r.joints[joint],
          name + " [" + unit + "]",
          "missing force [" + force + "]",
          {raw, law}};
}

// The finding that explains most on a joint.
const Finding* FindingOn(const DiagnosisResult& r, int joint) {
  const Finding* best = nullptr;
  for (const Finding& f : r.findings) {
    const bool here =
        f.joints.empty() || std::find(f.joints.begin(), f.joints.end(), r.joints[joint]) != f.joints.end();
    if (!here || f.effect == "parameters_only") continue;
    // What acts on this joint itself before what shows on all.
    const bool own = !f.joints.empty(), best_own = best != nullptr && !best->joints.empty();
    if (best == nullptr || (own && !best_own) ||
        (own == best_own && f.share_of_mismatch > best->share_of_mismatch))
      best = &f;
  }
  return best;
}

void Where(const DiagnosisResult& r, Page* page) {
  page->Heading("Where it is");
  Table shares{{"joint", "share of the missing force's energy"},
               {},
               "In units of each joint's usual torque, above the noise.",
               {0}};
  for (size_t j = 0; j < r.joints.size(); ++j) {
    shares.rows.push_back({r.joints[j], Percent(r.joint_share[static_cast<Eigen::Index>(j)])});
  }
  if (r.joint_share.size() > 0 && r.joint_share.maxCoeff() > 0) {
    page->AddTable(shares);
  } else {
    page->Paragraph(
        "The missing force does not rise above its noise in stairs of 50 ms; what was found shows in whole "
        "trajectories only.");
  }
  for (const Finding& f : r.findings) page->Paragraph(f.effect + ": " + f.summary + ".");
  std::vector<Plot> plots;
  for (const int joint : PlottedJoints(r)) {
    if (!r.force_plots.empty()) plots.push_back(OverTime(r, r.force_plots.front(), joint));
    const Finding* finding = FindingOn(r, joint);
    plots.push_back(
        OverVariable(r, joint, finding == nullptr ? effects::Variable::kVelocity : finding->shows_over));
  }
  if (!plots.empty()) page->AddPlots(plots);
}

// Axis for what was measured, with room for a model that is somewhat wrong; one that runs away leaves it.
void FitAxis(const std::vector<double>& measured, Plot* plot) {
  if (measured.empty()) return;
  const auto [low, high] = std::minmax_element(measured.begin(), measured.end());
  const double room = 0.6 * std::max(1e-9, *high - *low);
  plot->y_low = *low - room, plot->y_high = *high + room;
}

void BeforeAfter(const DiagnosisResult& r, Page* page) {
  page->Heading(r.holdout.judged_on_fit ? "Before and after, on the fitted recordings"
                                        : "Before and after, on recordings that were not fitted");
  page->Paragraph("Windows of " + FormatNumber(r.window_s) + " s, each restarted from what was measured.");
  Table each{{"recording", "as given", "calibrated", "with the findings", "median window as given",
              "median window with the findings"},
             {},
             "RMS error of the joint positions.",
             {0}};
  for (const auto& h : r.holdout.recordings) {
    const auto before = [](double x) { return std::isnan(x) ? std::string("cannot run") : FormatNumber(x); };
    each.rows.push_back({h.name, before(h.before_rms), FormatNumber(h.calibrated_rms),
                         FormatNumber(h.after_rms), before(h.before_median), FormatNumber(h.after_median)});
  }
  if (each.rows.size() > 1) page->AddTable(each);
  std::vector<Plot> plots;
  for (const auto& h : r.holdout_plots) {
    for (const int joint : PlottedJoints(r)) {
      plots.push_back({r.joints[joint] + ", " + h.recording,
                       "time [s]",
                       "position [" + r.units[joint] + "]",
                       {{"measured", h.t, RowOf(h.measured, joint)}, {"after", h.t, RowOf(h.after, joint)}}});
      if (h.before.size() > 0) {
        auto& series = plots.back().series;
        series.insert(series.begin() + 1, {"before", h.t, RowOf(h.before, joint), SeriesStyle::kDashed});
      }
      FitAxis(RowOf(h.measured, joint), &plots.back());
      if (plots.size() >= 6) break;
    }
  }
  if (!plots.empty()) page->AddPlots(plots);
}

void ProposedMotion(const DiagnosisResult& r, Page* page) {
  const diagnosis::ProposedMotion& motion = *r.motion;
  page->Paragraph(
      "These recordings cannot tell " + Joined(motion.effects) +
      " apart. motion.csv, beside this page, would: " + motion.description +
      ". The wrong one is then expected to lie " + FormatNumber(motion.expected_nats) +
      " nats behind. It stays within the recorded ranges and the limits of the URDF; collisions are "
      "not looked for.");
  page->Code(
      "realitygrad submit rollout --trajectory motion.csv --out MORE\nrealitygrad diagnose SET MORE --out "
      "AGAIN");
  Plot plot{"motion.csv", "time [s]", "position", {}};
  for (Eigen::Index j = 0; j < motion.q.rows(); ++j) {
    const std::vector<double> q = RowOf(motion.q, static_cast<int>(j));
    if (*std::max_element(q.begin(), q.end()) > *std::min_element(q.begin(), q.end()))
      plot.series.push_back({r.joints[static_cast<size_t>(j)], motion.t, q});
  }
  page->AddPlot(plot);
}

void Considered(const DiagnosisResult& r, Page* page) {
  page->Heading("What else was considered");
  Table table{
      {"model", "base parameters", "against the chosen one [nats]", "χ² per row", ""}, {}, {}, {0, 1, 4}};
  double chosen = 0;
  for (const auto& c : r.candidates) {
    if (c.chosen) chosen = c.evidence;
  }
  table.caption = r.effort_measured
                      ? "Log evidence on parts of the recordings left out in "
                        "turn. χ² per row is in units of what "
                        "the findings leave. A kind of effect must bring more nats than chance "
                        "over all hypotheses, more than two "
                        "standard errors, and a tenth of what remains on its joint."
                      : "Log evidence, less the chosen model's. χ² per row is 1 where only the sensors' "
                        "noise remains. An addition must "
                        "bring at least " +
                            FormatNumber(r.null_threshold) +
                            " nats, which chance alone reaches in 2 % of sets.";
  for (const auto& c : r.candidates) {
    table.rows.push_back({ShortName(c.name), c.calibrated ? "free" : "as given",
                          c.chosen ? "0" : FormatNumber(c.evidence - chosen, 3),
                          FormatNumber(c.chi2_per_row, 4),
                          c.chosen                  ? "chosen"
                          : c.evidence > chosen + 1 ? "more, but too little for what it adds"
                                                    : ""});
  }
  page->AddTable(table);
  Table next{{"instead of", "alternative", "log evidence", "separable", "what would tell them apart"},
             {},
             {},
             {0, 1, 3, 4}};
  for (const Finding& f : r.findings) {
    for (const auto& a : f.alternatives) {
      next.rows.push_back({f.effect,
                           ShortName(a.effect + (a.joints.empty() ? "" : " (" + Joined(a.joints) + ")")),
                           FormatNumber(a.evidence, 4), a.separable ? "yes" : "no", a.experiment});
    }
  }
  if (next.rows.empty()) return;
  const bool open = std::any_of(r.findings.begin(), r.findings.end(),
                                [](const Finding& f) { return f.effect_class.size() > 1; });
  page->Heading(open ? "What to record next" : "What would confirm it further");
  if (r.motion) ProposedMotion(r, page);
  page->AddTable(next);
}

constexpr double kWorthARow = 0.05;  // prior stddev

double Moved(const diagnosis::LedgerRow& row) { return (row.final - row.calibrated) / row.prior_stddev; }

void Absorbed(const DiagnosisResult& r, Page* page) {
  if (r.findings.empty() || r.ledger.empty() || std::abs(Moved(r.ledger.front())) < kWorthARow) return;
  page->Heading("Which parameters had absorbed it");
  page->Paragraph(
      "Base parameters fitted without the effects, and with them: what moves back toward the URDF had stood "
      "in for "
      "the missing physics.");
  Table table{{"parameter", "URDF", "calibrated alone", "with the findings", "moved [prior stddev]", "unit"},
              {},
              {},
              {0, 5}};
  for (const auto& row : r.ledger) {
    const double moved = Moved(row);
    if (table.rows.size() >= 12 || std::abs(moved) < kWorthARow) break;
    table.rows.push_back({row.name, FormatNumber(row.nominal, 4), FormatNumber(row.calibrated, 4),
                          FormatNumber(row.final, 4), FormatNumber(moved, 2), WithDots(row.unit)});
  }
  if (!table.rows.empty()) page->AddTable(table);
}

}  // namespace

std::string DiagnosisPage(const DiagnosisResult& r) {
  Page page("Diagnosis of " + r.robot,
            InWords(r.verdict) + " (" + r.verdict + "), in " + FormatNumber(r.elapsed_s) + " s");
  Summary(r, &page);
  FindingsTable(r, &page);
  Where(r, &page);
  BeforeAfter(r, &page);
  Considered(r, &page);
  Absorbed(r, &page);
  return page.Html();
}

}  // namespace rg::report
