#include "services/diagnosis/search/fit_requests.h"

#include <algorithm>

#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/likelihood/followed_fit.h"
#include "services/diagnosis/likelihood/jumps.h"
#include "services/diagnosis/likelihood/some_windows.h"
#include "services/diagnosis/likelihood/swing_starts.h"

namespace rg::diagnosis {

using Eigen::VectorXd;

namespace {

constexpr int kFollowed = 3;        // rounds over all windows with a pendulum; over some: one
constexpr double kOnTheWay = 0.05;  // of the cost in one iteration, for a fit to pieces to go on
constexpr size_t kWindowsOnTheWay = 32;
constexpr size_t kFewWindows = 16;      // to which a fit from far off is made first
constexpr size_t kManyWindows = 48;     // windows, from which on that saves time
constexpr int kIterationsFromNear = 4;  // at least, of the fit to all windows after that

// As many of them as a fit needs to find its way.
std::vector<NodeWindow> Spread(const std::vector<NodeWindow>& windows, size_t count) {
  std::vector<NodeWindow> out;
  for (const uint32_t i : EvenlySpread(windows.size(), count)) out.push_back(windows[i]);
  return out;
}

// A fit that begins at the recorded motion, far from the record as a rule. A few windows, evenly spread, tell
// the parameters nearly as well as all of them do: most iterations are made on these.
FitResult FitFromRecord(const FitData& data, FitModel model, LiftedOptions options) {
  if (data.windows.size() < data.WindowsFor(kManyWindows) || options.iterations <= kIterationsFromNear)
    return Fit(data, model, options);
  FitData few = data;
  few.windows = Spread(data.windows, data.WindowsFor(kFewWindows));
  LiftedOptions there = options;
  there.to_beat = 0;
  const FitResult start = Fit(few, model, there);
  if (start.ok) {
    model.values = start.values;
    options = AsFitted(options, start);
    options.more_iterations += options.iterations - kIterationsFromNear;
    options.iterations = kIterationsFromNear;
  }
  FitResult fit = Fit(data, model, options);
  fit.work += start.work;
  return fit;
}

// Base parameters found without a hidden state absorb some of its effect, those of the URDF are off:
// continues from whichever fits better after one step.
FitResult FitFromEither(const FitData& data, FitModel model, const LiftedOptions& options) {
  LiftedOptions once = KeepingStep(options);
  once.iterations = std::min(1, options.iterations), once.more_iterations = 0;
  FitModel nominal = model;
  for (const sysid::FitParameter& p : model.parameters) {
    if (model.plant.parameters()[p.index].kind != sim::ParameterKind::kEffect)
      nominal.values[p.index] = p.nominal;
  }
  const FitResult bent = Fit(data, model, once), given = Fit(data, nominal, once);
  const auto cost = [&](const FitResult& f) { return f.chi2 / options.noise_scale + f.prior_cost; };
  const bool back = given.ok && (!bent.ok || cost(given) < cost(bent));
  const FitResult& near = back ? given : bent;
  if (options.iterations + options.more_iterations == 0) {  // a look
    FitResult look = near;
    look.work = bent.work + given.work;
    return look;
  }
  if (near.ok) model.values = near.values;
  FitResult fit = Fit(data, model, options, near.ok ? &near.states : nullptr);
  fit.work += bent.work + given.work;
  return fit;
}

FitResult FitOn(const FitData& data, const Candidate& c, const FitRequest& request) {
  FitModel model{*c.plant, c.plant->parameters().Nominal(), c.parameters};
  const Candidate* from = request.from.get();
  if (c.base && from != nullptr && from->base) {
    const VectorXd nominal = model.values;
    model.values = c.plant->ValuesFrom(from->plant->parameters(), from->fit.values);
    for (int i = 0; i < nominal.size(); ++i) {
      if (c.plant->parameters()[i].kind == sim::ParameterKind::kEffect) model.values[i] = nominal[i];
    }
  }
  WidenPoint(*c.plant, &model.values);
  const bool hidden = HasHiddenStates(c);
  FitResult fit;
  double work = 0;
  for (double piece = hidden ? 0 : request.piece_s; piece > 0; piece *= kLongerPiece) {
    if (piece > kLongestPiece * data.nodes.window_s) break;
    FitData pieces = data;
    pieces.windows =
        InPieces(Spread(data.windows, data.WindowsFor(kWindowsOnTheWay)), piece, data.RowNoise());
    LiftedOptions options = request.pieces_alone ? request.options : KeepingStep(request.options);
    // Full convergence on pieces gains nothing on the way to longer ones.
    if (!request.pieces_alone) options.still_falling = std::max(options.still_falling, kOnTheWay);
    fit = Fit(pieces, model, options);
    work += fit.work;
    if (fit.ok) model.values = fit.values;
    if (!request.pieces_alone) continue;
    fit.states.clear(), fit.window_chi2.clear();  // of pieces, which nobody else knows
    return fit;
  }
  if (HasPendulum(c.specs) && (from == nullptr || from->fit.states.empty() || !HasPendulum(from->specs))) {
    fit = FitFollowed(data, model, request.options, request.places.empty() ? kFollowed : 1);
  } else if (hidden && c.base && from != nullptr && from->fit.states.empty()) {
    fit = FitFromEither(data, model, request.options);
  } else if (from == nullptr || from->fit.states.empty()) {
    fit = FitFromRecord(data, model, request.options);
  } else {
    NodeStates states = from->fit.states;
    if (!request.places.empty()) {
      states.clear();
      for (const uint32_t i : request.places) states.push_back(from->fit.states[i]);
    }
    const LiftedOptions options = AsFitted(request.options, from->fit);
    const NodeStates start = CarriedStates(data, model, *from->plant, states, options);
    fit = Fit(data, model, options, &start);
  }
  fit.work += work;
  return fit;
}

class LocalBatch final : public FitBatch {
 public:
  LocalBatch(const FitSetting& setting, std::vector<FitRequest> requests)
      : setting_(setting), requests_(std::move(requests)) {}
  FitResult Take(size_t i) override { return MakeFit(setting_, requests_[i]); }

 private:
  FitSetting setting_;
  std::vector<FitRequest> requests_;
};

}  // namespace

Candidate Unfitted(const FitSetting& setting, const std::vector<effects::EffectSpec>& specs, bool base) {
  Candidate c;
  c.specs = specs, c.base = base;
  auto plant = sim::Plant::Create(setting.nominal.shared_model(), setting.nominal.options(), specs);
  if (!plant.ok()) return c;
  c.plant = std::make_shared<const sim::Plant>(*plant);
  c.parameters = FreeParameters(*c.plant, setting.scales, base, &setting.nominal);
  return c;
}

FitResult MakeFit(const FitSetting& setting, const FitRequest& request) {
  const Candidate c = Unfitted(setting, request.specs, request.base);
  if (c.plant == nullptr) return {};
  if (request.places.empty()) {
    FitResult fit = FitOn(setting.data, c, request);
    if (!fit.ok || request.pieces_alone || !HasMassInSprings(c.specs)) return fit;
    const LiftedOptions options = AsFitted(request.options, fit);
    return WithJumps(setting.data, *c.plant, std::move(fit), options);
  }
  return FitOn(setting.data.OnWindows(request.places), c, request);
}

std::unique_ptr<FitBatch> LocalFits::Start(const FitSetting& setting, std::vector<FitRequest> requests) {
  return std::make_unique<LocalBatch>(setting, std::move(requests));
}

}  // namespace rg::diagnosis
