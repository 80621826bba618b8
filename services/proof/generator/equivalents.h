// Which other names describe the same data: the label must not ask for more than physics can tell.
#pragma once

#include <nlohmann/json.hpp>
#include <set>
#include <string>

namespace rg::proof {

struct RobotFacts {
  int joints = 1;
  std::string first_joint;
  bool linear = false;         // its first joint is prismatic
  bool upright_plane = false;  // every joint revolute about the same level axis: it moves in an upright plane
  std::set<std::string> damped;  // joints that the URDF declares damping of
  bool heavier = false;          // one joint: it accelerates more slowly for its torque than the URDF says
  // Joints whose motion does not feel the others', nor they its: a SCARA's lift.
  std::set<std::string> apart;
};

// Adds to `equivalents` of the label's effects, exact cases only:
// - one delay for all sensors and one for all drives (the robot does not change with time), or for all that
//   feel each other, where nothing else is amiss but bodies;
// - a rotor's inertia on the first joint, where it turns, and the first link's inertia about that axis;
// - viscous friction where the URDF declares damping on every joint of it: that is a parameter of the URDF;
// - on an upright plane: a tilt of the base and a wrong zero of the first joint;
// - on one joint that turns: rotor inertia, torque gain, payload, tilt and zero are all other moments of the
//   body; where it became heavier, a payload at some distance makes any of them once the body may differ;
// - on one level slide: the mass is all there is.
void AddEquivalents(const RobotFacts& facts, nlohmann::json* effects);

// Whether one effect of the label is part of what another does, which no data tell apart: a level slide's
// tilt moves a spring's centre, and a rotor's inertia on a first joint that a spring or play drives is the
// link's.
bool Hides(const RobotFacts& facts, const nlohmann::json& effects);

// Verdicts of RECORDINGS that are right for a label's effects with their equivalents.
nlohmann::json AcceptedVerdicts(const nlohmann::json& effects);

}  // namespace rg::proof
