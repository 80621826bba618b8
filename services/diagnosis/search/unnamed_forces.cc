#include "services/diagnosis/search/unnamed_forces.h"

#include "services/diagnosis/hypotheses/field_starts.h"
#include "services/diagnosis/hypotheses/hypotheses.h"

namespace rg::diagnosis {

void TryUnnamedForces(SearchState& state, bool freed, const std::function<bool(const Candidate&)>& enough) {
  for (const bool base : {false, true}) {
    const Candidate* from = state.fits.Known(state.given, base);
    if ((base && !freed) || from == nullptr || !from->fit.ok) continue;
    const MissingForce force = state.Force(*from);
    for (const std::string& variable : kFieldVariables) {
      const auto spec = UnnamedStart(state.setting, force, variable);
      if (spec && enough(state.fits.KnownOrFitted(Joined(state.given, {*spec}), base))) return;
    }
  }
}

}  // namespace rg::diagnosis
