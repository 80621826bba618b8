#include "services/diagnosis/search/pendulum_search.h"

#include <algorithm>
#include <cmath>

#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/likelihood/some_windows.h"
#include "services/diagnosis/likelihood/swing_starts.h"

namespace rg::diagnosis {

using effects::EffectSpec;

namespace {

constexpr double kPendulumShare = 0.8;   // of the work limit
constexpr size_t kPendulumWindows = 14;  // evenly spread, on which a pendulum is tried
constexpr double kTypically = 0.7;       // of these windows; the start of the others may be lost
constexpr double kLonger = 2.2;          // times a pendulum's length, that is tried too
constexpr double kSameFit = 0.02;        // of χ², within which two fits count as the same
constexpr double kAstray = 10.0;  // times a trial's misfit, above which its fit on all windows was lost
constexpr double kNoNearer =
    2.0;  // times kConsistent: a pendulum whose trial leaves more is not fitted on all windows

// The one among these effects.
const EffectSpec& MassIn(const TrialSpecs& specs) {
  return *std::ranges::find_if(specs, [](const EffectSpec& s) { return s.id == effects::SwingingMass().id; });
}

std::string HingeOf(const EffectSpec& rod) { return rod.options.at("hinge"); }

// The same with the pendulum about another axis.
TrialSpecs About(const EffectSpec& hinge, TrialSpecs specs) {
  for (EffectSpec& s : specs) {
    if (s.id == effects::SwingingMass().id) s.options["hinge"] = HingeOf(hinge);
  }
  return specs;
}

}  // namespace

void PendulumSearch::Run(Candidate* found) {
  if (!MayBeOne(*found) || SpringsHold()) return;
  springs_ = Springs();
  Begin(RodStarts(setting_.data, setting_.nominal, MassIn(springs_)).front(),
        EvenlySpread(setting_.data.windows.size(), setting_.data.WindowsFor(kPendulumWindows)));
  TryLengths();
  // A true pendulum explains something about any hinge.
  if (!(nearest_.left - 1 < kSwings * missing_)) return;
  TryHinges();
  if (!(nearest_.left > kNoNearer * kConsistent)) FitWhole(found);
}

// A swinging mass is ruled out beside an unnamed force, and where a model tried so far, admissible or not,
// leaves far less than the mass in springs; or free base parameters, or one force over two positions, do.
bool PendulumSearch::MayBeOne(const Candidate& found) {
  double least = fits_.PerRow(found);
  for (const auto& [key, c] : fits_.tried()) {
    const bool unnamed = HasUnnamed(c) && !c.fit.ok;
    const bool swinging = HasKind(c.specs, effects::SwingingMass().id);  // a refused one rules out none
    if (c.fit.rows > 0 && c.fit.chi2 > 0 && !unnamed && !swinging) least = std::min(least, fits_.PerRow(c));
  }
  const auto may_be = [&] {
    return !HasUnnamed(from_) && std::ranges::any_of(trials_.springs, [&](const auto& c) {
      return least - 1 > kPartly * (fits_.PerRow(*c) - 1);
    });
  };
  const auto compare = [&](const TrialSpecs& specs, bool freed, const Candidate* start) {
    if (!may_be() || fits_.Late()) return;
    const Candidate other = fits_.KnownOrFitted(specs, freed, start);
    if (other.fit.ok) least = std::min(least, fits_.PerRow(other));
  };
  if (!from_.base) compare(Refreshed(from_), true, &from_);
  if (trials_.surface != nullptr) compare(Refreshed(*trials_.surface), from_.base, nullptr);
  return may_be();
}

bool PendulumSearch::SpringsHold() const {
  return std::ranges::any_of(trials_.springs, [&](const auto& trial) {
    const Candidate* whole = fits_.Known(trial->specs, trial->base);
    return whole != nullptr && fits_.PerRow(*whole) < kExplained;
  });
}

// The better mass in springs. The fit on all windows knows the length better, unless it was lost on the way.
TrialSpecs PendulumSearch::Springs() const {
  const Candidate& trial = *trials_.springs.front();
  const Candidate* whole = fits_.Known(trial.specs, trial.base);
  const bool astray =
      whole == nullptr || !whole->fit.ok || fits_.PerRow(*whole) > kAstray * fits_.PerRow(trial);
  return Refreshed(astray ? trial : *whole);
}

void PendulumSearch::Follow(const std::vector<FollowedStart>& starts, Candidate* found) {
  std::vector<int> recordings;
  for (const NodeWindow& window : setting_.data.windows) recordings.push_back(window.recording);
  Begin(MassIn(starts.front().specs), FirstOfEach(recordings, setting_.data.WindowsFor(kPendulumWindows)));
  for (const auto& [specs, start] : starts) {
    if (fits_.Late()) return;
    request_.from = Along(start);
    const Hung other = Hang(Joined(Refreshed(from_), specs));
    if (other.in_all < nearest_.in_all) nearest_ = other;
    // With the swing known a true rod leaves nothing here, and following another one over all windows is
    // dear.
    if (nearest_.in_all < kExplained) return FitWhole(found);
  }
}

// The model with the rod, its states along the recorded motion.
std::shared_ptr<const Candidate> PendulumSearch::Along(const RodStart& start) const {
  Candidate out = Unfitted(setting_, Joined(Refreshed(from_), {start.rod}), from_.base);
  if (out.plant == nullptr) return nullptr;
  const VectorXd nominal = out.plant->parameters().Nominal();
  out.fit.values = out.plant->ValuesFrom(from_.plant->parameters(), from_.fit.values);
  for (int i = 0; i < nominal.size(); ++i) {
    if (out.plant->parameters()[i].kind == sim::ParameterKind::kEffect) out.fit.values[i] = nominal[i];
  }
  out.fit.states = InitialStates(setting_.data, {*out.plant, out.fit.values, {}}, fits_.AsFitted(from_));
  out.fit.step_s = from_.fit.step_s;
  PutSwing(setting_, start, &out.fit.states);
  out.fit.ok = true;
  return std::make_shared<const Candidate>(std::move(out));
}

void PendulumSearch::Begin(const EffectSpec& rod, std::vector<uint32_t> places) {
  request_ = fits_.WholeFit({rod}, from_.base, fits_.Start(&from_, from_.base));
  request_.places = std::move(places);
  std::vector<double> before;
  for (const uint32_t i : request_.places) before.push_back(from_.fit.window_chi2[i]);
  missing_ = Typically(before) - 1, enough_ = fits_.WorkAfter(kPendulumShare);
  hinges_ = AboutEachAxis(setting_.data, setting_.nominal, rod);
}

void PendulumSearch::TryLengths() {
  for (const double longer : {1.0, kLonger, 1 / kLonger}) {
    if (nearest_.left < kExplained) break;
    const Hung rod = Hang(Joined(springs_, {LongerRod(hinges_[0], longer)}));
    // Both lengths agree: found, or this is not the hinge.
    const bool same = std::abs(rod.left - nearest_.left) < kSameFit * nearest_.left;
    if (rod.left < nearest_.left) nearest_ = rod, times_ = longer;
    if (same && nearest_.left - 1 < kSwings * missing_) break;
  }
}

// A length found about one hinge is a start about the others.
void PendulumSearch::TryHinges() {
  const std::string tried = KeyOf({LongerRod(hinges_[0], times_)});
  for (const EffectSpec& hinge : hinges_) {
    if (&hinge != &hinges_.front() && nearest_.left < kExplained) break;
    for (const EffectSpec& rod : EitherPlace(setting_.data, setting_.nominal, LongerRod(hinge, times_))) {
      if (nearest_.in_all < kExplained || KeyOf({rod}) == tried) continue;
      const Hung other = Hang(Joined(nearest_.specs, {rod}));  // beside the same effects
      if (other.left < nearest_.left) nearest_ = other;
    }
  }
}

void PendulumSearch::FitWhole(Candidate* found) {
  for (const TrialSpecs& specs : {nearest_.needed, nearest_.specs}) {
    Weigh(specs, found);
    // One more superfluous law will not make it consistent.
    if (best_ && (fits_.PerRow(*best_) < kExplained || !(fits_.PerRow(*best_) < kConsistent))) break;
  }
  // Consecutive windows tell the hinge better than the few of a trial, whose starts may be lost.
  for (const EffectSpec& hinge : hinges_) {
    if (!FewWindowsLost() || fits_.PerRow(*best_) < kConsistent || fits_.Late() || fits_.work() > enough_)
      break;
    Weigh(About(hinge, Refreshed(*best_)), found);
  }
}

void PendulumSearch::Weigh(const TrialSpecs& specs, Candidate* found) {
  const Candidate whole = fits_.KnownOrFitted(specs, from_.base, &from_);
  if (whole.score > found->score) *found = whole;
  if (whole.fit.ok && (!best_ || fits_.PerRow(whole) < fits_.PerRow(*best_))) best_ = whole;
}

// Whether few windows hold what is left.
bool PendulumSearch::FewWindowsLost() const {
  if (!best_) return false;
  const double left = Typically(best_->fit.window_chi2);
  return left < kConsistent && left - 1 < kPartly * (fits_.PerRow(*best_) - 1);
}

// A trial of these effects.
PendulumSearch::Hung PendulumSearch::Hang(const TrialSpecs& specs) {
  if (fits_.Late(kWorkForComparisons) || fits_.work() > enough_) return {};
  request_.specs = specs;
  const Candidate c = fits_.Fitted(request_);
  trace_.Fit(c, "  rod");
  if (!c.fit.ok) return {};
  return {Refreshed(c), StillNeeded(from_, c), Typically(c.fit.window_chi2), fits_.PerRow(c)};
}

double PendulumSearch::Typically(const std::vector<double>& window_chi2) const {
  return TypicalChi2(setting_.data, window_chi2, fits_.noise_scale(), kTypically);
}

}  // namespace rg::diagnosis
