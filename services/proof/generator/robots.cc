#include "services/proof/generator/robots.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <initializer_list>

#include "common/base/file.h"
#include "services/proof/generator/truth.h"
#include "services/proof/generator/urdf_text.h"

namespace rg::proof {
namespace {

using Eigen::Vector3d;

std::string Number(double x) {
  char text[32];
  std::snprintf(text, sizeof text, "%.6g", x);
  return text;
}
std::string Triple(const Vector3d& v) { return Number(v[0]) + " " + Number(v[1]) + " " + Number(v[2]); }

struct Piece {  // a joint and the link behind it
  std::string joint, link;
  bool prismatic = false;
  Vector3d axis = Vector3d::UnitY(), origin = Vector3d::Zero();  // origin: in the parent link
  double lower = -3, upper = 3, velocity = 4, damping = 0;
  Vector3d along = Vector3d::UnitZ();  // from this joint to the link's far end
  double mass = 1, length = 0.3;
};

// A rod with something at its side: no link of a real robot is a perfect cylinder.
Inertial Body(const Piece& p, Rng& rng) {
  const double radius = std::max(0.02, 0.16 * p.length) * rng.Uniform(0.8, 1.3);
  const double across = p.mass * (p.length * p.length / 12 + radius * radius / 4) * rng.Uniform(0.8, 1.25),
               axial = 0.5 * p.mass * radius * radius * rng.Uniform(0.8, 1.2);
  Inertial body;
  body.mass = p.mass;
  body.inertia = across * Eigen::Matrix3d::Identity() +
                 (axial - across) * p.along.normalized() * p.along.normalized().transpose();
  body.com = rng.Uniform(0.4, 0.6) * p.length * p.along;
  for (int k = 0; k < 3; ++k) body.com[k] += 0.12 * radius * rng.Uniform(-1, 1);
  return body;
}

// Enough to hold the chain level and to move it briskly.
double Effort(const std::vector<Piece>& chain, size_t joint) {
  double reach = 0, gravity = 0, inertia = 0, mass = 0;
  for (size_t k = joint; k < chain.size(); ++k) {
    reach += chain[k].length;
    gravity += 9.81 * chain[k].mass * reach;
    inertia += chain[k].mass * reach * reach;
    mass += chain[k].mass;
  }
  return chain[joint].prismatic ? mass * 40 : 2 * gravity + 30 * inertia;
}

std::string Urdf(const std::string& name, const std::vector<Piece>& chain, Rng& rng) {
  std::string links = "  <link name=\"base\"/>\n", joints;
  std::string parent = "base";
  for (size_t i = 0; i < chain.size(); ++i) {
    const Piece& p = chain[i];
    links += "  <link name=\"" + p.link + "\">\n    " + InertialText(Body(p, rng)) + "\n  </link>\n";
    joints += "  <joint name=\"" + p.joint + "\" type=\"" + (p.prismatic ? "prismatic" : "revolute") +
              "\">\n    <parent link=\"" + parent + "\"/>\n    <child link=\"" + p.link +
              "\"/>\n    <origin xyz=\"" + Triple(p.origin) + "\" rpy=\"0 0 0\"/>\n    <axis xyz=\"" +
              Triple(p.axis) + "\"/>\n    <limit lower=\"" + Number(p.lower) + "\" upper=\"" +
              Number(p.upper) + "\" effort=\"" + Number(Effort(chain, i)) + "\" velocity=\"" +
              Number(p.velocity) + "\"/>\n    <dynamics damping=\"" + Number(p.damping) +
              "\" friction=\"0\"/>\n  </joint>\n";
    parent = p.link;
  }
  const Piece& last = chain.back();
  links += "  <link name=\"tool\"/>\n";
  joints += "  <joint name=\"joint_tool\" type=\"fixed\">\n    <parent link=\"" + parent +
            "\"/>\n    <child link=\"tool\"/>\n    <origin xyz=\"" + Triple(last.length * last.along) +
            "\" rpy=\"0 0 0\"/>\n  </joint>\n";
  return "<?xml version=\"1.0\"?>\n<robot name=\"" + name + "\">\n" + links + joints + "</robot>\n";
}

// Joints about `axes`, each at the far end of the link before it.
std::vector<Piece> Chain(const std::vector<Vector3d>& axes, const std::vector<double>& lengths,
                         const std::vector<double>& masses, const Vector3d& along, Rng& rng) {
  const double longer = rng.Uniform(0.75, 1.3), heavier = longer * longer * rng.Uniform(0.6, 1.6);
  std::vector<Piece> chain(axes.size());
  for (size_t i = 0; i < axes.size(); ++i) {
    Piece& p = chain[i];
    p.joint = "joint_" + std::to_string(i + 1), p.link = "link_" + std::to_string(i + 1);
    p.axis = axes[i], p.along = along;
    p.length = lengths[i] * longer * rng.Uniform(0.85, 1.15);
    p.mass = masses[i] * heavier * rng.Uniform(0.75, 1.25);
    p.origin = i == 0 ? Vector3d(0, 0, 0.5) : Vector3d(chain[i - 1].length * along);
    p.velocity = axes.size() > 3 ? 3 : 5;
  }
  // Every second robot declares some damping.
  if (rng.Uniform() < 0.5) {
    for (size_t i = 0; i < chain.size(); ++i) chain[i].damping = 0.002 * Effort(chain, i);
  }
  return chain;
}

std::vector<Piece> Scara(Rng& rng) {
  const Vector3d x = Vector3d::UnitX(), z = Vector3d::UnitZ();
  std::vector<Piece> chain = Chain({z, z, z}, {0.3, 0.25, 0.25}, {4, 2.5, 1.2}, x, rng);
  Piece& lift = chain[2];
  lift.prismatic = true;
  lift.along = -z, lift.lower = -0.25, lift.upper = 0.05, lift.velocity = 0.8;
  return chain;
}

std::vector<Piece> Slide(Rng& rng) {
  std::vector<Piece> chain = Chain({Vector3d::UnitX()}, {0.2}, {1}, Vector3d::UnitZ(), rng);
  Piece& p = chain[0];
  p.joint = "slide", p.link = "carriage";
  p.prismatic = true;
  p.mass = 2 * std::pow(50.0, rng.Uniform());  // 2 to 100 kg
  p.damping = 0;
  p.lower = -0.4, p.upper = 0.4, p.velocity = 0.8;
  return chain;
}

Result<std::string> Mico(const std::string& folder, Rng& rng) {
  RG_ASSIGN_OR_RETURN(std::string text, ReadFile(folder + "/mico2.urdf"));
  if (rng.Uniform() < 0.5) return text;
  for (const char* value : {"mass value=\"", "ixx=\""}) {
    for (size_t at = text.find(value); at != std::string::npos; at = text.find(value, at + 1)) {
      const double factor = rng.Uniform(0.8, 1.25);
      // One factor for the mass; one for all six moments of the tag.
      const size_t end = text.find("/>", at);
      for (size_t open = text.find('"', at); open != std::string::npos && open < text.find("/>", at);) {
        const size_t close = text.find('"', open + 1);
        const std::string scaled = Number(factor * std::stod(text.substr(open + 1, close - open - 1)));
        text.replace(open + 1, close - open - 1, scaled);
        open = text.find('"', open + 2 + scaled.size());
      }
      at = std::min(end, text.size() - 1);
    }
  }
  return text;
}

}  // namespace

const std::vector<std::string>& KnownRobots() {
  static const std::vector<std::string> kinds = {"mico2", "arm7",     "arm4", "scara",
                                                 "arm2",  "pendulum", "slide"};
  return kinds;
}

Result<std::string> DrawRobot(const std::string& kind, const std::string& folder, Rng rng) {
  const Vector3d y = Vector3d::UnitY(), z = Vector3d::UnitZ();
  if (kind == "mico2") return Mico(folder, rng);
  if (kind == "arm7")
    return Urdf(kind,
                Chain({z, y, z, -y, z, y, z}, {0.15, 0.2, 0.15, 0.2, 0.15, 0.12, 0.12},
                      {3.6, 3.4, 2.9, 2.6, 1.8, 1.3, 1.1}, z, rng),
                rng);
  if (kind == "arm6")
    return Urdf(kind,
                Chain({z, y, y, z, y, z}, {0.15, 0.35, 0.15, 0.18, 0.1, 0.08}, {4.2, 4.6, 1.9, 1.4, 0.8, 0.4},
                      z, rng),
                rng);
  if (kind == "arm4")
    return Urdf(kind, Chain({z, y, y, y}, {0.2, 0.3, 0.25, 0.15}, {3, 2.4, 1.6, 0.9}, z, rng), rng);
  if (kind == "scara") return Urdf(kind, Scara(rng), rng);
  if (kind == "arm2") {
    std::vector<Piece> chain = Chain({y, y}, {0.35, 0.3}, {1.8, 1.1}, -z, rng);
    chain[0].joint = "shoulder", chain[1].joint = "elbow";
    return Urdf(kind, chain, rng);
  }
  if (kind == "pendulum") {
    std::vector<Piece> chain = Chain({y}, {0.5}, {0.8}, -z, rng);
    chain[0].joint = "hinge", chain[0].link = "rod", chain[0].velocity = 8;
    return Urdf(kind, chain, rng);
  }
  if (kind == "slide") return Urdf(kind, Slide(rng), rng);
  std::string known;
  for (const std::string& k : KnownRobots()) known += (known.empty() ? "" : ", ") + k;
  return InvalidError("robot '" + kind + "' is not known, there are " + known);
}

bool Applies(const std::string& effect, const std::string& kind) {
  if (kind == "slide")
    return !OneOf(effect, {"encoder_offset", "contact", "base_flexibility", "joint_coupling"});
  return kind != "pendulum" || effect != "joint_coupling";
}

bool CanPair(const std::string& a, const std::string& b, const std::string& kind) {
  const auto both = [&](std::initializer_list<const char*> list) { return OneOf(a, list) && OneOf(b, list); };
  if (a == b) return false;
  if (both({"coulomb_friction", "stribeck_friction", "asymmetric_friction", "load_dependent_friction",
            "thermal_drift", "presliding_hysteresis"}) ||
      both({"torque_offset", "position_spring"}) || both({"actuator_delay", "sensor_delay"}) ||
      both({"joint_elasticity", "backlash"})) {
    return false;
  }
  // Dry friction of either direction and a constant force are friction that depends on the direction.
  const auto dry = [](const std::string& id) {
    return OneOf(id, {"coulomb_friction", "stribeck_friction", "asymmetric_friction",
                      "load_dependent_friction", "thermal_drift", "presliding_hysteresis"});
  };
  if ((a == "torque_offset" && dry(b)) || (b == "torque_offset" && dry(a))) return false;
  const bool one_joint = kind == "pendulum" || kind == "slide";
  return !one_joint || !(both({"payload", "rotor_inertia", "torque_gain"}) ||
                         both({"encoder_offset", "gravity_misalignment", "torque_offset", "payload"}));
}

}  // namespace rg::proof
