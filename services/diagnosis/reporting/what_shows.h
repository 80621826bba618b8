// Which effects of the catalogue the recordings excite, and which not, with the reason: one rule per need of
// an effect (effects::Need). Says neither that an effect is there nor how small a one would be found.
#pragma once

#include <string>
#include <vector>

#include "common/effects/effect.h"
#include "services/diagnosis/data/motion_survey.h"

namespace rg::diagnosis {

inline constexpr double kRateOfResonances = 60.0;  // Hz: sample rate needed to see resonances
inline constexpr double kRateOfReversals = 20.0;   // Hz: sample rate needed to see delays and reversals

struct WhyNot {
  std::vector<std::string> joints;  // empty: the robot as a whole
  std::string reason;
};

struct EffectShows {
  std::string effect;  // id
  bool shows = false;
  std::vector<std::string> joints;  // on which; empty for what belongs to no joint
  std::string within;               // the part of it that could show: "limits below 2.1 N m"; may be empty
  std::vector<WhyNot> not_on;
};

// Of every effect that findings name, in the catalogue's order.
std::vector<EffectShows> WhatShows(const MotionSurvey& survey, const sim::Plant& plant);

// For tables: id, "all joints" or names, within, "joint_2: never moved; …". `joints`: how many there are.
std::vector<std::string> InWords(const EffectShows& effect, int joints);

}  // namespace rg::diagnosis
