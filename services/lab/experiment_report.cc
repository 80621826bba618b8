#include "services/lab/experiment_report.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>

#include "common/model/robot_model.h"
#include "services/cli/output.h"
#include "services/cli/search_plot.h"
#include "services/report/page.h"
#include "services/rollouts/scoring.h"

namespace rg::lab {
namespace {

using nlohmann::json;
using report::FormatNumber;

struct Arm {
  const char* key;
  const char* title;
};

// Where a figure stands in an arm's result (or, with a leading "..", in the repetition), and the paper's:
// for the first two arms, more the paper does not have.
struct FigureRow {
  const char* figure;
  const char* unit;
  const char* pointer;
  const char* paper[2];
};
constexpr size_t kPaperArms = 2;

struct Definition {
  const char* name;
  const char* title;
  std::vector<Arm> arms;
  std::vector<FigureRow> rows;
};

constexpr char kAfterTip[] = "/identification/after/accumulated_tip_m";
constexpr char kMassesBelowZero[] = "masses below zero";
constexpr char kWindowResidual[] = "/identification/best_cost";

const Definition& DefinitionOf(Experiment experiment) {
  static const Definition bounded = {
      "bounded-vs-unbounded",
      "Bounded against unbounded identification",
      {{"bounded", "bounded"}, {"unbounded", "unbounded"}, {"whole", "whole recording"}},
      {{"residual on the window", "rad²", kWindowResidual, {"130.857", "2.67"}},
       {"residual over the recording", "rad²", "/identification/after/residual", {"–", "–"}},
       {"  of the nominal model", "rad²", "/identification/before/residual", {"–", "–"}},
       {"task-space error, accumulated", "m", kAfterTip, {"14.4414", "10.2955"}},
       {"  of the nominal model", "m", "/identification/before/accumulated_tip_m", {"–", "–"}},
       {"joint RMS in 1 s windows", "rad", "/identification/after_windows/joint_rms", {"–", "–"}},
       {"  of the nominal model", "rad", "/identification/before_windows/joint_rms", {"–", "–"}},
       {"nominal model breaks down after", "s", "/identification/before/breakdown_s", {"–", "–"}},
       {"masses below zero", "", kMassesBelowZero, {"–", "–"}},
       {"hops", "", "/identification/hops", {"–", "–"}},
       {"identification: time", "s", "/seconds/identification", {"3600 (6 workers)", "3600 (6 workers)"}},
       {"recording: length", "s", "../rollout/ended_after_s", {"8", "8"}}}};
  static const Definition iterations = {
      "two-iterations",
      "Two iterations of the loop",
      {{"iteration_1", "iteration 1"}, {"iteration_2", "iteration 2"}},
      {{"trajectories", "", "/trajectories/solved", {"450", "450"}},
       {"  time", "s", "/seconds/trajectories", {"77 (30 threads)", "–"}},
       {"policy: time", "s", "/seconds/policy", {"24", "–"}},
       {"rollout: length", "s", "/rollout/ended_after_s", {"6", "6"}},
       {"  end effector to goal at the end", "m", "/rollout/goal_error/tip_distance_m", {"–", "–"}},
       {"  joints to goal at the end", "rad", "/rollout/goal_error/joint_norm", {"–", "–"}},
       {"  joints to goal at the start", "rad", "/rollout/goal_error/start_norm", {"–", "–"}},
       {"residual before", "rad²", "/identification/before/residual", {"350155", "–"}},
       {"  after", "rad²", "/identification/after/residual", {"28.87", "12.26"}},
       {"task-space error before, accumulated",
        "m",
        "/identification/before/accumulated_tip_m",
        {"129.79", "150.72"}},
       {"  after", "m", kAfterTip, {"47.81", "59.98"}},
       {"simulation before breaks down after", "s", "/identification/before/breakdown_s", {"–", "–"}},
       {"joint RMS in 1 s windows before", "rad", "/identification/before_windows/joint_rms", {"–", "–"}},
       {"  after", "rad", "/identification/after_windows/joint_rms", {"–", "–"}},
       {"identification: time", "s", "/seconds/identification", {"1170", "–"}},
       {"iteration: time", "s", "/seconds/iteration", {"1278", "–"}}}};
  return experiment == Experiment::kTwoIterations ? iterations : bounded;
}

double NumberAt(const json& j, const json::json_pointer& at) {
  if (!j.contains(at) || !j.at(at).is_number()) return std::nan("");
  return j.at(at).get<double>();
}

double MassesBelowZero(const json& result) {
  const json parameters =
      result.value("/identification/identifiability/parameters"_json_pointer, json::array());
  if (parameters.empty()) return std::nan("");
  int count = 0;
  for (const json& p : parameters)
    count += p.value("name", "").rfind("mass.", 0) == 0 && p.value("value", 0.0) < 0;
  return count;
}

// Seconds after which the simulation of a judgement left the finite numbers; NaN if it did not.
double BreakdownSeconds(const json& result, const json& judgement) {
  const std::vector<double> t = cli::Numbers(result.at("series").at("t"));
  const size_t rows = judgement.value("rows", size_t{0});
  return judgement.value("ok", true) || t.empty() ? std::nan("") : t[std::min(rows, t.size() - 1)];
}

// A figure of a judgement; none where the simulation broke down, since a sum over what it reached looks
// better the earlier it broke.
double JudgedFigure(const json& result, const std::string& pointer) {
  const json::json_pointer at(pointer);
  const json judgement = result.value(at.parent_pointer(), json::object());
  if (at.back() == "breakdown_s") return BreakdownSeconds(result, judgement);
  return judgement.value("ok", true) ? NumberAt(result, at) : std::nan("");
}

double Figure(const json& repetition, const Arm& arm, const FigureRow& row) {
  const std::string pointer = row.pointer;
  if (pointer.rfind("..", 0) == 0) return NumberAt(repetition, json::json_pointer(pointer.substr(2)));
  if (!repetition.contains(arm.key)) return std::nan("");
  if (pointer == kMassesBelowZero) return MassesBelowZero(repetition.at(arm.key));
  // Another problem than the paper's: its cost is no residual on the window.
  if (pointer == kWindowResidual && std::string(arm.key) == "whole") return std::nan("");
  return JudgedFigure(repetition.at(arm.key), pointer);
}

Spread SpreadOfRow(const std::vector<json>& repetitions, const Arm& arm, const FigureRow& row) {
  std::vector<double> values;
  for (const json& repetition : repetitions) values.push_back(Figure(repetition, arm, row));
  return SpreadOf(std::move(values));
}

// Titles of the columns between the figure's name and its unit.
std::vector<std::string> Columns(const Definition& definition) {
  std::vector<std::string> columns;
  for (size_t arm = 0; arm < definition.arms.size(); ++arm) {
    columns.push_back(definition.arms[arm].title);
    if (arm < kPaperArms) columns.push_back("paper");
  }
  return columns;
}

std::vector<std::vector<std::string>> Cells(const Definition& definition,
                                            const std::vector<json>& repetitions) {
  std::vector<std::vector<std::string>> rows;
  for (const FigureRow& row : definition.rows) {
    std::vector<std::string> cells = {row.figure};
    for (size_t arm = 0; arm < definition.arms.size(); ++arm) {
      cells.push_back(SpreadText(SpreadOfRow(repetitions, definition.arms[arm], row)));
      if (arm < kPaperArms) cells.push_back(row.paper[arm]);
    }
    cells.push_back(row.unit);
    rows.push_back(std::move(cells));
  }
  return rows;
}

// ---- plots ----

// n × K of a series; rows that a failed simulation did not reach are NaN.
Eigen::MatrixXd Matrix(const json& rows, size_t samples) {
  Eigen::MatrixXd out = Eigen::MatrixXd::Constant(static_cast<Eigen::Index>(rows.size()),
                                                  static_cast<Eigen::Index>(samples), std::nan(""));
  for (size_t i = 0; i < rows.size(); ++i) {
    const auto values = cli::Numbers(rows[i]);
    for (size_t k = 0; k < std::min(samples, values.size()); ++k)
      out(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(k)) = values[k];
  }
  return out;
}

std::vector<double> RowOf(const Eigen::MatrixXd& m, Eigen::Index row) {
  std::vector<double> out(static_cast<size_t>(m.cols()));
  for (Eigen::Index k = 0; k < m.cols(); ++k) out[static_cast<size_t>(k)] = m(row, k);
  return out;
}

// One way to see the recording: measured, or as a model tells it.
struct Motion {
  std::string name;
  Eigen::MatrixXd q, tip;
  report::SeriesStyle style;
};

struct Motions {
  std::vector<double> t;
  std::vector<Motion> all;  // the first is the robot
};

void AddMotion(const model::RobotModel& robot, const json& rows, const std::string& name,
               report::SeriesStyle style, Motions* out) {
  Motion motion{name, Matrix(rows, out->t.size()), {}, style};
  motion.tip = rollouts::TipPositions(robot, motion.q);
  out->all.push_back(std::move(motion));
}

std::vector<report::Plot> JointPlots(const Motions& motions, const model::RobotModel& robot) {
  std::vector<report::Plot> plots;
  for (int j = 0; j < robot.num_joints(); ++j) {
    report::Plot plot{robot.joint(j).name, "time [s]", "position [rad]", {}};
    for (const Motion& motion : motions.all)
      plot.series.push_back({motion.name, motions.t, RowOf(motion.q, j), motion.style});
    plots.push_back(std::move(plot));
  }
  return plots;
}

std::vector<report::Plot> TipPlots(const Motions& motions) {
  std::vector<report::Plot> plots;
  for (int axis = 0; axis < 3; ++axis) {
    report::Plot plot{std::string("End effector, ") + "xyz"[axis], "time [s]", "position [m]", {}};
    for (const Motion& motion : motions.all)
      plot.series.push_back({motion.name, motions.t, RowOf(motion.tip, axis), motion.style});
    plots.push_back(std::move(plot));
  }
  report::Plot error{"Error of the end effector, accumulated", "time [s]", "Σ |p − p̂| [m]", {}};
  for (size_t m = 1; m < motions.all.size(); ++m) {
    std::vector<double> sum;
    double total = 0;
    for (Eigen::Index k = 0; k < motions.all[0].tip.cols(); ++k) {
      total += (motions.all[m].tip.col(k) - motions.all[0].tip.col(k)).norm();
      sum.push_back(total);
    }
    error.series.push_back({motions.all[m].name, motions.t, sum, motions.all[m].style});
  }
  plots.push_back(std::move(error));
  return plots;
}

report::Plot SearchPlot(const Definition& definition, const json& repetition) {
  report::Plot plot{"Basin hopping", "search of each chain [s]", "least cost so far", {}};
  plot.log_y = true;
  for (const Arm& arm : definition.arms) {
    if (repetition.contains(arm.key))
      plot.series.push_back(cli::LeastCost(repetition.at(arm.key).at("identification"), arm.title));
  }
  return plot;
}

// The repetition whose last arm has the smallest task-space error, as the paper shows its best of five.
size_t Best(const Definition& definition, const std::vector<json>& repetitions) {
  size_t best = 0;
  double least = std::numeric_limits<double>::infinity();
  for (size_t i = 0; i < repetitions.size(); ++i) {
    if (!repetitions[i].contains(definition.arms[1].key)) continue;
    const double error = NumberAt(repetitions[i].at(definition.arms[1].key), json::json_pointer(kAfterTip));
    if (error < least) least = error, best = i;
  }
  return best;
}

void AddPlotsOf(report::Page& page, Experiment experiment, const Definition& definition,
                const json& repetition, const model::RobotModel& robot) {
  Motions motions;
  for (const Arm& arm : definition.arms) {
    if (!repetition.contains(arm.key)) continue;
    const json& series = repetition.at(arm.key).at("series");
    const bool own_recording = experiment == Experiment::kTwoIterations;
    if (own_recording || motions.all.empty()) {
      motions = {cli::Numbers(series.at("t")), {}};
      AddMotion(robot, series.at("measured"), "robot", report::SeriesStyle::kLine, &motions);
      AddMotion(robot, series.at("before"), own_recording ? "simulation before" : "nominal simulation",
                report::SeriesStyle::kDashed, &motions);
    }
    AddMotion(robot, series.at("after"), own_recording ? "simulation after" : arm.title,
              report::SeriesStyle::kLine, &motions);
    if (!own_recording && &arm != &definition.arms.back()) continue;
    if (own_recording) page.Subheading(arm.title);
    page.AddPlots(JointPlots(motions, robot), 380);
    page.AddPlots(TipPlots(motions), 380);
  }
  page.AddPlots({SearchPlot(definition, repetition)});
}

report::Table DampingTable(const Definition& definition, const json& repetition) {
  static const char* const kPaper[] = {"12.12", "15.18", "17.56", "3.63", "4.31", "4.27"};
  report::Table table{{"damping [N·m·s/rad]"}, {}};
  for (const Arm& arm : definition.arms) {
    if (!repetition.contains(arm.key)) continue;
    table.columns.push_back(arm.title);
    size_t row = 0;
    const json parameters = repetition.at(arm.key).value(
        "/identification/identifiability/parameters"_json_pointer, json::array());
    for (const json& p : parameters) {
      const std::string name = p.value("name", "");
      if (name.rfind("damping.", 0) != 0) continue;
      if (row == table.rows.size()) table.rows.push_back({name.substr(8)});
      table.rows[row++].push_back(FormatNumber(p.value("value", std::nan(""))));
    }
  }
  table.columns.push_back("paper");
  for (size_t row = 0; row < table.rows.size(); ++row) {
    table.rows[row].resize(table.columns.size() - 1, "–");
    table.rows[row].push_back(row < 6 ? kPaper[row] : "–");
  }
  return table;
}

}  // namespace

Spread SpreadOf(std::vector<double> values) {
  std::erase_if(values, [](double v) { return !std::isfinite(v); });
  Spread spread;
  spread.count = static_cast<int>(values.size());
  if (values.empty()) {
    spread.median = spread.min = spread.max = std::nan("");
    return spread;
  }
  std::sort(values.begin(), values.end());
  const size_t half = values.size() / 2;
  spread.median = values.size() % 2 ? values[half] : 0.5 * (values[half - 1] + values[half]);
  spread.min = values.front(), spread.max = values.back();
  return spread;
}

std::string SpreadText(const Spread& spread) {
  if (spread.count == 0) return "–";
  const std::string median = FormatNumber(spread.median);
  if (spread.min == spread.max) return median;
  return median + " [" + FormatNumber(spread.min) + " … " + FormatNumber(spread.max) + "]";
}

const char* ExperimentName(Experiment experiment) { return DefinitionOf(experiment).name; }

std::string ExperimentTable(Experiment experiment, const std::vector<json>& repetitions) {
  const Definition& definition = DefinitionOf(experiment);
  std::vector<std::string> columns = {""};
  for (const std::string& title : Columns(definition)) columns.push_back(">" + title);
  columns.push_back("UNIT");
  cli::TextTable table(columns);
  for (auto& cells : Cells(definition, repetitions)) table.AddRow(std::move(cells));
  return table.ToString();
}

json ExperimentRows(Experiment experiment, const std::vector<json>& repetitions) {
  const Definition& definition = DefinitionOf(experiment);
  const auto number = [](double v) { return std::isfinite(v) ? json(v) : json(nullptr); };
  json rows = json::array();
  for (const FigureRow& row : definition.rows) {
    json arms;
    for (size_t arm = 0; arm < definition.arms.size(); ++arm) {
      const Spread spread = SpreadOfRow(repetitions, definition.arms[arm], row);
      json& figures = arms[definition.arms[arm].key];
      figures = {{"median", number(spread.median)},
                 {"min", number(spread.min)},
                 {"max", number(spread.max)},
                 {"count", spread.count}};
      if (arm < kPaperArms) figures["paper"] = row.paper[arm];
    }
    std::string figure = row.figure;
    figure.erase(0, figure.find_first_not_of(' '));
    rows.push_back({{"figure", figure}, {"unit", row.unit}, {"pointer", row.pointer}, {"arms", arms}});
  }
  return rows;
}

std::string ExperimentPage(Experiment experiment, const std::vector<json>& repetitions,
                           const model::RobotModel& robot, const std::string& setting) {
  const Definition& definition = DefinitionOf(experiment);
  report::Page page(definition.title, setting);
  page.Heading("Beside the paper");
  report::Table table{{""}, Cells(definition, repetitions)};
  for (std::string& title : Columns(definition)) table.columns.push_back(std::move(title));
  table.columns.push_back("unit");
  table.caption =
      "Median [smallest … largest] over " + std::to_string(repetitions.size()) +
      " repetitions. Residual and task-space error: the recorded torques run open loop through the simulator "
      "from the recording's first state. Paper: Collins, Brown, Leitner, Howard, RealityGrad; a real arm.";
  page.AddTable(table);
  if (repetitions.empty()) return page.Html();
  const size_t best = Best(definition, repetitions);
  page.Heading("Repetition " + std::to_string(best + 1) + ", the best");
  page.AddTable(DampingTable(definition, repetitions[best]));
  AddPlotsOf(page, experiment, definition, repetitions[best], robot);
  return page.Html();
}

}  // namespace rg::lab
