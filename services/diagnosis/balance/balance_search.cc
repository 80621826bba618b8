#include "services/diagnosis/balance/balance_search.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <set>

#include "common/effects/effect_catalog.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/balance/balance_selection.h"
#include "services/diagnosis/balance/shooting_refit.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/likelihood/candidate.h"

namespace rg::diagnosis {

using effects::Regressor;

namespace {

constexpr double kLeastErrors = 1.0;  // stddevs above zero, that a loss must be after the refit

class MeasuredSearch {
 public:
  MeasuredSearch(const FitSetting& setting, const DiagnosisOptions& options, int threads, const Clock& clock,
                 const ProgressFn& progress, const CancelToken* cancel)
      : setting_(setting),
        options_(options),
        threads_(threads),
        clock_(clock),
        progress_(progress),
        cancel_(cancel) {}

  SearchResult Run() {
    SearchResult out;
    Tell("timing", 0.1);
    chosen_.FindTiming();
    Tell("screen", 0.2);
    chosen_.Select(cancel_);
    Score(&out);
    Tell("calibrate", 0.4);
    out.calibrated.fit = Refit({}, true).fit;
    Tell("fit", 0.6);
    Finish(&out);
    return out;
  }

 private:
  void Tell(const std::string& stage, double done) const {
    if (progress_) progress_({stage, done, 1.0, ""});
    Trace(stage);
  }
  void Trace(const std::string& text) const {
    if (std::getenv("RG_DIAGNOSIS_TRACE") != nullptr)
      std::fprintf(stderr, "[%6.2f] %s\n", clock_.SteadySeconds() - start_, text.c_str());
  }
  const BalanceFit& fit() const { return chosen_.fit(); }
  const BalanceModel& model() const { return chosen_.model(); }

  Candidate Refit(const std::vector<EffectSpec>& specs, bool base) const {
    RefitOptions options{.threads = threads_, .window_s = options_.window_s, .cancel = cancel_};
    if (!specs.empty()) options.spread = chosen_.Spread();
    return RefitByShooting(setting_, specs, base, options);
  }

  // Its plant, at nominal values; false where its effects cannot stand together.
  bool MakePlant(Candidate* c) const {
    const auto plant = sim::Plant::Create(nominal_.shared_model(), nominal_.options(), c->specs);
    if (!plant.ok()) return false;
    c->plant = std::make_shared<const sim::Plant>(*plant);
    c->fit.values = plant->parameters().Nominal();
    return true;
  }

  // A candidate that was compared in the balance and not refitted in the simulator.
  Candidate Compared(const BalanceModel& m, double cost) const {
    Candidate c;
    c.specs = chosen_.SpecsOf(m), c.base = m.base;
    c.fit.ok = MakePlant(&c);
    c.fit.rows = fit().EffectiveRows();
    c.fit.chi2 = 2 * cost;
    c.score = -cost;
    c.score -= kEffectPrior * static_cast<double>(chosen_.KindsOf(m).size());
    for (const auto& f : m.features) c.score -= kJointPrior * static_cast<double>(f.size());
    c.score -= kJointPrior * static_cast<double>(m.drive.size());
    return c;
  }

  BalanceModel Bare(bool base) const {
    return {.base = base, .features = std::vector<std::set<int>>(data_.n)};
  }
  BalanceModel Without(BalanceModel m, Regressor law) const {
    for (int j = 0; j < data_.n; ++j) chosen_.Erase(law, j, &m);
    return m;
  }
  Candidate Judged(const BalanceModel& m) const { return Compared(m, fit().LeaveOut(m).sum()); }

