// A mass on a rod, followed from window to window.
#include "services/diagnosis/swing_starts.h"

#include <gtest/gtest.h>

#include <cmath>

#include "services/diagnosis/hypotheses.h"
#include "tests/unit/diagnosis/prepared_set.h"

namespace rg::diagnosis {
namespace {

using effects::EffectSpec;
using effects::MakeSpec;
using testing::Prepare;

EffectSpec Rod(double mass, double length, double damping) {
  EffectSpec spec = MakeSpec("sloshing_payload", {},
                             {{"mass", mass}, {"length", length}, {"damping", damping}, {"radius", 0.01}});
  spec.options = {{"form", "rod"}, {"hinge", "y"}};
  return spec;
}

TEST(FitFollowed, FindsAMassThatSwingsForLongWhereItsStartsAreNotKnown) {
  const auto p = Prepare("arm2", {Rod(0.15, 0.12, 1e-3)}, 12);
  const EffectSpec start = Rod(0.1, 0.1, 1e-2);
  auto plant = sim::Plant::Create(p->nominal.shared_model(), p->nominal.options(), {start});
  ASSERT_TRUE(plant.ok());
  const FitModel model{*plant, plant->parameters().Nominal(), FreeParameters(*plant, p->scales, false)};
  LiftedOptions options;
  options.more_iterations = 8;
  const FitResult alone = Fit(p->data, model, options), followed = FitFollowed(p->data, model, options, 3);
  ASSERT_TRUE(followed.ok);
  EXPECT_LT(followed.chi2, 0.1 * alone.chi2);
  const double dof = followed.rows - 8.0 * static_cast<double>(p->data.windows.size());
  EXPECT_NEAR(followed.chi2 / dof, 1.0, 0.1);
  EXPECT_NEAR(followed.values[plant->parameters().Find("sloshing_payload.*.length")], 0.12, 0.006);
  EXPECT_NEAR(followed.values[plant->parameters().Find("sloshing_payload.*.mass")], 0.15, 0.0075);
}

}  // namespace
}  // namespace rg::diagnosis
