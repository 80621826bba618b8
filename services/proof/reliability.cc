#include "services/proof/reliability.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <set>
#include <sstream>

#include "services/proof/json_of.h"

namespace rg::proof {

using nlohmann::json;

namespace {

constexpr int kReliabilityBins = 5;
constexpr double kDrawn = 2.0;      // findings' weight, by which a level's rate is drawn to what was said
constexpr int kLeastInDiagram = 5;  // findings of a level

struct Call {
  size_t examination = 0;
  std::string kind;
  double said = 0, weight = 0;
  bool right = false;
};
using LevelKey = std::pair<std::string, int>;  // kind, hundredths
LevelKey KeyOfCall(const Call& c) { return {c.kind, static_cast<int>(std::lround(100 * c.said))}; }

bool IsOfOrdinaryRobot(const CaseMarks& c) {
  return c.kind == CaseKind::kOrdinary || c.kind == CaseKind::kDeclared;
}

// Half of the cases' weight on ordinary robots, the mean weight of a finding one.
std::vector<Call> WeighedCalls(const std::vector<Examined>& examinations) {
  std::array<double, 2> cases = {0, 0};
  for (const Examined& e : examinations) {
    for (const CaseMarks& c : e.cases) cases[IsOfOrdinaryRobot(c)] += 1;
  }
  std::vector<Call> out;
  double sum = 0;
  for (size_t e = 0; e < examinations.size(); ++e) {
    for (const CaseMarks& c : examinations[e].cases) {
      for (size_t i = 0; i < c.calls.size(); ++i) {
        out.push_back({e, KindOfFinding(c.said[i]), c.calls[i].first, 1 / cases[IsOfOrdinaryRobot(c)],
                       c.calls[i].second});
        sum += out.back().weight;
      }
    }
  }
  for (Call& c : out) c.weight *= static_cast<double>(out.size()) / sum;
  return out;
}

int BinOf(double said) {
  return std::clamp(static_cast<int>(said * kReliabilityBins), 0, kReliabilityBins - 1);
}

struct Tally {
  double weight = 0, right = 0, said = 0;
  int n = 0, hits = 0;
  std::set<size_t> examinations;
  void Add(const Call& c) {
    weight += c.weight, right += c.weight * c.right, said += c.weight * c.said;
    ++n, hits += c.right;
    examinations.insert(c.examination);
  }
  double mixed() const { return weight > 0 ? right / weight : 0; }
};

// `say`: the confidence of a call.
template <class Say>
ReliabilityScore ScoreOf(const std::vector<Call>& calls, const Say& say) {
  std::array<double, kReliabilityBins> said{}, right{};
  ReliabilityScore s;
  double weight = 0;
  for (const Call& c : calls) {
    const double p = say(c);
    const auto bin = static_cast<size_t>(BinOf(p));
    said[bin] += c.weight * p, right[bin] += c.weight * c.right;
    s.brier += c.weight * (p - c.right) * (p - c.right);
    weight += c.weight;
  }
  for (size_t b = 0; b < said.size(); ++b) s.calibration_error += std::abs(said[b] - right[b]);
  if (weight > 0) s.calibration_error /= weight, s.brier /= weight;
  return s;
}

json ScoreJson(const ReliabilityScore& s) {
  return {{"calibration_error", s.calibration_error}, {"brier", s.brier}};
}

}  // namespace

Reliability ReliabilityOf(const std::vector<Examined>& examinations) {
  const std::vector<Call> calls = WeighedCalls(examinations);
  std::map<LevelKey, Tally> levels;
  std::map<std::pair<size_t, LevelKey>, Tally> own;  // of one examination
  std::array<Tally, kReliabilityBins> bins;
  for (const Call& c : calls) {
    levels[KeyOfCall(c)].Add(c), own[{c.examination, KeyOfCall(c)}].Add(c);
    bins[static_cast<size_t>(BinOf(c.said))].Add(c);
  }
  Reliability r;
  r.findings = static_cast<int>(calls.size());
  for (const auto& [key, t] : levels)
    r.levels.push_back({key.first, key.second / 100.0, ShareOf(t.hits, t.n), t.mixed(),
                        static_cast<int>(t.examinations.size())});
  std::stable_sort(r.levels.begin(), r.levels.end(), [](const auto& a, const auto& b) {
    return a.kind != b.kind ? a.kind < b.kind : a.said > b.said;
  });
  for (int b = 0; b < kReliabilityBins; ++b) {
    const Tally& t = bins[static_cast<size_t>(b)];
    r.bins.push_back({b / static_cast<double>(kReliabilityBins),
                      (b + 1) / static_cast<double>(kReliabilityBins), t.weight > 0 ? t.said / t.weight : 0,
                      ShareOf(t.hits, t.n), t.mixed()});
  }
  r.as_said = ScoreOf(calls, [](const Call& c) { return c.said; });
  r.left_out = ScoreOf(calls, [&](const Call& c) {
    const Tally &all = levels[KeyOfCall(c)], &mine = own[{c.examination, KeyOfCall(c)}];
    return (all.right - mine.right + kDrawn * c.said) / (all.weight - mine.weight + kDrawn);
  });
  return r;
}

json ToJson(const Reliability& r) {
  json levels = json::array(), bins = json::array();
  for (const ReliabilityLevel& l : r.levels)
    levels.push_back({{"kind", l.kind},
                      {"said", l.said},
                      {"right", ShareJson(l.right)},
                      {"mixed", l.mixed},
                      {"examinations", l.examinations}});
  for (const ReliabilityBin& b : r.bins)
    bins.push_back({{"low", b.low},
                    {"high", b.high},
                    {"mean_said", b.mean_said},
                    {"right", ShareJson(b.right)},
                    {"mixed", b.mixed}});
  return {{"findings", r.findings},
          {"levels", levels},
          {"bins", bins},
          {"as_said", ScoreJson(r.as_said)},
          {"left_out", ScoreJson(r.left_out)}};
}

std::string ReliabilitySvg(const Reliability& r) {
  constexpr double kSize = 300, kLeft = 44, kTop = 12;
  const auto x = [&](double p) { return kLeft + kSize * p; };
  const auto y = [&](double p) { return kTop + kSize * (1 - p); };
  const std::map<std::string, std::pair<const char*, const char*>> kinds = {
      {"name", {"#1f77b4", "names"}},
      {"unnamed", {"#d62728", "unnamed forces"}},
      {"parameters", {"#2ca02c", "parameters"}}};
  std::ostringstream svg;
  svg.precision(4);
  const auto line = [&](double x0, double y0, double x1, double y1, const char* style) {
    svg << "<line x1=\"" << x(x0) << "\" y1=\"" << y(y0) << "\" x2=\"" << x(x1) << "\" y2=\"" << y(y1)
        << "\" " << style << "/>\n";
  };
  svg << "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"360\" height=\"360\" font-family=\"sans-serif\" "
         "font-size=\"11\">\n<rect width=\"360\" height=\"360\" fill=\"white\"/>\n";
  for (int i = 0; i <= kReliabilityBins; ++i) {
    const double p = i / static_cast<double>(kReliabilityBins);
    line(0, p, 1, p, "stroke=\"#ddd\"");
    svg << "<text x=\"" << x(p) << "\" y=\"" << y(0) + 16 << "\" text-anchor=\"middle\">" << p << "</text>\n";
    svg << "<text x=\"" << x(0) - 6 << "\" y=\"" << y(p) + 4 << "\" text-anchor=\"end\">" << p << "</text>\n";
  }
  line(0, 0, 1, 1, "stroke=\"#999\" stroke-dasharray=\"4\"");
  for (const ReliabilityLevel& l : r.levels) {
    if (l.right.n < kLeastInDiagram) continue;
    svg << "<g stroke=\"" << kinds.at(l.kind).first << "\" fill=\"" << kinds.at(l.kind).first << "\"><title>"
        << l.kind << " said at " << l.said << ": " << l.right.n << " findings, " << l.right.value
        << " right</title>\n";
    line(l.said, l.right.low, l.said, l.right.high, "stroke-width=\"1.5\"");
    svg << "<circle cx=\"" << x(l.said) << "\" cy=\"" << y(l.right.value) << "\" r=\""
        << std::min(9.0, 1.5 + std::sqrt(l.right.n) / 2) << "\"/></g>\n";
  }
  svg << "<text x=\"" << x(0.5) << "\" y=\"" << y(0) + 34 << "\" text-anchor=\"middle\">confidence said:";
  for (const auto& [kind, style] : kinds)
    svg << " <tspan fill=\"" << style.first << "\">" << style.second << "</tspan>";
  svg << "</text>\n<text transform=\"translate(12," << y(0.5)
      << ") rotate(-90)\" text-anchor=\"middle\">share right, 95 % interval</text>\n</svg>\n";
  return svg.str();
}

}  // namespace rg::proof
