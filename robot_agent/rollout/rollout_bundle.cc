#include "robot_agent/rollout/rollout_bundle.h"

#include <cmath>
#include <map>
#include <nlohmann/json.hpp>
#include <vector>

#include "common/model/urdf_loader.h"
#include "common/recordings/command_time.h"
#include "common/recordings/csv.h"
#include "common/recordings/recording_set.h"
#include "robot_agent/safety/monitor.h"
#include "services/rollouts/scoring.h"

namespace rg::robot_agent {
namespace {

using nlohmann::json;
using recordings::Recording;

// The state is what ended it: it must not become data.
bool StateWasTheCause(EndReason reason) {
  return reason == EndReason::kRobotNan || reason == EndReason::kStaleState ||
         reason == EndReason::kImpossibleState || reason == EndReason::kDriverLost ||
         reason == EndReason::kModeLost || reason == EndReason::kNotStarted;
}

bool Finite(const Sample& sample, int n) {
  for (int i = 0; i < n; ++i)
    if (!std::isfinite(sample.q[i] + sample.v[i] + sample.effort[i] + sample.command[i] + sample.sent[i]))
      return false;
  return true;
}

std::vector<const Sample*> ChooseRows(const RawRecording& raw, int n, EndReason reason) {
  std::vector<const Sample*> rows;
  for (const Sample& sample : raw.samples) {
    const bool stopping = sample.flags & Sample::kStopping;
    if (stopping && StateWasTheCause(reason)) break;
    const bool later = rows.empty() || sample.stamp_ns > rows.back()->stamp_ns;
    if ((sample.flags & Sample::kNewState) && later && Finite(sample, n)) rows.push_back(&sample);
    if (stopping) break;
  }
  return rows;
}

// `arm_adds_gravity`: what drives the arm is what it was handed plus a gravity that only its base knows. The
// command column is then what it was handed, and the manifest says so.
Recording MakeRecording(const std::vector<const Sample*>& rows, const std::vector<std::string>& joints,
                        bool arm_adds_gravity) {
  const auto n = static_cast<Eigen::Index>(joints.size());
  const auto count = static_cast<Eigen::Index>(rows.size());
  Recording recording;
  recording.name = kRecordingFile;
  recording.joints = joints;
  recording.t.resize(count);
  for (auto* matrix : {&recording.q, &recording.v, &recording.effort_command, &recording.effort_measured})
    matrix->resize(n, count);
  for (Eigen::Index k = 0; k < count; ++k) {
    const Sample& sample = *rows[k];
    recording.t[k] = 1e-9 * static_cast<double>(sample.stamp_ns - rows[0]->stamp_ns);
    recording.q.col(k) = Eigen::Map<const Eigen::VectorXd>(sample.q.data(), n);
    recording.v.col(k) = Eigen::Map<const Eigen::VectorXd>(sample.v.data(), n);
    recording.effort_measured.col(k) = Eigen::Map<const Eigen::VectorXd>(sample.effort.data(), n);
    const JointArray& handed = arm_adds_gravity ? sample.sent : sample.command;
    recording.effort_command.col(k) = Eigen::Map<const Eigen::VectorXd>(handed.data(), n);
  }
  Eigen::VectorXd sent_at(count);
  for (Eigen::Index k = 0; k < count; ++k)
    sent_at[k] = 1e-9 * static_cast<double>(rows[k]->time_ns - rows[0]->stamp_ns);
  recording.other[recordings::kCommandTime] = sent_at;
  for (Eigen::Index i = 0; arm_adds_gravity && i < n; ++i) {
    Eigen::VectorXd column(count);
    for (Eigen::Index k = 0; k < count; ++k) column[k] = rows[k]->command[i];
    recording.other["effort_asked." + joints[i]] = column;
  }
  return recording;
}

double MeanCommandDelay(const std::vector<const Sample*>& rows) {
  double sum = 0.0;
  for (const Sample* sample : rows) sum += 1e-9 * static_cast<double>(sample->time_ns - sample->stamp_ns);
  return rows.empty() ? 0.0 : sum / static_cast<double>(rows.size());
}

std::string MakeManifest(const json& metadata, const Recording& recording) {
  recordings::RecordingSet set;
  set.joints = recording.joints;
  if (metadata.contains("gravity")) {
    const auto gravity = metadata["gravity"].get<std::vector<double>>();
    if (gravity.size() == 3) set.gravity = {gravity[0], gravity[1], gravity[2]};
  }
  if (metadata.contains("locked")) set.locked = metadata["locked"].get<std::map<std::string, double>>();
  const double rate = metadata.at("rate_hz").get<double>();
  set.sample_rate_hz = set.control_rate_hz = rate;
  set.effort_excludes_gravity = metadata.value("adds_gravity_compensation", false);
  set.effort_excludes_gravity_given = true;
  const json noise = metadata.value("noise", json::object());
  if (noise.contains("position_stddev")) set.noise.position_stddev = noise["position_stddev"].get<double>();
  if (noise.contains("velocity_stddev")) set.noise.velocity_stddev = noise["velocity_stddev"].get<double>();
  if (noise.contains("position_resolution"))
    set.noise.position_resolution = noise["position_resolution"].get<double>();
  if (recording.rows() >= 2) set.recordings.push_back(recording);
  return recordings::FormatManifest(set, "robot.urdf");
}

// Null where there is nothing to score or the URDF cannot be read again.
json GoalErrorOf(const json& metadata, const std::string& urdf, const Recording& recording) {
  if (!metadata.contains("goal") || recording.rows() == 0) return nullptr;
  const auto model = model::ParseUrdf(urdf, "robot.urdf", {.joints = recording.joints});
  const auto goal = metadata["goal"].get<std::vector<double>>();
  if (!model.ok() || static_cast<int>(goal.size()) != recording.n() || model->num_joints() != recording.n())
    return nullptr;
  const Eigen::VectorXd target = Eigen::Map<const Eigen::VectorXd>(goal.data(), recording.n());
  return json::parse(rollouts::ScoreGoal(*model, recording, target).ToJson());
}

Result<FinishedRollout> Finish(const RawRecording& raw) {
  json rollout = json::parse(raw.metadata_json);
  const std::string urdf = rollout.at("urdf").get<std::string>();
  const auto joints = rollout.at("joints").get<std::vector<std::string>>();
  if (joints.empty() || joints.size() > kMaxJoints) return DataLossError("the recording names no joints");
  rollout.erase("urdf");
  if (raw.end_json.has_value()) {
    rollout.update(json::parse(*raw.end_json));
  } else {
    rollout["end_reason"] = EndReasonName(EndReason::kInterrupted);
    rollout["detail"] = "the process that recorded it ended before the rollout did";
    rollout["ended_after_s"] =
        raw.samples.empty() ? 0.0 : 1e-9 * static_cast<double>(raw.samples.back().time_ns);
  }
  const EndReason reason = EndReasonFromName(rollout.value("end_reason", ""));
  const auto rows = ChooseRows(raw, static_cast<int>(joints.size()), reason);
  FinishedRollout finished;
  finished.recording = MakeRecording(rows, joints, rollout.value("adds_gravity_compensation", false));
  rollout["rows"] = finished.recording.rows();
  rollout["samples"] = raw.samples.size();
  rollout["torn_bytes"] = raw.torn_bytes;
  rollout["mean_command_delay_s"] = MeanCommandDelay(rows);
  rollout["goal_error"] = GoalErrorOf(rollout, urdf, finished.recording);
  finished.rollout_json = rollout.dump(2) + "\n";
  finished.bundle["manifest.json"] = MakeManifest(rollout, finished.recording);
  finished.bundle["robot.urdf"] = urdf;
  finished.bundle["rollout.json"] = finished.rollout_json;
  finished.bundle[kRecordingFile] = recordings::FormatCsv(finished.recording);
  return finished;
}

}  // namespace

Result<FinishedRollout> FinishRollout(const RawRecording& raw) {
  try {
    return Finish(raw);
  } catch (const json::exception& error) {
    return DataLossError(std::string("the recording's metadata: ") + error.what());
  }
}

Result<std::string> FinishFile(const std::string& path) {
  RG_ASSIGN_OR_RETURN(const RawRecording raw, ReadRawRecording(path));
  auto finished = FinishRollout(raw);
  if (!finished.ok()) return finished.status().WithPrefix(path);
  return rollouts::PackBundle(finished->bundle);
}

}  // namespace rg::robot_agent
