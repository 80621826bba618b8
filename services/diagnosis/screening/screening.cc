#include "services/diagnosis/screening/screening.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <set>
#include <tuple>

#include "common/effects/effect_catalog.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/likelihood/candidate.h"

namespace rg::diagnosis {

using effects::EffectInfo;
using effects::Inference;
using effects::Regressor;
using effects::Term;

namespace {

constexpr double kNullQuantile = 0.98;
constexpr double kLeastOfOne = 0.25, kMostOfOne = 4;  // range of a coefficient that is one at the right shape
constexpr size_t kGrown = 8;                          // width of the forward selection of joints: effects
constexpr size_t kPaired = 16;  // width of the forward selection of second effects: hypotheses

// The columns of one hypothesis: each coefficient multiplies a sum of standardised columns.
struct Group {
  std::string effect;
  std::vector<int> joints;
  std::vector<std::vector<int>> columns;
  std::vector<double> scale;  // coefficient in SI per standardised unit
  double shape = 0, shape_end = 0;
  std::map<std::string, std::string> options = {};
  double search = 0;  // log of the number of shapes tried
  bool positive = false;
  bool load = false;                  // the first coefficient is a mass
  double low = -1e300, high = 1e300;  // admissible standardised coefficients
};

// Whether some coefficient must be positive: of a force's terms, or the parameter that shows the effect.
bool HasSign(const EffectInfo& effect) {
  const auto& terms = effects::InferenceOf(effect.id).terms;
  return terms.empty() ? effect.parameters[0].lower >= 0
                       : std::ranges::any_of(terms, [](const Term& t) { return t.positive; });
}

class Scorer {
 public:
  Scorer(const Screen& screen, const std::vector<ParameterColumn>& columns, const FeatureSet& features,
         bool base_free, const sim::Plant& plant)
      : columns_(columns), features_(features), plant_(plant), n_(plant.num_joints()) {
    Project(screen, base_free);
    MakeGroups();
  }

  ScreenResult Run(const Screen& screen) {
    std::map<std::tuple<std::string, std::vector<int>, std::map<std::string, std::string>>, Scored> best;
    for (const Group& g : groups_) {
      const Solved solved = Solve(g, G_);
      Scored s = Score(g, solved, b_, true);
      s.step_rule = 0.5 * Score(g, solved, step_rule_, false).chi2;
      if (!std::isfinite(s.gain)) continue;
      auto [it, fresh] = best.try_emplace({g.effect, g.joints, g.options}, s);
      if (!fresh && s.gain > it->second.gain) it->second = s;
    }
    ScreenResult out;
    for (auto& [key, s] : best) out.hypotheses.push_back(s);
    std::ranges::sort(out.hypotheses, [](const Scored& a, const Scored& b) { return a.gain > b.gain; });
    out.null_gain = NullGain();
    out.chi2 = chi2_, out.evidence = -0.5 * chi2_ - log_det_;
    out.rows = screen.rows, out.work = screen.work, out.unknowns = screen.force_unknowns;
    Combine(&out);
    return out;
  }

 private:
  // Projects the nuisance parameters out of Gram matrix, right-hand side, null draws and step-rule response.
  void Project(const Screen& screen, bool base_free) {
    const int P = screen.parameters, C = screen.features, D = P + C;
    std::vector<int> own, free;
    VectorXd unit = VectorXd::Ones(D);
    for (int c = 0; c < P; ++c) {
      unit[c] = columns_[c].prior_stddev;
      if (!columns_[c].effect.empty() || (columns_[c].last_link && !base_free)) {
        free.push_back(c);
      } else if (!columns_[c].base || base_free) {
        own.push_back(c);
      }
    }
    for (int c = 0; c < C; ++c) free.push_back(P + c);
    place_.assign(D, -1);
    for (size_t i = 0; i < free.size(); ++i) place_[free[i]] = static_cast<int>(i);
    const auto F = std::ssize(free), B = std::ssize(own);
    const auto scaled = [&](const auto& x) -> MatrixXd { return unit.asDiagonal() * x; };
    const MatrixXd gram = scaled(screen.gram.topLeftCorner(D, D)) * unit.asDiagonal();
    const VectorXd right = scaled(screen.gram.col(D).head(D));
    const MatrixXd null = scaled(screen.null);
    const VectorXd step_rule = scaled(screen.step_rule);
    G_ = gram(free, free), b_ = right(free);
    chi2_ = screen.gram(D, D), log_det_ = screen.force_log_det;
    null_ = null(free, Eigen::all), step_rule_ = step_rule(free);
    if (B > 0) {
      MatrixXd Gbb = gram(own, own), Gbf(B, F + 1);
      Gbf << gram(own, free), right(own);
      for (int i = 0; i < B; ++i) Gbf(i, F) -= columns_[own[i]].away;
      Gbb.diagonal().array() += 1.0;
      const Eigen::LDLT<MatrixXd> precision(Gbb);
      const MatrixXd X = precision.solve(Gbf);
      G_ -= Gbf.leftCols(F).transpose() * X.leftCols(F);
      b_ -= Gbf.leftCols(F).transpose() * X.col(F);
      for (int i = 0; i < B; ++i) chi2_ += columns_[own[i]].away * columns_[own[i]].away;
      chi2_ -= Gbf.col(F).dot(X.col(F)), log_det_ += 0.5 * precision.vectorD().array().log().sum();
      null_ -= Gbf.leftCols(F).transpose() * precision.solve(MatrixXd(null(own, Eigen::all)));
      step_rule_ -= Gbf.leftCols(F).transpose() * precision.solve(VectorXd(step_rule(own)));
    }
    feature_start_ = P;
  }

