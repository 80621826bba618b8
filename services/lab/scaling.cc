#include "services/lab/scaling.h"

#include <nlohmann/json.hpp>
#include <numeric>

#include "common/base/rng.h"
#include "services/lab/subjects.h"

namespace rg::lab {
namespace {

constexpr double kLengths[] = {1, 2, 4, 8, 16, 32};  // s
constexpr int kStep = 8;                             // parameters from one subset to the next

struct Subject {
  double x;
  std::unique_ptr<MovingArm> arm;
  std::vector<double> seconds;
};

std::vector<int> Shuffled(std::vector<int> items, uint64_t seed) {
  Rng rng(seed);
  for (size_t i = items.size(); i > 1; --i) std::swap(items[i - 1], items[rng.Index(i)]);
  return items;
}

Status MeasureInTurns(int rounds, std::vector<Subject>* subjects, const ProgressFn& progress,
                      const CancelToken* cancel) {
  const ThreadCpuClock clock;
  for (int round = 0; round < rounds; ++round) {
    for (Subject& s : *subjects) {
      if (cancel != nullptr && cancel->cancelled()) return CancelledError("interrupted");
      const double begin = clock.SteadySeconds();
      if (!s.arm->SimulateWithSensitivities()) return InternalError(s.arm->out.outcome.ToString());
      s.seconds.push_back(clock.SteadySeconds() - begin);
    }
    if (progress) progress({"scaling", round + 1.0, static_cast<double>(rounds), ""});
  }
  return Status::Ok();
}

std::vector<ScalingPoint> PointsOf(const std::vector<Subject>& subjects, size_t first, size_t last) {
  std::vector<ScalingPoint> points;
  for (size_t k = first; k < last; ++k) points.push_back({subjects[k].x, 1e3 * Median(subjects[k].seconds)});
  return points;
}

nlohmann::json PointsJson(const std::vector<ScalingPoint>& points, const char* x) {
  const ScalingLine line = LineThrough(points);
  nlohmann::json out = {
      {"points", nlohmann::json::array()},
      {"line", {{"ms_at_zero", line.at_zero}, {"ms_per_unit", line.slope}, {"r_squared", line.r_squared}}}};
  for (const ScalingPoint& p : points) out["points"].push_back({{x, p.x}, {"ms", p.ms}});
  return out;
}

}  // namespace

ScalingLine LineThrough(const std::vector<ScalingPoint>& points) {
  const auto count = static_cast<double>(points.size());
  double x = 0, y = 0, xx = 0, xy = 0, yy = 0;
  for (const ScalingPoint& p : points) x += p.x / count, y += p.ms / count;
  for (const ScalingPoint& p : points) {
    xx += (p.x - x) * (p.x - x), xy += (p.x - x) * (p.ms - y), yy += (p.ms - y) * (p.ms - y);
  }
  ScalingLine line;
  line.slope = xx > 0 ? xy / xx : 0;
  line.at_zero = y - line.slope * x;
  line.r_squared = yy > 0 ? line.slope * xy / yy : 1;
  return line;
}

Result<Scaling> MeasureScaling(std::shared_ptr<const model::RobotModel> robot, bool quick, uint64_t seed,
                               const ProgressFn& progress, const CancelToken* cancel) {
  std::vector<Subject> subjects;
  for (const double length : kLengths) {
    if (quick && length > 8) continue;
    subjects.push_back(
        {length, std::make_unique<MovingArm>(robot, std::vector<effects::EffectSpec>(), length), {}});
  }
  const size_t lengths = subjects.size();
  Scaling out;
  if (quick) out.seconds = 1;
  const auto add = [&](std::vector<int> parameters) {
    auto arm = std::make_unique<MovingArm>(robot, std::vector<effects::EffectSpec>(), out.seconds);
    arm->parameters = std::move(parameters);
    const auto count = static_cast<double>(arm->parameters.size());
    subjects.push_back({count, std::move(arm), {}});
  };
  const std::vector<int> paper = Shuffled(subjects[0].arm->parameters, seed);
  out.paper_parameters = static_cast<int>(paper.size());
  for (size_t count = kStep; count < paper.size(); count += kStep) {
    add({paper.begin(), paper.begin() + static_cast<std::ptrdiff_t>(count)});
  }
  add(paper);
  std::vector<int> all(static_cast<size_t>(subjects[0].arm->plant.parameters().size()));
  std::iota(all.begin(), all.end(), 0);
  add(all);
  RG_RETURN_IF_ERROR(MeasureInTurns(quick ? 3 : 15, &subjects, progress, cancel));
  out.by_length = PointsOf(subjects, 0, lengths);
  out.by_parameters = PointsOf(subjects, lengths, subjects.size());
  return out;
}

nlohmann::json ScalingJson(const Scaling& scaling) {
  return {{"by_length", PointsJson(scaling.by_length, "seconds")},
          {"by_parameters", PointsJson(scaling.by_parameters, "parameters")},
          {"paper_parameters", scaling.paper_parameters},
          {"seconds", scaling.seconds}};
}

}  // namespace rg::lab
