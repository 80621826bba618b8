#include "services/lab/prove_battery.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "common/base/file.h"
#include "common/base/printf.h"
#include "services/cli/child_processes.h"
#include "services/cli/output.h"
#include "services/cli/progress_display.h"
#include "services/lab/proof_runs.h"
#include "services/proof/battery.h"
#include "services/proof/reliability.h"
#include "services/proof/run_record.h"

namespace rg::lab {

namespace fs = std::filesystem;
using nlohmann::json;
using proof::CaseMarks;
using proof::LabelledSet;

namespace {

constexpr char kIndex[] = "/battery.json", kFormat[] = "realitygrad.battery/1";
constexpr size_t kJointsInARow = 2;

std::string Number(double x, const char* format = "%.2f") {
  if (!std::isfinite(x)) return "–";
  return Printf(format, x);
}
std::string Number(const std::optional<double>& x) { return x ? Number(*x) : "–"; }

// What stands behind an effect in "coulomb_friction [a, b, c] 0.90", its joints counted where they are many.
std::string Behind(const std::string& name) {
  const size_t open = name.find('['), close = name.find(']');
  if (open == std::string::npos || close == std::string::npos)
    return name.substr(std::min(name.find(' '), name.size()));
  const auto commas = static_cast<size_t>(
      std::count(name.begin() + static_cast<long>(open), name.begin() + static_cast<long>(close), ','));
  if (commas < kJointsInARow) return name.substr(open - 1);
  return " [" + std::to_string(commas + 1) + " joints" + name.substr(close);
}

// Effects on the same joints, one after another and as sure, share what stands behind them.
std::string Listed(const std::vector<std::string>& names) {
  std::string text;
  for (size_t i = 0; i < names.size(); ++i) {
    const bool shared = i + 1 < names.size() && Behind(names[i]) == Behind(names[i + 1]) &&
                        names[i].find('[') != std::string::npos;
    text += names[i].substr(0, names[i].find(' '));
    if (shared) {
      text += ", ";
    } else {
      text += Behind(names[i]) + (i + 1 < names.size() ? " + " : "");
    }
  }
  return text.empty() ? "none" : text;
}

std::string VerdictOf(const CaseMarks& c) {
  if (c.diagnosed) return c.verdict;
  return c.reason.empty() ? "no answer" : c.reason;
}

std::string NameOf(const std::optional<proof::CaseKind>& kind) { return kind ? proof::NameOf(*kind) : "all"; }

std::string RowPerSet(const std::vector<CaseMarks>& cases) {
  cli::TextTable table(
      {"", "set", "robot", ">Hz", ">F1", ">joints", ">over floor", ">CPU s", "verdict", "truth", "said"});
  for (const CaseMarks& c : cases)
    table.AddRow({proof::Missed(c) ? "✗" : "", c.name, c.robot, Number(c.rate_hz, "%.0f"), Number(c.f1),
                  Number(c.joints_f1), Number(c.over_floor), Number(c.seconds, "%.1f"), VerdictOf(c),
                  Listed(c.truth), Listed(c.said)});
  return table.ToString();
}

std::string SumsText(const std::vector<CaseMarks>& cases) {
  cli::TextTable table({"stratum", ">sets", ">no answer", ">right", ">95 % interval", ">F1",
                        ">or unexplained", ">joints", ">over floor", ">worst", ">CPU s", ">worst",
                        ">wrong ≥ 0.8"});
  for (const proof::StratumSums& s : proof::SumByStratum(cases))
    table.AddRow({NameOf(s.kind), std::to_string(s.sets), std::to_string(s.unanswered),
                  Number(s.right.value, "%.3f"),
                  Number(s.right.low, "%.3f") + " to " + Number(s.right.high, "%.3f"), Number(s.f1, "%.3f"),
                  Number(s.f1_or_unexplained, "%.3f"), Number(s.joints_f1, "%.3f"), Number(s.over_floor),
                  Number(s.over_floor_worst), Number(s.seconds, "%.1f"), Number(s.seconds_worst, "%.1f"),
                  std::to_string(s.sure.wrong) + " of " + std::to_string(s.sure.n)});
  return table.ToString();
}

// Each finding at a confidence of 0.8 or more that is wrong; empty: none.
std::vector<std::pair<std::string, std::string>> SureAndWrong(const std::vector<CaseMarks>& cases) {
  std::vector<std::pair<std::string, std::string>> out;
  for (const CaseMarks& c : cases) {
    for (size_t i = 0; i < c.calls.size(); ++i) {
      if (c.calls[i].first >= proof::kSureFinding && !c.calls[i].second) out.push_back({c.name, c.said[i]});
    }
  }
  return out;
}

std::string SureText(const std::vector<CaseMarks>& cases) {
  std::string text;
  for (const auto& [name, said] : SureAndWrong(cases))
    text += "wrong at 0.8 or more: " + name + ": " + Listed({said}) + "\n";
  return text;
}

Result<std::vector<CaseMarks>> MarkAll(const std::vector<LabelledSet>& sets, const std::string& answers) {
  std::vector<CaseMarks> out;
  for (const LabelledSet& set : sets) {
    RG_ASSIGN_OR_RETURN(CaseMarks marks, proof::MarkAnswer(set, answers + "/" + set.name, {}));
    if (!marks.diagnosed && marks.reason.empty())
      marks.reason = cli::LastLine(answers + "/logs/" + set.name + ".log");
    out.push_back(std::move(marks));
  }
  return out;
}

// What stands in `answers` beside the marks: whose answers these are.
std::set<std::string> Programs(const std::vector<LabelledSet>& sets, const std::string& answers) {
  std::set<std::string> out;
  for (const LabelledSet& set : sets) {
    if (const auto run = proof::ReadRunRecord(answers + "/" + set.name)) out.insert(run->program);
  }
  return out;
}

json BatteryJson(const std::vector<LabelledSet>& sets, const std::vector<CaseMarks>& cases,
                 const std::string& answers) {
  json all = {{"programs", Programs(sets, answers)},
              {"cases", json::array()},
              {"strata", json::array()},
              {"wrong_sure_findings", json::array()}};
  for (size_t i = 0; i < cases.size(); ++i) {
    json row = proof::ToJson(cases[i]);
    row["set"] = fs::absolute(sets[i].folder).string(), row["label"] = fs::absolute(sets[i].label).string();
    row["missed"] = proof::Missed(cases[i]);
    all["cases"].push_back(row);
  }
  for (const proof::StratumSums& s : proof::SumByStratum(cases)) all["strata"].push_back(proof::ToJson(s));
  for (const auto& [name, said] : SureAndWrong(cases))
    all["wrong_sure_findings"].push_back({{"set", name}, {"said", said}});
  return all;
}

// The sets that a folder of answers was made of.
Result<std::vector<LabelledSet>> SetsOf(const std::string& answers) {
  RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(answers + kIndex));
  const json index = json::parse(text, nullptr, false);
  std::vector<LabelledSet> out;
  try {
    for (const json& c : index.at("cases")) out.push_back({c.at("name"), c.at("set"), c.at("label")});
  } catch (const json::exception&) {
    return DataLossError(answers + kIndex + ": not what `prove --sets` writes");
  }
  return out;
}

// Those that both folders know; of `sets` where that is given.
Result<std::vector<LabelledSet>> SetsToCompare(const BatteryArguments& a) {
  if (!a.sets.empty()) return proof::FindLabelledSets(a.sets);
  RG_ASSIGN_OR_RETURN(const std::vector<LabelledSet> before, SetsOf(a.compare[0]));
  RG_ASSIGN_OR_RETURN(const std::vector<LabelledSet> after, SetsOf(a.compare[1]));
  std::map<std::string, std::string> known;
  for (const LabelledSet& set : after) known[set.name] = set.folder;
  std::vector<LabelledSet> both;
  for (const LabelledSet& set : before) {
    const auto at = known.find(set.name);
    if (at == known.end()) continue;
    if (at->second != set.folder)
      return InvalidError(set.name + " is " + set.folder + " in " + a.compare[0] + " and " + at->second +
                          " in " + a.compare[1]);
    both.push_back(set);
  }
  if (both.empty()) return InvalidError(a.compare[0] + " and " + a.compare[1] + ": no set in common");
  return both;
}

std::string Change(double before, double after) {
  return Number(before, "%.3f") + " → " + Number(after, "%.3f");
}

std::string ComparisonText(const std::vector<proof::PairedMarks>& pairs) {
  std::string text;
  cli::TextTable changed({"", "set", "robot", ">F1", ">CPU s", "truth", "before", "after"});
  for (const proof::PairedMarks& p : pairs) {
    if (!p.won() && !p.lost()) continue;
    changed.AddRow({p.won() ? "won" : "lost", p.before.name, p.before.robot,
                    Number(p.before.f1) + " → " + Number(p.after.f1),
                    Number(p.before.seconds, "%.1f") + " → " + Number(p.after.seconds, "%.1f"),
                    Listed(p.before.truth), p.before.diagnosed ? Listed(p.before.said) : VerdictOf(p.before),
                    p.after.diagnosed ? Listed(p.after.said) : VerdictOf(p.after)});
  }
  if (!changed.empty()) text += changed.ToString() + "\n";
  cli::TextTable table({"stratum", ">sets", ">won", ">lost", ">McNemar p", ">F1", ">joints",
                        ">CPU, median ratio", ">of the sums"});
  for (const proof::StratumComparison& s : proof::CompareByStratum(pairs))
    table.AddRow({NameOf(s.kind), std::to_string(s.sets), std::to_string(s.won), std::to_string(s.lost),
                  Number(s.p, "%.3g"), Change(s.f1_before, s.f1_after),
                  Change(s.joints_before, s.joints_after), Number(s.cpu_ratio), Number(s.cpu_total_ratio)});
  return text + table.ToString();
}

std::string ReliabilityText(const proof::Reliability& r) {
  cli::TextTable levels(
      {"kind", ">said", ">findings", ">right", ">95 % interval", ">in the mixture", ">examinations"});
  const auto interval = [](const proof::Share& s) {
    return Number(s.low, "%.3f") + " to " + Number(s.high, "%.3f");
  };
  for (const proof::ReliabilityLevel& l : r.levels)
    levels.AddRow({l.kind, Number(l.said), std::to_string(l.right.n), Number(l.right.value, "%.3f"),
                   interval(l.right), Number(l.mixed, "%.3f"), std::to_string(l.examinations)});
  cli::TextTable bins({"said", ">mean", ">findings", ">right", ">95 % interval", ">in the mixture"});
  for (const proof::ReliabilityBin& b : r.bins) {
    if (b.right.n == 0) continue;
    bins.AddRow({Number(b.low, "%.1f") + " to " + Number(b.high, "%.1f"), Number(b.mean_said),
                 std::to_string(b.right.n), Number(b.right.value, "%.3f"), interval(b.right),
                 Number(b.mixed, "%.3f")});
  }
  cli::TextTable scores({"", ">calibration error", ">Brier"});
  scores.AddRow({"as said", Number(r.as_said.calibration_error, "%.3f"), Number(r.as_said.brier, "%.4f")});
  scores.AddRow({"by the other examinations", Number(r.left_out.calibration_error, "%.3f"),
                 Number(r.left_out.brier, "%.4f")});
  return levels.ToString() + "\n" + bins.ToString() + "\n" + scores.ToString();
}

std::string Trimmed(std::string text) {
  while (!text.empty() && text.back() == '\n') text.pop_back();
  return text;
}

}  // namespace

