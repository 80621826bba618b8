// Fits of candidates as requests, so that the search need not know who makes them: this process, or workers
// on other hosts (services/jobs/remote_fits.h). A request holds everything but the recordings; its result is
// the same whoever makes it.
#pragma once

#include <cstdint>
#include <memory>
#include <vector>

#include "services/diagnosis/likelihood/candidate.h"
#include "services/diagnosis/likelihood/fit_setting.h"

namespace rg::diagnosis {

inline constexpr double kLongerPiece = 2.2;         // times from one length of pieces to the next
inline constexpr double kLongestPiece = 1.0 / 1.5;  // of a window

struct FitRequest {
  std::vector<effects::EffectSpec> specs;  // with start values
  bool base = false;                       // base parameters free
  LiftedOptions options;
  // Windows that are fitted, by their places among all; empty: all.
  std::vector<uint32_t> places;
  // Length [s] of the pieces that windows are first cut into; 0: whole windows. Over a short piece a model
  // that is far off stays near the recorded motion, so that fits converge. They go on over longer pieces to
  // whole windows, unless `pieces_alone`. Models with hidden states are fitted to whole windows only.
  double piece_s = 0;
  bool pieces_alone = false;
  // A fitted model at whose states (without any: at the recorded motion) and base parameters it starts; null:
  // at the recorded motion and nominal parameters.
  std::shared_ptr<const Candidate> from;
};

// Plant and free parameters of the request's candidate, not yet fitted; without a plant where its effects
// cannot stand together.
Candidate Unfitted(const FitSetting& setting, const std::vector<effects::EffectSpec>& specs, bool base);
// Not ok where the request's candidate has no plant.
FitResult MakeFit(const FitSetting& setting, const FitRequest& request);

// Fits that were asked for together.
class FitBatch {
 public:
  virtual ~FitBatch() = default;  // what was not taken is given up
  virtual FitResult Take(size_t i) = 0;
};

class FitExecutor {
 public:
  virtual ~FitExecutor() = default;
  virtual std::unique_ptr<FitBatch> Start(const FitSetting& setting, std::vector<FitRequest> requests) = 0;
};

// In this process, each when it is taken.
class LocalFits final : public FitExecutor {
 public:
  std::unique_ptr<FitBatch> Start(const FitSetting& setting, std::vector<FitRequest> requests) override;
};

}  // namespace rg::diagnosis
