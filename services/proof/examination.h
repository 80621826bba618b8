// The marks of a blind examination: what a diagnosis said against the sealed label, case by case and over
// all.
//
// A name is right when it is the effect of the label or one that the label calls equivalent (the data cannot
// tell them apart), half right when it belongs to the same family (EFFECTS: friction, delay, transmission,
// gain, body, base, fields), wrong otherwise. Findings below a confidence of 0.3 count for nothing but
// calibration. Of an ordinary robot, joints that the label calls optional may be named or left out; on a
// control that declares all of its friction and rotors any finding is a false alarm.
#pragma once

#include <array>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "services/proof/statistics.h"

namespace rg::proof {

// RMS of joint positions on the concealed recordings, 1 s windows restarted from the measured state, against
// the noise-free truth [rad or m]. NaN: none.
struct PredictionMarks {
  double nominal = 0, oracle = 0, tool = 0;
  double black_box = std::numeric_limits<double>::quiet_NaN();  // black_box.h
  // 1 where the true model is reached, 0 at the nominal one; absent where there is no gap (< 1.3 × oracle).
  std::optional<double> recovered() const { return recovered_by(tool); }
  std::optional<double> recovered_by(double rms) const;
  // Of the diagnosed model, without one of the nominal model, over the true one's.
  double against_oracle() const;
};

// How far predictions are off, on the joint of the first concealed recording where the nominal model is off
// most.
struct CasePlot {
  std::string joint, unit;
  std::vector<double> t, nominal, tool, black_box;  // s; rad or m, NaN where there is none
};

// open: the effect is outside the catalogue; ordinary: friction, damping and rotors on every joint; declared:
// the same, all of which the set says.
enum class CaseKind { kControl, kSingle, kPair, kOpen, kOrdinary, kDeclared };
constexpr int kCaseKinds = 6;

struct CaseMarks {
  std::string name, robot;
  CaseKind kind = CaseKind::kSingle;
  bool weak = false, diagnosed = false;
  bool tuned = false;  // the URDF had absorbed part of the effect
  double rate_hz = 0;
  double seconds = 0;              // of CPU; of a clock where nobody measured them (run_record.h)
  std::vector<std::string> truth;  // "coulomb_friction [joint_2]"
  std::string verdict;
  std::string reason;             // why there is no diagnosis
  std::vector<std::string> said;  // "coulomb_friction [joint_2] 0.97"
  bool verdict_right = false, false_alarm = false;
  double first = 0;                  // mark of the first finding
  double first_or_unexplained = 0;   // the same, whole where the label allows such a verdict
  double f1 = 0;                     // of the set of effects
  double f1_or_unexplained = 0;      // the same, where `unexplained` stands for what may be unnamed
  std::optional<bool> joints_exact;  // of the effects that act on joints
  std::optional<double> joints_f1;   // of the set of pairs (effect, joint); absent where nobody speaks of one
  std::vector<double> parameter_errors;        // relative, of the parameters of rightly named effects
  std::vector<std::pair<double, bool>> calls;  // confidence of every finding in `said`, whether it holds
  std::vector<std::string> effects;            // ids of the label
  PredictionMarks prediction;
  CasePlot plot;  // empty: nothing concealed could be predicted
  // Of the gap between before and floor on the set's own held-out recordings: what rigid-body parameters
  // alone recover, and what the findings do. Absent where there is no gap.
  std::optional<double> calibrated_alone, with_findings;
  // Error with the findings on the set's own held-out recordings over the sensors' noise there.
  std::optional<double> over_floor;
};

const char* NameOf(CaseKind kind);
// Of one of CaseMarks::said: "name", "unnamed" or "parameters".
const char* KindOfFinding(const std::string& said);
// Whether anything of it is not as the label asks.
bool Missed(const CaseMarks& marks);

// label: label.json of a case; diagnosis: diagnosis.json, null if there is none. Error: a label that is none.
Result<CaseMarks> Mark(const nlohmann::json& label, const nlohmann::json& diagnosis,
                       const PredictionMarks& prediction);

constexpr double kSureFinding = 0.8;  // confidence at which a user acts on a finding

struct ConfidenceBin {
  double low = 0, high = 1, mean_confidence = 0, hit_rate = 0;
  int n = 0;
};

// Findings that are stated with a confidence of 0.8 or more.
struct SureFindings {
  int n = 0, wrong = 0;
  void Count(const CaseMarks& marks);
};

struct OrdinarySummary {  // means and, of the error over the true model's on concealed recordings, two
                          // quantiles
  int cases = 0;
  double f1 = 0, joints_f1 = 0;
  double against_oracle = 0, against_oracle_worst = 0;
  double seconds_median = 0, seconds_max = 0;
  Share false_alarms;  // on controls that declare all of it
};

struct Summary {
  int cases = 0, undiagnosed = 0;
  Share right_first;                 // single effects whose nominal error exceeds three times the floor
  Share right_first_or_unexplained;  // the same effects, where `unexplained` is right if the label allows it
  Share right_first_weak;            // the other single effects
  Share right_first_tuned;           // single effects of any strength that the URDF had absorbed part of
  Share joints;                      // exact, over all cases whose effects act on joints
  double pair_f1 = 0;
  double pair_f1_or_unexplained = 0;  // where `unexplained` stands for a swinging mass or a flexible base
  int pairs = 0;
  Share false_alarms;  // on controls
  Share open;          // outside the catalogue: `unexplained` with the right joints, no wrong name before it
  Share verdicts;
  double parameter_error = 0;  // median
  int parameters = 0;
  double recovered = 0;  // median
  int gaps = 0;
  double black_box = 0;  // median of what it recovers on the concealed recordings
  int black_boxes = 0;
  double calibrated_alone = 0, with_findings = 0;  // medians, on the sets' held-out recordings, effects only
  int worse = 0;                                   // predictions worse than the nominal model's by 5 %
  std::vector<ConfidenceBin> bins;
  double calibration_error = 0;  // Σ n·|confidence − hit rate| / Σ n
  double seconds_median = 0, seconds_max = 0;
  OrdinarySummary ordinary;  // which no row above counts, but verdicts, confidence and times
  std::array<SureFindings, kCaseKinds> sure;
};
Summary Summarise(const std::vector<CaseMarks>& cases);

// A row per effect, ordinary robots left out: cases, first, f1, joints, parameter error, recovered.
nlohmann::json PerEffect(const std::vector<CaseMarks>& cases);

nlohmann::json ToJson(const CaseMarks& marks);
nlohmann::json ToJson(const Summary& summary);

}  // namespace rg::proof
