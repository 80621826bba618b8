// Cache of fits by their request: a search reaches the same hypothesis on several paths.
#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "services/diagnosis/search/fit_requests.h"

namespace rg::diagnosis {

class RememberedFits : public FitExecutor {
 public:
  // `fits`: makes them; outlives this.
  explicit RememberedFits(FitExecutor& fits) : fits_(fits) {}

  // A cached result has no work. A batch must not outlive this or a Forget().
  std::unique_ptr<FitBatch> Start(const FitSetting& setting, std::vector<FitRequest> requests) override;
  void Forget() { made_.clear(); }

 private:
  FitExecutor& fits_;
  std::map<std::string, FitResult> made_;  // by RequestKey
};

}  // namespace rg::diagnosis
