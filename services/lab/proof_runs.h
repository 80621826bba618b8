// `prove`'s runs of the diagnosis: a process of this program for each set, one thread each, some at a time,
// with a limit of CPU time; what was answered, or had no answer in as much time, is not asked again.
#pragma once

#include <string>
#include <vector>

#include "common/base/status.h"
#include "services/cli/progress_display.h"

namespace rg::lab {

struct SetToDiagnose {
  std::string name, folder;
};

struct ProofRuns {
  std::string answers;  // ANSWERS/NAME/diagnosis.json, run.json (services/proof/run_record.h), …
  std::string logs;     // LOGS/NAME.log
  int limit_s = 0;      // of CPU, for each set; 0: none
  int jobs = 1;
};

// A set's model.json, what it declares that a URDF cannot say, is what its diagnosis starts from. A run that
// fails or is out of time is an outcome; error: interrupted, or a process cannot be started.
Status DiagnoseSets(const std::vector<SetToDiagnose>& sets, const ProofRuns& runs,
                    cli::ProgressDisplay* display);

}  // namespace rg::lab
