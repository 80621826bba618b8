// The marks of all cases together: Summarise, PerEffect and both as JSON.
#include <algorithm>
#include <cmath>
#include <map>

#include "services/proof/examination.h"
#include "services/proof/json_of.h"

namespace rg::proof {

using nlohmann::json;

namespace {

void Calibrate(const std::vector<CaseMarks>& cases, Summary* s) {
  constexpr int kBins = 5;
  s->bins.resize(kBins);
  int total = 0;
  for (int b = 0; b < kBins; ++b) s->bins[b].low = b / 5.0, s->bins[b].high = (b + 1) / 5.0;
  for (const CaseMarks& c : cases) {
    for (const auto& [confidence, holds] : c.calls) {
      ConfidenceBin& bin = s->bins[std::clamp(static_cast<int>(confidence * kBins), 0, kBins - 1)];
      bin.mean_confidence += confidence, bin.hit_rate += holds;
      ++bin.n, ++total;
    }
  }
  for (ConfidenceBin& bin : s->bins) {
    if (bin.n == 0) continue;
    bin.mean_confidence /= bin.n, bin.hit_rate /= bin.n;
    s->calibration_error += bin.n * std::abs(bin.mean_confidence - bin.hit_rate) / total;
  }
}

// Whose rows are their own.
bool IsOrdinary(const CaseMarks& c) { return c.kind == CaseKind::kOrdinary || c.kind == CaseKind::kDeclared; }

OrdinarySummary SummariseOrdinary(const std::vector<CaseMarks>& cases) {
  OrdinarySummary s;
  double alarms = 0;
  int declared = 0;
  std::vector<double> errors, seconds;
  for (const CaseMarks& c : cases) {
    if (c.kind == CaseKind::kDeclared) ++declared, alarms += c.false_alarm;
    if (c.kind != CaseKind::kOrdinary) continue;
    ++s.cases;
    s.f1 += c.f1, s.joints_f1 += c.joints_f1.value_or(1.0);
    errors.push_back(c.prediction.against_oracle());
    if (c.diagnosed) seconds.push_back(c.seconds);
  }
  if (s.cases > 0) s.f1 /= s.cases, s.joints_f1 /= s.cases;
  s.against_oracle = Median(errors), s.seconds_median = Median(seconds);
  if (!errors.empty()) s.against_oracle_worst = *std::max_element(errors.begin(), errors.end());
  if (!seconds.empty()) s.seconds_max = *std::max_element(seconds.begin(), seconds.end());
  s.false_alarms = ShareOf(alarms, declared);
  return s;
}

}  // namespace

void SureFindings::Count(const CaseMarks& marks) {
  for (const auto& [confidence, holds] : marks.calls) {
    if (confidence >= kSureFinding) ++n, wrong += !holds;
  }
}

Summary Summarise(const std::vector<CaseMarks>& cases) {
  Summary s;
  s.cases = static_cast<int>(cases.size());
  double strong = 0, lenient = 0, weak = 0, tuned = 0, joints = 0, alarms = 0, open = 0, verdicts = 0;
  int strong_n = 0, weak_n = 0, tuned_n = 0, joints_n = 0, controls = 0, open_n = 0;
  std::vector<double> errors, recovered, black_box, seconds, calibrated, findings;
  for (const CaseMarks& c : cases) {
    s.undiagnosed += !c.diagnosed;
    verdicts += c.verdict_right;
    if (c.diagnosed) seconds.push_back(c.seconds);
    if (IsOrdinary(c)) continue;
    if (c.kind != CaseKind::kControl && c.calibrated_alone) {
      calibrated.push_back(*c.calibrated_alone), findings.push_back(*c.with_findings);
    }
    if (c.kind == CaseKind::kControl) ++controls, alarms += c.false_alarm;
    if (c.kind == CaseKind::kPair) {
      ++s.pairs;
      s.pair_f1 += c.f1, s.pair_f1_or_unexplained += c.f1_or_unexplained;
    }
    if (c.kind == CaseKind::kSingle) {
      const bool clear = c.prediction.nominal > 3 * c.prediction.oracle && !c.weak;
      (clear ? strong : weak) += c.first;
      if (clear) lenient += c.first_or_unexplained;
      ++(clear ? strong_n : weak_n);
      if (c.tuned) tuned += c.first, ++tuned_n;
    }
    if (c.kind == CaseKind::kOpen) ++open_n, open += c.first == 1.0 && c.joints_exact.value_or(true);
    if (c.joints_exact && c.kind != CaseKind::kOpen) ++joints_n, joints += *c.joints_exact;
    errors.insert(errors.end(), c.parameter_errors.begin(), c.parameter_errors.end());
    if (const auto share = c.prediction.recovered()) recovered.push_back(*share);
    const auto boxed = c.prediction.recovered_by(c.prediction.black_box);
    if (boxed && std::isfinite(c.prediction.black_box)) black_box.push_back(*boxed);
    s.worse += c.prediction.tool > 1.05 * c.prediction.nominal;
  }
  if (s.pairs > 0) s.pair_f1 /= s.pairs, s.pair_f1_or_unexplained /= s.pairs;
  s.right_first = ShareOf(strong, strong_n), s.right_first_weak = ShareOf(weak, weak_n);
  s.right_first_or_unexplained = ShareOf(lenient, strong_n);
  s.right_first_tuned = ShareOf(tuned, tuned_n);
  s.joints = ShareOf(joints, joints_n);
  s.false_alarms = ShareOf(alarms, controls);
  s.open = ShareOf(open, open_n);
  s.verdicts = ShareOf(verdicts, s.cases);
  s.parameter_error = Median(errors), s.parameters = static_cast<int>(errors.size());
  s.recovered = Median(recovered), s.gaps = static_cast<int>(recovered.size());
  s.black_box = Median(black_box), s.black_boxes = static_cast<int>(black_box.size());
  s.calibrated_alone = Median(calibrated), s.with_findings = Median(findings);
  s.seconds_median = Median(seconds);
  s.seconds_max = seconds.empty() ? 0 : *std::max_element(seconds.begin(), seconds.end());
  Calibrate(cases, &s);
  s.ordinary = SummariseOrdinary(cases);
  for (const CaseMarks& c : cases) s.sure[static_cast<size_t>(c.kind)].Count(c);
  return s;
}

json PerEffect(const std::vector<CaseMarks>& cases) {
  std::map<std::string, std::vector<const CaseMarks*>> by_effect;
  for (const CaseMarks& c : cases) {
    if (IsOrdinary(c)) continue;
    if (c.effects.empty()) by_effect["none"].push_back(&c);
    for (const std::string& id : c.effects) {
      if (id != "parameters_only" || c.kind == CaseKind::kControl) by_effect[id].push_back(&c);
    }
  }
  json rows = json::array();
  for (const auto& [id, list] : by_effect) {
    double first = 0, f1 = 0, joints = 0;
    int joints_n = 0;
    std::vector<double> errors, recovered, black_box;
    for (const CaseMarks* c : list) {
      first += c->first, f1 += c->f1;
      if (c->joints_exact) ++joints_n, joints += *c->joints_exact;
      errors.insert(errors.end(), c->parameter_errors.begin(), c->parameter_errors.end());
      if (const auto share = c->prediction.recovered()) recovered.push_back(*share);
      const auto boxed = c->prediction.recovered_by(c->prediction.black_box);
      if (boxed && std::isfinite(c->prediction.black_box)) black_box.push_back(*boxed);
    }
    const double n = static_cast<double>(list.size());
    rows.push_back({{"effect", id},
                    {"cases", list.size()},
                    {"right_first", first / n},
                    {"f1", f1 / n},
                    {"joints_exact", joints_n > 0 ? json(joints / joints_n) : json(nullptr)},
                    {"parameter_error", NumberOrNull(Median(errors))},
                    {"recovered", NumberOrNull(Median(recovered))},
                    {"black_box_recovered", NumberOrNull(Median(black_box))}});
  }
  return rows;
}

json ToJson(const CaseMarks& c) {
  const auto share = c.prediction.recovered();
  json calls = json::array();
  for (const auto& [confidence, holds] : c.calls)
    calls.push_back({{"confidence", confidence}, {"holds", holds}});
  return {{"name", c.name},
          {"robot", c.robot},
          {"rate_hz", c.rate_hz},
          {"kind", NameOf(c.kind)},
          {"weak", c.weak},
          {"tuned", c.tuned},
          {"truth", c.truth},
          {"verdict", c.verdict},
          {"reason", c.reason},
          {"said", c.said},
          {"calls", calls},
          {"verdict_right", c.verdict_right},
          {"false_alarm", c.false_alarm},
          {"right_first", c.first},
          {"right_first_or_unexplained", c.first_or_unexplained},
          {"f1", c.f1},
          {"f1_or_unexplained", c.f1_or_unexplained},
          {"joints_exact", c.joints_exact ? json(*c.joints_exact) : json(nullptr)},
          {"joints_f1", c.joints_f1 ? json(*c.joints_f1) : json(nullptr)},
          {"parameter_errors", c.parameter_errors},
          {"over_noise_floor", c.over_floor ? json(*c.over_floor) : json(nullptr)},
          {"nominal_rms", NumberOrNull(c.prediction.nominal)},
          {"oracle_rms", NumberOrNull(c.prediction.oracle)},
          {"rms", NumberOrNull(c.prediction.tool)},
          {"recovered", share ? json(*share) : json(nullptr)},
          {"black_box_rms", NumberOrNull(c.prediction.black_box)},
          {"seconds", c.seconds}};
}

json ToJson(const Summary& s) {
  json bins = json::array();
  for (const ConfidenceBin& b : s.bins) {
    bins.push_back({{"low", b.low},
                    {"high", b.high},
                    {"n", b.n},
                    {"confidence", b.mean_confidence},
                    {"hit_rate", b.hit_rate}});
  }
  json sure = json::object();
  for (size_t kind = 0; kind < s.sure.size(); ++kind)
    sure[NameOf(static_cast<CaseKind>(kind))] = {{"n", s.sure[kind].n}, {"wrong", s.sure[kind].wrong}};
  const json ordinary = {{"cases", s.ordinary.cases},
                         {"f1", s.ordinary.f1},
                         {"joints_f1", s.ordinary.joints_f1},
                         {"against_oracle", NumberOrNull(s.ordinary.against_oracle)},
                         {"against_oracle_worst", NumberOrNull(s.ordinary.against_oracle_worst)},
                         {"seconds_median", NumberOrNull(s.ordinary.seconds_median)},
                         {"seconds_max", s.ordinary.seconds_max},
                         {"false_alarms_declared", ShareJson(s.ordinary.false_alarms)}};
  return {{"cases", s.cases},
          {"ordinary", ordinary},
          {"sure_findings", sure},
          {"undiagnosed", s.undiagnosed},
          {"right_first", ShareJson(s.right_first)},
          {"right_first_or_unexplained", ShareJson(s.right_first_or_unexplained)},
          {"right_first_weak", ShareJson(s.right_first_weak)},
          {"right_first_tuned", ShareJson(s.right_first_tuned)},
          {"joints_exact", ShareJson(s.joints)},
          {"pair_f1", s.pair_f1},
          {"pair_f1_or_unexplained", s.pair_f1_or_unexplained},
          {"pairs", s.pairs},
          {"false_alarms", ShareJson(s.false_alarms)},
          {"outside_catalogue", ShareJson(s.open)},
          {"verdicts", ShareJson(s.verdicts)},
          {"parameter_error", NumberOrNull(s.parameter_error)},
          {"parameters", s.parameters},
          {"recovered", NumberOrNull(s.recovered)},
          {"gaps", s.gaps},
          {"worse_than_nominal", s.worse},
          {"black_box_recovered", NumberOrNull(s.black_box)},
          {"black_boxes", s.black_boxes},
          {"holdout_calibrated_alone", NumberOrNull(s.calibrated_alone)},
          {"holdout_with_findings", NumberOrNull(s.with_findings)},
          {"confidence_bins", bins},
          {"calibration_error", s.calibration_error},
          {"seconds_median", s.seconds_median},
          {"seconds_max", s.seconds_max}};
}

}  // namespace rg::proof
