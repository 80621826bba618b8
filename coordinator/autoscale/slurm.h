// Slurm by its own commands: sbatch, squeue, scancel. Each has a time-out.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "coordinator/autoscale/plan.h"

namespace rg::coordinator::autoscale {

struct SlurmOptions {
  std::vector<std::string> worker;  // the command of a worker, without its name
  uint32_t slots = 1;
  std::vector<std::string> sbatch;  // further arguments of sbatch
  std::string log_folder;           // of what the allocations print
  double timeout_s = 30.0;
};

class Slurm {
 public:
  explicit Slurm(SlurmOptions options) : options_(std::move(options)) {}

  // Would it take such an allocation? kInvalid: no, and why; kUnavailable: it does not answer.
  Status TryOut() const;
  // The id. kInvalid: refused; any other error: what became of it is not known.
  Result<std::string> Ask(const std::string& tag) const;
  // All of this user that still pend or run, or ended a while ago.
  Result<std::vector<Listed>> List() const;
  // What is gone already is no error.
  Status GiveBack(const std::string& id) const;
  const std::string& log_folder() const { return options_.log_folder; }

 private:
  std::vector<std::string> SbatchWords(const std::string& tag) const;
  std::string Script(const std::string& tag) const;
  SlurmOptions options_;
};

// Removes logs in `folder` (TAG.log) beyond the newest `most` and those older than `age_s`, but none of `kept` tags. The
// number removed.
size_t PruneLogs(const std::string& folder, const std::vector<std::string>& kept, size_t most, double age_s);

// The lines of `squeue -o "%i|%j|%T"`.
Result<std::vector<Listed>> ParseQueue(const std::string& text);

}  // namespace rg::coordinator::autoscale
