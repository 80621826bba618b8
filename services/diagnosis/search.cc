#include "services/diagnosis/search.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <set>

#include "common/base/check.h"
#include "common/effects/effect_catalog.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/acceptance.h"
#include "services/diagnosis/field_starts.h"
#include "services/diagnosis/push_starts.h"

namespace rg::diagnosis {

using effects::EffectSpec;
using Eigen::MatrixXd;
using Eigen::VectorXd;

namespace {

constexpr double kRivalShare = 0.25;  // of what parameters explain, by the screen's linear estimate
constexpr double kHolds = 2.0;        // χ² per row below which a model's own states are trusted
constexpr double kExplained = 1.1;    // χ² per row at which nothing else is looked for in another world

class Search {
 public:
  Search(const FitData& data, const sim::Plant& nominal, const MotionScales& scales,
         const DiagnosisOptions& options, int threads, const Clock& clock, const ProgressFn& progress,
         const CancelToken* cancel)
      : data_(data),
        nominal_(nominal),
        scales_(scales),
        options_(options),
        clock_(clock),
        progress_(progress),
        cancel_(cancel) {
    lifted_.threads = threads;
    lifted_.step_s = options.step_s;
    start_ = clock.SteadySeconds();
  }

  SearchResult Run() {
    SearchResult out;
    Tell("noise", 0.02, "");
    const FitModel bare{nominal_, nominal_.parameters().Nominal(), {}};
    const double stair = std::max(0.02, data_.recordings[0].recording->SamplePeriod());
    MissingForce missing = EstimateMissingForce(data_, bare, InitialStates(data_, bare, lifted_),
                                                scales_.torque, stair, lifted_);
    lifted_.noise_scale = std::max(1.0, missing.chi2 / std::max(1.0, missing.rows - missing.unknowns));
    Tell("calibrate", 0.05, "");
    out.nominal = Evaluate({}, false);
    out.calibrated = Evaluate({}, true);
    Candidate best =
        out.calibrated.score > out.nominal.score + Threshold(out.nominal) ? out.calibrated : out.nominal;
    features_ = MakeFeatures(data_, scales_);
    for (round_ = 1; round_ <= options_.max_effects && !Late(); ++round_) {
      const bool added = AddOne(&best);
      if (!added) break;
      Prune(&best);
      LowerNoise(&best, &out);
      // What little is left of it is the surface's own coarseness, and no further name.
      if ((round_ == 1 || OfPosition(best)) && Flexible(&best, LeavesNothing(out))) break;
    }
    Prune(&best);
    if (PerRow(best) > kExplained || OfPosition(best)) Flexible(&best, 1e300);
    out.best = best;
    for (const auto& [key, c] : tried_) out.tried.push_back(c);
    std::sort(out.tried.begin(), out.tried.end(),
              [](const Candidate& a, const Candidate& b) { return a.score > b.score; });
    out.null_gain = acceptance_.null_gain();
    out.noise_scale = lifted_.noise_scale;
    Tell("locate", 0.95, "");
    const Candidate without = Better(out.nominal, out.calibrated);
    out.threshold = Threshold(without);
    out.missing = Force(without);
    out.remaining = Force(best);
    return out;
  }

 private:
  static constexpr double kSegment = 0.05;  // s
  static constexpr int kNullDraws = 60;

  // A model that fits better than any force on the old one could: the noise is less than was thought. All
  // scores are brought to it.
  void LowerNoise(Candidate* best, SearchResult* out) {
    const double dof = best->fit.rows - 2.0 * data_.n * static_cast<double>(data_.windows.size());
    const double scale = std::max(1.0, std::min(lifted_.noise_scale, best->fit.chi2 / std::max(1.0, dof)));
    const double change = 0.5 * (1.0 / scale - 1.0 / lifted_.noise_scale);
    if (change < 1e-3) return;
    lifted_.noise_scale = scale;
    for (Candidate* c : {best, &out->nominal, &out->calibrated}) c->score -= change * c->fit.chi2;
    for (auto& [key, c] : tried_) c.score -= change * c.fit.chi2;
  }

