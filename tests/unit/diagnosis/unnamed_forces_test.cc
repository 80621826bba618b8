// Forces without a name, over one variable each.
#include "services/diagnosis/search/unnamed_forces.h"

#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "common/base/clock.h"
#include "tests/unit/diagnosis/prepared_set.h"

namespace rg::diagnosis {
namespace {

using effects::MakeSpec;

// A pendulum with a force over its position that no law of the catalogue has.
TEST(UnnamedForces, AreFittedOverOneVariableAfterAnotherUntilOneIsEnough) {
  effects::EffectSpec bump =
      MakeSpec("unknown_field", {"hinge"}, {{"low", -1.5}, {"high", 1.5}, {"w3", 0.4}, {"w4", 0.5}});
  bump.options["variable"] = "position";
  const auto p = testing::Prepare("pendulum", {bump}, 61);
  const FakeClock clock;
  const ProgressFn progress;
  SearchState state({p->data, p->nominal, p->scales}, p->options, 1, clock, progress, nullptr);
  state.fits.Evaluate({}, false);
  std::vector<std::string> variables;
  std::vector<double> left;
  const auto all = [&](const Candidate& c) {
    variables.push_back(FieldVariable(c.specs, "hinge"));
    left.push_back(state.fits.PerRow(c));
    return false;
  };
  TryUnnamedForces(state, false, all);
  EXPECT_EQ(variables, kFieldVariables);
  EXPECT_LT(left[0], kExplained);
  EXPECT_GT(left[2], 2 * left[0]) << "its speed says little of a force in one place";
  size_t asked = 0;
  TryUnnamedForces(state, true, [&](const Candidate&) { return ++asked == 1; });
  EXPECT_EQ(asked, 1u) << "neither other variables nor free base parameters after one that is enough";
}

}  // namespace
}  // namespace rg::diagnosis
