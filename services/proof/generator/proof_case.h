// One case of the blind examination: a recording set on disk, and its label and concealed recordings
// in another folder.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "services/proof/generator/ordinary.h"

namespace rg::proof {

struct CaseRequest {
  std::string name;                  // folder name
  std::string kind;                  // of robot, robots.h
  std::string urdf;                  // text; empty: a robot of that kind is drawn
  std::string robots = ".";          // folder that robots which are not drawn are read from
  std::vector<std::string> effects;  // ids; "none" alone is a control
  double rate_hz = 100;
  bool weak = false;                 // nominal error 1.5 to 2.5 times the floor
  bool wrong_parameters = false;     // masses and inertias of the URDF are off as well
  bool tuned = false;                // the URDF was tuned on this robot and has absorbed part of the effect
  std::optional<Ordinary> ordinary;  // in the place of effects, weak, wrong_parameters and tuned
  bool declared = false;  // the set says all that is ordinary: in its URDF, or in a model.json as well
  bool with_velocity = true;
  uint64_t seed = 1;
};

struct CaseSummary {
  double nominal_rms = 0, oracle_rms = 0, ratio = 0;
  std::string warning;
};

// Writes SETS/<name>/{robot.urdf, manifest.json, rec_00k.csv}, of declared rotors a model.json, and
// LABELS/<name>/{label.json, oracle.json, hidden_00k.csv}. What leaves the nominal model, or one with a
// simpler effect (siblings.h), almost as good as the true one, or throws the robot through its stops, is
// drawn anew; an error after the sixth time.
Result<CaseSummary> MakeCase(const CaseRequest& request, const std::string& sets_folder,
                             const std::string& labels_folder);

}  // namespace rg::proof