  void Tell(const std::string& stage, double done, const std::string& note) const {
    if (progress_) progress_({stage, done, 1.0, note});
    if (std::getenv("RG_DIAGNOSIS_TRACE") != nullptr) {
      std::fprintf(stderr, "[%6.2f] %s %s\n", clock_.SteadySeconds() - start_, stage.c_str(), note.c_str());
    }
  }
  bool Late() const {
    return (cancel_ != nullptr && cancel_->cancelled()) ||
           clock_.SteadySeconds() - start_ > options_.time_limit_s;
  }
  static const Candidate& Better(const Candidate& a, const Candidate& b) { return b.score > a.score ? b : a; }

  MissingForce Force(const Candidate& c) {
    const FitModel model{*c.plant, c.fit.values, {}};
    return EstimateMissingForce(data_, model, InitialStates(data_, model, lifted_), scales_.torque, kSegment,
                                lifted_);
  }

  Candidate Evaluate(const std::vector<EffectSpec>& specs, bool base, int iterations = 6) {
    const std::string key = KeyOf(specs) + (base ? "+base" : "");
    Candidate c;
    c.specs = specs, c.base = base, c.round = round_;
    c.score = -1e300;
    auto plant = sim::Plant::Create(nominal_.shared_model(), nominal_.options(), specs);
    if (!plant.ok()) return c;
    c.plant = std::make_shared<const sim::Plant>(*plant);
    c.parameters = FreeParameters(*c.plant, scales_, base);
    LiftedOptions options = lifted_;
    options.iterations = iterations;
    c.fit = Fit(data_, {*c.plant, c.plant->parameters().Nominal(), c.parameters}, options);
    if (c.fit.ok) c.score = c.fit.evidence - StructurePrior(specs, base);
    auto [it, fresh] = tried_.try_emplace(key, c);
    if (!fresh && c.score > it->second.score) it->second = c;
    TraceFit(c, "fit");
    return c;
  }

  void TraceFit(const Candidate& c, const char* what) const {
    if (std::getenv("RG_DIAGNOSIS_TRACE") == nullptr) return;
    std::fprintf(stderr, "[%6.2f]   %s %-50s%s score %.1f chi2/row %.4f it %d",
                 clock_.SteadySeconds() - start_, what, KeyOf(c.specs).c_str(), c.base ? "+base" : "",
                 c.score, c.fit.chi2 / std::max(1, c.fit.rows), c.fit.iterations);
    for (size_t i = 0; i < c.parameters.size(); ++i) {
      if (c.plant->parameters()[c.parameters[i].index].kind == sim::ParameterKind::kEffect && c.fit.ok)
        std::fprintf(stderr, " %s=%.4g", c.parameters[i].name.substr(c.parameters[i].name.find('.')).c_str(),
                     c.fit.theta[static_cast<long>(i)]);
    }
    std::fprintf(stderr, "\n");
  }

  // Specs of a fitted candidate with the fitted values in them, as the start of a larger model.
  std::vector<EffectSpec> Refreshed(const Candidate& c) const {
    std::vector<EffectSpec> specs = c.specs;
    for (EffectSpec& s : specs) {
      std::vector<std::string> owners = s.joints;
      if (s.joints.empty() || s.id == "joint_coupling" || s.id == "unknown_field_pair") owners = {"*"};
      for (const std::string& owner : owners) {
        for (const auto& info : effects::FindEffect(s.id)->parameters) {
          const int at = c.plant->parameters().Find(s.id + "." + owner + "." + info.name);
          if (at >= 0 && c.fit.ok) s.values[owner][info.name] = c.fit.values[at];
        }
      }
    }
    return specs;
  }