Status RunBattery(cli::Context& context, const BatteryArguments& a) {
  RG_ASSIGN_OR_RETURN(const std::vector<LabelledSet> sets, proof::FindLabelledSets(a.sets));
  cli::ProgressDisplay display(context.quiet());
  if (!a.mark_only) {
    std::vector<SetToDiagnose> to_diagnose;
    for (const LabelledSet& set : sets) to_diagnose.push_back({set.name, set.folder});
    RG_RETURN_IF_ERROR(
        DiagnoseSets(to_diagnose, {a.answers, a.answers + "/logs", a.limit_s, a.jobs}, &display));
    display.Finish();
  }
  RG_ASSIGN_OR_RETURN(const std::vector<CaseMarks> cases, MarkAll(sets, a.answers));
  const json all = BatteryJson(sets, cases, a.answers);
  json written = {{"format", kFormat}};
  written.update(all);
  RG_RETURN_IF_ERROR(WriteFileAtomically(a.answers + kIndex, written.dump(1)));
  if (context.json()) {
    cli::PrintJson(kFormat, all);
  } else if (context.quiet()) {
    cli::Print(a.answers + kIndex);
  } else {
    cli::Print(Trimmed(RowPerSet(cases) + "\n" + SumsText(cases) + "\n" + SureText(cases)));
    if (all["programs"].size() > 1)
      cli::PrintNote("answers of " + std::to_string(all["programs"].size()) + " different builds in " +
                     a.answers);
  }
  return Status::Ok();
}

