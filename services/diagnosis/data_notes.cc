#include "services/diagnosis/data_notes.h"

#include <algorithm>
#include <cmath>

#include "common/dynamics/dynamics.h"
#include "common/model/robot_model.h"
#include "common/recordings/recording_set.h"
#include "services/diagnosis/swing_starts.h"
#include "services/diagnosis/words.h"
#include "services/sysid/drive_signal.h"

namespace rg::diagnosis {

using Eigen::VectorXd;

namespace {

constexpr double kResonances = 60.0;    // Hz: rows rarer than this do not show them
constexpr double kReversals = 20.0;     // Hz: nor what happens within a reversal, or a delay
constexpr double kTurnPerRow = 0.6;     // rad of a joint's oscillation between rows: ten rows per period
constexpr double kWorthMissing = 0.02;  // share of rows
constexpr double kOtherRate = 1.5;      // factor between rates
constexpr double kHeld = 0.5;           // of the torque needed
constexpr double kBeyond = 0.01;        // rad or m outside a limit

bool Moved(const FitData& data, const MotionScales& scales, int j) {
  return scales.high[j] - scales.low[j] >= kMovesBy * data.noise.position_stddev[j];
}

class Notes {
 public:
  Notes(const recordings::RecordingSet& set, const FitData& data, const sim::Plant& nominal,
        const MotionScales& scales)
      : set_(set),
        data_(data),
        model_(nominal.model()),
        scales_(scales),
        still_(StillJoints(data, nominal, scales)) {}

  std::vector<std::string> Take() {
    Still();
    Limits();
    Rate();
    Missing();
    Commands();
    if (!data_.use_velocity) Say("velocities are not measured: they were estimated from positions");
    if (set_.holdout_was_chosen) Say("the manifest has no holdout split: whole recordings were set aside");
    return std::move(out_);
  }

 private:
  void Say(const std::string& line) { out_.push_back(line); }
  const std::string& Name(int j) const { return model_.joint(j).name; }
  bool Moves(int j) const { return Moved(data_, scales_, j); }

  void Still() {
    for (const StillJoint& still : still_) {
      const std::string& name = Name(still.joint);
      Say(name + " never moved: nothing can be said of its friction and inertia");
      if (still.held)
        Say(name + "'s effort misses the torque that held it by " + Number(still.missed) +
            " (RMS; needed: " + Number(still.needed) +
            "): a brake, a stop or friction held it, and findings on it are not to be trusted; \"locked\" in "
            "the "
            "manifest leaves the joint out");
    }
  }

  void Limits() {
    for (int j = 0; j < data_.n; ++j) {
      const model::Joint& joint = model_.joint(j);
      if (scales_.low[j] >= joint.lower - kBeyond && scales_.high[j] <= joint.upper + kBeyond) continue;
      Say(Name(j) + " was recorded from " + Number(scales_.low[j]) + " to " + Number(scales_.high[j]) +
          ", outside the URDF's limits " + Number(joint.lower) + " to " + Number(joint.upper) +
          ": is this the robot's URDF, and its zero the encoder's?");
    }
  }

  void Rate() {
    const double period = std::max(1e-9, data_.recordings[0].recording->SamplePeriod()), rate = 1.0 / period;
    if (rate < kResonances) {
      Say("sampled at " + Number(rate) +
          " Hz: resonances (joint_elasticity, backlash, base_flexibility) above " + Number(rate / 4) +
          " Hz and torque_ripple that passes faster cannot be seen");
    }
    if (rate < kReversals) {
      Say("sampled at " + Number(rate) +
          " Hz: what happens within a reversal (stribeck_friction, presliding_hysteresis) and delays below " +
          Number(1e3 * period) + " ms (actuator_delay, actuator_lag, sensor_delay) cannot be seen");
    }
    std::vector<std::string> fast;
    for (int j = 0; j < data_.n; ++j) {
      if (Moves(j) && scales_.speed[j] * period > kTurnPerRow * Spread(j)) fast.push_back(Name(j));
    }
    if (!fast.empty())
      Say("the rows are too far apart for the motion of " + Listed(fast) + ": fewer than " +
          Number(2 * M_PI / kTurnPerRow) + " rows per oscillation, so that verdicts are not to be trusted");
    if (set_.sample_rate_hz &&
        (rate > kOtherRate * *set_.sample_rate_hz || rate * kOtherRate < *set_.sample_rate_hz))
      Say("the manifest says " + Number(*set_.sample_rate_hz) + " Hz, the rows are " + Number(1e3 * period) +
          " ms apart: rows are missing, or time is not in s");
  }

