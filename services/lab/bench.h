// `realitygrad bench`: the figures the project is held to, measured on the user's own machine.
//
// Each row has a key that never changes, a target and what rivals reach (measured elsewhere, on one
// AVX-512 capable server core: compare through a yardstick, not by microseconds). Single-threaded rows are
// CPU time of the calling thread, so that a busy machine disturbs them little; rows with several threads or
// programs are wall time. Figures are medians; a row that cannot be measured says why.
#pragma once

#include <functional>
#include <memory>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

#include "common/base/clock.h"
#include "common/base/progress.h"
#include "common/base/status.h"

namespace rg::model {
class RobotModel;
}

namespace rg::lab {

struct Row {
  const char* key;   // "rnea_us"; the suffix is the unit
  const char* what;  // for people
  const char* unit;
  double target;
  const char* rival = nullptr;
  bool at_least = false;  // the target is a lower bound
};
// In the order of the table.
const std::vector<Row>& Rows();

struct Measurement {
  std::string key;
  std::optional<double> value;  // median, in the row's unit; none: `note` says why
  int samples = 0;
  std::string note;  // what exactly was measured
};

struct BenchOptions {
  std::vector<std::string> only;  // keys; empty: all
  bool quick = false;             // fewer samples; long rows are scaled up from a part, and say so
  int threads = 2;                // of the rows that use several
  uint64_t seed = 1;
  // Runs one iteration of the loop at the paper's size, seconds. Empty: the row stays without a figure.
  std::function<Result<double>()> run_iteration;
};

// `robot`: 6 joints moving (the Mico² for figures that compare). Error: an unknown key, a cancel.
Result<std::vector<Measurement>> RunBench(std::shared_ptr<const model::RobotModel> robot,
                                          const BenchOptions& options, const Clock& clock,
                                          const ProgressFn& progress = {},
                                          const CancelToken* cancel = nullptr);

// Those of `rows` that `only` names (none: all), in their order. Error: an unknown key, a cancel.
Result<std::vector<Measurement>> MeasureRows(
    const std::vector<Row>& rows, const std::vector<std::string>& only,
    const std::function<Measurement(const std::string& key)>& measure, const ProgressFn& progress,
    const CancelToken* cancel);

// {"rnea_us": 0.7, …, "notes": {…}, "samples": {…}, "targets": {…}}; keys not asked for are left out, keys
// without a figure are null.
nlohmann::json BenchJson(const std::vector<Row>& rows, const std::vector<Measurement>& measurements);

}  // namespace rg::lab