  // Scores the chosen model, those without effects, and its rivals: one effect removed or exchanged.
  void Score(SearchResult* out) {
    chosen_.fit().SetNoiseFrom(model());
    const double cost = fit().LeaveOut(model()).sum();
    for (const bool base : {false, true}) {
      Candidate& c = base ? out->calibrated : out->nominal;
      c = Judged(Bare(base));
      c.score -= chosen_.timing_gain();
      c.specs.clear();
      c.plant = std::make_shared<const sim::Plant>(nominal_);
      c.fit.values = nominal_.parameters().Nominal();
      out->tried.push_back(c);
    }
    out->best = Compared(model(), cost);
    std::map<std::string, std::set<Regressor>> laws;  // by the effect that they are
    for (int j = 0; j < data_.n; ++j) {
      for (const int c : model().features[j]) {
        const Regressor law = chosen_.balance().columns[j][c].regressor;
        laws[effects::LawOf(law).id].insert(law);
      }
    }
    for (const auto& [effect, own] : laws) {
      BalanceModel less = model();
      for (const Regressor law : own) less = Without(less, law);
      out->tried.push_back(Judged(less));
    }
    if (!model().drive.empty()) out->tried.push_back(Judged(chosen_.Uncoupled()));
    for (const Regressor law : kFinerLaws) Exchange(law, out);
    if (laws.count(effects::LawOf(Regressor::kConstant).id) > 0) {
      BalanceModel tilted = Without(model(), Regressor::kConstant);
      tilted.tilt = true;
      out->tried.push_back(Judged(tilted));
      MergeByDirection(out);
    }
    OtherTiming(out);
    Gains(cost, out);
    Ceiling(out, cost);
  }

  // The model with dry friction of another form on every joint that has any.
  void Exchange(Regressor finer, SearchResult* out) const {
    BalanceModel other = model();
    bool changed = false;
    for (int j = 0; j < data_.n; ++j) {
      if (!chosen_.Has(model(), Regressor::kDirection, j) || chosen_.Has(model(), finer, j)) continue;
      for (const Regressor old : kFinerLaws) chosen_.Erase(old, j, &other);
      const auto shapes = chosen_.ColumnsOf(finer, j);
      if (shapes.empty()) continue;  // the joint does not take it
      other.features[j].insert(shapes[shapes.size() / 2]);
      const bool admissible = chosen_.Admissible(other, j);
      if (!admissible) other.features[j] = model().features[j];
      changed = changed || admissible;
    }
    if (changed) out->tried.push_back(Judged(other));
  }

  // Coulomb friction c with an offset o of the effort equals friction by direction: −(c − o) forwards,
  // +(c + o) backwards.
  void MergeByDirection(SearchResult* out) const {
    const effects::EffectInfo &plain = effects::LawOf(Regressor::kDirection),
                              &constant = effects::LawOf(Regressor::kConstant),
                              &either = effects::LawOf(Regressor::kForwards);
    Candidate c = out->best;
    for (EffectSpec& s : c.specs) {
      if (s.id != plain.id) continue;
      const auto zero = std::ranges::find_if(
          c.specs, [&](const EffectSpec& e) { return e.id == constant.id && e.joints == s.joints; });
      if (zero == c.specs.end()) continue;
      const double level = s.values.at(s.joints[0]).at(plain.parameters[0].name),
                   offset = zero->values.at(s.joints[0]).at(constant.parameters[0].name);
      if (std::abs(offset) >= level) continue;
      s = effects::MakeSpec(
          either.id, s.joints,
          {{either.parameters[0].name, level - offset}, {either.parameters[1].name, level + offset}});
    }
    std::erase_if(c.specs, [&](const EffectSpec& e) {
      return e.id == constant.id && Contains(c.specs, either.id, e.joints[0]);
    });
    if (MakePlant(&c)) out->tried.push_back(std::move(c));
  }

  // Lags for delays and the reverse; and delays of the sensors, the same balance as delays of the drives.
  void OtherTiming(SearchResult* out) const {
    if (chosen_.timing_gain() <= 0) return;
    const effects::EffectInfo &delay = effects::LawOf(Regressor::kDelayed),
                              &lag = effects::LawOf(Regressor::kLagging),
                              &late_sensor = effects::EffectOf(effects::Role::kSensorDelay);
    for (const bool sensor : {false, true}) {
      Candidate c = out->best;
      for (EffectSpec& s : c.specs) {
        if (s.id != delay.id && s.id != lag.id) continue;
        const double seconds = s.values.begin()->second.begin()->second;
        const effects::EffectInfo& other = sensor ? late_sensor : s.id == delay.id ? lag : delay;
        s = effects::MakeSpec(other.id, s.joints, {{other.parameters[0].name, seconds}});
      }
      if (!sensor) c.score += chosen_.other_timing_gain();
      if (MakePlant(&c)) out->tried.push_back(std::move(c));
    }
  }

