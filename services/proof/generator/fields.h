// Forces outside the catalogue: structured, repeatable, and no row of EFFECTS makes one of them.
//
//   bump          exp(−(a² + b²)/2)                a hill over the positions of one or two joints
//   detent        −a·exp((1 − a²)/2)               a magnet that holds at one place only
//   wave          sin a·cos b                      two joints' positions together
//   saddle        tanh a·tanh b                    the same, without a period
//   sticky_patch  −v/s·exp(−a²/2)                  drag in one region
//   speed_bump    −tanh(10v/s)·exp(−(|v| − s)²/2w²)  drag that peaks at the speed s, in one or both
//   directions cross_speed   −v_k/s·sin a                     another joint's speed, by the position of this
//   one wind          cos(2π·t/T + a)                  turns with time and position
// with a, b = (q − centre)/width, times the amplitude.
#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "services/proof/generator/truth.h"

namespace rg::proof {

// Laws that mean something on a robot of n joints, to be drawn from evenly.
std::vector<std::string> FieldForms(int n);

// Force on joint field.on [N·m or N]; q, v: n positions and speeds, time since the recording's start.
double FieldForce(const Field& field, const Eigen::VectorXd& q, const Eigen::VectorXd& v, double time);

}  // namespace rg::proof
