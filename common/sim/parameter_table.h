// The parameters of a plant, one row per scalar, in a fixed order: gravity; masses, centres of mass,
// inertias of all links (link by link within a kind); damping, friction, force gains of the joints;
// then the effects in the plant's order. Values travel as an Eigen::VectorXd of that length.
//
// Names:  gravity.x|y|z           mass.<link>         com_x|y|z.<link>
//         inertia_xx|yy|zz|xy|xz|yz.<link>            damping.<joint>   friction.<joint>
//         force_gain.<joint>      armature.<joint> of joints whose links have no inertia about their axis
//         <effect id>.<joint>.<parameter>   <effect id>.*.<parameter>
#pragma once

#include <Eigen/Core>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

#include "common/base/status.h"

namespace rg::sim {

enum class ParameterKind {
  kGravity,       // m/s², base frame
  kMass,          // kg
  kCenterOfMass,  // m, link frame
  kInertia,       // kg·m² about the link's centre of mass, link axes
  kDamping,       // URDF-declared viscous damping d: tau = -d v
  kFriction,      // URDF-declared Coulomb friction
  kForceGain,     // the paper's P_d: tau = P_d u
  kArmature,      // rotor inertia where the links bring none, nominal 0: the URDF does not tell it
  kEffect,
};

struct Parameter {
  std::string name;
  ParameterKind kind = ParameterKind::kEffect;
  std::string owner;   // link, joint, or "*"
  std::string field;   // "x", "mass", "com_x", "inertia_xx", "damping", …, the effect's parameter name
  std::string effect;  // effect id, empty for other kinds
  std::string unit;
  double nominal = 0;
  double lower = 0;  // physical bounds (−inf, +inf where there is none), not a search range
  double upper = 0;
  double prior_stddev = 1;
};

class ParameterTable {
 public:
  int size() const { return static_cast<int>(rows_.size()); }
  const Parameter& operator[](int i) const { return rows_[i]; }
  std::vector<Parameter>::const_iterator begin() const { return rows_.begin(); }
  std::vector<Parameter>::const_iterator end() const { return rows_.end(); }

  // Index of a name, or −1.
  int Find(std::string_view name) const;
  // The same with a line that names the closest existing parameter.
  Result<int> IndexOf(std::string_view name) const;
  // Indices of one kind, in table order.
  std::vector<int> OfKind(ParameterKind kind) const;

  Eigen::VectorXd Nominal() const;
  // Right length, all finite, inside the physical bounds; the line names the first parameter that is not.
  Status Validate(const Eigen::VectorXd& values) const;

  void Add(Parameter row);  // RG_CHECKs that the name is new

 private:
  std::vector<Parameter> rows_;
  std::unordered_map<std::string, int> by_name_;
};

}  // namespace rg::sim
