#include "services/proof/generator/set_files.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace rg::proof {

using nlohmann::json;

SetStyle DrawStyle(double rate_hz, bool with_velocity, Rng rng) {
  SetStyle style;
  style.with_velocity = with_velocity;
  const double dice = rng.Uniform();
  if (dice < 0.1) style.rows = rate_hz >= 100 && rng.Uniform() < 0.4 ? Rows::kMissing : Rows::kJittered;
  const bool slow = style.rows == Rows::kMissing || (dice > 0.9 && rate_hz >= 100);
  if (slow) style.rows_per_command = rate_hz < 200 ? 2 : 5;
  const double noise = rng.Uniform();
  if (noise < 0.2) {
    style.says_position_noise = style.says_velocity_noise = style.says_resolution = false;
  } else if (noise < 0.4) {
    style.says_position_noise = rng.Uniform() < 0.5;
    style.says_velocity_noise = rng.Uniform() < 0.5;
    style.says_resolution = rng.Uniform() < 0.5;
  }
  style.says_gravity = rng.Uniform() < 0.7;
  style.says_rate = rng.Uniform() < 0.85;
  style.says_control = rng.Uniform() < 0.75;
  style.says_splits = rng.Uniform() < 0.94;
  return style;
}

std::vector<PlannedRecording> DrawPlan(Rng rng) {
  std::vector<PlannedRecording> plan = {{"fit", "multisine"},      {"fit", "p2p"},      {"fit", "ramps"},
                                        {"fit", "multisine"},      {"fit", "holds"},    {"holdout", "chirp"},
                                        {"holdout", "sequential"}, {"hidden", "chirp"}, {"hidden", "p2p"}};
  const bool other = rng.Uniform() < 0.35;
  if (other) {
    const char* const kinds[] = {"multisine", "p2p", "ramps", "holds", "chirp", "sequential"};
    plan.clear();
    plan.push_back({"fit", "multisine"});
    const auto fitted = static_cast<int>(2 + rng.Index(4));
    for (int k = 0; k < fitted; ++k) plan.push_back({"fit", kinds[rng.Index(6)]});
    const auto held = static_cast<int>(1 + rng.Index(3));
    for (int k = 0; k < held; ++k) plan.push_back({"holdout", kinds[k == 0 ? 0 : rng.Index(6)]});
    plan.push_back({"hidden", "chirp"}), plan.push_back({"hidden", "p2p"});
  }
  for (PlannedRecording& r : plan) {
    const bool hidden = r.split == "hidden";
    r.duration_s = other && !hidden ? 5.0 + 0.5 * static_cast<double>(rng.Index(15))
                                    : 6.0 + 0.5 * static_cast<double>(rng.Index(5));
  }
  return plan;
}

RowPlan PlanRows(const SetStyle& style, bool regular, double duration_s, double rate_hz, double tick,
                 Rng rng) {
  RowPlan plan;
  const auto rows = static_cast<long>(duration_s * rate_hz) + 1;
  const Rows kind = regular ? Rows::kRegular : style.rows;
  if (kind == Rows::kJittered) {  // the loop itself is late now and then, and its command holds as long
    for (double t = 0; t <= duration_s + 1e-9;) {
      plan.time.push_back(std::round(t / tick) * tick);
      const double late =
          rng.Uniform() < 0.02 ? 1.0 + static_cast<double>(rng.Index(rate_hz < 100 ? 1 : 3)) : 0.0;
      t += (rng.Uniform(0.65, 1.35) + late) / rate_hz;
    }
    plan.commands.assign(plan.time.size(), true);
    plan.written = plan.commands;
    return plan;
  }
  for (long k = 0; k < rows; ++k) {
    const bool command = k % style.rows_per_command == 0;
    plan.time.push_back(static_cast<double>(k) / rate_hz);
    plan.commands.push_back(command);
    plan.written.push_back(command || kind != Rows::kMissing || rng.Uniform() > 0.15);
  }
  return plan;
}

std::string Csv(const Track& track, const std::vector<std::string>& joints, bool with_velocity,
                bool concealed) {
  const auto n = static_cast<Eigen::Index>(joints.size());
  std::string text = "time";
  const auto header = [&](const std::string& kind) {
    for (const std::string& j : joints) text += "," + kind + "." + j;
  };
  header("position");
  if (with_velocity) header("velocity");
  header("effort_command");
  if (concealed) header("true_position"), header("true_velocity");
  text += "\n";
  char number[40];
  const auto put = [&](double x, const char* format) {
    std::snprintf(number, sizeof number, format, x);
    text += number;
  };
  for (Eigen::Index k = 0; k < track.q.cols(); ++k) {
    put(track.t[k], "%.9g");
    for (Eigen::Index i = 0; i < n; ++i) put(track.q(i, k), ",%.7g");
    for (Eigen::Index i = 0; with_velocity && i < n; ++i) put(track.v(i, k), ",%.6g");
    for (Eigen::Index i = 0; i < n; ++i) put(track.u(i, k), ",%.9g");
    for (Eigen::Index i = 0; concealed && i < n; ++i) put(track.true_q(i, k), ",%.9g");
    for (Eigen::Index i = 0; concealed && i < n; ++i) put(track.true_v(i, k), ",%.9g");
    text += "\n";
  }
  return text;
}

json Manifest(const SetStyle& style, const std::vector<std::string>& joints,
              const std::vector<PlannedRecording>& plan, const Noise& noise, double rate_hz) {
  json recordings = json::array();
  for (size_t r = 0; r < plan.size(); ++r) {
    if (plan[r].split == "hidden") continue;
    char file[32];
    std::snprintf(file, sizeof file, "rec_%03d.csv", static_cast<int>(r));
    json entry = {{"file", file}};
    if (style.says_splits) entry["split"] = plan[r].split;
    recordings.push_back(entry);
  }
  json manifest = {{"format", "realitygrad.recordings/1"},
                   {"robot", "robot.urdf"},
                   {"joints", joints},
                   {"recordings", recordings}};
  if (style.says_gravity) manifest["gravity"] = {0, 0, -9.81};
  if (style.says_rate) manifest["sample_rate_hz"] = rate_hz;
  if (style.says_control)
    manifest["control"] = {{"rate_hz", rate_hz / style.rows_per_command}, {"hold", "zero_order"}};
  json sheet = json::object();
  if (style.says_position_noise) sheet["position_stddev"] = noise.position;
  if (style.says_velocity_noise) sheet["velocity_stddev"] = noise.velocity;
  if (style.says_resolution) sheet["position_resolution"] = noise.resolution;
  if (!sheet.empty()) manifest["noise"] = sheet;
  return manifest;
}

}  // namespace rg::proof
