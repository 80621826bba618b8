#include "services/proof/battery.h"

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <functional>
#include <limits>
#include <map>

#include "common/base/file.h"
#include "services/proof/json_of.h"
#include "services/proof/run_record.h"

namespace rg::proof {

namespace fs = std::filesystem;
using nlohmann::json;

namespace {

bool IsSet(const fs::path& folder) { return fs::exists(folder / "manifest.json"); }

std::string NameOfFolder(const fs::path& folder) {
  const fs::path plain = fs::weakly_canonical(folder);
  return plain.filename().string();
}

std::vector<fs::path> SetsIn(const fs::path& folder) {
  if (IsSet(folder)) return {folder};
  const fs::path own = fs::is_directory(folder / "sets") ? folder / "sets" : folder;
  std::vector<fs::path> out;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(own, error)) {
    if (IsSet(entry.path())) out.push_back(entry.path());
  }
  std::sort(out.begin(), out.end());
  return out;
}

Result<std::string> LabelOf(const fs::path& set) {
  const fs::path around = fs::weakly_canonical(set).parent_path().parent_path(), name = NameOfFolder(set);
  for (const fs::path& file : {set / "label.json", around / "sealed" / name / "label.json",
                               around / "labels" / name / "label.json"}) {
    if (fs::exists(file)) return file.string();
  }
  return NotFoundError(set.string() + ": no label.json in it, nor in " + (around / "sealed" / name).string() +
                       " or " + (around / "labels" / name).string());
}

std::string OutOfTime(double limit_s) {
  char text[80];
  std::snprintf(text, sizeof text, "no answer in %g s of CPU time", limit_s);
  return text;
}

double Worst(const std::vector<double>& v) {
  return v.empty() ? std::numeric_limits<double>::quiet_NaN() : *std::max_element(v.begin(), v.end());
}

json NameOrAll(const std::optional<CaseKind>& kind) { return kind ? NameOf(*kind) : "all"; }

// `make` of every kind's members that there are, in their order, then of all.
template <class Row, class Member>
std::vector<Row> ByStratum(const std::vector<Member>& all,
                           const std::function<CaseKind(const Member&)>& kind_of,
                           const std::function<Row(const std::vector<const Member*>&)>& make) {
  std::vector<Row> out;
  std::map<CaseKind, std::vector<const Member*>> strata;
  std::vector<const Member*> every;
  for (const Member& m : all) strata[kind_of(m)].push_back(&m), every.push_back(&m);
  for (const auto& [kind, members] : strata) {
    out.push_back(make(members));
    out.back().kind = kind;
  }
  out.push_back(make(every));
  return out;
}

StratumSums SumsOf(const std::vector<const CaseMarks*>& cases) {
  StratumSums s;
  s.sets = static_cast<int>(cases.size());
  std::vector<double> f1, or_unexplained, joints, over_floor, seconds;
  double right = 0;
  for (const CaseMarks* c : cases) {
    s.unanswered += !c->diagnosed;
    right += !Missed(*c);
    f1.push_back(c->f1), or_unexplained.push_back(c->f1_or_unexplained);
    if (c->joints_f1) joints.push_back(*c->joints_f1);
    if (c->over_floor) over_floor.push_back(*c->over_floor);
    seconds.push_back(c->seconds);
    s.sure.Count(*c);
  }
  s.right = ShareOf(right, s.sets);
  s.f1 = Mean(f1), s.f1_or_unexplained = Mean(or_unexplained), s.joints_f1 = Mean(joints);
  s.over_floor = Median(over_floor), s.over_floor_worst = Worst(over_floor);
  s.seconds = Median(seconds), s.seconds_worst = Worst(seconds);
  return s;
}

StratumComparison ComparisonOf(const std::vector<const PairedMarks*>& pairs) {
  StratumComparison c;
  c.sets = static_cast<int>(pairs.size());
  std::vector<double> ratios, f1_before, f1_after, joints_before, joints_after;
  double before = 0, after = 0;
  for (const PairedMarks* p : pairs) {
    c.won += p->won(), c.lost += p->lost();
    f1_before.push_back(p->before.f1), f1_after.push_back(p->after.f1);
    if (p->before.joints_f1 && p->after.joints_f1) {
      joints_before.push_back(*p->before.joints_f1);
      joints_after.push_back(*p->after.joints_f1);
    }
    if (!p->before.diagnosed || !p->after.diagnosed || p->before.seconds <= 0) continue;
    before += p->before.seconds, after += p->after.seconds;
    ratios.push_back(p->after.seconds / p->before.seconds);
  }
  c.p = McNemarExact(c.won, c.lost);
  c.f1_before = Mean(f1_before), c.f1_after = Mean(f1_after);
  c.joints_before = Mean(joints_before), c.joints_after = Mean(joints_after);
  c.cpu_ratio = Median(ratios);
  c.cpu_total_ratio = before > 0 ? after / before : std::numeric_limits<double>::quiet_NaN();
  return c;
}

}  // namespace