Status CompareAnswers(cli::Context& context, const BatteryArguments& a) {
  RG_ASSIGN_OR_RETURN(const std::vector<LabelledSet> sets, SetsToCompare(a));
  RG_ASSIGN_OR_RETURN(const std::vector<CaseMarks> before, MarkAll(sets, a.compare[0]));
  RG_ASSIGN_OR_RETURN(const std::vector<CaseMarks> after, MarkAll(sets, a.compare[1]));
  std::vector<proof::PairedMarks> pairs;
  for (size_t i = 0; i < sets.size(); ++i) pairs.push_back({before[i], after[i]});
  json all = {{"before", a.compare[0]},
              {"after", a.compare[1]},
              {"changed", json::array()},
              {"strata", json::array()}};
  for (const proof::PairedMarks& p : pairs) {
    if (p.won() || p.lost())
      all["changed"].push_back(
          {{"won", p.won()}, {"before", proof::ToJson(p.before)}, {"after", proof::ToJson(p.after)}});
  }
  for (const proof::StratumComparison& s : proof::CompareByStratum(pairs))
    all["strata"].push_back(proof::ToJson(s));
  if (context.json()) {
    cli::PrintJson("realitygrad.battery_comparison/1", all);
  } else {
    cli::Print(Trimmed(ComparisonText(pairs)));
  }
  return Status::Ok();
}

Status TellReliability(cli::Context& context, const BatteryArguments& a) {
  std::vector<proof::Examined> examinations;
  for (const std::string& answers : a.reliability) {
    RG_ASSIGN_OR_RETURN(const std::vector<LabelledSet> sets, SetsOf(answers));
    RG_ASSIGN_OR_RETURN(std::vector<CaseMarks> cases, MarkAll(sets, answers));
    examinations.push_back({answers, std::move(cases)});
  }
  const proof::Reliability r = proof::ReliabilityOf(examinations);
  if (!a.svg.empty()) RG_RETURN_IF_ERROR(WriteFileAtomically(a.svg, proof::ReliabilitySvg(r)));
  if (context.json()) {
    cli::PrintJson("realitygrad.reliability/1", proof::ToJson(r));
  } else {
    cli::Print(Trimmed(ReliabilityText(r)));
  }
  return Status::Ok();
}

}  // namespace rg::lab
