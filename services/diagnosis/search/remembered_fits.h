// Fits that were asked for before are not made again: a search comes back to the same hypothesis by several
// ways, and a fit's result is the same for the same request.
#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "services/diagnosis/search/fit_requests.h"

namespace rg::diagnosis {

class RememberedFits : public FitExecutor {
 public:
  // `fits`: who makes them; outlives this.
  explicit RememberedFits(FitExecutor& fits) : fits_(fits) {}

  // A result that was taken before has no work. The batch outlives neither this nor a Forget().
  std::unique_ptr<FitBatch> Start(const FitSetting& setting, std::vector<FitRequest> requests) override;
  void Forget() { made_.clear(); }

 private:
  FitExecutor& fits_;
  std::map<std::string, FitResult> made_;  // by all that a request holds
};

}  // namespace rg::diagnosis
