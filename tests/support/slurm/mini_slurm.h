// A real Slurm of one node with four cores, in a folder of its own: munged, slurmctld and slurmd as children
// of the test. Its commands find it by SLURM_CONF, which is set for this process and what it starts.
#pragma once

#include <memory>
#include <string>

#include "tests/support/service/processes.h"

namespace rg::testing {

class MiniSlurm {
 public:
  // Why it cannot run here; empty: it can.
  static std::string Missing();

  explicit MiniSlurm(const std::string& folder);
  ~MiniSlurm();

  // False: not within the time.
  bool WaitUntilIdle(double timeout_s);
  void KillController();   // kill -9
  void StartController();  // again, with the state it kept
  // `squeue` with these arguments; empty where it does not answer.
  std::string Queue(const std::string& arguments) const;
  std::string Logs() const;

 private:
  void WriteConfiguration() const;
  const std::string folder_;
  std::unique_ptr<Process> munged_, controller_, node_;
};

}  // namespace rg::testing
