// `prove --sets`, `--compare` and `--reliability`: labelled sets of any origin diagnosed and marked; two
// folders of answers, of two builds, set by set; confidences against what held.
#pragma once

#include <string>
#include <vector>

#include "common/base/status.h"
#include "services/cli/context.h"

namespace rg::lab {

struct BatteryArguments {
  std::vector<std::string> sets;         // folders; of `compare`: empty where both folders say them
  std::vector<std::string> compare;      // two folders of answers
  std::vector<std::string> reliability;  // folders of answers, each an examination
  std::string svg;                       // file for the reliability diagram; empty: none
  std::string answers;  // folder: NAME/diagnosis.json, NAME/run.json, logs/NAME.log, battery.json
  int limit_s = 0, jobs = 1;
  bool mark_only = false;
};

// Diagnoses what has no answer yet unless `mark_only`, marks all, prints a row per set and sums per stratum.
Status RunBattery(cli::Context& context, const BatteryArguments& arguments);

// Marks both folders' answers to the sets that both know, with this program's marks.
Status CompareAnswers(cli::Context& context, const BatteryArguments& arguments);

// How sure the findings of all these folders were said to be and how often they held.
Status TellReliability(cli::Context& context, const BatteryArguments& arguments);

}  // namespace rg::lab
