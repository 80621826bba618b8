#include "services/diagnosis/reporting/data_notes.h"

#include <algorithm>
#include <cmath>

#include "common/effects/effect_catalog.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/data/words.h"
#include "services/diagnosis/likelihood/swing_starts.h"
#include "services/diagnosis/reporting/what_shows.h"
#include "services/sysid/joint_roles.h"

namespace rg::diagnosis {

using effects::Need;
using recordings::Recording;

namespace {

// Thresholds of the notes.
constexpr double kPhasePerRow = 0.6;    // rad of a joint's oscillation between rows: ten rows per period
constexpr double kMissingShare = 0.02;  // of rows
constexpr double kOtherRate = 1.5;      // factor between rates
constexpr double kBeyond = 0.01;        // rad or m outside a limit
constexpr double kFaster = 3.0, kStronger = 1.2;  // times a limit (a URDF's velocity is often a controller's)
constexpr double kNoisier = 3.0;                  // times the manifest's noise
constexpr double kLeastLag = 0.002;               // s, of a velocity
constexpr double kLeastRest = 0.05;               // of the effort's variance

class Notes {
 public:
  Notes(const recordings::RecordingSet& set, const MotionSurvey& survey, const sim::Plant& plant)
      : set_(set), s_(survey), model_(plant.model()), out_(set.warnings) {
    period_ = s_.FirstToFit().period;
    for (const std::string& note : sysid::NotesOnRoles(set, plant)) Say(note);
  }

  std::vector<std::string> Take() {
    Still();
    Limits();
    Noise();
    Rate();
    Missing();
    Commands();
    Velocities();
    KeptAside();
    return std::move(out_);
  }

 private:
  void Say(const std::string& line) { out_.push_back(line); }
  const std::string& Name(int j) const { return model_.joint(j).name; }
  std::string Unit(int j) const { return model_.joint(j).is_revolute() ? "rad" : "m"; }
  std::string EffortUnit(int j) const { return model_.joint(j).is_revolute() ? "N m" : "N"; }
  const JointFigures& Of(int j) const { return s_.joints[j]; }

  void Still() {
    for (const StillJoint& still : StillJoints(s_)) {
      const std::string& name = Name(still.joint);
      const std::string bound =
          still.withstood > 0
              ? "it holds against at least " + Number(still.withstood) + " " + EffortUnit(still.joint) +
                    " (the most that its effort differs from what the URDF needs there), and "
              : "";
      Say(name + " never moved: " + bound +
          "nothing else can be said of it; move it, or leave it out by \"locked\": {\"" + name +
          "\": " + Number(0.5 * (Of(still.joint).low + Of(still.joint).high)) + "}");
    }
  }

  void Limits() {
    std::vector<std::string> fast, strong;
    for (int j = 0; j < s_.n; ++j) {
      const model::Joint& joint = model_.joint(j);
      const JointFigures& f = Of(j);
      if (f.low < joint.lower - kBeyond || f.high > joint.upper + kBeyond)
        Say(Name(j) + " was recorded from " + Number(f.low) + " to " + Number(f.high) + " " + Unit(j) +
            ", outside the URDF's limits " + Number(joint.lower) + " to " + Number(joint.upper) +
            ": check that this is the robot's URDF, and that its zero is the encoder's");
      if (joint.velocity > 0 && f.peak_speed > kFaster * joint.velocity)
        fast.push_back(Name(j) + " " + Number(f.peak_speed) + " of " + Number(joint.velocity));
      if (joint.effort > 0 && f.peak_effort > kStronger * joint.effort)
        strong.push_back(Name(j) + " " + Number(f.peak_effort) + " of " + Number(joint.effort));
    }
    if (!fast.empty())
      Say("speeds beyond the URDF's limits (" + Listed(fast) +
          "): check its <limit velocity>, or the columns' unit");
    if (!strong.empty())
      Say("efforts beyond the URDF's limits (" + Listed(strong) +
          "): check its <limit effort>, or the columns' unit");
  }

  void Noise() {
    if (!set_.noise.position_stddev) return;
    std::vector<std::string> noisy;
    for (int j = 0; j < s_.n; ++j) {
      const double estimated = s_.estimated.position_stddev[j];
      if (estimated > kNoisier * s_.noise.position_stddev[j])
        noisy.push_back(Name(j) + " " + Number(estimated) + " " + Unit(j));
    }
    if (!noisy.empty())
      Say("positions are noisier than the manifest says (" + Number(*set_.noise.position_stddev) +
          "): " + Listed(noisy) + "; correct noise.position_stddev, or leave it out to have it estimated");
  }

  // The effects that have this need, by the catalogue.
  static std::string EffectsThatNeed(Need need) {
    std::vector<std::string> ids;
    for (const effects::EffectInfo& info : effects::Catalog()) {
      if (std::ranges::find(info.needs, need) != info.needs.end()) ids.push_back(info.id);
    }
    return Listed(ids);
  }