  // Standard deviation of a joint's positions, the largest of any recording.
  double Spread(int j) const {
    double most = 0;
    for (const sysid::FitRecording& r : data_.recordings) {
      const VectorXd q = r.recording->q.row(j).transpose();
      most = std::max(most, std::sqrt((q.array() - q.mean()).square().mean()));
    }
    return most;
  }

  void Missing() {
    double missing = 0, rows = 0, longest = 0;
    for (const sysid::FitRecording& r : data_.recordings) {
      const VectorXd& t = r.recording->t;
      const double period = r.recording->SamplePeriod();
      for (Eigen::Index k = 1; k < t.size(); ++k) {
        const double gap = t[k] - t[k - 1];
        longest = std::max(longest, gap);
        missing += std::max(0.0, std::round(gap / period) - 1);
      }
      rows += static_cast<double>(t.size());
    }
    if (missing < kWorthMissing * (missing + rows)) return;
    Say("about " + Number(100 * missing / (missing + rows)) +
        " % of the rows are missing (the longest gap is " + Number(longest) + " s): " + CommandsLost());
  }

  void Commands() {
    const double rate = 1.0 / std::max(1e-9, data_.recordings[0].recording->SamplePeriod());
    if (!set_.control_rate_hz || *set_.control_rate_hz < kOtherRate * rate) return;
    Say("commands change at " + Number(*set_.control_rate_hz) + " Hz, rows come at " + Number(rate) +
        " Hz: " + CommandsLost());
  }

  std::string CommandsLost() const {
    return data_.recordings[0].recording->drive == recordings::EffortKind::kCommand
               ? "commands between rows are not in the file, and what they did looks like missing physics"
               : "what the effort did between rows is taken as linear";
  }

  const recordings::RecordingSet& set_;
  const FitData& data_;
  const model::RobotModel& model_;
  const MotionScales& scales_;
  std::vector<StillJoint> still_;
  std::vector<std::string> out_;
};

}  // namespace

std::string NoteOnFreeSwing(const std::vector<effects::EffectSpec>& effects, double before_rms,
                            double after_rms) {
  if (!HasRod(effects) || after_rms < before_rms) return "";
  return "no sensor reads where a mass that swings freely is when a held-out window begins, so that held-out "
         "errors do not become smaller by it; it is believed because it swings on from each window to the "
         "next";
}

std::vector<StillJoint> StillJoints(const FitData& data, const sim::Plant& nominal,
                                    const MotionScales& scales) {
  std::vector<StillJoint> out;
  for (int j = 0; j < data.n; ++j) {
    if (!nominal.IsPrescribed(j) && !Moved(data, scales, j)) out.push_back({j, 0, 0, false});
  }
  if (out.empty()) return out;
  const dynamics::Mechanism mechanism = sysid::MechanismOf(nominal, nominal.parameters().Nominal());
  dynamics::Workspace workspace;
  VectorXd torque(data.n);
  double rows = 0;
  for (const FineMotion& m : data.fine) {
    for (Eigen::Index k = 0; k < m.q.cols(); k += 8, ++rows) {
      dynamics::Rnea(mechanism, workspace, m.q.col(k), m.v.col(k), m.a.col(k), torque);
      for (StillJoint& s : out)
        s.missed += std::pow(m.u(s.joint, k) - torque[s.joint], 2), s.needed += std::pow(torque[s.joint], 2);
    }
  }
  for (StillJoint& s : out) {
    s.missed = std::sqrt(s.missed / std::max(1.0, rows)),
    s.needed = std::sqrt(s.needed / std::max(1.0, rows));
    s.held = s.missed > kHeld * s.needed;
  }
  return out;
}

std::vector<std::string> NotesOn(const recordings::RecordingSet& set, const FitData& data,
                                 const sim::Plant& nominal, const MotionScales& scales) {
  return Notes(set, data, nominal, scales).Take();
}

}  // namespace rg::diagnosis