  int Find(Regressor regressor, int joint, double shape, int other = -1) const {
    for (size_t c = 0; c < features_.features.size(); ++c) {
      const Feature& f = features_.features[c];
      if (f.joint == joint && f.regressor == regressor && f.other == other && f.shape == shape)
        return place_[feature_start_ + static_cast<int>(c)];
    }
    return -1;
  }
  double ScaleOf(int place) const {
    for (size_t c = 0; c < place_.size(); ++c) {
      if (place_[c] != place) continue;
      if (static_cast<int>(c) < feature_start_) return columns_[c].prior_stddev;
      const size_t i = c - static_cast<size_t>(feature_start_), joint_features = features_.features.size();
      return i < joint_features ? features_.features[i].scale : features_.surfaces[i - joint_features].scale;
    }
    return 1;
  }

  std::vector<double> Shapes(Regressor regressor, int joint) const {
    std::vector<double> out;
    for (const Feature& f : features_.features) {
      if (f.regressor == regressor && f.joint == joint) out.push_back(f.shape);
    }
    return out;
  }

  void Push(Group g) {
    if (g.columns.empty()) return;  // a prescribed joint has no features
    for (const auto& c : g.columns) {
      for (const int i : c) {
        if (i < 0) return;
      }
      if (c.empty()) return;
      g.scale.push_back(ScaleOf(c.front()));
    }
    g.positive = HasSign(*effects::FindEffect(g.effect));
    groups_.push_back(std::move(g));
  }

  void MakeGroups() {
    for (const EffectInfo& effect : effects::Catalog()) {
      const Inference& own = effects::InferenceOf(effect.id);
      for (int j = 0; j < n_; ++j) {
        if (!own.terms.empty()) JointGroups(effect, own, j);
      }
      if (n_ > 1 && own.terms.size() == 1 && (own.common || own.of_every_drive)) AllJointGroups(effect, own);
    }
    SurfaceGroups();
    ParameterGroups();
  }

  void SurfaceGroups() {
    const size_t first = feature_start_ + features_.features.size();
    for (size_t i = 0; i < features_.surfaces.size(); ++i) {
      const SurfaceFeature& surface = features_.surfaces[i];
      Group g{effects::Surface().id, {}, {{place_[first + i]}}, {}, surface.height};
      g.options = surface.options;
      g.search = std::log(static_cast<double>(features_.surfaces.size()));
      Push(g);
    }
  }

  void JointGroups(const EffectInfo& effect, const Inference& own, int j) {
    const Regressor law = own.terms.back().regressor;
    if (law == Regressor::kOtherEffort) {
      for (int other = 0; other < n_; ++other) {
        Group g{effect.id, {other, j}, {{Find(law, j, 0, other)}}, {}};
        g.search = std::log(std::max(1.0, n_ - 1.0));
        if (other != j) Push(g);
      }
    } else if (law == Regressor::kPulse) {
      Pulses(effect.id, j);
    } else if (own.pieces) {
      Group g{effect.id, {j}, {}, {}};
      for (const Term& t : own.terms) {
        for (const double s : Shapes(t.regressor, j)) g.columns.push_back({Find(t.regressor, j, s)});
      }
      Push(g);
    } else {
      const auto shapes = Shapes(law, j);
      for (const double s : shapes) Push(Shaped(effect.id, own, j, s, shapes));
    }
  }

