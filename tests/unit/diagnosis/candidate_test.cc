#include "services/diagnosis/candidate.h"

#include <gtest/gtest.h>

#include "tests/unit/diagnosis/prepared_set.h"

namespace rg::diagnosis {
namespace {

// A swinging mass on a pendulum, each parameter known to a tenth of its prior.
Candidate Swinging() {
  const auto p = testing::Prepare("pendulum", {}, 31);
  Candidate c;
  c.specs = {effects::MakeSpec("sloshing_payload", {}, {{"mass", 0.05}})};
  const auto plant = sim::Plant::Create(p->nominal.shared_model(), p->nominal.options(), c.specs);
  RG_CHECK(plant.ok()) << plant.status().ToString();
  c.plant = std::make_shared<const sim::Plant>(*plant);
  c.parameters = FreeParameters(*c.plant, p->scales, false);
  const auto count = static_cast<Eigen::Index>(c.parameters.size());
  c.fit.theta.resize(count), c.fit.stddev.resize(count);
  for (Eigen::Index k = 0; k < count; ++k) {
    const sysid::FitParameter& q = c.parameters[static_cast<size_t>(k)];
    c.fit.theta[k] = std::max(0.05, 10 * q.lower), c.fit.stddev[k] = 0.1 * q.prior_stddev;
  }
  return c;
}

TEST(Candidate, IsSeenWhereItsParametersAreKnown) {
  Candidate c = Swinging();
  EXPECT_FALSE(Unseen(c));
  for (Eigen::Index k = 0; k < c.fit.stddev.size(); ++k)
    c.fit.stddev[k] = c.parameters[static_cast<size_t>(k)].prior_stddev;
  EXPECT_TRUE(Unseen(c));
}

TEST(Candidate, IsNotSeenWhereItsMassVanishes) {
  Candidate c = Swinging();
  bool mass = false;
  for (Eigen::Index k = 0; k < c.fit.theta.size(); ++k) {
    const sysid::FitParameter& q = c.parameters[static_cast<size_t>(k)];
    if (c.plant->parameters()[q.index].field != "mass") continue;
    mass = true;
    c.fit.theta[k] = 1.1 * q.lower;
  }
  ASSERT_TRUE(mass);
  EXPECT_TRUE(Unseen(c));
}

}  // namespace
}  // namespace rg::diagnosis
