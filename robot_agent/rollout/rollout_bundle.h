// From the recorder's file to the bundle that the store keeps (services/rollouts/recording_bundle.h).
//
// The recorder's metadata holds all that is needed, the URDF too, so that a recording can be finished by
// another process after a crash. Metadata (JSON): "format" realitygrad.rollout/1, "id", "joints",
// "urdf" (text), "gravity", "rate_hz", "duration_s", "goal", "noise", …; it becomes rollout.json
// without the URDF and with the end record's fields, "rows" and "goal_error" added.
//
// Rows of the CSV: one per control tick that had a new state, at the time the state was *measured*; the
// command beside it was sent "mean_command_delay_s" later. A tick without a new state is left out (a
// policy then repeats its command). After the controller's last command one more row holds the
// state it led to, unless the state itself was what ended the rollout.
//
// Gravity. The manifest says whose it is. "effort_excludes_gravity": false: effort_command is the whole joint
// torque. true: the arm's base added its own gravity compensation, effort_command is what it was handed, and
// effort_asked is what the controller asked for (with the gravity of the agent's URDF, which is not what
// acted).
#pragma once

#include <string>

#include "common/base/status.h"
#include "common/recordings/recording.h"
#include "robot_agent/recorder.h"
#include "services/rollouts/recording_bundle.h"

namespace rg::robot_agent {

inline constexpr const char* kRecordingFile = "rec_000.csv";

struct FinishedRollout {
  rollouts::Bundle bundle;
  recordings::Recording recording;  // also when it has too few rows to be in the manifest (< 2)
  std::string rollout_json;
};

// kDataLoss: the metadata is not what it should be.
Result<FinishedRollout> FinishRollout(const RawRecording& raw);
// For Spool::Salvage: reads the file, finishes, packs.
Result<std::string> FinishFile(const std::string& path);

}  // namespace rg::robot_agent
