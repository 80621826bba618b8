// Whether an effect shows in what is recorded of a robot: over the sensors' noise, as more than a simpler
// effect, as more than other masses.
#pragma once

#include <array>
#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <vector>

#include "services/proof/generator/comparison.h"
#include "services/proof/generator/set_files.h"
#include "services/proof/generator/truth.h"

namespace rg::proof {

struct Visibility {
  Comparison compared;                     // of the robot without its effects
  std::vector<std::string> joints, links;  // link i hangs on joint i
  std::array<double, 3> tool = {0, 0, 0};  // where a mass hangs on the last link, m
  double noise = 0;                        // of the sensors' positions, rad or m
  double fit_s = 0;                        // length of all recordings to fit, s
  Track track = {};                        // what models are compared on
  std::vector<Track> for_bodies = {};      // what other masses are found from

  // Whether a model is worse than the true one, both from the recorded rows.
  bool StandsOut(const Truth& truth, const Truth& model) const;
  // Of each model whether it is off by more than the sensors' noise, from the true state.
  std::vector<bool> ShowEach(const Truth& truth, const std::vector<Truth>& models) const;
  // Whether all of them are.
  bool Shows(const Truth& truth, const std::vector<Truth>& models) const;
  // Whether `effect` shows as more than the simpler ones inside it; joint: any for an effect on none.
  bool ShowsAsMore(const Truth& truth, const std::string& effect, size_t joint) const;
  // Whether other masses, centres of mass, inertias and damping would do in the place of what `truth` has
  // more than `without` on these joints, where they must be found from the same recordings: then nobody can
  // tell it from them. No, where the robot ran away.
  bool LooksLikeBodies(const Truth& truth, const Truth& without, const std::vector<std::string>& on) const;

  // Joints of the label's `effect` on which it shows as more than a simpler one; of several, where a model
  // without it on the joint stands out as well and, with `from_bodies`, other masses would not do in its
  // place. These two are not asked on `shared` joints, on which other effects act too.
  std::vector<std::string> JointsThatShow(const Truth& truth, const nlohmann::json& effect,
                                          const std::set<std::string>& shared, bool from_bodies) const;
};

}  // namespace rg::proof
