// The flags that shape an iteration, shared by `run` and `submit`.
#pragma once

#include "services/jobs/job_graphs.h"

namespace CLI {
class App;
}

namespace rg::cli {

struct RobotProfile;

void AddTrajectoryFlags(CLI::App* command, jobs::IterationOptions* options);
void AddTrainFlags(CLI::App* command, jobs::IterationOptions* options);
// What only a whole iteration has: aggregation, examination, curriculum.
void AddLearningFlags(CLI::App* command, jobs::IterationOptions* options);
// Whether each rollout is diagnosed, and how long that may take.
void AddLoopDiagnosisFlags(CLI::App* command, jobs::IterationOptions* options);
void AddRolloutFlags(CLI::App* command, jobs::IterationOptions* options);
void AddIdentifyFlags(CLI::App* command, jobs::IterationOptions* options);
// Whatever makes a rollout, or parameters from one.
void AddPartialFlag(CLI::App* command, jobs::IterationOptions* options);
// Name, candle pose, peak torque.
void TakeProfile(const RobotProfile& profile, jobs::IterationOptions* options);

}  // namespace rg::cli
