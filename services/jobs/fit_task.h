// Kind "fit": one fit of a diagnosis that another process leads (remote_fits.h).
#pragma once

#include "worker/task_registry.h"

namespace rg::jobs {

// A function that keeps the recordings of its last task ready for the next one.
worker::TaskFunction MakeFitTask();

}  // namespace rg::jobs
