// What an iteration found, as the JSON artefact "iteration-result" (format realitygrad.iteration/1) that
// the command line prints and draws, and as a version of the parameter history.
#pragma once

#include <Eigen/Core>
#include <nlohmann/json.hpp>

#include "common/recordings/recording.h"
#include "common/sim/model_file.h"
#include "common/sim/plant.h"
#include "services/rollouts/scoring.h"
#include "services/sysid/basin_hopping.h"
#include "services/sysid/identifiability.h"
#include "worker/task_registry.h"

namespace realitygrad::v1 {
class ConcludePayload;
}

namespace rg::jobs {

class IdentifyProblem;

// The recording as the model tells it before and after identification: once open loop from the first
// state to the end (the paper's measure), and in windows of 1 s restarted from what was measured.
struct Judgement {
  rollouts::SimulationError before, after, before_windows, after_windows;
  Eigen::VectorXd t;
  Eigen::MatrixXd measured;
  double noise_variance = 1.0;  // of one position residual at the solution, rad²
};
Judgement Judge(const sim::ModelFile& before, const sim::Plant& plant, const Eigen::VectorXd& after,
                const recordings::Recording& recording);

// Which of the 71 the recording determines at p, with a warning for each link that no body can have any more.
sysid::IdentifiabilityReport Determine(const sim::Plant& plant, const IdentifyProblem& problem,
                                       const Eigen::VectorXd& p, double noise_variance);

nlohmann::json ResultJson(const worker::TaskInput& input, const realitygrad::v1::ConcludePayload& payload,
                          const Judgement& judgement, const sysid::HopState& best,
                          const sysid::IdentifiabilityReport& identified);
// How the rollout ended that parameters come from, and what that means for them: into the metadata of a version, and as
// the remark of its task. No remark: it ended as asked.
std::string NoteRolloutEnd(const worker::InputArtifact& recording, bool accept_partial, nlohmann::json* metadata);
// Without the series: for the task's row.
nlohmann::json SummaryOf(const nlohmann::json& result);

// [{"name", "value", "stddev", "unit", "verdict"}, …] of the fitted parameters.
nlohmann::json ParametersJson(const sim::Plant& plant, const IdentifyProblem& problem,
                              const Eigen::VectorXd& values, const sysid::IdentifiabilityReport& identified);
nlohmann::json ParametersMetadata(const worker::TaskInput& input,
                                  const realitygrad::v1::ConcludePayload& payload,
                                  const sim::ModelFile& before, const Judgement& judgement,
                                  const std::string& model_json, const IdentifyProblem& problem,
                                  const Eigen::VectorXd& values,
                                  const sysid::IdentifiabilityReport& identified);

}  // namespace rg::jobs
