#include "services/cli/live_view.h"

#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>
#include <nlohmann/json.hpp>

#include "common/base/clock.h"
#include "common/base/printf.h"
#include "common/base/utf8.h"
#include "coordinator/client/client.h"
#include "services/cli/job_selector.h"
#include "services/cli/job_view.h"
#include "services/cli/output.h"
#include "services/cli/progress_display.h"

namespace rg::cli {
namespace {

namespace pb = ::realitygrad::v1;

constexpr uint32_t kMostTasks = 2000;  // more are not asked for one by one
constexpr int kNameCells = 18, kBarCells = 40;

// By cells of a terminal, not bytes; nothing in it that a terminal would obey.
std::string Fitted(const std::string& text, int width) {
  std::string out = VisibleText(text);
  size_t bytes = 0;
  for (int cells = 0; bytes < out.size(); ++bytes) {
    if ((out[bytes] & 0xC0) != 0x80 && ++cells > width) break;
  }
  out.resize(bytes);
  return out;
}

std::string Padded(std::string text, int width) {
  text = Fitted(text, width);
  return text + std::string(static_cast<size_t>(std::max(0, width - DisplayWidth(text))), ' ');
}

std::string HeadLine(const pb::GetJobReply& reply) {
  const pb::JobSummary& job = reply.job();
  std::string line = "job " + std::to_string(job.id()) + "  " + job.kind() +
                     (job.name().empty() ? "" : " " + job.name()) + "  " + JobStateText(job.state()) + "  " +
                     std::to_string(std::lround(100 * job.progress())) + " %";
  if (job.finished_ns() == 0 && job.eta_s() >= 0) line += "  ETA " + FormatSeconds(job.eta_s());
  const double best = coordinator::BestResidual(reply);
  if (!std::isnan(best)) {
    const std::string text = Printf("  best residual %.4g", best);
    line += text;
  }
  return line;
}

std::string StageLine(const pb::StageInfo& stage, int width) {
  const int cells = std::clamp(width - kNameCells - 30, 10, kBarCells);
  std::string line =
      Padded(stage.name(), kNameCells) + " [" +
      Padded(ShardBar(stage.total(), stage.done(), stage.running(), stage.failed(), cells), cells) + "] " +
      std::to_string(stage.done()) + "/" + std::to_string(stage.total());
  if (stage.failed() > 0) line += "  " + std::to_string(stage.failed()) + " failed";
  if (!stage.latest().note().empty() && stage.done() < stage.total()) line += "  " + stage.latest().note();
  return line;
}

// "worker-1: shard-03 4/10, shard-07", a line for each.
std::vector<std::string> WorkerLines(const pb::GetJobReply& reply) {
  std::map<std::string, std::string> lines;
  for (const pb::TaskInfo& task : reply.tasks()) {
    if (task.state() != pb::TASK_STATE_LEASED) continue;
    std::string& line = lines[task.worker()];
    line += (line.empty() ? "" : ", ") + task.name();
    if (task.progress().total() > 0) {
      const std::string text = Printf(" %.4g/%.4g", task.progress().done(), task.progress().total());
      line += text;
    }
  }
  std::vector<std::string> out;
  for (const auto& [worker, line] : lines) out.push_back("  " + worker + ": " + line);
  return out;
}

// Draws over what it drew before.
class Redrawing {
 public:
  void Draw(const std::vector<std::string>& lines) {
    std::string text;
    if (drawn_ > 0) text = "\033[" + std::to_string(drawn_) + "A\r\033[J";
    for (const std::string& line : lines) text += line + "\n";
    std::fputs(text.c_str(), stderr);
    std::fflush(stderr);
    drawn_ = lines.size();
  }

 private:
  size_t drawn_ = 0;
};

int TerminalHeight() {
  winsize size{};
  if (ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_row > 3) return size.ws_row;
  return 24;
}

}  // namespace

std::string ShardBar(uint32_t total, uint32_t done, uint32_t running, uint32_t failed, int width) {
  if (total == 0 || width <= 0) return "";
  const auto cells = std::min<uint32_t>(total, static_cast<uint32_t>(width));
  // What is there at all has a cell, as far as there are cells; what is not done never looks done.
  const auto share = [&](uint32_t n) {
    const auto exact = static_cast<uint32_t>(static_cast<uint64_t>(n) * cells / total);
    return n > 0 ? std::max(exact, 1u) : 0u;
  };
  std::string bar;
  bar.append(done == total ? cells : static_cast<uint32_t>(static_cast<uint64_t>(done) * cells / total), '#');
  bar.append(share(failed), '!');
  bar.append(share(running), '>');
  bar.resize(cells, '.');
  return bar;
}

std::vector<std::string> LiveView(const pb::GetJobReply& reply, int width, int height) {
  std::vector<std::string> lines = {HeadLine(reply)};
  if (!reply.job().reason().empty()) lines.push_back("  " + reply.job().reason());
  for (const pb::StageInfo& stage : reply.stages()) lines.push_back(StageLine(stage, width));
  for (std::string& line : WorkerLines(reply)) lines.push_back(std::move(line));
  if (static_cast<int>(lines.size()) > height) {
    lines.resize(static_cast<size_t>(std::max(1, height - 1)));
    lines.push_back("…");
  }
  for (std::string& line : lines) line = Fitted(line, width);
  return lines;
}

Result<pb::GetJobReply> WatchLive(coordinator::Client& client, int64_t job, double timeout_s) {
  constexpr uint32_t kLookMs = 1'000;
  constexpr double kPatience_s = 60.0;
  Redrawing picture;
  const double end = RealClock().SteadySeconds() + timeout_s;
  double answered = RealClock().SteadySeconds();
  pb::GetJobReply now;
  while (true) {
    const bool with_tasks = now.job().tasks_total() > 0 && now.job().tasks_total() <= kMostTasks;
    auto reply = client.WatchJob(job, now.job().revision(), now.job().id() == 0 ? 0 : kLookMs, with_tasks);
    const double clock = RealClock().SteadySeconds();
    if (reply.ok()) {
      const bool is_first = now.job().id() == 0;
      now = *std::move(reply);
      job = now.job().id();
      answered = clock;
      if (!is_first || IsOver(now.job().state()))
        picture.Draw(LiveView(now, TerminalWidth() - 1, TerminalHeight() - 1));
      if (is_first) now.mutable_job()->set_revision(0);  // again at once, with its tasks
      if (IsOver(now.job().state())) return now;
    } else if (reply.status().code() != StatusCode::kUnavailable || clock - answered > kPatience_s) {
      return reply.status();
    }
    if (timeout_s >= 0 && clock > end)
      return DeadlineExceededError("job " + std::to_string(job) + " is not over yet");
  }
}

}  // namespace rg::cli
