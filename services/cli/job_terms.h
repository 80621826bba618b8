// The flags that say when a job may start, how long it may run and what it is called, for every kind of job.
#pragma once

#include <string>
#include <vector>

#include "common/base/status.h"
#include "realitygrad/v1/job.pb.h"

namespace CLI {
class App;
}
namespace rg::coordinator {
class Client;
}

namespace rg::cli {

class JobTerms {
 public:
  // `this` must live as long as the command.
  void AddTo(CLI::App* command);
  // Writes them into the job. kInvalid: a label without a name; otherwise what the selector of `--after` gives.
  Status Apply(coordinator::Client& client, realitygrad::v1::JobSpec* job) const;

 private:
  std::string name_, after_;
  std::vector<std::string> labels_;
  int priority_ = 0;
  double time_limit_s_ = 0.0;
};

}  // namespace rg::cli
