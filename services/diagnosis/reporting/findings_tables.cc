// Tables of a diagnosis: base parameters before and after, fitted models, missing force over time.

#include <algorithm>
#include <cmath>
#include <map>

#include "services/diagnosis/data/words.h"
#include "services/diagnosis/hypotheses/force_samples.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/reporting/findings.h"

namespace rg::diagnosis {

std::vector<LedgerRow> LedgerOf(const SearchResult& search) {
  std::vector<LedgerRow> out;
  const Candidate &without = search.calibrated, &best = search.best;
  for (size_t k = 0; k < without.parameters.size(); ++k) {
    const auto& p = without.parameters[k];
    LedgerRow row{p.name, p.unit, p.nominal, without.fit.theta[k], p.nominal, p.prior_stddev};
    const int at = best.plant->parameters().Find(p.name);
    if (at >= 0) row.final = best.fit.values[at];
    out.push_back(row);
  }
  std::ranges::sort(out, [](const LedgerRow& a, const LedgerRow& b) {
    return std::abs(a.final - a.calibrated) / a.prior_stddev >
           std::abs(b.final - b.calibrated) / b.prior_stddev;
  });
  return out;
}

std::vector<CandidateRow> CandidateRows(const SearchResult& search) {
  std::vector<CandidateRow> out;
  for (const Candidate& c : search.tried) {
    if (!c.fit.ok || out.size() >= kMostCandidates) continue;
    CandidateRow row;
    std::map<std::string, std::vector<std::string>> by_id;
    for (const EffectSpec& e : c.specs) {
      auto& joints = by_id[e.id];
      joints.insert(joints.end(), e.joints.begin(), e.joints.end());
    }
    for (const auto& [id, joints] : by_id)
      row.name += (row.name.empty() ? "" : " + ") + id + (joints.empty() ? "" : " (" + Listed(joints) + ")");
    if (row.name.empty()) row.name = "none";
    row.calibrated = c.base;
    row.evidence = c.score - search.nominal.score;
    row.chi2_per_row = c.fit.chi2 / std::max(1, c.fit.rows) / search.noise_scale;
    row.round = c.round;
    row.chosen = c.base == search.best.base && KeyOf(c.specs) == KeyOf(search.best.specs);
    out.push_back(row);
  }
  return out;
}

std::vector<ForcePlot> ForcePlots(const SearchResult& search, const FitData& data) {
  std::vector<ForcePlot> out;
  std::map<int, std::vector<size_t>> by_recording;
  for (size_t w = 0; w < data.windows.size(); ++w) by_recording[data.windows[w].recording].push_back(w);
  for (const auto& [recording, windows] : by_recording) {
    ForcePlot plot;
    plot.recording = data.recordings[recording].recording->name;
    const FineMotion& fine = data.fine[recording];
    long count = 0;
    for (const size_t w : windows) count += std::ssize(search.missing.t[w]);
    for (MatrixXd* m : {&plot.force, &plot.stddev, &plot.explained, &plot.q, &plot.v, &plot.u})
      m->resize(data.n, count);
    for (const size_t w : windows) {
      for (size_t s = 0; s < search.missing.t[w].size(); ++s) {
        const double t = search.missing.t[w][s];
        const Eigen::Index at = FineRow(fine, t);
        const long k = std::ssize(plot.t), col = static_cast<long>(s);
        plot.t.push_back(t);
        plot.force.col(k) = search.missing.force[w].col(col);
        plot.stddev.col(k) = search.missing.stddev[w].col(col);
        plot.explained.col(k) = plot.force.col(k) - search.remaining.force[w].col(col);
        plot.q.col(k) = fine.q.col(at), plot.v.col(k) = fine.v.col(at), plot.u.col(k) = fine.u.col(at);
      }
    }
    out.push_back(std::move(plot));
  }
  return out;
}

}  // namespace rg::diagnosis
