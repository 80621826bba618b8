// Shows ProgressUpdates on stderr: one line that redraws itself on a terminal, a line now and then
// elsewhere. The ETA comes from the stage's own pace. Not thread-safe: one thread shows.
#pragma once

#include <string>

#include "common/base/clock.h"
#include "common/base/progress.h"

namespace rg::cli {

class ProgressDisplay {
 public:
  struct Options {
    bool terminal = false;  // stderr is one; see StderrIsTerminal
    int width = 100;
    double line_period_s = 5.0;  // without a terminal
    bool quiet = false;
  };
  ProgressDisplay(Options options, const Clock& clock) : options_(options), clock_(clock) {}
  ~ProgressDisplay() { Finish(); }

  void Show(const ProgressUpdate& update);
  // Ends the stage's line; the next Show starts a new one. `summary` replaces the bar if not empty.
  void Finish(const std::string& summary = "");

  // "trajectories  [#########-----------]  210/450  ETA 12 s  note"
  static std::string Line(const ProgressUpdate& update, double elapsed_s, int width);

 private:
  Options options_;
  const Clock& clock_;
  ProgressUpdate last_;
  double stage_start_s_ = 0.0;
  double last_line_s_ = -1e9;
  bool open_ = false;
};

bool StderrIsTerminal();
int TerminalWidth();

}  // namespace rg::cli