  std::vector<ParameterColumn> ScreenColumns(const sim::Plant& plant,
                                             std::vector<sysid::FitParameter>* parameters,
                                             const std::vector<EffectSpec>& specs) {
    *parameters = FreeParameters(plant, scales_, true);
    std::vector<ParameterColumn> columns;
    auto held = [&](const std::string& id, const std::string& joint) { return Contains(specs, id, joint); };
    for (const auto& p : *parameters) {
      const sim::Parameter& row = plant.parameters()[p.index];
      ParameterColumn c;
      c.prior_stddev = p.prior_stddev;
      c.base = row.kind != sim::ParameterKind::kEffect;
      const bool probe =
          (row.effect == "encoder_offset" || row.effect == "sensor_delay") && !held(row.effect, row.owner);
      if (probe) {
        c.effect = row.effect, c.role = row.field, c.joint = plant.model().FindJoint(row.owner);
      }
      columns.push_back(c);
    }
    if (!held("gravity_misalignment", "")) {
      for (const char* axis : {"gravity.x", "gravity.y"}) {
        const int at = plant.parameters().Find(axis);
        sysid::FitParameter p{at, axis, "m/s^2", plant.parameters()[at].nominal, -20, 20, 0.6};
        parameters->push_back(p);
        columns.push_back({"gravity_misalignment", axis, -1, 0.6, false});
      }
    }
    return columns;
  }

  ScreenResult ScreenAround(const Candidate& current, bool base) {
    std::vector<EffectSpec> specs = Refreshed(current);
    const std::vector<EffectSpec> own = specs;
    for (const std::string& joint : nominal_.joint_names()) {
      if (!Contains(own, "encoder_offset", joint))
        specs.push_back(effects::MakeSpec("encoder_offset", {joint}));
      if (!Contains(own, "sensor_delay", joint)) specs.push_back(effects::MakeSpec("sensor_delay", {joint}));
    }
    auto plant = sim::Plant::Create(nominal_.shared_model(), nominal_.options(), specs);
    if (!plant.ok()) return {};
    std::vector<sysid::FitParameter> parameters;
    auto columns = ScreenColumns(*plant, &parameters, own);
    // Around a model that holds, its own states and values; around a wrong one, the recorded motion.
    const bool holds = PerRow(current) < kHolds && current.fit.states.front().rows() == plant->num_states();
    VectorXd values = plant->parameters().Nominal();
    if (holds) values = plant->ValuesFrom(current.plant->parameters(), current.fit.values);
    for (size_t c = 0; c < columns.size(); ++c) {
      const sysid::FitParameter& p = parameters[c];
      if (columns[c].effect.empty()) columns[c].away = (values[p.index] - p.nominal) / p.prior_stddev;
    }
    const FitModel model{*plant, values, parameters};
    const NodeStates states = holds ? current.fit.states : InitialStates(data_, model, lifted_);
    // It hardly depends on the model: the first one's serves all.
    if (step_rule_.empty()) step_rule_ = StepRuleResiduals(data_, model, states, lifted_);
    const Screen screen = MakeScreen(data_, model, states, features_.block, lifted_, step_rule_, kNullDraws,
                                     Rng(options_.seed).Split(static_cast<uint64_t>(round_)));
    return ScoreHypotheses(screen, columns, features_, scales_, base, data_.n);
  }

  std::vector<std::string> Names(const std::vector<int>& joints) const {
    std::vector<std::string> out;
    for (const int j : joints) out.push_back(nominal_.joint_names()[j]);
    return out;
  }

  // Whether the model has this already.
  bool Known(const Candidate& current, const Scored& h) const {
    if (h.effect == "gravity_misalignment") return Contains(current.specs, h.effect, "");
    if (h.effect == "joint_coupling") {
      for (const EffectSpec& s : current.specs) {
        if (s.id == h.effect && s.joints == Names(h.joints)) return true;
      }
      return false;
    }
    for (const std::string& joint : Names(h.joints)) {
      if (Contains(current.specs, h.effect, joint)) return true;
    }
    return false;
  }

