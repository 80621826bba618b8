// What a run shows when it is done: the table of iterations beside the paper's figures, and the page.
#pragma once

#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

namespace rg::cli {

// `results`: one "realitygrad.iteration/1" each, in order.
std::string IterationsTable(const std::vector<nlohmann::json>& results);
// One line per iteration that identified bodies which cannot exist; empty: none did.
std::string ImpossibleText(const std::vector<nlohmann::json>& results);
// Of rollouts that MPC drove in place of the policy, that ended early, or that were made again at less speed; empty: none.
std::string RolloutsText(const std::vector<nlohmann::json>& results);
// Verdict and names of each iteration that was diagnosed; empty without any.
std::string DiagnosesText(const std::vector<nlohmann::json>& results);
std::string RunPage(const std::string& robot, const std::vector<nlohmann::json>& results);
// {"iterations": […]} with the table's figures.
nlohmann::json RunJson(const std::vector<nlohmann::json>& results);

}  // namespace rg::cli
