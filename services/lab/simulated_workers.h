// Workers that compute nothing, for `bench service`: real sockets, keys, leases and heartbeats, and a
// result for each assignment after a given time. A process of its own runs one or hundreds of them.
#pragma once

#include <cstdint>
#include <string>

#include "common/base/progress.h"
#include "common/base/status.h"

namespace rg::lab {

struct SimulatedWorkersOptions {
  std::string coordinator;
  std::string key_file, server_key_file;  // empty: without encryption
  std::string prefix = "w";               // their names are prefix-1, prefix-2, …
  int count = 1;
  int slots = 256;
  double seconds = 0.0;     // that a task takes
  int summary_bytes = 0;    // of each result
  int output_bytes = 0;     // of an artefact that travels with each result; 0: none
  std::string delays_file;  // where the times from a task's payload ("<steady ns>") to its arrival go, in ms
};

// The kind of task that they run.
inline constexpr char kSimulatedKind[] = "simulated";

// Until `stop`; then they leave, and the file is written.
Status RunSimulatedWorkers(const SimulatedWorkersOptions& options, const CancelToken& stop);

}  // namespace rg::lab
