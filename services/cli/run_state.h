// A run on this machine: its folder and what is in it.
//
//   realitygrad-runs/001/run.json         what was asked for and how far it came
//                        realitygrad.db   the coordinator's database: jobs, artefacts, parameter history
//                        logs/            one file per program
//                        spool/           recordings of the agent
//                        report.html
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "services/jobs/job_graphs.h"

namespace rg::cli {

struct RunState {
  std::string folder;
  std::string id;  // request ids of its jobs begin with it
  std::string robot = "mico2";
  std::string driver = "simulated";  // or "kinova"
  bool stand_in = false;             // of the kinova
  int iterations = 2;
  int workers = 0;
  jobs::IterationOptions options;
  // Results of the iterations that are done ("realitygrad.iteration/1"), without job ones in between.
  std::vector<nlohmann::json> results;

  std::string File(const std::string& name) const { return folder + "/" + name; }
};

// The next free number under `parent`.
Result<std::string> NewRunFolder(const std::string& parent);
// The newest run under `parent` that is not finished. kNotFound: there is none.
Result<std::string> UnfinishedRunFolder(const std::string& parent);
Status SaveRun(const RunState& run);
Result<RunState> LoadRun(const std::string& folder);

}  // namespace rg::cli
