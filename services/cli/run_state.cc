#include "services/cli/run_state.h"

#include <algorithm>
#include <filesystem>

#include "common/base/file.h"
#include "common/base/printf.h"
#include "services/jobs/options_json.h"

namespace rg::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

constexpr char kFormat[] = "realitygrad.run/1";

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
  const std::string name = Printf("%03d", number);
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
  const json file = {{"format", kFormat},        {"id", run.id},
                     {"robot", run.robot},       {"driver", run.driver},
                     {"stand_in", run.stand_in}, {"iterations", run.iterations},
                     {"workers", run.workers},   {"options", jobs::OptionsToJson(run.options)},
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
    run.driver = file.value("driver", run.driver), run.stand_in = file.value("stand_in", false);
    file.at("iterations").get_to(run.iterations), file.at("workers").get_to(run.workers);
    run.options = jobs::OptionsFromJson(file.at("options"));
    run.results = file.at("results").get<std::vector<json>>();
    return run;
  } catch (const json::exception& error) {
    return InvalidError(path + ": " + error.what());
  }
}

}  // namespace rg::cli
