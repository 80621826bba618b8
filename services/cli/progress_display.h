// Shows ProgressUpdates on stderr: one line that redraws itself on a terminal, a line now and then
// elsewhere. The ETA comes from the stage's own pace. Not thread-safe: one thread shows.
#pragma once

#include <string>

#include "common/base/progress.h"

namespace rg::cli {

bool StderrIsTerminal();
int TerminalWidth();

class ProgressDisplay {
 public:
  explicit ProgressDisplay(bool quiet) : quiet_(quiet) {}
  ~ProgressDisplay() { Finish(); }

  void Show(const ProgressUpdate& update);
  // Ends the stage's line; the next Show starts a new one. `summary` replaces the bar if not empty.
  void Finish(const std::string& summary = "");

  // "trajectories  [#########-----------]  210/450  ETA 12 s  note"
  static std::string Line(const ProgressUpdate& update, double elapsed_s, int width);

 private:
  const bool quiet_, terminal_ = StderrIsTerminal();
  const int width_ = TerminalWidth();
  ProgressUpdate last_;
  double stage_start_s_ = 0.0;
  double last_line_s_ = -1e9;
  bool open_ = false;
};

}  // namespace rg::cli
