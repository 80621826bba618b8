// Where fits of a mass that swings on a rod (sloshing_payload, form "rod") begin.
#pragma once

#include <vector>

#include "common/model/robot_model.h"
#include "services/diagnosis/likelihood/lifted_fit.h"

namespace rg::diagnosis {

bool HasPendulum(const std::vector<EffectSpec>& specs);
bool HasMassInSprings(const std::vector<EffectSpec>& specs);
// Whether one swings on the last link, not on the end effector.
bool SwingsOnLastLink(const std::vector<EffectSpec>& specs);

// `rod` with a body that is so many times as long, of the same mass.
EffectSpec LongerRod(EffectSpec rod, double times);
// `rod` where it hangs, and at the same hinge of the other point, unless both points were moved alike: below
// an upright slide what hangs on either is one.
std::vector<EffectSpec> EitherPlace(const FitData& data, const sim::Plant& nominal, const EffectSpec& rod);

// `start` with a rod that hangs and does not turn.
VectorXd HangingFrom(const sim::Simulator& simulator, const VectorXd& start);
// States like `start` in which a rod may be: it hangs and does not turn, is off that by ±0.7 rad about either
// axis, or passes it at the speed of a swing so wide. Empty where the plant has no rod.
std::vector<VectorXd> SwingsFrom(const sim::Simulator& simulator, const VectorXd& start);

// The same where `window` begins, of a rod that was let go where its recording does, in any direction of its
// link.
std::vector<VectorXd> LetGo(const FitData& data, sim::Simulator& simulator, const NodeWindow& window,
                            const VectorXd& start);

double RowsPerWindow(const FitData& data);  // on average

// χ² per row, in units of the noise, of that share of windows that is met best, all of `data` or some: what a
// mass does where its swings were found. Infinite without windows.
double TypicalChi2(const FitData& data, const std::vector<double>& window_chi2, double noise_scale,
                   double share);

inline constexpr double kFitted =
    2.0;  // χ² per row below which a window's start is not looked for any further

// Replaces a point mass in the values of `plant` by an extended one that hangs and swings alike: fits may
// converge to a point mass, and none leads away from it.
void WidenPoint(const sim::Plant& plant, VectorXd* values);

// Of the link that a mass hangs on.
model::Frame FrameOfMass(const model::RobotModel& model, const EffectSpec& mass);

// The rod that swings as a point `length` from its hinge does, where `place` says; moment: its mass times the
// distance of its centre [kg·m]; decay: of its rates [1/s].
EffectSpec RodThatSwingsLike(double length, double moment, double decay, EffectSpec place);
// `rod` about the axis of its link that gravity is least along, about the next one, and about the last.
std::vector<EffectSpec> AboutEachAxis(const FitData& data, const sim::Plant& nominal, EffectSpec rod);

// A mass on a rod in the place of one in springs, from what is found of that: where its link hardly turns
// springs of k are a rod of L = m·9.81/k. Its hinge is the axis of the link that gravity is least along, or
// the next one, or the last.
std::vector<EffectSpec> RodStarts(const FitData& data, const sim::Plant& nominal, const EffectSpec& springs);

}  // namespace rg::diagnosis
