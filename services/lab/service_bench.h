// `realitygrad bench service`: what the service costs and bears on this machine, through real programs: an
// encrypted coordinator with its database on a disk (every commit synced), worker processes, real sockets.
// All figures are wall time; the notes say what was measured and the coordinator's own CPU time.
#pragma once

#include <string>
#include <vector>

#include "common/base/progress.h"
#include "common/base/status.h"
#include "services/lab/bench.h"

namespace rg::lab {

// `quick`: of smaller loads.
std::vector<Row> ServiceRows(bool quick = false);

struct ServiceBenchOptions {
  std::vector<std::string> only;  // keys; empty: all
  bool quick = false;             // smaller loads, said in the notes
  int workers = 500;              // of the row `workers`
};

// Error: an unknown key, an interrupt. A row that cannot be measured has no value, and a note why.
Result<std::vector<Measurement>> RunServiceBench(const ServiceBenchOptions& options,
                                                 const ProgressFn& progress, const CancelToken* cancel);

// A database with `ended` tasks of jobs that are over, with attempts and results, and `live` ones of a job
// that runs. The coordinator's tables must be in `path` already.
Status FillServiceDatabase(const std::string& path, int64_t ended, int64_t live);

}  // namespace rg::lab
