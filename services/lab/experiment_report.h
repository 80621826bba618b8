// What the paper's experiments found here, beside the paper: tables, JSON, pages. Pure: from results.
//
// A repetition is one JSON object. Its arms are "realitygrad.iteration/1" results:
//   bounded-vs-unbounded   {"bounded": …, "unbounded": …, "whole": …, "rollout": the recording's metadata}
//   two-iterations         {"iteration_1": …, "iteration_2": …}
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace rg::model {
class RobotModel;
}

namespace rg::lab {

// Median and range over the repetitions that have a finite figure.
struct Spread {
  double median = 0, min = 0, max = 0;
  int count = 0;
};
Spread SpreadOf(std::vector<double> values);  // NaN are left out
// "2.67 [1.9 … 3.4]"; one value alone: "2.67"; none: "–".
std::string SpreadText(const Spread& spread);

enum class Experiment { kBoundedVsUnbounded, kTwoIterations };
const char* ExperimentName(Experiment experiment);

// For the terminal: a row per figure, for each arm our spread and the paper's figure.
std::string ExperimentTable(Experiment experiment, const std::vector<nlohmann::json>& repetitions);
// [{"figure", "unit", "arms": {"bounded": {"median", "min", "max", "count", "paper"}, …}}, …]
nlohmann::json ExperimentRows(Experiment experiment, const std::vector<nlohmann::json>& repetitions);
// The same table and the plots of the paper's figures for the best repetition: joint responses, the end
// effector in space, its error over time, the search. `setting`: budget, workers, robot, in one line.
std::string ExperimentPage(Experiment experiment, const std::vector<nlohmann::json>& repetitions,
                           const model::RobotModel& robot, const std::string& setting);

}  // namespace rg::lab