  double Threshold(const Candidate& best) const { return acceptance_.Needed(best, Explained(best)); }
  double Threshold(const Candidate& best, const Candidate& c) const {
    return acceptance_.Needed(best, Explained(best), c);
  }
  // Log evidence that the effects of a candidate bring.
  double Explained(const Candidate& c) const {
    const auto without = tried_.find(c.base ? "+base" : "");
    return c.specs.empty() || without == tried_.end() ? 0.0 : c.score - without->second.score;
  }

  // The most that any addition could bring: half of χ² above what noise alone leaves.
  double AtStake(const Candidate& c) const {
    const double noise = c.fit.rows - 2.0 * data_.n * static_cast<double>(data_.windows.size());
    return 0.5 * (c.fit.chi2 / lifted_.noise_scale - noise);
  }

  bool AddOne(Candidate* best) {
    Tell("screen", 0.1 + 0.2 * round_, KeyOf(best->specs));
    Candidate winner = *best;
    std::vector<bool> worlds = {false, true};
    for (const bool base : worlds) {
      if (Late()) break;
      if (base && PerRow(winner) < kExplained && winner.score > best->score + Threshold(*best, winner)) break;
      const Candidate* own = base == best->base ? best : OtherWorld(*best);
      if (own == nullptr || !own->fit.ok) continue;
      if (round_ > 1 && own->score < best->score - 0.5 * data_.Rows()) continue;
      // Parameters explain all: only what explains it as well with less is of interest.
      const bool rival = !base && best->base && AtStake(*best) < Threshold(*best);
      const Candidate from = *own;
      const ScreenResult screened = ScreenAround(from, base);
      acceptance_.Note(screened, nominal_.joint_names());
      Trace(screened, base);
      const double best_gain = screened.hypotheses.empty() ? 0.0 : screened.hypotheses.front().gain;
      if (AtStake(from) < Threshold(*best) && best_gain < Threshold(*best)) {
        if (base == best->base) break;  // nothing is left; freed parameters would leave less
        continue;
      }
      const double wanted = rival ? kRivalShare * (best->score - from.score) : 1.0;
      TryBest(from, Pool(from, screened, base, wanted), base, base ? 3 : 4, &winner);
    }
    if (KeyOf(winner.specs) != KeyOf(best->specs)) {
      Siblings(&winner);
      const Candidate twin = Evaluate(Refreshed(winner), !winner.base);
      if (twin.score > winner.score + (twin.base ? 1.0 : -1.0) * Threshold(*best)) winner = twin;
    }
    // Fits with hidden states end before they are done: the old model has another try from where it is, or an
    // addition would be credited with what a longer fit alone brings.
    if (winner.score > best->score && best->fit.ok && best->plant->num_states() > 2 * data_.n) {
      const Candidate longer = Evaluate(Refreshed(*best), best->base, 12);
      if (longer.score > best->score) *best = longer;
    }
    const double needed = Threshold(*best, winner);
    const bool accept = winner.score > best->score + needed;
    Tell("decide", 0.1 + 0.2 * round_,
         KeyOf(winner.specs) + " gains " + std::to_string(winner.score - best->score) + " needs " +
             std::to_string(needed));
    if (accept) *best = winner;
    return accept;
  }

  // χ² per row of an account that leaves next to nothing of what there was.
  double LeavesNothing(const SearchResult& out) const {
    return std::max(kExplained, 1 + 0.02 * (std::min(PerRow(out.nominal), PerRow(out.calibrated)) - 1));
  }

  // Whether the account is of forces over position that may be parts of an unnamed one.
  static bool OfPosition(const Candidate& c) {
    return std::any_of(c.specs.begin(), c.specs.end(), [](const EffectSpec& e) {
      return e.id == "unknown_field" || e.id == "position_spring" || e.id == "torque_ripple";
    });
  }