  // An effect on a joint at one of its shapes; terms that belong to a plainer law have none.
  Group Shaped(const std::string& id, const Inference& own, int j, double s,
               const std::vector<double>& shapes) const {
    using Near = Inference::Near;
    Group g{id, {j}, {}, {}, s};
    g.search = std::log(static_cast<double>(shapes.size()));
    for (const Term& t : own.terms)
      g.columns.push_back({Find(t.regressor, j, effects::LawOf(t.regressor).id == id ? s : 0)});
    if (own.coefficient == Near::kAny) return g;
    const bool open = (own.coefficient == Near::kOneOrBelowFirst && s == shapes.front()) ||
                      (own.coefficient == Near::kOneOrBelowLast && s == shapes.back());
    g.low = open ? 0 : kLeastOfOne, g.high = kMostOfOne;
    return g;
  }

  void Pulses(const std::string& id, int j) {
    const auto bins = Shapes(Regressor::kPulse, j);
    const double width = bins.size() > 1 ? bins[1] - bins[0] : 1;
    for (size_t a = 0; a < bins.size(); ++a) {
      std::vector<int> run;
      for (size_t b = a; b < std::min(bins.size(), a + 6); ++b) {
        run.push_back(Find(Regressor::kPulse, j, bins[b]));
        Group g{id, {j}, {run}, {}, bins[a], bins[b] + width};
        g.search = std::log(6.0 * static_cast<double>(bins.size()));
        Push(g);
      }
    }
  }

  // Effects that are parameters of the plant: of a sensor on its joint or on all, gravity's direction,
  // payload.
  void ParameterGroups() {
    std::map<std::string, Group> on_all, of_robot;
    for (size_t c = 0; c < columns_.size(); ++c) {
      const ParameterColumn& p = columns_[c];
      if (p.effect.empty()) continue;
      if (p.joint < 0) {
        of_robot[p.effect].columns.push_back({place_[c]});
        continue;
      }
      Push({p.effect, {p.joint}, {{place_[c]}}, {}});
      if (n_ < 2 || !effects::InferenceOf(p.effect).common) continue;
      on_all.try_emplace(p.effect, Group{p.effect, Takers(p.effect), {{}}, {}});
      on_all[p.effect].columns[0].push_back(place_[c]);
    }
    for (auto& [id, g] : on_all) Push(g);
    for (auto& [id, g] : of_robot) g.effect = id, Push(g);
    Group payload{effects::EffectOf(effects::Role::kBodyInertia).id, {}, {}, {}};
    for (const std::string_view role : model::kLinkParameterNames) {
      for (size_t c = 0; c < columns_.size(); ++c) {
        if (columns_[c].last_link && columns_[c].role == role && place_[c] >= 0)
          payload.columns.push_back({place_[c]});
      }
    }
    payload.load = true;
    if (payload.columns.size() == model::kLinkParameters) Push(payload);
  }

  std::vector<int> Takers(const std::string& effect) const {
    std::vector<int> out;
    for (int j = 0; j < n_; ++j) {
      if (plant_.Takes(effect, j)) out.push_back(j);
    }
    return out;
  }

  // The same effect on every joint that takes it: with one coefficient for all, or one each.
  void AllJointGroups(const EffectInfo& effect, const Inference& own) {
    const std::vector<int> all = Takers(effect.id);
    if (all.size() < 2) return;
    const Regressor law = own.terms[0].regressor;
    const auto shapes = Shapes(law, all[0]);
    for (const double s : shapes) {
      Group common{effect.id, all, {{}}, {}, s}, each{effect.id, all, {}, {}, s};
      for (const int j : all) {
        const int place = Find(law, j, s);
        common.columns[0].push_back(place);
        each.columns.push_back({place});
      }
      common.search = each.search = std::log(static_cast<double>(shapes.size()));
      if (s > 0) common.low = kLeastOfOne, common.high = kMostOfOne;
      if (own.common) Push(common);
      if (s == 0) Push(each);
    }
  }

  // Of each coefficient the sum over its columns.
  static VectorXd Totals(const VectorXd& b, const std::vector<std::vector<int>>& columns) {
    VectorXd out = VectorXd::Zero(std::ssize(columns));
    for (size_t i = 0; i < columns.size(); ++i) {
      for (const int c : columns[i]) out[i] += b[c];
    }
    return out;
  }

