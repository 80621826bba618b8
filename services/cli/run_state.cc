#include "services/cli/run_state.h"

#include <algorithm>
#include <cstdio>
#include <filesystem>

#include "common/base/file.h"

namespace rg::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr char kFormat[] = "realitygrad.run/1";

json OptionsJson(const jobs::IterationOptions& o) {
  return {{"seed", o.seed},
          {"trajectories",
           {{"count", o.trajectories.count},
            {"shard_size", o.trajectories.shard_size},
            {"duration_s", o.trajectories.duration_s},
            {"reach", o.trajectories.reach},
            {"spread", o.trajectories.spread}}},
          {"train",
           {{"epochs", o.train.epochs},
            {"batch", o.train.batch},
            {"learning_rate", o.train.learning_rate},
            {"hidden", o.train.hidden}}},
          {"rollout",
           {{"duration_s", o.rollout.duration_s},
            {"rate_hz", o.rollout.rate_hz},
            {"goal_q", o.rollout.goal_q},
            {"goal_position", o.rollout.goal_position},
            {"reach_s", o.rollout.reach_s},
            {"controller", o.rollout.controller}}},
          {"identify",
           {{"chains", o.identify.chains},
            {"rounds", o.identify.rounds},
            {"budget_s", o.identify.budget_s},
            {"hops", o.identify.hops},
            {"whole_recording", o.identify.whole_recording},
            {"window_s", o.identify.window_s},
            {"window_start_s", o.identify.window_start_s},
            {"solver", o.identify.solver},
            {"bounds", o.identify.bounds},
            {"friction", o.identify.friction},
            {"alpha", o.identify.alpha}}}};
}

jobs::IterationOptions OptionsFrom(const json& j) {
  jobs::IterationOptions o;
  j.at("seed").get_to(o.seed);
  const json &t = j.at("trajectories"), &p = j.at("train"), &r = j.at("rollout"), &i = j.at("identify");
  t.at("count").get_to(o.trajectories.count), t.at("shard_size").get_to(o.trajectories.shard_size);
  t.at("duration_s").get_to(o.trajectories.duration_s), t.at("reach").get_to(o.trajectories.reach),
      t.at("spread").get_to(o.trajectories.spread);
  p.at("epochs").get_to(o.train.epochs), p.at("batch").get_to(o.train.batch);
  p.at("learning_rate").get_to(o.train.learning_rate), p.at("hidden").get_to(o.train.hidden);
  r.at("duration_s").get_to(o.rollout.duration_s), r.at("rate_hz").get_to(o.rollout.rate_hz),
      r.at("goal_q").get_to(o.rollout.goal_q);
  r.at("goal_position").get_to(o.rollout.goal_position), r.at("reach_s").get_to(o.rollout.reach_s),
      r.at("controller").get_to(o.rollout.controller);
  i.at("chains").get_to(o.identify.chains), i.at("rounds").get_to(o.identify.rounds),
      i.at("budget_s").get_to(o.identify.budget_s);
  i.at("hops").get_to(o.identify.hops), i.at("whole_recording").get_to(o.identify.whole_recording),
      i.at("window_s").get_to(o.identify.window_s);
  i.at("window_start_s").get_to(o.identify.window_start_s), i.at("solver").get_to(o.identify.solver),
      i.at("bounds").get_to(o.identify.bounds);
  i.at("alpha").get_to(o.identify.alpha), i.at("friction").get_to(o.identify.friction);
  return o;
}

std::vector<std::string> RunFolders(const std::string& parent) {
  std::vector<std::string> found;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(parent, error)) {
    const std::string name = entry.path().filename();
    if (!name.empty() && std::all_of(name.begin(), name.end(), ::isdigit)) found.push_back(entry.path());
  }
  std::sort(found.begin(), found.end());
  return found;
}

}  // namespace

Result<std::string> NewRunFolder(const std::string& parent) {
  int number = 1;
  for (const std::string& folder : RunFolders(parent))
    number = std::max(number, std::stoi(fs::path(folder).filename()) + 1);
  char name[16];
  std::snprintf(name, sizeof name, "%03d", number);
  const std::string folder = parent + "/" + name;
  std::error_code error;
  fs::create_directories(folder + "/logs", error);
  if (error) return InternalError(folder + ": cannot create: " + error.message());
  return folder;
}

Result<std::string> UnfinishedRunFolder(const std::string& parent) {
  auto folders = RunFolders(parent);
  for (auto folder = folders.rbegin(); folder != folders.rend(); ++folder) {
    const auto run = LoadRun(*folder);
    if (run.ok() && static_cast<int>(run->results.size()) < run->iterations) return *folder;
  }
  return NotFoundError(parent + ": no unfinished run to go on with");
}

Status SaveRun(const RunState& run) {
  const json file = {{"format", kFormat},      {"id", run.id},
                     {"robot", run.robot},     {"iterations", run.iterations},
                     {"workers", run.workers}, {"options", OptionsJson(run.options)},
                     {"results", run.results}};
  return WriteFileAtomically(run.File("run.json"), file.dump());
}

Result<RunState> LoadRun(const std::string& folder) {
  const std::string path = folder + "/run.json";
  RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  try {
    const json file = json::parse(text);
    if (file.at("format") != kFormat)
      return InvalidError(path + ": format is " + file.at("format").dump() + ", must be \"" + kFormat + "\"");
    RunState run;
    run.folder = folder;
    file.at("id").get_to(run.id), file.at("robot").get_to(run.robot);
    file.at("iterations").get_to(run.iterations), file.at("workers").get_to(run.workers);
    run.options = OptionsFrom(file.at("options"));
    run.results = file.at("results").get<std::vector<json>>();
    return run;
  } catch (const json::exception& error) {
    return InvalidError(path + ": " + error.what());
  }
}

}  // namespace rg::cli
