// Ordinary robots: dry friction, damping and a rotor on every joint at the levels of geared arms, mostly
// drives that are late, sometimes a URDF whose masses are off, and in two thirds of cases one thing more.
#pragma once

#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "common/base/rng.h"
#include "services/proof/generator/hypotheses.h"
#include "services/proof/generator/truth.h"

namespace rg::proof {

// Which of it a robot has.
struct Ordinary {
  std::string friction = "coulomb_friction";  // or stribeck_friction, asymmetric_friction
  std::string timing;                         // actuator_lag, actuator_delay; empty: neither
  std::string extra;                          // an effect of OrdinaryExtras; empty: none
  bool wrong_bodies = false, rotors = true;
};

const std::vector<std::string>& OrdinaryRobots();  // kinds of robots.h, six joints more often than others
const std::vector<double>& OrdinaryRates();        // Hz

// What one thing more can be beside the rest of it and still be told: springs and play want 100 Hz, one joint
// knows no second moment, and wrong masses would do in the place of a tilt.
std::vector<std::string> OrdinaryExtras(const std::string& kind, double rate_hz, const Ordinary& ordinary);
Ordinary DrawOrdinary(const std::string& kind, double rate_hz, Rng rng);
// The same with nothing that no URDF or model file would declare: Coulomb friction alone, right masses,
// nothing more; a third without rotors and late drives, which a URDF has no words for.
Ordinary DrawDeclared(Rng rng);

// Figures of friction, damping, rotors and drives for every joint, in proportion to the torque and inertia
// that it moves; a light wrist has those of its gear, a part of the strongest joint's.
void SetGears(const Ordinary& ordinary, const Scales& scales, double rate_hz, Rng rng, Truth* truth);

// Ids of what SetGears made, in the label's order.
std::vector<std::string> GearEffects(const Ordinary& ordinary);
// Doubles one of them on a joint, on which it does not show; the drives' lateness is none of one joint's.
void Strengthen(const std::string& id, size_t joint, Truth* truth);
// The truth without one of them on a joint, or (−1) on all.
Truth WithoutGear(const Truth& truth, const std::string& id, int joint);

// Their entries in label.json, with the figures of the truth. A joint whose rotor is a motor behind a spring
// is not one of rotor_inertia's, nor one whose friction grows with the load one of Coulomb's: these, and a
// first joint's rotor, which is also its link's inertia, are "optional_joints".
nlohmann::json GearLabels(const Ordinary& ordinary, const Scales& scales, const Truth& truth);

// Adds the one thing more to the truth, and returns its entry in the label. Nothing where it fits no joint: a
// spring or play wants a link that is heavier than its motor, a gain a joint among others.
std::optional<nlohmann::json> AddExtra(const std::string& id, double strength, const Scales& scales, Rng rng,
                                       Truth* truth);

// What one thing more, or a law of friction, must be told from: the simpler ones inside it (siblings.h), and
// for a gain a joint whose friction and rotor are as much larger as its torque.
std::vector<Truth> OrdinarySiblings(const Truth& truth, const nlohmann::json& entry, const Scales& scales,
                                    const Eigen::VectorXd& load);

}  // namespace rg::proof
