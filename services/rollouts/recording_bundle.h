// A recording set as one artefact: a POSIX tar (ustar) of
//
//   manifest.json    realitygrad.recordings/1
//   rec_000.csv      the rollout
//   robot.urdf       the model as it was believed
//   rollout.json     realitygrad.rollout/1: why it ended, goal, policy, safety, punctuality
//
// `tar xf` makes a folder that every command on recordings takes. The same files give the same bytes:
// no time, owner or order of the machine that packed them is inside.
#pragma once

#include <map>
#include <string>
#include <string_view>

#include "common/base/status.h"
#include "common/recordings/recording_set.h"

namespace rg::rollouts {

inline constexpr const char* kRolloutFormat = "realitygrad.rollout/1";
inline constexpr const char* kBundleKind = "recording";  // the artefact's kind in the store

using Bundle = std::map<std::string, std::string>;  // file name -> bytes

// Names: at most 99 characters, plain (no '/', not empty).
std::string PackBundle(const Bundle& bundle);
// kDataLoss for anything that is not such a tar: sizes, checksums, names with paths, links.
Result<Bundle> UnpackBundle(std::string_view bytes);

// The files into `folder` (made if needed), ready for recordings::LoadSet.
Status ExtractBundle(std::string_view bytes, const std::string& folder);
// kFailedPrecondition where the bundle's rollout left fewer rows than `least`: how it ended, in one line. Ok where
// the bundle does not say.
Status CheckRows(std::string_view bytes, int least);
inline constexpr int kLeastRows = 10;  // what can be identified from

// The set that the bundle holds; unpacks to a folder of its own under the system's temporary folder
// and removes it. A rollout that left no two rows: CheckRows.
Result<recordings::RecordingSet> LoadBundle(std::string_view bytes);

// The same with efforts that are whole joint torques: where the manifest says that the drive adds its own
// gravity compensation, the gravity torque of the bundle's URDF is added, as sysid does on files
// (services/sysid/drive_signal.h), and the set says so no more. For algorithms that take a recording alone.
Result<recordings::RecordingSet> LoadBundleOfWholeTorques(std::string_view bytes);

}  // namespace rg::rollouts