Result<std::vector<LabelledSet>> FindLabelledSets(const std::vector<std::string>& folders) {
  struct Found {
    fs::path set, given;
  };
  std::vector<Found> all;
  std::map<std::string, int> named;
  for (const std::string& folder : folders) {
    const std::vector<fs::path> sets = SetsIn(folder);
    if (sets.empty())
      return NotFoundError(folder +
                           ": no recording set (a folder with a manifest.json), nor a folder of them");
    for (const fs::path& set : sets) {
      all.push_back({set, folder});
      ++named[NameOfFolder(set)];
    }
  }
  std::vector<LabelledSet> out;
  std::map<std::string, std::string> taken;
  for (const Found& found : all) {
    std::string name = NameOfFolder(found.set);
    if (named[name] > 1) {
      fs::path given = fs::weakly_canonical(found.given);
      if (given.filename() == "sets") given = given.parent_path();
      name = given.filename().string() + "." + name;
    }
    RG_ASSIGN_OR_RETURN(std::string label, LabelOf(found.set));
    const auto [at, fresh] = taken.try_emplace(name, found.set.string());
    if (!fresh) return InvalidError(found.set.string() + " and " + at->second + " have one name: " + name);
    out.push_back({std::move(name), found.set.string(), std::move(label)});
  }
  return out;
}

Result<CaseMarks> MarkAnswer(const LabelledSet& set, const std::string& answer_folder,
                             const PredictionMarks& prediction) {
  RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(set.label));
  const json label = json::parse(text, nullptr, false);
  if (!label.is_object()) return DataLossError(set.label + ": no JSON object");
  const auto run = ReadRunRecord(answer_folder);
  // What was written as the time ran out is no answer: the program was stopped before it had finished.
  const bool out_of_time = run && run->outcome == RunRecord::Outcome::kOutOfTime;
  const auto said = ReadFile(answer_folder + "/diagnosis.json");
  RG_ASSIGN_OR_RETURN(
      CaseMarks marks,
      Mark(label, said.ok() && !out_of_time ? json::parse(*said, nullptr, false) : json(nullptr),
           prediction));
  marks.name = set.name;
  if (run) marks.seconds = run->cpu_s;
  if (out_of_time) marks.reason = OutOfTime(run->limit_s);
  return marks;
}

std::vector<StratumSums> SumByStratum(const std::vector<CaseMarks>& cases) {
  return ByStratum<StratumSums, CaseMarks>(
      cases, [](const CaseMarks& c) { return c.kind; }, SumsOf);
}

std::vector<StratumComparison> CompareByStratum(const std::vector<PairedMarks>& pairs) {
  return ByStratum<StratumComparison, PairedMarks>(
      pairs, [](const PairedMarks& p) { return p.before.kind; }, ComparisonOf);
}

json ToJson(const StratumSums& s) {
  return {{"stratum", NameOrAll(s.kind)},
          {"sets", s.sets},
          {"unanswered", s.unanswered},
          {"right", ShareJson(s.right)},
          {"f1", NumberOrNull(s.f1)},
          {"f1_or_unexplained", NumberOrNull(s.f1_or_unexplained)},
          {"joints_f1", NumberOrNull(s.joints_f1)},
          {"over_noise_floor", NumberOrNull(s.over_floor)},
          {"over_noise_floor_worst", NumberOrNull(s.over_floor_worst)},
          {"cpu_s", NumberOrNull(s.seconds)},
          {"cpu_s_worst", NumberOrNull(s.seconds_worst)},
          {"sure_findings", {{"n", s.sure.n}, {"wrong", s.sure.wrong}}}};
}

json ToJson(const StratumComparison& c) {
  return {{"stratum", NameOrAll(c.kind)},
          {"sets", c.sets},
          {"won", c.won},
          {"lost", c.lost},
          {"mcnemar_p", c.p},
          {"f1", {NumberOrNull(c.f1_before), NumberOrNull(c.f1_after)}},
          {"joints_f1", {NumberOrNull(c.joints_before), NumberOrNull(c.joints_after)}},
          {"cpu_ratio", NumberOrNull(c.cpu_ratio)},
          {"cpu_total_ratio", NumberOrNull(c.cpu_total_ratio)}};
}

}  // namespace rg::proof
