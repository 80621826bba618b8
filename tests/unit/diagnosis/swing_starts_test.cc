// A mass on a rod, followed from window to window.
#include "services/diagnosis/likelihood/swing_starts.h"

#include <gtest/gtest.h>

#include <cmath>

#include "common/dynamics/dynamics.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/likelihood/followed_fit.h"
#include "services/diagnosis/search/fit_ledger.h"
#include "tests/unit/diagnosis/prepared_set.h"

namespace rg::diagnosis {
namespace {

using effects::EffectSpec;
using effects::MakeSpec;
using testing::MakeSet;
using testing::Prepare;

EffectSpec Rod(double mass, double length, double damping, const std::string& hinge = "y") {
  EffectSpec spec = MakeSpec("sloshing_payload", {},
                             {{"mass", mass}, {"length", length}, {"damping", damping}, {"radius", 0.01}});
  spec.options = {{"form", "rod"}, {"hinge", hinge}};
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
  const FitResult followed = FitFollowed(p->data, model, options, 3);
  ASSERT_TRUE(followed.ok);
  const double dof = followed.rows - 8.0 * static_cast<double>(p->data.windows.size());
  EXPECT_NEAR(followed.chi2 / dof, 1.0, 0.1);
  EXPECT_NEAR(followed.values[plant->parameters().Find("sloshing_payload.*.length")], 0.12, 0.006);
  EXPECT_NEAR(followed.values[plant->parameters().Find("sloshing_payload.*.mass")], 0.15, 0.0075);
}

// A hand that weighs little is thrown anywhere within a window by a rod of the wrong length.
TEST(FitFollowed, FindsAMassOnALightHandFromFarOff) {
  const auto p = Prepare("mico2", {Rod(0.02, 0.05, 4e-3)}, 14);
  auto plant = sim::Plant::Create(p->nominal.shared_model(), p->nominal.options(), {Rod(0.012, 0.03, 4e-3)});
  ASSERT_TRUE(plant.ok());
  const FitModel model{*plant, plant->parameters().Nominal(), FreeParameters(*plant, p->scales, false)};
  LiftedOptions options;
  options.more_iterations = 8, options.threads = 2;
  const FitResult followed = FitFollowed(p->data, model, options, 3);
  ASSERT_TRUE(followed.ok);
  EXPECT_LT(followed.chi2 / followed.rows, 1.1);
  EXPECT_NEAR(followed.values[plant->parameters().Find("sloshing_payload.*.length")], 0.05, 0.0005);
  EXPECT_NEAR(followed.values[plant->parameters().Find("sloshing_payload.*.mass")], 0.02, 0.0004);
}

EffectSpec Springs(double mass, double stiffness) {
  EffectSpec spec =
      MakeSpec("sloshing_payload", {}, {{"mass", mass}, {"stiffness", stiffness}, {"damping", 1e-3}});
  spec.options = {{"point", "last_link"}};
  return spec;
}

TEST(RodStarts, SwingsAsTheSpringsDoAndTurnsAboutNoAxisThatGravityIsAlong) {
  const auto p = Prepare("arm2", {}, 13);
  const std::vector<EffectSpec> rods = RodStarts(p->data, p->nominal, Springs(0.15, 10.0));
  ASSERT_EQ(rods.size(), 3u);
  const EffectSpec& rod = rods[0];
  const auto& values = rod.values.begin()->second;
  EXPECT_EQ(values.at("mass"), 0.15);
  const double length = values.at("length"), radius = values.at("radius");
  EXPECT_GT(radius, 0);
  EXPECT_NEAR(length + radius * radius / length, 0.15 * 9.81 / 10.0, 1e-3);
  EXPECT_EQ(rod.options.at("form"), "rod");
  EXPECT_EQ(rod.options.at("point"), "last_link");
  // The arm moves in an upright plane about y of all its links: only y is never along gravity.
  EXPECT_EQ(rod.options.at("hinge"), "y");
}

// Friction holds the arm wherever it is put.
TEST(SwingsFrom, BeginsAtRestWhereItHangsAndPassesThere) {
  std::vector<EffectSpec> held;
  const sim::Plant mico2 = sysid::testing::LoadPlant("mico2");
  for (const std::string& joint : mico2.joint_names())
    held.push_back(MakeSpec("coulomb_friction", {joint}, {{"coulomb", 1e3}}));
  for (const char* hinge : {"x", "y", "z"}) {
    std::vector<EffectSpec> effects = held;
    effects.push_back(Rod(0.02, 0.12, 0.0, hinge));
    const sim::Plant plant = sysid::testing::LoadPlant("mico2", effects);
    const Eigen::Index n = plant.num_joints(), hidden = plant.num_states() - 2 * n;
    Eigen::VectorXd x = Eigen::VectorXd::Zero(plant.num_states());
    x.head(n) << 0.4, 2.5, 1.2, -0.7, 0.5, 0.9;
    const Eigen::VectorXd values = plant.parameters().Nominal();
    sim::Simulator at_rest(plant, {});
    at_rest.SetParameters(values);
    const std::vector<Eigen::VectorXd> starts = SwingsFrom(at_rest, x);
    ASSERT_EQ(starts.size(), 9u);
    // The widest that the rod is off its start within a second.
    const auto swing = [&](const Eigen::VectorXd& start) {
      sim::Simulator simulator(plant, {.step_s = 1e-3});
      std::vector<double> times;
      for (int k = 1; k <= 100; ++k) times.push_back(0.01 * k);
      const auto command = sim::CommandSignal::Constant(Eigen::VectorXd::Zero(n));
      const sim::Trajectory out = simulator.Simulate(
          {start.head(n), start.segment(n, n), start.tail(hidden), 0.0, {}, {}}, command, times);
      RG_CHECK(out.outcome.ok());
      double widest = 0;
      for (size_t i = 0; i < plant.internal_state_names().size(); ++i) {
        if (plant.internal_state_names()[i].rfind("position.swing_", 0) != 0) continue;
        const auto row = 2 * n + static_cast<Eigen::Index>(i);
        widest = std::max(widest, (out.state.row(row).array() - starts[0][row]).abs().maxCoeff());
      }
      return widest;
    };
    EXPECT_LT(swing(starts[0]), 0.02) << hinge;
    for (size_t i = 1; i < starts.size(); ++i) {
      EXPECT_GT(swing(starts[i]), 0.4) << hinge << " " << i;
      EXPECT_EQ(starts[i].head(2 * n), x.head(2 * n));
    }
  }
  EXPECT_TRUE(SwingsFrom(sim::Simulator(mico2, {}), {}).empty());
}

// Friction holds the arm: what the mass falls by is what it moves with.
TEST(LetGo, FallsFromRestInAnyDirectionUntilTheWindowBegins) {
  constexpr double kLength = 0.12, kRadius = 0.01;
  const auto p = Prepare("mico2", {}, 13);
  recordings::Recording still = *p->data.recordings[0].recording;
  const Eigen::VectorXd q = still.q.col(0);
  still.q.colwise() = q, still.v.setZero();
  FitData data = p->data;
  data.recordings[0].recording = &still;
  data.motions[0] = SmoothMotion(still, data.noise);
  const NodeWindow& window = data.windows[0];
  std::vector<EffectSpec> held;
  for (const std::string& joint : p->nominal.joint_names())
    held.push_back(MakeSpec("coulomb_friction", {joint}, {{"coulomb", 1e3}}));
  const model::RobotModel& model = p->nominal.model();
  const dynamics::Mechanism mechanism(model);
  dynamics::Workspace workspace;
  const Eigen::Matrix3d tool =
      dynamics::FramePose(mechanism, workspace, q, *model.FindFrame(model.end_effector().name)).rotation;
  const Eigen::Vector3d gravity = tool.transpose() * p->nominal.options().gravity;
  for (const int hinge : {0, 1, 2}) {
    std::vector<EffectSpec> effects = held;
    effects.push_back(Rod(0.02, kLength, 0.0, std::string(1, "xyz"[hinge])));
    const sim::Plant plant = sysid::testing::LoadPlant("mico2", effects);
    sim::Simulator simulator(plant, {.step_s = 1e-3});
    const Eigen::VectorXd x = Eigen::VectorXd::Constant(plant.num_states(), 0.3);
    const std::vector<Eigen::VectorXd> starts = LetGo(data, simulator, window, x);
    ASSERT_EQ(starts.size(), 24u);
    // Of the unit vector along the rod, in the tool's axes.
    const auto along = [&](double first, double second) {
      Eigen::Vector3d out;
      out[hinge] = -std::sin(second);
      out[(hinge + 1) % 3] = std::cos(second) * std::sin(first);
      out[(hinge + 2) % 3] = -std::cos(second) * std::cos(first);
      return out;
    };
    for (size_t i = 0; i < starts.size(); ++i) {
      EXPECT_EQ(starts[i].head(starts[i].size() - 4), x.head(x.size() - 4));
      const Eigen::Vector4d rod = starts[i].tail<4>();
      const double aside[] = {0.0, M_PI / 3, -M_PI / 3};
      const Eigen::Vector3d from = along(M_PI / 4 * static_cast<double>(i % 8), aside[i / 8]);
      const double first = std::pow(rod[1], 2), second = std::pow(rod[3], 2);
      const double moves = 0.5 * kLength * kLength * (first * std::pow(std::cos(rod[2]), 2) + second) +
                           0.5 * kRadius * kRadius * (first + second);
      EXPECT_NEAR(moves, kLength * gravity.dot(along(rod[0], rod[2]) - from), 0.02) << hinge << " " << i;
    }
  }
  sim::Simulator without(p->nominal, {});
  EXPECT_TRUE(LetGo(data, without, window, Eigen::VectorXd::Zero(12)).empty());
}

TEST(LongerRod, HasItsMassAndSwingsSoMuchSlower) {
  const EffectSpec rod = Rod(0.15, 0.12, 1e-3), longer = LongerRod(rod, 4.0);
  const auto &of = rod.values.begin()->second, &now = longer.values.begin()->second;
  EXPECT_EQ(now.at("mass"), of.at("mass"));
  EXPECT_NEAR(now.at("length"), 4 * of.at("length"), 1e-12);
  EXPECT_NEAR(now.at("radius"), 4 * of.at("radius"), 1e-12);
}

TEST(EitherPlace, IsTheToolAndTheLastLinkUnlessBothWereMovedAlike) {
  const auto p = Prepare("arm2", {}, 13);
  const std::vector<EffectSpec> places = EitherPlace(p->data, p->nominal, Rod(0.15, 0.12, 1e-3));
  ASSERT_EQ(places.size(), 2u);
  EXPECT_FALSE(SwingsOnLastLink({places[0]}));
  EXPECT_TRUE(SwingsOnLastLink({places[1]}));
  EXPECT_FALSE(SwingsOnLastLink({EitherPlace(p->data, p->nominal, places[1])[1]}));
  // Where the last link hardly turns its tool is only further along.
  for (FineMotion& fine : p->data.fine) fine.q.row(1) = -fine.q.row(0).array() + 0.3;
  EXPECT_EQ(EitherPlace(p->data, p->nominal, places[1]).size(), 1u);
}

TEST(TypicalChi2, IsNotLedByWindowsWhoseStartWasNotFound) {
  const auto p = Prepare("arm2", {}, 13);
  ASSERT_GT(p->data.windows.size(), 12u);
  const double rows = p->data.Rows() / static_cast<double>(p->data.windows.size());
  std::vector<double> chi2(10, 2.0 * rows);
  chi2[1] = chi2[4] = chi2[9] = 1e6;
  EXPECT_NEAR(TypicalChi2(p->data, chi2, 1.0, 0.7), 2.0, 1e-9);
  EXPECT_NEAR(TypicalChi2(p->data, chi2, 2.0, 0.7), 1.0, 1e-9);
  chi2[0] = 1e6;
  EXPECT_GT(TypicalChi2(p->data, chi2, 1.0, 0.7), 100);
  EXPECT_TRUE(std::isinf(TypicalChi2(p->data, {}, 1.0, 0.7)));
}

TEST(WidenPoint, HangsAndSwingsAlike) {
  const auto p = Prepare("arm2", {}, 13);
  EffectSpec rod = Rod(0.15, 0.12, 1e-3);
  const auto widened = [&](double radius) {
    rod.values.begin()->second.at("radius") = radius;
    const auto plant = sim::Plant::Create(p->nominal.shared_model(), p->nominal.options(), {rod});
    RG_CHECK(plant.ok());
    Eigen::VectorXd values = plant->parameters().Nominal();
    WidenPoint(*plant, &values);
    const auto of = [&](const char* field) {
      return values[plant->parameters().Find(std::string("sloshing_payload.*.") + field)];
    };
    return Eigen::Vector3d(of("mass"), of("length"), of("radius"));
  };
  const Eigen::Vector3d point = widened(0.0), body = widened(0.03);
  EXPECT_NEAR(point[0] * point[1], 0.15 * 0.12, 1e-12);
  EXPECT_NEAR(point[1] + point[2] * point[2] / point[1], 0.12, 1e-12);
  EXPECT_GT(point[2], 0.02);
  EXPECT_EQ(body, Eigen::Vector3d(0.15, 0.12, 0.03));
}

struct Best {
  Candidate candidate;
  double chi2_per_row = 0;
};

// Of trials of a mass on the model as given.
Best BestWithAMass(const testing::Prepared& p) {
  const FitSetting setting{p.data, p.nominal, p.scales};
  const FakeClock clock;
  const Trace trace{clock};
  FitLedger ledger{setting, p.options, 2, trace, nullptr};
  const Candidate nothing = ledger.Evaluate({}, false);
  Best best{nothing};
  ledger.TryBest(nothing, BodyStarts("sloshing_payload", p.nominal, p.scales), {}, 2, &best.candidate);
  best.chi2_per_row = ledger.PerRow(best.candidate);
  return best;
}

// What remains is found where it hangs, of the tool and the last link's own point.
TEST(FitLedger, AMassFoundInSpringsIsTriedOnARodWhereItHangs) {
  for (const bool on_last_link : {false, true}) {
    const double mass = on_last_link ? 0.1 : 0.01;
    EffectSpec truth = Rod(mass, 0.12, 1e-3);
    if (on_last_link) truth.options["point"] = "last_link";
    const auto p = Prepare("arm2", {truth}, 14);
    const Best best = BestWithAMass(*p);
    const Candidate& winner = best.candidate;
    EXPECT_TRUE(HasPendulum(winner.specs));
    EXPECT_EQ(SwingsOnLastLink(winner.specs), on_last_link);
    EXPECT_LT(best.chi2_per_row, 1.1);
    EXPECT_NEAR(winner.fit.values[winner.plant->parameters().Find("sloshing_payload.*.mass")], mass,
                0.05 * mass);
  }
}

// Hinges are one to a mass that stays away from their first axes; where it comes along one it is held there.
TEST(LongFitLedger, AMassThatComesAlongItsHingeIsFoundAboutTheRightOne) {
  const auto p = Prepare(MakeSet("mico2", {Rod(0.02, 0.12, 1e-4, "z")}, 15, 2.5));
  const Best best = BestWithAMass(*p);
  ASSERT_TRUE(HasPendulum(best.candidate.specs));
  EXPECT_EQ(best.candidate.specs[0].options.at("hinge"), "z");
  EXPECT_LT(best.chi2_per_row, 1.1);
}

}  // namespace
}  // namespace rg::diagnosis
