// A mass on a rod as a law of the recorded motion.
#include "services/diagnosis/hypotheses/rod_screen.h"

#include <gtest/gtest.h>

#include "services/diagnosis/likelihood/free_force.h"
#include "services/diagnosis/likelihood/some_windows.h"
#include "services/diagnosis/likelihood/swing_starts.h"
#include "tests/unit/diagnosis/prepared_set.h"

namespace rg::diagnosis {
namespace {

using effects::EffectSpec;
using effects::MakeSpec;
using testing::Prepare;
using testing::Prepared;

constexpr double kMass = 0.15, kLength = 0.1, kRadius = 0.03;
constexpr double kSwingsLike = kLength + kRadius * kRadius / kLength;

EffectSpec Pendulum(double mass, double length, double radius, const std::string& hinge) {
  EffectSpec spec = MakeSpec("sloshing_payload", {},
                             {{"mass", mass}, {"length", length}, {"damping", 0}, {"radius", radius}});
  spec.options = {{"form", "rod"}, {"hinge", hinge}};
  return spec;
}

std::vector<RodStart> Screened(const Prepared& p, int threads = 2) {
  LiftedOptions options;
  options.threads = threads;
  const FitModel model{p.nominal, p.nominal.parameters().Nominal(), {}};
  const MissingForce force = EstimateMissingForce(p.data, model, InitialStates(p.data, model, options),
                                                  p.scales.torque, FreeForce{}.segment_s, options);
  return ScreenRods({p.data, p.nominal, p.scales}, force, MakeFeatures(p.data, p.nominal, p.scales), threads);
}

double ValueOf(const RodStart& start, const std::string& field) {
  return start.rod.values.begin()->second.at(field);
}

TEST(RodScreen, FindsTheRodAndTheLawBesideIt) {
  const auto p = Prepare(
      "arm2",
      {Pendulum(kMass, kLength, kRadius, "x"), MakeSpec("torque_offset", {"shoulder"}, {{"offset", 0.4}})},
      21);
  const std::vector<RodStart> found = Screened(*p);
  ASSERT_FALSE(found.empty());
  EXPECT_NEAR(found[0].swing.length, kSwingsLike, 0.04 * kSwingsLike);
  EXPECT_NEAR(ValueOf(found[0], "mass") * ValueOf(found[0], "length"), kMass * kLength,
              0.15 * kMass * kLength);
  EXPECT_LT(found[0].left, 0.5);
  ASSERT_TRUE(found[0].beside);
  EXPECT_EQ(found[0].beside->regressor, effects::Regressor::kConstant);
  EXPECT_EQ(found[0].beside->joint, 0);
}

TEST(RodScreen, FindsNoneWhereNoneSwings) {
  const auto p = Prepare("arm2",
                         {MakeSpec("coulomb_friction", {"shoulder"}, {{"coulomb", 0.3}}),
                          MakeSpec("viscous_friction", {"elbow"}, {{"viscous", 0.2}})},
                         22);
  EXPECT_TRUE(Screened(*p).empty());
}

TEST(RodScreen, IsTheSameForAnyNumberOfThreads) {
  const auto p = Prepare("arm2", {Pendulum(kMass, kLength, kRadius, "x")}, 23);
  const std::vector<RodStart> one = Screened(*p, 1), three = Screened(*p, 3);
  ASSERT_FALSE(one.empty());
  ASSERT_EQ(one.size(), three.size());
  EXPECT_EQ(one[0].swing.length, three[0].swing.length);
  EXPECT_EQ(ValueOf(one[0], "mass"), ValueOf(three[0], "mass"));
}

TEST(PutSwing, BeginsWindowsWhereTheRodIs) {
  const auto p = Prepare("arm2", {Pendulum(kMass, kLength, kRadius, "x")}, 24);
  const std::vector<RodStart> found = Screened(*p);
  ASSERT_FALSE(found.empty());
  const EffectSpec rod = Pendulum(kMass, kLength, kRadius, found[0].rod.options.at("hinge"));
  auto plant = sim::Plant::Create(p->nominal.shared_model(), p->nominal.options(), {rod});
  ASSERT_TRUE(plant.ok());
  FitData early = p->data;
  std::erase_if(early.windows, [](const NodeWindow& w) { return w.t.back() > 2.0; });
  ASSERT_GE(early.windows.size(), 9u);
  const FitModel model{*plant, plant->parameters().Nominal(), {}};
  LiftedOptions once;
  once.iterations = 1, once.more_iterations = 0;
  const NodeStates hung = InitialStates(early, model, once);
  NodeStates put = hung;
  RodStart start = found[0];
  start.swing.length = kSwingsLike;
  PutSwing({early, p->nominal, p->scales}, start, &put);
  const FitResult from_swing = Fit(early, model, once, &put), from_rest = Fit(early, model, once, &hung);
  ASSERT_TRUE(from_swing.ok);
  EXPECT_LT(from_swing.chi2 / from_swing.rows, 1.5);
  EXPECT_GT(from_rest.chi2, 3 * from_swing.chi2);
}

TEST(PutSwing, EndsWhereRowsAreMissing) {
  const auto p = Prepare("arm2", {Pendulum(kMass, kLength, kRadius, "x")}, 25);
  for (FineMotion& fine : p->data.fine) fine.gaps = {{fine.t[0] + 1.2, fine.t[0] + 1.5}};
  const RodStart start{Pendulum(kMass, kLength, kRadius, "x"), {kSwingsLike, 0, 0}, 1, {}};
  auto plant = sim::Plant::Create(p->nominal.shared_model(), p->nominal.options(), {start.rod});
  ASSERT_TRUE(plant.ok());
  const NodeStates before = InitialStates(p->data, {*plant, plant->parameters().Nominal(), {}}, {});
  NodeStates after = before;
  PutSwing({p->data, p->nominal, p->scales}, start, &after);
  int put = 0;
  for (size_t w = 0; w < before.size(); ++w) {
    const bool early = p->data.windows[w].t.back() < 1.2;
    put += early;
    EXPECT_EQ(early, before[w] != after[w]) << "window " << w;
    EXPECT_TRUE(after[w].allFinite());
  }
  EXPECT_GT(put, 0);
}

TEST(FirstOfEach, TakesTheFirstWindowOfEveryRecordingFirst) {
  const std::vector<int> recordings = {0, 0, 0, 1, 1, 2};
  EXPECT_EQ(FirstOfEach(recordings, 4), (std::vector<uint32_t>{0, 1, 3, 5}));
  EXPECT_EQ(FirstOfEach(recordings, 9).size(), 6u);
  EXPECT_TRUE(FirstOfEach({}, 3).empty());
}

}  // namespace
}  // namespace rg::diagnosis
