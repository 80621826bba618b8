#include "services/cli/run_report.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "common/base/printf.h"
#include "services/cli/output.h"
#include "services/cli/search_plot.h"
#include "services/report/page.h"

namespace rg::cli {
namespace {

using nlohmann::json;
using report::FormatNumber;

double Number(const json& j, const json::json_pointer& at) {
  if (!j.contains(at) || !j.at(at).is_number()) return std::nan("");
  return j.at(at).get<double>();
}

// A row of the table: what it is, where it stands in a result (a number, or a word), and the paper's figure per
// iteration.
struct ResultRow {
  const char* name;
  const char* unit;
  const char* pointer;
  const char* paper;
};

std::string Cell(const json& result, const ResultRow& row) {
  const json::json_pointer at(row.pointer);
  if (result.contains(at) && result.at(at).is_string()) return result.at(at).get<std::string>();
  const double value = Number(result, at);
  return row.unit[0] == '\0' && value == std::floor(value) && std::abs(value) < 1e9
             ? std::to_string(std::lround(value))
             : FormatNumber(value);
}

const ResultRow kRows[] = {
    {"trajectories solved", "", "/trajectories/solved", "450"},
    {"  draws replaced", "", "/trajectories/failed", "–"},
    {"  time", "s", "/seconds/trajectories", "77 (30 threads)"},
    {"policy: training loss", "", "/policy/train_loss", "–"},
    {"  validation loss", "", "/policy/validation_loss", "–"},
    {"  time", "s", "/seconds/policy", "24"},
    {"  goal error in simulation, median", "rad", "/examination/policy/median", "–"},
    {"  90th percentile", "rad", "/examination/policy/p90", "–"},
    {"  pairs whose policy diverges", "", "/examination/policy/diverged", "–"},
    {"  median of MPC", "rad", "/examination/mpc/median", "–"},
    {"  90th percentile of MPC", "rad", "/examination/mpc/p90", "–"},
    {"rollout: ended", "", "/rollout/end_reason", "–"},
    {"  after", "s", "/rollout/ended_after_s", "6"},
    {"  distance to goal at the end", "rad", "/rollout/goal_error/joint_norm", "–"},
    {"  distance covered at the start", "rad", "/rollout/goal_error/start_norm", "–"},
    {"  end effector to goal", "m", "/rollout/goal_error/tip_distance_m", "–"},
    {"  excitation, share of the torque limits", "", "/rollout/excitation", "–"},
    {"  share of the full speed", "", "/rollout/speed", "–"},
    {"  time", "s", "/seconds/rollout", "6"},
    {"simulation: residual before", "rad²", "/identification/before/residual", "350155"},
    {"  residual after", "rad²", "/identification/after/residual", "28.9, then 12.3"},
    {"  task-space error before, accumulated", "m", "/identification/before/accumulated_tip_m",
     "129.8, then 150.7"},
    {"  task-space error after", "m", "/identification/after/accumulated_tip_m", "47.8, then 60.0"},
    {"  joint RMS in 1 s windows before", "rad", "/identification/before_windows/joint_rms", "–"},
    {"  joint RMS in 1 s windows after", "rad", "/identification/after_windows/joint_rms", "–"},
    {"  time", "s", "/seconds/identification", "1170"},
    {"iteration: time", "s", "/seconds/iteration", "1278"},
};

// What a diagnosis brought beside identification alone; only of runs that have one. Models made before the
// rollout have not seen it; "all rollouts" are those so far, which the models were fitted to (identification
// alone to the newest).
const ResultRow kDiagnosisRows[] = {
    {"rollout not seen, RMS in 1 s windows: nominal", "rad", "/diagnosis/unseen/nominal/window_rms", "–"},
    {"  identified only", "rad", "/diagnosis/unseen/identified/window_rms", "–"},
    {"  diagnosed", "rad", "/diagnosis/unseen/diagnosed/window_rms", "–"},
    {"  open loop, whole rollout: nominal", "rad", "/diagnosis/unseen/nominal/open_loop_rms", "–"},
    {"  identified only", "rad", "/diagnosis/unseen/identified/open_loop_rms", "–"},
    {"  diagnosed", "rad", "/diagnosis/unseen/diagnosed/open_loop_rms", "–"},
    {"all rollouts, RMS in 1 s windows: nominal", "rad", "/diagnosis/all_rollouts/nominal/window_rms", "–"},
    {"  identified only", "rad", "/diagnosis/all_rollouts/identified/window_rms", "–"},
    {"  diagnosed", "rad", "/diagnosis/all_rollouts/diagnosed/window_rms", "–"},
    {"  the model that goes on", "rad", "/diagnosis/adopted_error/window_rms", "–"},
    {"  open loop: nominal", "rad", "/diagnosis/all_rollouts/nominal/open_loop_rms", "–"},
    {"  identified only", "rad", "/diagnosis/all_rollouts/identified/open_loop_rms", "–"},
    {"  diagnosed", "rad", "/diagnosis/all_rollouts/diagnosed/open_loop_rms", "–"},
    {"  the model that goes on", "rad", "/diagnosis/adopted_error/open_loop_rms", "–"},
    {"held-out rollouts: calibrated", "rad", "/diagnosis/fit/holdout/calibrated_rms", "–"},
    {"  diagnosed", "rad", "/diagnosis/fit/holdout/after_rms", "–"},
    {"diagnosis: time", "s", "/seconds/diagnosis", "–"},
};

bool Diagnosed(const json& result) { return result.contains("diagnosis"); }

std::vector<ResultRow> RowsFor(const std::vector<json>& results) {
  std::vector<ResultRow> rows(std::begin(kRows), std::end(kRows));
  if (std::any_of(results.begin(), results.end(), Diagnosed))
    rows.insert(rows.end(), std::begin(kDiagnosisRows), std::end(kDiagnosisRows));
  return rows;
}

// "coulomb_friction of joint_2 (0.92): Joint 2 loses …"
std::vector<std::string> Names(const json& diagnosis) {
  std::vector<std::string> lines;
  for (const json& f : diagnosis.at("findings")) {
    std::string joints;
    for (const json& joint : f.at("joints"))
      joints += (joints.empty() ? "" : ", ") + joint.get<std::string>();
    const std::string confidence = Printf(" (%.2f)", f.at("confidence").get<double>());
    lines.push_back(f.at("effect").get<std::string>() + (joints.empty() ? "" : " of " + joints) + confidence +
                    ": " + f.at("statement").get<std::string>());
  }
  if (diagnosis.contains("note")) lines.push_back(diagnosis.at("note").get<std::string>());
  return lines;
}

void AddDiagnosis(report::Page& page, const json& result) {
  if (!Diagnosed(result)) return;
  const json& d = result.at("diagnosis");
  page.Subheading("What the model leaves out: " + d.at("verdict").get<std::string>());
  report::Table table{{"named"}, {}};
  for (const std::string& line : Names(d)) table.rows.push_back({line});
  table.text_columns = {0};
  table.caption = "From " + std::to_string(d.at("rollouts").get<int>()) +
                  " rollouts. The next iteration goes on with the model that is " +
                  d.at("adopted").get<std::string>() + ".";
  page.AddTable(table);
}

std::vector<std::string> JointNames(const json& result) {
  std::vector<std::string> names;
  const size_t count = result.at("series").at("measured").size();
  const json joints = result.value("joints", json::array());
  for (size_t j = 0; j < count; ++j)
    names.push_back(j < joints.size() ? joints[j].get<std::string>() : "joint " + std::to_string(j + 1));
  return names;
}

void Trim(std::vector<double>* values, size_t size) { values->resize(size, std::nan("")); }

// What is worth seeing of a joint: the robot, the goal and the simulation after; one that ran away before
// leaves the picture.
void SetRange(const std::vector<const std::vector<double>*>& shown, report::Plot* plot) {
  double low = 1e300, high = -1e300;
  for (const auto* values : shown) {
    for (const double x : *values) {
      if (std::isfinite(x)) low = std::min(low, x), high = std::max(high, x);
    }
  }
  const double margin = std::max(0.05, 0.25 * (high - low));
  plot->y_low = low - margin, plot->y_high = high + margin;
}

std::vector<report::Plot> ResponsePlots(const json& result) {
  std::vector<report::Plot> plots;
  const json& series = result.at("series");
  const std::vector<double> t = Numbers(series.at("t"));
  const std::vector<double> goal = Numbers(
      result.contains("/rollout/goal"_json_pointer) ? result.at("rollout").at("goal") : json::array());
  const auto names = JointNames(result);
  for (size_t j = 0; j < names.size(); ++j) {
    report::Plot plot{names[j], "time [s]", "position [rad]", {}};
    std::vector<double> measured = Numbers(series.at("measured")[j]);
    std::vector<double> before = Numbers(series.at("before").at(j)),
                        after = Numbers(series.at("after").at(j));
    Trim(&measured, t.size()), Trim(&before, t.size()), Trim(&after, t.size());
    plot.series.push_back({"robot", t, measured});
    plot.series.push_back({"simulation before", t, before, report::SeriesStyle::kDashed});
    plot.series.push_back({"simulation after", t, after});
    if (j < goal.size())
      plot.series.push_back(
          {"goal", {t.front(), t.back()}, {goal[j], goal[j]}, report::SeriesStyle::kDashed, 6});
    const std::vector<double> target = j < goal.size() ? std::vector<double>{goal[j]} : std::vector<double>{};
    SetRange({&measured, &after, &target}, &plot);
    plots.push_back(std::move(plot));
  }
  return plots;
}

report::Plot LossPlot(const json& result) {
  report::Plot plot{"Learning curve", "epoch", "mean squared error (normalised)", {}};
  plot.log_y = true;
  const json curve =
      result.contains("/policy/curve"_json_pointer) ? result.at("policy").at("curve") : json::object();
  for (const char* name : {"train", "validation"}) {
    const std::vector<double> y = Numbers(curve.value(name, json::array()));
    std::vector<double> x;
    for (size_t i = 0; i < y.size(); ++i) x.push_back(static_cast<double>(i + 1));
    plot.series.push_back({name, x, y});
  }
  return plot;
}

double Reduction(const json& result) {
  return 1.0 - Number(result, "/identification/after/accumulated_tip_m"_json_pointer) /
                   Number(result, "/identification/before/accumulated_tip_m"_json_pointer);
}

std::string PercentOrNone(double share) {
  return std::isfinite(share) ? std::to_string(std::lround(100 * share)) + " %" : "–";
}

// What a small residual hides: links of a negative mass or of an inertia that no body has. Empty: none.
std::string Impossible(const json& result) {
  const json warnings = result.value("/identification/identifiability/warnings"_json_pointer, json::array());
  std::string text;
  for (const json& warning : warnings) text += (text.empty() ? "" : "; ") + warning.get<std::string>();
  return text.empty() ? text : text + ". The small error is no proof: the recording leaves this free";
}

// How a rollout ended that did not end as asked, and what that means. Empty: it did.
std::string EndedEarly(const json& result) {
  const json& rollout = result.contains("rollout") ? result.at("rollout") : json();
  if (!rollout.is_object() || rollout.value("as_asked", true)) return "";
  return rollout.value("ended", "") +
         (rollout.value("held_back", false) ? "; its parameters are not current, the next iteration goes on from them"
                                            : "; accepted");
}

// Who drove where it was not the policy, how the rollout ended, and how the attempts did that do not count.
std::string AboutRollout(const json& result) {
  std::string text = EndedEarly(result);
  const double diverged = Number(result, "/examination/policy/diverged"_json_pointer);
  if (diverged > 0 && result.value("/rollout/controller"_json_pointer, "") == "mpc")
    text += (text.empty() ? "" : "; ") + std::string("MPC drove, for the policy diverges in simulation from ") +
            FormatNumber(diverged) + " of " + FormatNumber(Number(result, "/examination/pairs"_json_pointer)) + " starts";
  for (const json& end : result.value("/rollout/made_again"_json_pointer, json::array()))
    text += (text.empty() ? "" : "; ") + std::string("made again, slower: ") + end.get<std::string>();
  return text;
}

// A line for each iteration of which there is something to say.
std::string PerIteration(const std::vector<json>& results, const char* what, const char* then,
                         std::string (*say)(const json&)) {
  std::string text;
  for (size_t i = 0; i < results.size(); ++i) {
    const std::string said = say(results[i]);
    if (!said.empty()) text += (text.empty() ? "" : "\n") + (what + std::to_string(i + 1)) + then + said;
  }
  return text;
}

void AddIdentifiability(report::Page& page, const json& result) {
  const json& report_json = result.at("identification").at("identifiability");
  if (!report_json.contains("parameters")) return;
  report::Table table{{"parameter", "value", "nominal", "standard deviation", "verdict"}, {}};
  int shown = 0;
  for (const json& p : report_json.at("parameters")) {
    if (p.value("verdict", "") == "prior_only" && ++shown > 0) continue;
    table.rows.push_back({p.value("name", ""), FormatNumber(p.value("value", std::nan(""))),
                          FormatNumber(p.value("nominal", std::nan(""))),
                          FormatNumber(p.value("stddev", std::nan(""))), p.value("verdict", "")});
  }
  table.text_columns = {4};
  table.caption = std::to_string(shown) + " of " + std::to_string(report_json.at("parameters").size()) +
                  " parameters are left out here: the recording says nothing of them, only the prior does.";
  page.Subheading("What the recording determines");
  if (const std::string said = Impossible(result); !said.empty()) page.Note(said + ".", true);
  page.AddTable(table);
}

}  // namespace

std::string IterationsTable(const std::vector<json>& results) {
  std::vector<std::string> columns = {""};
  for (size_t i = 0; i < results.size(); ++i) columns.push_back(">ITERATION " + std::to_string(i + 1));
  columns.push_back(">PAPER");
  columns.push_back("UNIT");
  TextTable table(columns);
  for (const ResultRow& row : RowsFor(results)) {
    std::vector<std::string> cells = {row.name};
    for (const json& result : results)
      cells.push_back(Cell(result, row));
    cells.push_back(row.paper);
    cells.push_back(row.unit);
    table.AddRow(cells);
  }
  return table.ToString();
}

std::string ImpossibleText(const std::vector<json>& results) {
  return PerIteration(results, "warning: identification ", ": ", Impossible);
}

std::string RolloutsText(const std::vector<json>& results) {
  return PerIteration(results, "rollout ", ": ", AboutRollout);
}

std::string DiagnosesText(const std::vector<json>& results) {
  std::string text;
  for (size_t i = 0; i < results.size(); ++i) {
    if (!Diagnosed(results[i])) continue;
    const json& d = results[i].at("diagnosis");
    text += (text.empty() ? "" : "\n") + std::string("diagnosis ") + std::to_string(i + 1) + ": " +
            d.at("verdict").get<std::string>() + "; goes on: " + d.at("adopted").get<std::string>();
    for (const std::string& line : Names(d)) text += "\n  " + line;
  }
  return text;
}

json RunJson(const std::vector<json>& results) {
  json iterations = json::array();
  for (const json& result : results) {
    json one = result;
    one.erase("series");
    if (one.contains("/policy/curve"_json_pointer)) one["policy"].erase("curve");
    iterations.push_back(std::move(one));
  }
  return {{"iterations", iterations}};
}

std::string RunPage(const std::string& robot, const std::vector<json>& results) {
  report::Page page("RealityGrad: " + robot,
                    std::to_string(results.size()) + (results.size() == 1 ? " iteration" : " iterations"));
  if (!results.empty()) {
    const json& last = results.back();
    page.Lead(
        "Identification took " + PercentOrNone(Reduction(results.front())) +
        " off the simulation's task-space error in the first iteration. The robot's last rollout ended " +
        FormatNumber(Number(last, "/rollout/goal_error/joint_norm"_json_pointer)) + " rad from its goal, " +
        FormatNumber(Number(last, "/rollout/goal_error/start_norm"_json_pointer)) +
        " rad from where it began.");
    std::vector<report::Card> cards;
    for (size_t i = 0; i < results.size(); ++i) {
      const std::string n = std::to_string(i + 1);
      cards.push_back(
          {"iteration " + n + ": task-space error",
           FormatNumber(Number(results[i], "/identification/before/accumulated_tip_m"_json_pointer)) + " → " +
               FormatNumber(Number(results[i], "/identification/after/accumulated_tip_m"_json_pointer)) +
               " m",
           "accumulated over the rollout, before and after"});
      cards.push_back(
          {"iteration " + n + ": goal error",
           FormatNumber(Number(results[i], "/rollout/goal_error/joint_norm"_json_pointer)) + " rad",
           "of the robot at the rollout's end"});
    }
    page.Cards(cards);
  }
  page.Heading("Iterations beside the paper");
  report::Table table{{""}, {}};
  for (size_t i = 0; i < results.size(); ++i) table.columns.push_back("iteration " + std::to_string(i + 1));
  table.columns.push_back("paper");
  table.columns.push_back("unit");
  for (const ResultRow& row : RowsFor(results)) {
    std::string name = row.name;
    if (name.starts_with("  ")) name.replace(0, 2, "\u2003");  // an indent that HTML keeps
    std::vector<std::string> cells = {name};
    for (const json& result : results)
      cells.push_back(Cell(result, row));
    cells.push_back(row.paper);
    cells.push_back(row.unit);
    table.rows.push_back(cells);
  }
  table.caption =
      "Paper: Collins, Brown, Leitner, Howard, RealityGrad; 32 cores, real arm. Residual and task-space "
      "error: the recorded torques run open loop through the simulator from the first state.";
  page.AddTable(table);
  for (size_t i = 0; i < results.size(); ++i) {
    page.Heading("Iteration " + std::to_string(i + 1) + ": joint responses");
    page.AddPlots(ResponsePlots(results[i]), 380);
    std::vector<report::Plot> plots = {LossPlot(results[i])};
    for (report::Plot& plot : SearchPlots(results[i].at("identification"))) plots.push_back(std::move(plot));
    page.AddPlots(plots);
    if (const std::string said = AboutRollout(results[i]); !said.empty())
      page.Note("Rollout: " + said + ".", true);
    AddDiagnosis(page, results[i]);
    AddIdentifiability(page, results[i]);
  }
  return page.Html();
}

}  // namespace rg::cli
