// manifest.json of a recording set, checked field by field, before anything it names is read.
#pragma once

#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.h"
#include "common/recordings/recording_set.h"

namespace rg::recordings {

struct ManifestEntry {
  std::string file;
  Split split = Split::kFit;
};

struct Manifest {
  std::string robot;                // file name as given
  std::vector<std::string> joints;  // as given
  std::vector<ManifestEntry> recordings;
  // robot, urdf_text, joints, joint_info and recordings of this one are not filled.
  RecordingSet settings;
};

// Errors name the source and the field: "manifest.json: noise.position_stddev: -1, must be positive".
Result<Manifest> ParseManifest(std::string_view text, const std::string& source_name);

}  // namespace rg::recordings
