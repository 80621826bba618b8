// A command of the administrator's that is run when a job ends, with the job as one JSON object on its stdin. One after
// the other, in a thread of its own; a command that does not end in time is killed. Ends that came while the
// coordinator was being stopped, or were too many at once, are not told: `jobs --since` knows them.
#pragma once

#include <condition_variable>
#include <deque>
#include <mutex>
#include <string>
#include <thread>

#include "realitygrad/v1/job.pb.h"

namespace rg::coordinator {

class EndHook {
 public:
  // `command` is a shell's; empty: nothing is run.
  explicit EndHook(std::string command, double most_s = 60.0);
  ~EndHook();  // what waits is left out

  void JobEnded(const realitygrad::v1::JobSummary& job);

 private:
  void Work();
  void RunOnce(const std::string& input);
  bool Stopped();
  const std::string command_;
  const double most_s_;
  std::mutex mutex_;
  std::condition_variable wake_;
  std::deque<std::string> waiting_;
  bool stop_ = false;
  std::thread thread_;
};

}  // namespace rg::coordinator
