// The fits of a diagnosis as tasks of workers: a job per batch, a task per fit. This process takes part, from
// the other end of a batch, and makes what no worker has begun or what failed; so the result is the same with
// many workers, with one, and without any, and with a coordinator that goes away.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "services/diagnosis/fit_requests.h"

namespace rg::coordinator {
class Client;
}

namespace rg::jobs {

class RemoteFits final : public diagnosis::FitExecutor {
 public:
  // `set`: the artefact of the recording set, as rollouts::PackBundle makes it. `client` and `cancel` outlive
  // this.
  RemoteFits(coordinator::Client& client, std::string set, double fit_window_s, const CancelToken* cancel)
      : client_(client), set_(std::move(set)), fit_window_s_(fit_window_s), cancel_(cancel) {}

  std::unique_ptr<diagnosis::FitBatch> Start(const diagnosis::FitSetting& setting,
                                             std::vector<diagnosis::FitRequest> requests) override;
  // Fits so far, by workers and by this process.
  int by_workers() const { return by_workers_; }
  int here() const { return here_; }

 private:
  class Batch;
  // The job of a batch; 0 where the coordinator does not take it.
  int64_t Submit(const std::vector<diagnosis::FitRequest>& requests);

  coordinator::Client& client_;
  std::string set_;
  double fit_window_s_;
  const CancelToken* cancel_;
  int by_workers_ = 0, here_ = 0;
};

}  // namespace rg::jobs
