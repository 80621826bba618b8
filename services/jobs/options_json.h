// IterationOptions as JSON: what a job's spec shows and what a run's file keeps.
#pragma once

#include <nlohmann/json_fwd.hpp>

#include "services/jobs/job_graphs.h"

namespace rg::jobs {

// Everything but `robot`, `home`, `peak_torque` and `iteration`, which belong to the robot's profile and
// to the job.
nlohmann::json OptionsToJson(const IterationOptions& options);
// Throws nlohmann::json::exception where a field is missing or of another type: callers name the file.
IterationOptions OptionsFromJson(const nlohmann::json& json);

}  // namespace rg::jobs