  struct Solved {
    MatrixXd inverse;  // (G + 1)⁻¹
    double log_det = 0;
  };
  static Solved Solve(const Group& g, const MatrixXd& G) {
    const int m = static_cast<int>(g.columns.size());
    MatrixXd H(m, m);
    for (int i = 0; i < m; ++i) {
      for (int k = 0; k < m; ++k) {
        double sum = 0;
        for (const int a : g.columns[i]) {
          for (const int b : g.columns[k]) sum += G(a, b);
        }
        H(i, k) = sum;
      }
    }
    H.diagonal().array() += 1.0;
    const Eigen::LLT<MatrixXd> llt(H);
    Solved s;
    s.inverse = llt.solve(MatrixXd::Identity(m, m));
    for (int i = 0; i < m; ++i) s.log_det += 2 * std::log(std::max(1e-12, llt.matrixL()(i, i)));
    return s;
  }

  // `c`: standardised coefficients of the group.
  static Scored Found(const Group& g, const VectorXd& c) {
    Scored s;
    s.effect = g.effect, s.joints = g.joints, s.options = g.options;
    s.shape = g.shape, s.shape_end = g.shape_end;
    for (long k = 0; k < c.size(); ++k) s.coefficients.push_back(c[k] * g.scale[k]);
    return s;
  }

  static Scored Score(const Group& g, const Solved& solved, const VectorXd& b, bool admissible) {
    const VectorXd rhs = Totals(b, g.columns);
    const VectorXd c = solved.inverse * rhs;
    Scored s = Found(g, c);
    s.chi2 = rhs.dot(c);
    s.gain = 0.5 * s.chi2 - 0.5 * solved.log_det - g.search;
    if (admissible && !Admissible(g, c)) s.gain = -std::numeric_limits<double>::infinity();
    return s;
  }

  static bool Admissible(const Group& g, const VectorXd& c) {
    if (g.positive && c.maxCoeff() <= 0) return false;
    if (g.load && c[0] <= 0) return false;
    return c[c.size() - 1] >= g.low && c[c.size() - 1] <= g.high;
  }

  // The normal equations with some groups projected out, each under its prior.
  struct Reduced {
    MatrixXd G;
    VectorXd b;
    std::vector<int> groups;
    double gain = 0;
  };

  void Add(int index, Reduced* r) const {
    const Group& g = groups_[index];
    const Solved solved = Solve(g, r->G);
    const int m = static_cast<int>(g.columns.size());
    MatrixXd C = MatrixXd::Zero(r->G.rows(), m);
    for (int i = 0; i < m; ++i) {
      for (const int a : g.columns[i]) C.col(i) += r->G.col(a);
    }
    r->gain += Score(g, solved, r->b, false).gain - Structure(g, r->groups);
    r->b.noalias() -= C * (solved.inverse * Totals(r->b, g.columns));
    r->G.noalias() -= C * (solved.inverse * C.transpose());
    r->groups.push_back(index);
  }

  double Structure(const Group& g, const std::vector<int>& chosen) const {
    double cost = StructurePrior({EffectSpec{g.effect}}, false) *
                  std::max<double>(1.0, static_cast<double>(g.joints.size()));
    cost -= kEffectPrior * (std::max<double>(1.0, static_cast<double>(g.joints.size())) - 1);
    for (const int other : chosen) {
      if (groups_[other].effect == g.effect) return cost - kEffectPrior;
    }
    return cost;
  }

  // The group with the largest positive gain after those in `r`, among the groups admitted; −1: none.
  template <class Admit>
  int Next(const Reduced& r, const Admit& admit) const {
    int next = -1;
    double most = 0;
    for (size_t i = 0; i < groups_.size(); ++i) {
      const Group& g = groups_[i];
      if (!admit(g) || Overlaps(g, r.groups)) continue;
      const double gain = Score(g, Solve(g, r.G), r.b, true).gain - Structure(g, r.groups);
      if (gain > most) most = gain, next = static_cast<int>(i);
    }
    return next;
  }

  bool Overlaps(const Group& g, const std::vector<int>& chosen) const {
    for (const int c : chosen) {
      const Group& other = groups_[c];
      if (other.effect != g.effect) continue;
      if (other.joints == g.joints) return true;
      if (effects::FindEffect(g.effect)->scope == effects::Scope::kJointPair) continue;
      for (const int j : g.joints) {
        if (std::ranges::find(other.joints, j) != other.joints.end()) return true;
      }
    }
    return false;
  }