  // The ceiling: one unnamed force over two joints' positions in the place of all effects. It is taken where
  // it leaves less than `worst` χ² per row and is the better account.
  bool Flexible(Candidate* best, double worst) {
    if (data_.n < 2 || Late() || PerRow(*best) < kExplained) return false;
    bool taken = false;
    Tell("flexible", 0.3 + 0.15 * round_, KeyOf(best->specs));
    for (const bool base : {false, true}) {
      const auto from = tried_.find(base ? "+base" : "");
      if (from == tried_.end() || !from->second.fit.ok) continue;
      // Free base parameters only where they are part of the account.
      if (base && !best->base) continue;
      const auto spec = FieldPairStart(data_, nominal_, scales_, Force(from->second));
      if (!spec) continue;
      const std::string key = KeyOf({*spec}) + (base ? "+base" : "");
      const auto done = tried_.find(key);
      const Candidate c = done != tried_.end() ? done->second : Evaluate({*spec}, base);
      if (c.score > best->score + Threshold(*best) && PerRow(c) < worst) *best = c, taken = true;
    }
    return taken;
  }

  double PerRow(const Candidate& c) const {
    return c.fit.chi2 / std::max(1, c.fit.rows) / lifted_.noise_scale;
  }

  using Start = std::vector<EffectSpec>;

  // What is worth a trial in the simulator: the best of the screen, what it is easily taken for, and what
  // the screen cannot see.
  // Hypotheses that the screen gives less than `wanted` are left out; above 1 also what it cannot see.
  std::vector<Start> Pool(const Candidate& from, const ScreenResult& screened, bool base, double wanted) {
    std::vector<Start> pool;
    std::map<int, double> joint_gain;
    auto push = [&](const std::vector<Start>& starts) {
      pool.insert(pool.end(), starts.begin(), starts.end());
    };
    int taken = 0;
    for (const Scored& h : screened.hypotheses) {
      if (h.joints.size() == 1 && h.effect != "unknown_field") {
        joint_gain[h.joints[0]] = std::max(joint_gain[h.joints[0]], h.gain);
      }
      if (h.gain < wanted || taken >= (base ? 10 : 16) || Known(from, h)) continue;
      ++taken;
      push(SpecsFor(h, nominal_, scales_));
    }
    auto has = [&](const std::string& id) {
      return std::any_of(from.specs.begin(), from.specs.end(),
                         [&](const EffectSpec& e) { return e.id == id; });
    };
    if (!base && !has("payload")) push(BodyStarts("payload", nominal_, scales_));
    if (wanted > 1.0) return pool;
    std::vector<std::pair<double, int>> joints;
    for (const auto& [joint, gain] : joint_gain) joints.push_back({gain, joint});
    std::sort(joints.rbegin(), joints.rend());
    for (size_t i = 0; i < std::min<size_t>(3, joints.size()); ++i) {
      for (const Scored& h : screened.hypotheses) {
        const bool dry =
            h.effect == "coulomb_friction" || h.effect == "viscous_friction" || h.effect == "torque_deadband";
        if (dry && h.joints.size() == 1 && h.joints[0] == joints[i].second && !Known(from, h)) {
          push(SpecsFor(h, nominal_, scales_));
        }
      }
    }
    const size_t springy = data_.n <= 2 ? 2 : base ? 1 : 2;
    for (size_t i = 0; i < std::min(springy, joints.size()); ++i) {
      const std::string& name = nominal_.joint_names()[joints[i].second];
      if (Contains(from.specs, "joint_elasticity", name) || Contains(from.specs, "backlash", name)) continue;
      double added = 0;
      for (const Scored& h : screened.hypotheses) {
        if (h.effect == "rotor_inertia" && h.joints == std::vector<int>{joints[i].second})
          added = h.coefficients[0];
      }
      for (const char* id : {"joint_elasticity", "backlash"})
        push(TransmissionStarts(id, joints[i].second, nominal_, scales_, added));
    }
    for (const char* id : {"sloshing_payload", "base_flexibility"}) {
      if (!has(id) && (data_.n <= 2 || !base)) push(BodyStarts(id, nominal_, scales_));
    }
    if (from.fit.ok && (!has("contact") || !has("external_disturbance"))) {
      const MissingForce missing = Force(from);
      if (!has("contact")) push(ContactStarts(data_, nominal_, missing, base ? 2 : 3));
      if (!has("external_disturbance")) push(PushStarts(data_, nominal_, missing));
    }
    return pool;
  }