  // Cross-validated gain of each kind of effect of the chosen model.
  void Gains(double cost, SearchResult* out) const {
    const BalanceSolution s = fit().Solve(model());
    for (const std::string& kind : chosen_.KindsOf(model())) {
      const bool coupling = kind == effects::LawOf(Regressor::kOtherEffort).id;
      BalanceModel less = coupling ? chosen_.Uncoupled() : model();
      if (kind == effects::EffectOf(effects::Role::kGravity).id) less.tilt = false;
      for (int j = 0; j < data_.n; ++j) {
        const auto specs = chosen_.SpecsOfJoint(model(), s, j);
        if (std::ranges::none_of(specs, [&](const EffectSpec& e) { return e.id == kind; })) continue;
        // Terms that a plainer law needs stay.
        const auto& terms = effects::InferenceOf(kind).terms;
        for (const effects::Term& t : terms) {
          const bool own = effects::LawOf(t.regressor).id == kind;
          if (own || t.regressor == Regressor::kConstant) chosen_.Erase(t.regressor, j, &less);
        }
      }
      out->measured.gain[kind] = IsTiming(kind) ? chosen_.timing_gain() : fit().LeaveOut(less).sum() - cost;
    }
  }

  // The share of the residual cost that a free force over position and velocity of each joint would explain.
  void Ceiling(SearchResult* out, double cost) {
    BalanceModel free = model();
    for (int j = 0; j < data_.n; ++j) {
      chosen_.Insert({Regressor::kPositionPiece, Regressor::kVelocityPiece}, j, &free);
    }
    const BlockCosts now = fit().LeaveOut(model()), ceiling = fit().LeaveOut(free);
    const BalanceSolution s = fit().Solve(model());
    MeasuredEffort& m = out->measured;
    m.active = true, m.early = chosen_.early();
    m.explained = 1.0 - cost / std::max(1e-300, fit().LeaveOut(Bare(true)).sum());
    for (VectorXd* x : {&m.structured, &m.effort_share, &m.effort_noise, &m.effort_correlation_s})
      x->setZero(data_.n);
    for (int j = 0; j < data_.n; ++j) {
      const Gain gain = GainOf(now, ceiling, j);
      if (gain.Beyond(kErrors)) m.structured[j] = gain.nats / std::max(1e-300, now.col(j).sum());
      const VectorXd u = fit().Moving(chosen_.balance().joints[j].effort, j);
      if (u.size() >= 2)
        m.effort_share[j] = s.energy[j] / std::max(1e-300, (u.array() - u.mean()).square().mean());
      m.effort_noise[j] = std::sqrt(s.energy[j]);
      m.effort_correlation_s[j] = 0.02 * fit().Correlation(j);
    }
  }

  void Finish(SearchResult* out) {
    const auto specs = chosen_.SpecsOf(model());
    const double score = out->best.score, chi2 = out->best.fit.chi2;
    const int rows = out->best.fit.rows;
    out->best = WithoutWeakLosses(Refit(specs, model().base));
    out->best.score = score, out->best.fit.chi2 = chi2, out->best.fit.rows = rows;
    out->calibrated.parameters = FreeParameters(nominal_, setting_.scales, true);
    out->tried.push_back(out->best);
    std::ranges::sort(out->tried, [](const Candidate& a, const Candidate& b) { return a.score > b.score; });
    out->noise_scale = 1;
    out->null_gain = chosen_.LogHypotheses();
    out->threshold = out->null_gain + kEffectPrior;
    Forces(out);
  }
  // Refitted without the losses that are not significantly positive in the simulator.
  Candidate WithoutWeakLosses(const Candidate& c) const {
    std::vector<EffectSpec> left = Refreshed(c);
    std::erase_if(left, [&](const EffectSpec& s) {
      const effects::EffectInfo& info = *effects::FindEffect(s.id);
      if (info.parameters.size() != 1 || !IsLossOfDrives(s.id)) return false;
      const std::string name = s.id + "." + s.joints[0] + "." + info.parameters[0].name;
      for (size_t i = 0; i < c.parameters.size(); ++i) {
        const auto k = static_cast<long>(i);
        if (c.parameters[i].name == name) return c.fit.theta[k] < kLeastErrors * c.fit.stddev[k];
      }
      return false;
    });
    return left.size() == c.specs.size() ? c : Refit(left, c.base);
  }

