#include "services/proof/proof_text.h"

#include <algorithm>
#include <cmath>

#include "services/report/page.h"

namespace rg::proof {

using nlohmann::json;
using report::FormatNumber;

namespace {

struct Line {
  std::string what, least, measured;
};

std::string Percent(double share) {
  return std::isfinite(share) ? FormatNumber(100 * share) + " %" : std::string("–");
}
std::string Text(const Share& s) {
  return s.n == 0 ? "no case"
                  : Percent(s.value) + " (" + Percent(s.low) + " to " + Percent(s.high) +
                        ", n = " + std::to_string(s.n) + ")";
}
std::string Count(const char* what, int n) { return std::string(" (") + what + std::to_string(n) + ")"; }

std::string Sure(const Summary& s, CaseKind kind) {
  const SureFindings& f = s.sure[static_cast<size_t>(kind)];
  return std::to_string(f.wrong) + " of " + std::to_string(f.n);
}

std::vector<Line> OrdinaryLines(const Summary& s) {
  const OrdinarySummary& o = s.ordinary;
  const auto of = [&](const std::string& figure) { return o.cases == 0 ? "no case" : figure; };
  return {
      {"ordinary robots: F1 of the set of effects", "0.90", of(FormatNumber(o.f1) + Count("n = ", o.cases))},
      {"ordinary robots: F1 of effects with their joints", "0.90", of(FormatNumber(o.joints_f1))},
      {"ordinary robots: error on concealed recordings over the true model's, median / worst", "1.5 / 5",
       of(FormatNumber(o.against_oracle) + " / " + FormatNumber(o.against_oracle_worst))},
      {"ordinary robots: seconds of CPU per set, median / longest", "–",
       of(FormatNumber(o.seconds_median) + " / " + FormatNumber(o.seconds_max))},
      {"false alarms on controls that declare friction and rotors", "at most 5 %", Text(o.false_alarms)},
      {"findings at confidence ≥ 0.8 that are wrong: singles / pairs / outside / controls / ordinary / "
       "declared",
       "at most 1 in 10",
       Sure(s, CaseKind::kSingle) + " / " + Sure(s, CaseKind::kPair) + " / " + Sure(s, CaseKind::kOpen) +
           " / " + Sure(s, CaseKind::kControl) + " / " + Sure(s, CaseKind::kOrdinary) + " / " +
           Sure(s, CaseKind::kDeclared)}};
}

std::vector<Line> Lines(const Summary& s) {
  const auto of_pairs = [&](double f1) {
    return s.pairs == 0 ? "no case" : FormatNumber(f1) + Count("n = ", s.pairs);
  };
  return {
      {"right effect first, single effects, nominal error > 3 × floor", "90 %", Text(s.right_first)},
      {"the same, where `unexplained` counts for a swinging mass or a flexible base", "–",
       Text(s.right_first_or_unexplained)},
      {"the same, weak ones", "–", Text(s.right_first_weak)},
      {"hidden behind tuned parameters: right first", "–", Text(s.right_first_tuned)},
      {"the right joints, exactly", "95 %", Text(s.joints)},
      {"pairs: F1 of the set of effects", "0.85", of_pairs(s.pair_f1)},
      {"the same, where `unexplained` stands for a swinging mass or a flexible base", "–",
       of_pairs(s.pair_f1_or_unexplained)},
      {"false alarms on controls", "at most 5 %", Text(s.false_alarms)},
      {"outside the catalogue: `unexplained` first, right joints", "80 %", Text(s.open)},
      {"verdict right", "–", Text(s.verdicts)},
      {"median error of named parameters", "at most 5 %",
       Percent(s.parameter_error) + Count("n = ", s.parameters)},
      {"gap recovered on concealed recordings, median", "0.9",
       FormatNumber(s.recovered) + Count("n = ", s.gaps) +
           ", worse than nominal: " + std::to_string(s.worse)},
      {"baseline: the same by a black-box residual on the nominal model, median", "–",
       FormatNumber(s.black_box) + Count("n = ", s.black_boxes)},
      {"baseline on the sets' held-out recordings: gap recovered by rigid-body parameters alone / with the "
       "findings, median over effects",
       "–", FormatNumber(s.calibrated_alone) + " / " + FormatNumber(s.with_findings)},
      {"confidence against hit rate, expected calibration error", "at most 0.1",
       FormatNumber(s.calibration_error)},
      {"seconds of CPU per set, median / longest", "–",
       FormatNumber(s.seconds_median) + " / " + FormatNumber(s.seconds_max)}};
}

std::string Joined(const std::vector<std::string>& list) {
  std::string out;
  for (const std::string& x : list) out += (out.empty() ? "" : " + ") + x;
  return out.empty() ? "none" : out;
}

std::string Verdict(const CaseMarks& c) {
  if (c.diagnosed) return c.verdict;
  return "no diagnosis" + (c.reason.empty() ? "" : ": " + c.reason);
}

std::string Number(const json& x) { return x.is_number() ? FormatNumber(x.get<double>()) : "–"; }

std::vector<std::vector<std::string>> EffectRows(const std::vector<CaseMarks>& cases) {
  std::vector<std::vector<std::string>> rows;
  for (const json& e : PerEffect(cases)) {
    rows.push_back({e["effect"].get<std::string>(), e["cases"].dump(), Number(e["right_first"]),
                    Number(e["f1"]), Number(e["joints_exact"]), Number(e["parameter_error"]),
                    Number(e["recovered"]), Number(e["black_box_recovered"])});
  }
  return rows;
}
const std::vector<std::string> kEffectColumns = {"effect", "cases",           "right first", "F1",
                                                 "joints", "parameter error", "recovered",   "black box"};

std::vector<std::vector<std::string>> BinRows(const Summary& s) {
  std::vector<std::vector<std::string>> rows;
  for (const ConfidenceBin& b : s.bins) {
    rows.push_back({FormatNumber(b.low) + " to " + FormatNumber(b.high), std::to_string(b.n),
                    b.n > 0 ? FormatNumber(b.mean_confidence) : "–",
                    b.n > 0 ? FormatNumber(b.hit_rate) : "–"});
  }
  return rows;
}

std::string TableText(const std::vector<std::string>& columns,
                      const std::vector<std::vector<std::string>>& rows) {
  std::string out = "|", rule = "|";
  for (const std::string& c : columns) out += " " + c + " |", rule += "---|";
  out += "\n" + rule + "\n";
  for (const auto& row : rows) {
    out += "|";
    for (const std::string& cell : row) out += " " + cell + " |";
    out += "\n";
  }
  return out;
}

std::vector<std::vector<std::string>> MissRows(const std::vector<CaseMarks>& cases, bool all) {
  std::vector<std::vector<std::string>> rows;
  for (const CaseMarks& c : cases) {
    if (!all && !Missed(c)) continue;
    const auto share = c.prediction.recovered();
    rows.push_back({c.name,
                    c.robot + ", " + FormatNumber(c.rate_hz) + " Hz" +
                        (c.weak    ? ", weak"
                         : c.tuned ? ", tuned"
                                   : ""),
                    Joined(c.truth), Verdict(c), Joined(c.said), FormatNumber(c.first), FormatNumber(c.f1),
                    share ? FormatNumber(*share) : "–"});
  }
  return rows;
}
const std::vector<std::string> kCaseColumns = {"case", "set",   "hidden", "verdict",
                                               "said", "first", "F1",     "recovered"};

report::Miniature MiniatureOf(const CaseMarks& c) {
  report::Miniature m;
  m.title = c.name + ": " + Joined(c.truth);
  m.link = c.diagnosed ? "answers/" + c.name + "/report.html" : "";
  const auto share = c.prediction.recovered();
  m.text = c.robot + ", " + FormatNumber(c.rate_hz) + " Hz" +
           (c.weak    ? ", weak"
            : c.tuned ? ", tuned"
                      : "") +
           ". Said: " + (c.diagnosed ? c.verdict + ", " + Joined(c.said) : Verdict(c)) + "." +
           (share ? " Recovered " + FormatNumber(*share) + "." : "");
  m.warning = Missed(c);
  m.y_label = "error on " + c.plot.joint + " [" + c.plot.unit + "]";
  m.series = {{"nominal model", c.plot.t, c.plot.nominal, report::SeriesStyle::kLine, 6},
              {"black box", c.plot.t, c.plot.black_box, report::SeriesStyle::kLine, 4},
              {"diagnosed model", c.plot.t, c.plot.tool, report::SeriesStyle::kLine, 0}};
  return m;
}

// Misses first, so that nobody has to look for them.
std::vector<report::Miniature> Miniatures(const std::vector<CaseMarks>& cases) {
  std::vector<report::Miniature> out;
  for (const CaseMarks& c : cases) {
    if (!c.plot.t.empty()) out.push_back(MiniatureOf(c));
  }
  std::stable_partition(out.begin(), out.end(), [](const report::Miniature& m) { return m.warning; });
  return out;
}

std::vector<std::vector<std::string>> LineRows(const Summary& s) {
  std::vector<std::vector<std::string>> rows;
  for (const auto& lines : {Lines(s), OrdinaryLines(s)})
    for (const Line& l : lines) rows.push_back({l.what, l.least, l.measured});
  return rows;
}

}  // namespace

std::string Markdown(const ProofRecord& record) {
  const Summary s = Summarise(record.cases);
  std::string out = "`" + record.command + "`\n\nSeal (SHA-256 over all labels, printed before the first " +
                    "diagnosis): `" + record.seal + "`. " + std::to_string(s.cases) + " cases, " +
                    std::to_string(s.undiagnosed) + " without a diagnosis.\n\n";
  out += TableText({"", "asked", "measured (95 % interval)"}, LineRows(s));
  out += "\n### By effect\n\n" + TableText(kEffectColumns, EffectRows(record.cases));
  out += "\n### Confidence\n\n" + TableText({"stated", "findings", "mean", "hold"}, BinRows(s));
  out += "\n### Every miss\n\n" + TableText(kCaseColumns, MissRows(record.cases, false));
  return out;
}

std::string ProofPage(const ProofRecord& record) {
  const Summary s = Summarise(record.cases);
  report::Page page("The diagnosis, examined blind", record.command);
  page.Lead("Right effect first in " + Text(s.right_first) + " of the single effects that are not weak; " +
            "false alarms on controls " + Text(s.false_alarms) + ".");
  page.Paragraph(
      "Sets made by an engine that shares no code with the simulator; labels sealed before the first "
      "diagnosis, opened after the last. Seal: " +
      record.seal);
  page.AddTable({.columns = {"", "asked", "measured (95 % interval)"},
                 .rows = LineRows(s),
                 .caption = {},
                 .text_columns = {0, 1, 2}});
  page.Heading("Concealed recordings");
  report::Series nominal{"nominal model", {}, {}, report::SeriesStyle::kPoints},
      tool{"diagnosed model", {}, {}, report::SeriesStyle::kPoints},
      oracle{"true model", {}, {}, report::SeriesStyle::kPoints};
  double at = 0;
  for (const CaseMarks& c : record.cases) {
    at += 1;
    for (report::Series* series : {&nominal, &tool, &oracle}) series->x.push_back(at);
    nominal.y.push_back(c.prediction.nominal), tool.y.push_back(c.prediction.tool);
    oracle.y.push_back(c.prediction.oracle);
  }
  page.AddPlot({.title = "Error on recordings that nobody fitted, per case",
                .x_label = "case",
                .y_label = "RMS in 1 s windows [rad or m]",
                .series = {nominal, tool, oracle},
                .log_y = true});
  page.Heading("By effect");
  page.AddTable(
      {.columns = kEffectColumns, .rows = EffectRows(record.cases), .caption = {}, .text_columns = {0}});
  page.Heading("Confidence");
  page.AddTable({.columns = {"stated", "findings", "mean", "hold"}, .rows = BinRows(s)});
  page.Heading("Every case");
  page.Paragraph(
      "How far predictions are off on the first concealed recording, in windows of 1 s restarted from the "
      "measured state, on the joint where the nominal model is off most. Cases that missed something are "
      "framed "
      "and stand first; a title leads to the diagnosis' own page.");
  page.AddMiniatures(Miniatures(record.cases));
  page.AddTable({.columns = kCaseColumns,
                 .rows = MissRows(record.cases, true),
                 .caption = {},
                 .text_columns = {0, 1, 2, 3, 4}});
  return page.Html();
}

}  // namespace rg::proof