  // Trials on some windows with few iterations; the best of them on all.
  void TryBest(const Candidate& from, const std::vector<Start>& pool, bool base, size_t full,
               Candidate* winner) {
    const FitData some = SomeWindows();
    const double reference = Coarse(some, Refreshed(from), base).fit.evidence;
    std::vector<std::pair<double, std::vector<EffectSpec>>> ranked;
    std::set<std::string> seen;
    for (const Start& start : pool) {
      if (Late()) break;
      std::vector<EffectSpec> specs = Joined(Refreshed(from), start);
      Candidate c = Coarse(some, specs, base);
      if (!c.fit.ok) continue;
      const double score = c.fit.evidence - StructurePrior(specs, base);
      if (score < reference - 2) continue;
      ranked.push_back({score, Refreshed(c)});
      TraceFit(c, "  ~");
    }
    std::sort(ranked.begin(), ranked.end(), [](auto& a, auto& b) { return a.first > b.first; });
    size_t done = 0;
    for (const auto& [score, specs] : ranked) {
      if (done >= full || Late()) break;
      if (!seen.insert(KeyOf(specs)).second) continue;
      ++done;
      const Candidate c = Evaluate(specs, base);
      if (c.score > winner->score) *winner = c;
    }
  }

  FitData SomeWindows() const {
    const size_t wanted = data_.n <= 2 ? 24 : 14;
    FitData some = data_;
    if (data_.windows.size() <= wanted) return some;
    some.windows.clear();
    for (size_t i = 0; i < wanted; ++i)
      some.windows.push_back(data_.windows[i * data_.windows.size() / wanted]);
    return some;
  }

  Candidate Coarse(const FitData& some, const std::vector<EffectSpec>& specs, bool base) {
    Candidate c;
    c.specs = specs, c.base = base;
    auto plant = sim::Plant::Create(nominal_.shared_model(), nominal_.options(), specs);
    if (!plant.ok()) return c;
    c.plant = std::make_shared<const sim::Plant>(*plant);
    c.parameters = FreeParameters(*c.plant, scales_, base);
    LiftedOptions options = lifted_;
    options.iterations = 4;
    c.fit = Fit(some, {*c.plant, c.plant->parameters().Nominal(), c.parameters}, options);
    return c;
  }

  // The winner with its newest effect exchanged for what it is easily taken for, on the same joints.
  void Siblings(Candidate* winner) {
    const std::vector<EffectSpec> specs = Refreshed(*winner);
    if (specs.empty()) return;
    const std::string id = specs.back().id;
    const std::vector<std::string> siblings = SiblingsOf(id);
    for (const std::string& sibling : siblings) {
      if (sibling == id || Late()) continue;
      std::vector<EffectSpec> other;
      for (const EffectSpec& s : specs)
        other.push_back(s.id == id ? Exchanged(s, sibling, nominal_, scales_) : s);
      const std::string key = KeyOf(other) + (winner->base ? "+base" : "");
      if (tried_.count(key)) continue;
      const Candidate c = Evaluate(other, winner->base);
      if (c.score > winner->score) *winner = c;
    }
  }

  const Candidate* OtherWorld(const Candidate& c) const {
    const auto it = tried_.find(KeyOf(c.specs) + (c.base ? "" : "+base"));
    return it == tried_.end() ? nullptr : &it->second;
  }