  // Force along the recordings that the calibrated base parameters miss, and the residual of the model.
  void Forces(SearchResult* out) const {
    const BalanceSolution s = fit().Solve(model());
    BalanceSolution bare = s;
    for (VectorXd& f : bare.features) f.setZero();
    bare.drive.setZero();
    out->missing = Stairs(bare, true);
    out->remaining = Stairs(s, false);
  }

  // The mean residual of a solution on each 50 ms of the windows; `still`: also of rows in which a joint may
  // stick.
  MissingForce Stairs(const BalanceSolution& s, bool still) const {
    MissingForce out;
    out.rows = fit().EffectiveRows();
    std::vector<VectorXd> rest;
    for (int j = 0; j < data_.n; ++j) rest.push_back(fit().Residual(s, j));
    for (const NodeWindow& window : data_.windows) {
      const double begin = window.t.front(), span = window.t.back() - begin;
      const int S = std::max(1, static_cast<int>(std::lround(span / 0.05)));
      MatrixXd force = MatrixXd::Zero(data_.n, S), stddev = force;
      for (int j = 0; j < data_.n; ++j) {
        if (nominal_.IsPrescribed(j)) continue;
        const BalanceRows& rows = chosen_.balance().joints[j];
        VectorXd count = VectorXd::Zero(S);
        for (size_t k = 0; k < rows.t.size(); ++k) {
          if (rows.recording[k] != window.recording || rows.t[k] < begin || rows.t[k] >= window.t.back())
            continue;
          const int at = std::min(S - 1, static_cast<int>((rows.t[k] - begin) / span * S));
          ++count[at];
          if (still || !rows.still[k]) force(j, at) += rest[j][k];
        }
        force.row(j) = force.row(j).transpose().cwiseQuotient(count.cwiseMax(1.0)).transpose();
        stddev.row(j) =
            (count.array() > 0).select(VectorXd::Constant(S, std::sqrt(fit().Variance(j))), 0.0).transpose();
      }
      std::vector<double> middles;
      for (int k = 0; k < S; ++k) middles.push_back(begin + span * (k + 0.5) / S);
      out.force.push_back(force), out.stddev.push_back(stddev), out.t.push_back(middles);
    }
    return out;
  }

  const FitSetting setting_;
  const FitData& data_ = setting_.data;
  const sim::Plant& nominal_ = setting_.nominal;
  const DiagnosisOptions& options_;
  int threads_;
  const Clock& clock_;
  const ProgressFn& progress_;
  const CancelToken* cancel_;
  const double start_ = clock_.SteadySeconds();
  BalanceSelection chosen_{setting_, options_.max_effects, [this](const std::string& s) { Trace(s); }};
};

}  // namespace

bool EffortIsMeasured(const FitData& data) {
  return std::ranges::any_of(data.recordings, [](const sysid::FitRecording& r) {
    return r.recording->drive == recordings::EffortKind::kMeasured;
  });
}

SearchResult SearchMeasuredEffort(const FitSetting& setting, const DiagnosisOptions& options, int threads,
                                  const Clock& clock, const ProgressFn& progress, const CancelToken* cancel) {
  return MeasuredSearch(setting, options, threads, clock, progress, cancel).Run();
}

}  // namespace rg::diagnosis
