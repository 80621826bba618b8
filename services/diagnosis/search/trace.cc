#include "services/diagnosis/search/trace.h"

#include <algorithm>
#include <cstdio>
#include <cstdlib>

#include "services/diagnosis/hypotheses/hypotheses.h"

namespace rg::diagnosis {

namespace {

constexpr size_t kHypotheses = 8, kSets = 6;  // printed of each screen

void Print(const Scored& h) {
  std::fprintf(stderr, " %s[", h.effect.c_str());
  for (const int j : h.joints) std::fprintf(stderr, "%d", j + 1);
  std::fprintf(stderr, "]");
}

}  // namespace

Trace::Trace(const Clock& clock)
    : clock_(clock), start_(clock.SteadySeconds()), on_(std::getenv("RG_DIAGNOSIS_TRACE") != nullptr) {}

void Trace::Stage(const std::string& stage, const std::string& note) const {
  if (on_) std::fprintf(stderr, "[%6.2f] %s %s\n", Elapsed(), stage.c_str(), note.c_str());
}

void Trace::Fit(const Candidate& c, const char* what) const {
  if (!on_) return;
  std::fprintf(stderr, "[%6.2f]   %s %-50s%s ", Elapsed(), what, KeyOf(c.specs).c_str(),
               c.base ? "+base" : "");
  if (c.score > kNoScore)
    std::fprintf(stderr, "score %.1f", c.score);
  else
    std::fprintf(stderr, "refused");
  std::fprintf(stderr, " chi2/row %.4f step %.2f it %d work %.1e", c.fit.chi2 / std::max(1, c.fit.rows),
               1e3 * c.fit.step_s, c.fit.iterations, c.fit.work);
  for (size_t i = 0; i < c.parameters.size() && c.fit.theta.size() > 0; ++i) {
    const auto& p = c.parameters[i];
    if (c.plant->parameters()[p.index].kind != sim::ParameterKind::kEffect) continue;
    std::fprintf(stderr, " %s=%.4g", p.name.substr(p.name.find('.')).c_str(), c.fit.theta[i]);
  }
  std::fprintf(stderr, "\n");
}

void Trace::Screen(const ScreenResult& s, bool base) const {
  if (!on_) return;
  std::fprintf(stderr, "[%6.2f]  screen base=%d null %.1f:", Elapsed(), base, s.null_gain);
  for (size_t i = 0; i < std::min(kHypotheses, s.hypotheses.size()); ++i) {
    Print(s.hypotheses[i]);
    std::fprintf(stderr, " %.1f", s.hypotheses[i].gain);
  }
  for (const auto* list : {&s.sets, &s.pairs}) {
    for (size_t i = 0; i < std::min(kSets, list->size()); ++i) {
      std::fprintf(stderr, " {");
      for (const Scored& h : (*list)[i].parts) Print(h);
      std::fprintf(stderr, " } %.1f", (*list)[i].gain);
    }
  }
  std::fprintf(stderr, "\n");
}

}  // namespace rg::diagnosis
