#include "services/cli/progress_display.h"

#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>

#include "common/base/clock.h"
#include "common/base/printf.h"
#include "services/cli/output.h"

namespace rg::cli {
namespace {

constexpr double kLinePeriod_s = 5.0;  // without a terminal

std::string Count(double x) { return Printf(x == std::floor(x) ? "%.0f" : "%.1f", x); }

}  // namespace

bool StderrIsTerminal() { return isatty(STDERR_FILENO) == 1; }

int TerminalWidth() {
  winsize size{};
  if (ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 20) return size.ws_col;
  return 100;
}

std::string ProgressDisplay::Line(const ProgressUpdate& update, double elapsed_s, int width) {
  std::string line = update.stage;
  line.resize(std::max<size_t>(line.size(), 16), ' ');
  if (update.total > 0) {
    const double fraction = std::clamp(update.done / update.total, 0.0, 1.0);
    const int filled = static_cast<int>(std::lround(20 * fraction));
    line += " [" + std::string(static_cast<size_t>(filled), '#') +
            std::string(static_cast<size_t>(20 - filled), '-') + "] " + Count(update.done) + "/" +
            Count(update.total);
    if (fraction >= 1.0) {
      line += "  " + FormatSeconds(elapsed_s);
    } else if (fraction > 0.0 && elapsed_s > 0.5) {
      line += "  ETA " + FormatSeconds(elapsed_s * (1.0 - fraction) / fraction);
    }
  }
  if (!update.note.empty()) line += "  " + update.note;
  if (DisplayWidth(line) >= width) {
    size_t bytes = 0;
    for (int cells = 0; bytes < line.size(); ++bytes) {
      if ((line[bytes] & 0xC0) != 0x80 && ++cells >= width) break;
    }
    line.resize(bytes);
  }
  return line;
}

void ProgressDisplay::Show(const ProgressUpdate& update) {
  if (quiet_) return;
  const double now = RealClock().SteadySeconds();
  if (!open_ || update.stage != last_.stage) {
    Finish();
    open_ = true;
    stage_start_s_ = now;
    last_line_s_ = -1e9;
  }
  last_ = update;
  const std::string line = Line(update, now - stage_start_s_, width_);
  if (terminal_) {
    std::fprintf(stderr, "\r\033[K%s", line.c_str());
    std::fflush(stderr);
  } else if (now - last_line_s_ >= kLinePeriod_s) {
    std::fprintf(stderr, "%s\n", line.c_str());
    last_line_s_ = now;
  }
}

void ProgressDisplay::Finish(const std::string& summary) {
  if (!open_) return;
  open_ = false;
  const std::string line =
      !summary.empty() ? summary : Line(last_, RealClock().SteadySeconds() - stage_start_s_, width_);
  std::fprintf(stderr, terminal_ ? "\r\033[K%s\n" : "%s\n", line.c_str());
  std::fflush(stderr);
}

}  // namespace rg::cli