  // Takes out, one by one, what the data do not pay for.
  void Prune(Candidate* best) {
    bool changed = true;
    while (changed && best->specs.size() > 1 && !Late()) {
      changed = false;
      for (size_t i = 0; i < best->specs.size(); ++i) {
        // Worth a fit only if its strength is within a few stddev of nothing.
        if (Strength(*best, i) > 4.0) continue;
        std::vector<EffectSpec> specs = Refreshed(*best);
        specs.erase(specs.begin() + static_cast<long>(i));
        const Candidate c = Evaluate(specs, best->base, 4);
        if (c.score > best->score) {
          *best = c;
          changed = true;
          break;
        }
      }
    }
  }

  // |strength − none| in its stddev.
  double Strength(const Candidate& c, size_t i) const {
    static const std::set<std::string> kStrengths = {"viscous",
                                                     "coulomb",
                                                     "coulomb_positive",
                                                     "coulomb_negative",
                                                     "static",
                                                     "load_coefficient",
                                                     "quadratic",
                                                     "delay",
                                                     "time_constant",
                                                     "gain",
                                                     "deadband",
                                                     "amplitude",
                                                     "armature",
                                                     "mass",
                                                     "tilt",
                                                     "offset",
                                                     "stiffness",
                                                     "initial",
                                                     "final",
                                                     "torque",
                                                     "coefficient",
                                                     "gap",
                                                     "cubic"};
    const EffectSpec& s = c.specs[i];
    double most = 0;
    bool any = false;
    for (size_t k = 0; k < c.parameters.size(); ++k) {
      const sim::Parameter& p = c.plant->parameters()[c.parameters[k].index];
      if (p.effect != s.id || kStrengths.count(p.field) == 0) continue;
      if (!s.joints.empty() && p.owner != "*" &&
          std::find(s.joints.begin(), s.joints.end(), p.owner) == s.joints.end())
        continue;
      const double none = p.field == "gain" ? 1 : 0, sd = std::max(1e-12, c.fit.stddev[static_cast<long>(k)]);
      most = std::max(most, std::abs(c.fit.theta[static_cast<long>(k)] - none) / sd);
      any = true;
    }
    return any ? most : 1e9;
  }

  void Trace(const ScreenResult& s, bool base) const {
    if (std::getenv("RG_DIAGNOSIS_TRACE") == nullptr) return;
    std::fprintf(stderr, "[%6.2f]  screen base=%d null %.1f:", clock_.SteadySeconds() - start_, base,
                 s.null_gain);
    for (size_t i = 0; i < std::min<size_t>(8, s.hypotheses.size()); ++i) {
      const Scored& h = s.hypotheses[i];
      std::fprintf(stderr, "  %s[", h.effect.c_str());
      for (const int j : h.joints) std::fprintf(stderr, "%d", j + 1);
      std::fprintf(stderr, "] %.1f", h.gain);
    }
    std::fprintf(stderr, "\n");
  }

  const FitData& data_;
  const sim::Plant& nominal_;
  const MotionScales& scales_;
  const DiagnosisOptions& options_;
  const Clock& clock_;
  const ProgressFn& progress_;
  const CancelToken* cancel_;
  LiftedOptions lifted_;
  double start_ = 0;
  int round_ = 0;
  Acceptance acceptance_;
  std::vector<VectorXd> step_rule_;
  FeatureSet features_;
  std::map<std::string, Candidate> tried_;
};

}  // namespace

SearchResult SearchEffects(const FitData& data, const sim::Plant& nominal, const MotionScales& scales,
                           const DiagnosisOptions& options, int threads, const Clock& clock,
                           const ProgressFn& progress, const CancelToken* cancel) {
  return Search(data, nominal, scales, options, threads, clock, progress, cancel).Run();
}

}  // namespace rg::diagnosis