  void Rate() {
    const double rate = 1.0 / period_;
    if (rate < kRateOfResonances)
      Say("sampled at " + Number(rate) + " Hz: vibrations above " + Number(rate / 4) +
          " Hz cannot be seen (" + EffectsThatNeed(Need::kResonances) + "), nor what passes faster (" +
          EffectsThatNeed(Need::kPeriods) + "); record at " + Number(kRateOfResonances) + " Hz or more");
    if (rate < kRateOfReversals)
      Say("sampled at " + Number(rate) + " Hz: what lasts less than " + Number(1e3 * period_) +
          " ms, as within a reversal or a delay, cannot be seen (" + EffectsThatNeed(Need::kDenseRows) +
          "); record at " + Number(kRateOfReversals) + " Hz or more");
    std::vector<std::string> fast;
    for (int j = 0; j < s_.n; ++j) {
      if (Of(j).moved && Of(j).speed * period_ > kPhasePerRow * Of(j).spread) fast.push_back(Name(j));
    }
    if (!fast.empty())
      Say("the rows are too far apart for the motion of " + Listed(fast) + " (fewer than " +
          Number(2 * M_PI / kPhasePerRow) +
          " per oscillation): no verdict is to be trusted; record faster, or move slower");
    if (set_.sample_rate_hz &&
        (rate > kOtherRate * *set_.sample_rate_hz || rate * kOtherRate < *set_.sample_rate_hz))
      Say("the manifest says " + Number(*set_.sample_rate_hz) + " Hz, the rows are " + Number(1e3 * period_) +
          " ms apart: rows are missing, or time is not in s; correct sample_rate_hz or the time column");
  }

  void Missing() {
    double missing = 0, rows = 0;
    for (const FileFigures& f : s_.files) missing += f.missing, rows += f.rows;
    if (missing >= kMissingShare * (missing + rows))
      Say("about " + Number(100 * missing / (missing + rows)) +
          " % of the rows are missing: " + CommandsLost());
  }

  void Commands() {
    const double rate = 1.0 / period_;
    if (!set_.control_rate_hz || *set_.control_rate_hz < kOtherRate * rate) return;
    Say("commands change at " + Number(*set_.control_rate_hz) + " Hz, rows come at " + Number(rate) +
        " Hz: " + CommandsLost());
  }

  std::string CommandsLost() const {
    return set_.Fit().front()->drive == recordings::EffortKind::kCommand
               ? "commands between rows are not in the file, and what they did looks like missing physics; "
                 "record every command"
               : "what the effort did between rows is taken as linear; record every row that the drive gives";
  }

  void Velocities() {
    size_t without = 0;
    for (const Recording& r : set_.recordings) without += r.has_velocity() ? 0 : 1;
    if (without == set_.recordings.size()) {
      Say("velocities are not measured: they are estimated from positions");
    } else if (without > 0) {
      Say("velocities are not measured in " + std::to_string(without) + " of " +
          std::to_string(set_.recordings.size()) +
          " recordings: none are used, they are estimated from positions");
    }
    std::vector<std::string> late;
    double least = 1e9, most = 0;
    for (int j = 0; j < s_.n; ++j) {
      const double lag = s_.velocity_lag[j];
      if (lag < kLeastLag || Of(j).prescribed) continue;
      late.push_back(Name(j)), least = std::min(least, lag), most = std::max(most, lag);
    }
    if (!late.empty())
      Say("the velocities of " + Listed(late) + " lag the positions' slope by " + Number(1e3 * least) +
          " to " + Number(1e3 * most) + " ms: they are filtered, and weighed accordingly");
  }

  void KeptAside() {
    if (set_.Holdout().empty())
      Say("no recording is kept aside: all figures are of fitted data; record another, with the split "
          "\"holdout\"");
    if (!set_.holdout_was_chosen) return;
    std::vector<std::string> names;
    for (const FileFigures& f : s_.files) {
      if (f.split == recordings::Split::kHoldout) names.push_back(f.name);
    }
    Say("the manifest has no holdout split: " + Listed(names) + (names.size() == 1 ? " was" : " were") +
        " kept aside to judge by");
  }

  const recordings::RecordingSet& set_;
  const MotionSurvey& s_;
  const model::RobotModel& model_;
  double period_ = 0;  // s
  std::vector<std::string> out_;
};

}  // namespace

std::vector<std::string> NotesOn(const recordings::RecordingSet& set, const MotionSurvey& survey,
                                 const sim::Plant& plant) {
  return Notes(set, survey, plant).Take();
}

std::vector<std::string> NotesOnMeasurement(const std::vector<std::string>& names,
                                            const MeasuredEffort& measured) {
  if (!measured.active) return {};
  std::vector<std::string> notes, early, rest;
  for (const int j : measured.early) early.push_back(names[j]);
  if (!early.empty()) {
    notes.push_back("the effort of " + Listed(early) +
                    " lags the motion that it makes: it is filtered or stamped late, which no effect of the "
                    "catalogue does");
  }
  for (size_t j = 0; j < names.size(); ++j) {
    const double share = measured.effort_share[j];
    if (share > kLeastRest) rest.push_back(names[j] + " " + Number(100 * share) + " %");
  }
  if (!rest.empty()) notes.push_back("of the effort's variance the findings leave: " + Listed(rest));
  return notes;
}

std::string NoteOnFreeSwing(const std::vector<EffectSpec>& effects, double before_rms, double after_rms) {
  if (!HasPendulum(effects) || !(after_rms >= before_rms)) return "";
  return "held-out errors do not become smaller by a mass that swings freely, for no sensor reads where it "
         "is "
         "when a window begins: it is believed because it swings on from each window to the next";
}

}  // namespace rg::diagnosis