  // All groups solved jointly; false where a sign or a range is violated.
  bool Together(const Reduced& r, Combination* out) const {
    Group all;
    for (const int i : r.groups) {
      const Group& g = groups_[i];
      all.columns.insert(all.columns.end(), g.columns.begin(), g.columns.end());
    }
    const Solved solved = Solve(all, G_);
    const VectorXd c = solved.inverse * Totals(b_, all.columns);
    long at = 0;
    for (const int i : r.groups) {
      const Group& g = groups_[i];
      const VectorXd own = c.segment(at, static_cast<long>(g.columns.size()));
      if (!Admissible(g, own)) return false;
      out->parts.push_back(Found(g, own));
      at += own.size();
    }
    out->gain = r.gain;
    return true;
  }

  // Forward selection in the linear model: of joints for each effect, and of a second effect for the best
  // hypotheses. An effect that a larger one hides shows only together with that.
  void Combine(ScreenResult* out) const {
    // A spring's columns are no start of a fit: it is looked at alone.
    const auto named = [](const Group& g) {
      return !IsUnnamed(g.effect) && !effects::IsIn(effects::Slot::kTransmission, g.effect);
    };
    std::vector<std::pair<double, int>> first;
    for (size_t i = 0; i < groups_.size(); ++i) {
      if (!named(groups_[i])) continue;
      const double gain = Score(groups_[i], Solve(groups_[i], G_), b_, true).gain - Structure(groups_[i], {});
      if (gain > 0) first.push_back({gain, static_cast<int>(i)});
    }
    std::ranges::sort(first, [](const auto& a, const auto& b) {
      return a.first > b.first || (a.first == b.first && a.second < b.second);
    });
    std::set<std::string> grown;
    std::set<std::pair<std::string, std::vector<int>>> paired;
    for (const auto& [gain, index] : first) {
      const Group& g = groups_[index];
      const bool grows = grown.size() < kGrown && g.joints.size() == 1 && grown.insert(g.effect).second;
      const bool pairs = paired.size() < kPaired && paired.insert({g.effect, g.joints}).second;
      if (!grows && !pairs) continue;
      Reduced alone{G_, b_, {}, 0};
      Add(index, &alone);
      if (pairs) {
        const int next = Next(alone, [&](const Group& o) { return named(o) && o.effect != g.effect; });
        if (next >= 0) {
          Reduced r = alone;
          Add(next, &r);
          Combination c;
          if (Together(r, &c)) out->pairs.push_back(std::move(c));
        }
      }
      while (grows && static_cast<int>(alone.groups.size()) < n_) {
        const int next =
            Next(alone, [&](const Group& o) { return o.effect == g.effect && o.joints.size() == 1; });
        if (next < 0) break;
        Add(next, &alone);
        Combination c;
        if (Together(alone, &c)) out->sets.push_back(std::move(c));
      }
    }
    for (auto* list : {&out->sets, &out->pairs}) {
      std::ranges::stable_sort(*list,
                               [](const Combination& a, const Combination& b) { return a.gain > b.gain; });
    }
  }

  double NullGain() const {
    std::vector<Solved> solved;
    for (const Group& g : groups_) solved.push_back(Solve(g, G_));
    std::vector<double> largest;
    for (int draw = 0; draw < null_.cols(); ++draw) {
      const VectorXd b = null_.col(draw);
      double best = -1e300;
      for (size_t g = 0; g < groups_.size(); ++g) {
        if (IsUnnamed(groups_[g].effect)) continue;
        best = std::max(best, Score(groups_[g], solved[g], b, false).gain);
      }
      largest.push_back(best);
    }
    if (largest.empty()) return 0;
    std::ranges::sort(largest);
    return largest[static_cast<size_t>(kNullQuantile * (static_cast<double>(largest.size()) - 1))];
  }

  const std::vector<ParameterColumn>& columns_;
  const FeatureSet& features_;
  const sim::Plant& plant_;
  int n_;
  int feature_start_ = 0;
  double chi2_ = 0, log_det_ = 0;
  std::vector<int> place_;
  MatrixXd G_;
  VectorXd b_, step_rule_;
  MatrixXd null_;
  std::vector<Group> groups_;
};

}  // namespace

ScreenResult ScoreHypotheses(const Screen& screen, const std::vector<ParameterColumn>& columns,
                             const FeatureSet& features, bool base_free, const sim::Plant& plant) {
  return Scorer(screen, columns, features, base_free, plant).Run(screen);
}

}  // namespace rg::diagnosis
