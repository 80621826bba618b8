#include "services/jobs/adopt_task.h"
#include "services/jobs/identify_tasks.h"
#include "services/jobs/kinds.h"
#include "services/jobs/learning_tasks.h"
#include "services/jobs/task_kinds.h"
#include "worker/task_registry.h"

namespace rg::jobs {

void RegisterIterationKinds(worker::TaskRegistry* registry) {
  registry->Register(kKindTrajectories, RunTrajectories);
  registry->Register(kKindTrain, RunTrain);
  registry->Register(kKindAggregate, RunAggregate);
  registry->Register(kKindExamine, RunExamine);
  registry->Register(kKindIdentify, RunIdentify);
  registry->Register(kKindConclude, RunConclude);
  registry->Register(kKindAdopt, RunAdopt);
}

}  // namespace rg::jobs
