// What a run of the diagnosis on one set took and came to: run.json beside its diagnosis.json.
#pragma once

#include <optional>
#include <string>

#include "common/base/status.h"

namespace rg::proof {

struct RunRecord {
  enum class Outcome { kAnswered, kOutOfTime, kFailed };
  std::string set;      // the set's folder, as seen from the answer's
  std::string program;  // of the program's SHA-256, the first 12 digits
  Outcome outcome = Outcome::kAnswered;
  double cpu_s = 0;
  double limit_s = 0;  // of CPU; 0: none

  // Whether a run of `set` with this limit need not be made again: it was answered, or had as much time.
  bool Settles(const std::string& of_set, double limit) const;
};

// As JSON, "realitygrad.proof_run/1".
std::string ToText(const RunRecord& record);
// Of an answer's folder; nothing where there is none that can be read.
std::optional<RunRecord> ReadRunRecord(const std::string& answer_folder);
Status WriteRunRecord(const std::string& answer_folder, const RunRecord& record);

}  // namespace rg::proof
