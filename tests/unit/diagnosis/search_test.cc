// Where a search ends: what holds on recordings kept aside too has no free parameters as its rivals.
#include "services/diagnosis/search.h"

#include <gtest/gtest.h>

#include <memory>
#include <set>

#include "tests/unit/diagnosis/prepared_set.h"

namespace rg::diagnosis {
namespace {

using effects::EffectSpec;
using effects::MakeSpec;

constexpr char kElbow[] = "joint_3";

// Kinds of effects that were fitted beside free base parameters.
std::set<std::string> KindsBesideFreeParameters(const SearchResult& result) {
  std::set<std::string> out;
  for (const Candidate& c : result.tried) {
    for (const EffectSpec& s : c.base ? c.specs : std::vector<EffectSpec>{}) out.insert(s.id);
  }
  return out;
}

SearchResult Searched(std::vector<EffectSpec> truth, uint64_t seed) {
  auto p = testing::Prepare("mico2", std::move(truth), seed);
  p->data.held_out = PrepareHeldOut(p->set, p->data, p->nominal, p->options);
  RG_CHECK(p->data.held_out != nullptr);
  return SearchEffects(p->data, p->nominal, p->scales, p->options, 2, RealClock(), nullptr, nullptr);
}

TEST(Search, AForceWithoutANameThatHoldsIsNotSoughtAmongFreeParameters) {
  const auto still = testing::Prepare("mico2", {}, 51);
  const EffectSpec saddle = MakeSpec("unknown_field_pair", {"joint_2", kElbow},
                                     {{"low", still->scales.low[1]},
                                      {"high", still->scales.high[1]},
                                      {"other_low", still->scales.low[2]},
                                      {"other_high", still->scales.high[2]},
                                      {"w22", 0.06},
                                      {"w23", -0.04},
                                      {"w32", -0.04},
                                      {"w33", 0.06}});
  const SearchResult r = Searched({saddle}, 51);
  ASSERT_TRUE(HasUnnamed(r.best));
  EXPECT_LT(r.best.fit.chi2 / r.best.fit.rows, kExplained);
  EXPECT_TRUE(KindsBesideFreeParameters(r).empty());
}

TEST(Search, AnAccountWithHiddenStatesThatHoldsIsNotSoughtAmongFreeParameters) {
  const SearchResult r = Searched({MakeSpec("actuator_lag", {kElbow}, {{"time_constant", 0.008}})}, 52);
  ASSERT_EQ(r.best.specs.size(), 1u);
  EXPECT_EQ(r.best.specs[0].id, "actuator_lag");
  EXPECT_LT(r.best.fit.chi2 / r.best.fit.rows, kExplained);
  // Its own twin, and what it is easily taken for.
  const std::set<std::string> timing = {"actuator_lag", "actuator_delay", "sensor_delay"};
  for (const std::string& kind : KindsBesideFreeParameters(r)) EXPECT_TRUE(timing.count(kind)) << kind;
}

// A search begins again with more recordings: it need not find anew what it had come to, nor believe it.
TEST(Search, WhatAnEarlierSearchCameToIsWeighedFirst) {
  auto p = testing::Prepare("arm2", {MakeSpec("coulomb_friction", {"elbow"}, {{"coulomb", 0.2}})}, 53);
  const auto search = [&] {
    return SearchEffects(p->data, p->nominal, p->scales, p->options, 2, RealClock(), nullptr, nullptr);
  };
  const SearchResult first = search();
  ASSERT_EQ(first.best.specs.size(), 1u);
  ASSERT_EQ(first.best.specs[0].id, "coulomb_friction");

  auto earlier = std::make_shared<Candidate>(first.best);
  earlier->fit.states.clear(), earlier->fit.window_chi2.clear();
  p->options.earlier = earlier;
  const SearchResult again = search();
  ASSERT_EQ(again.best.specs.size(), 1u);
  EXPECT_EQ(again.best.specs[0].id, "coulomb_friction");
  EXPECT_LT(again.work, 0.5 * first.work);

  auto wrong = std::make_shared<Candidate>();
  wrong->specs = {MakeSpec("viscous_friction", {"shoulder"}, {{"viscous", 0.1}})};
  wrong->plant = std::make_shared<const sim::Plant>(
      *sim::Plant::Create(p->nominal.shared_model(), p->nominal.options(), wrong->specs));
  p->options.earlier = wrong;
  const SearchResult still = search();
  ASSERT_EQ(still.best.specs.size(), 1u);
  EXPECT_EQ(still.best.specs[0].id, "coulomb_friction");
}

}  // namespace
}  // namespace rg::diagnosis
