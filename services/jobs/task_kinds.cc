#include "services/jobs/task_kinds.h"

#include "services/jobs/diagnose_task.h"
#include "services/jobs/fit_task.h"
#include "services/jobs/kinds.h"
#include "worker/task_registry.h"

namespace rg::jobs {

void RegisterWorkerKinds(worker::TaskRegistry* registry) {
  RegisterIterationKinds(registry);
  registry->Register(kKindDiagnose, RunDiagnose);
  registry->Register(kKindFit, MakeFitTask());
  registry->Register(kKindNothing,
                     [](const worker::TaskInput&, worker::TaskContext&) -> Result<worker::TaskOutputs> {
                       return worker::TaskOutputs();
                     });
}

}  // namespace rg::jobs
