// The battery: labelled recording sets of any origin, marked as the examination marks its cases, and the
// answers of two builds compared set by set. It predicts no concealed recordings: what a model is worth is
// read off the set's own held-out ones.
#pragma once

#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "services/proof/examination.h"

namespace rg::proof {

struct LabelledSet {
  std::string name;    // of the answer's folder
  std::string folder;  // with a manifest.json
  std::string label;   // file
};

// Each of `folders` is a set, or holds sets, or holds `sets/` as `realitygrad prove` writes them. A set's
// label is label.json in it or in ../../sealed/NAME or ../../labels/NAME. Sets of different folders that have
// one name get their folder's in front of it. Errors: no set; a set without a label; two that cannot be told
// apart.
Result<std::vector<LabelledSet>> FindLabelledSets(const std::vector<std::string>& folders);

// Marks of ANSWERS/NAME/diagnosis.json; with CPU time, and the reason where there is none, of run.json there.
// A program that was stopped by its time limit gave no answer, whatever it had written. Error: a label that
// is none.
Result<CaseMarks> MarkAnswer(const LabelledSet& set, const std::string& answer_folder,
                             const PredictionMarks& prediction);

// Sums over one kind of cases, or over all.
struct StratumSums {
  std::optional<CaseKind> kind;
  int sets = 0, unanswered = 0;
  Share right;                                  // nothing missed
  double f1 = 0, f1_or_unexplained = 0;         // means
  double joints_f1 = 0;                         // mean of those that have one; NaN: none
  double over_floor = 0, over_floor_worst = 0;  // median and worst of those that have one; NaN: none
  double seconds = 0, seconds_worst = 0;        // of CPU: median, worst
  SureFindings sure;
};
std::vector<StratumSums> SumByStratum(const std::vector<CaseMarks>& cases);  // kinds in their order, then all

// Two answers to one set.
struct PairedMarks {
  CaseMarks before, after;
  bool won() const { return Missed(before) && !Missed(after); }
  bool lost() const { return !Missed(before) && Missed(after); }
};

struct StratumComparison {
  std::optional<CaseKind> kind;
  int sets = 0, won = 0, lost = 0;
  double p = 1;                        // McNemar, exact
  double f1_before = 0, f1_after = 0;  // means
  double joints_before = 0, joints_after = 0;
  double cpu_ratio = 0;        // median of after / before, of sets that both answered; NaN: none
  double cpu_total_ratio = 0;  // of their sums
};
std::vector<StratumComparison> CompareByStratum(const std::vector<PairedMarks>& pairs);

nlohmann::json ToJson(const StratumSums& sums);
nlohmann::json ToJson(const StratumComparison& comparison);

}  // namespace rg::proof
