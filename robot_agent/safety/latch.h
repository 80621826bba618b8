// What keeps an arm from moving until a person has looked: a file, so that it outlives every process.
//
//   no file        the arm was at rest in position mode when it was last seen
//   "under_way"    somebody moves it; if nobody does (the process is gone), how it ended is not known
//   "latched"      it was told to stop and that was not confirmed
//
// A motion writes "under_way" before anything moves and takes it away after its stop was confirmed. Who finds
// the file before a motion must not begin one. Only `realitygrad agent clear` takes it away. The file is
// replaced whole (temp and rename, synced), so that it is there or not, never half; one that cannot be read
// counts as latched. One process at a time uses it (the spool's lock).
#pragma once

#include <optional>
#include <string>

#include "common/base/status.h"

namespace rg::robot_agent {

struct LatchEntry {
  bool latched = true;  // false: under_way
  std::string rollout;  // its id
  std::string reason;   // one line
  std::string since;    // wall time
};

class Latch {
 public:
  // The file is FOLDER/latch.json.
  explicit Latch(const std::string& folder);

  std::optional<LatchEntry> Read() const;
  // kFailedPrecondition saying why and what to type, if a motion must not begin.
  Status CheckClear() const;
  // CheckClear, then "under_way". kUnavailable: it cannot be written, and nothing may move.
  Status BeginMotion(const std::string& rollout, const std::string& now);
  // The stop was confirmed.
  Status EndMotion();
  // It was not. Tried again a few times; an "under_way" that stays does the same.
  Status Set(const std::string& rollout, const std::string& reason, const std::string& now);
  // A person has looked.
  Status Clear();

 private:
  Status Write(const LatchEntry& entry) const;
  const std::string path_;
};

}  // namespace rg::robot_agent
