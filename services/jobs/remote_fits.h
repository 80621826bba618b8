// The fits of a diagnosis as tasks of workers: a job per batch, a task per fit. This process takes part, from
// the other end of a batch, and makes what no worker has begun or what failed; so the result is the same with
// many workers, with one, and without any, and with a coordinator that goes away. It may be a task itself:
// its next attempt then finds the fits that the one before had asked for.
#pragma once

#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <vector>

#include "services/diagnosis/search/fit_requests.h"

namespace rg::coordinator {
class Client;
}

namespace rg::jobs {

// What the fits read, as artefacts.
struct FitInputs {
  std::vector<std::string> recordings;  // sets, as rollouts::PackBundle makes them
  std::string model;                    // that the diagnosis starts from; empty: the sets' URDF
  bool rollouts = false;                // of a loop (SetToDiagnose)
  bool of_a_task = false;               // `client` speaks for a task (TaskContext::Coordinator)
};

class RemoteFits final : public diagnosis::FitExecutor {
 public:
  // `client` and `cancel` outlive this.
  RemoteFits(coordinator::Client& client, FitInputs inputs, const CancelToken* cancel)
      : client_(client), inputs_(std::move(inputs)), cancel_(cancel) {}

  std::unique_ptr<diagnosis::FitBatch> Start(const diagnosis::FitSetting& setting,
                                             std::vector<diagnosis::FitRequest> requests) override;
  // Fits so far, by workers and by this process.
  int by_workers() const { return by_workers_; }
  int here() const { return here_; }
  // Of batches that are not over; from any thread.
  std::vector<int64_t> open_jobs() const;

 private:
  class Batch;
  // The job of a batch; 0 where the coordinator does not take it.
  int64_t Submit(const std::vector<diagnosis::FitRequest>& requests, const diagnosis::FitData& data);

  coordinator::Client& client_;
  FitInputs inputs_;
  const CancelToken* cancel_;
  int by_workers_ = 0, here_ = 0;
  mutable std::mutex mutex_;
  std::set<int64_t> open_;
};

}  // namespace rg::jobs
