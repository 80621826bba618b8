#include "services/diagnosis/screening/screening.h"

#include <gtest/gtest.h>

#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/likelihood/lineariser.h"
#include "services/diagnosis/likelihood/missing_force.h"
#include "tests/unit/diagnosis/prepared_set.h"

namespace rg::diagnosis {
namespace {

using effects::MakeSpec;
using testing::Prepare;
using testing::Prepared;

ScreenResult Screened(const Prepared& p, const std::vector<sysid::FitParameter>& parameters,
                      const std::vector<ParameterColumn>& columns) {
  const FeatureSet features = MakeFeatures(p.data, p.nominal, p.scales);
  const FitModel model{p.nominal, p.nominal.parameters().Nominal(), parameters};
  const NodeStates states = InitialStates(p.data, model, {});
  const auto step_rule = StepRuleResiduals(p.data, model, states, {});
  const Screen screen = MakeScreen(p.data, model, states, features.block, {}, step_rule, 60, Rng(5));
  return ScoreHypotheses(screen, columns, features, false, p.nominal);
}

bool Holds(const Combination& c, const std::string& effect, const std::vector<int>& joints) {
  return std::any_of(c.parts.begin(), c.parts.end(),
                     [&](const Scored& h) { return h.effect == effect && h.joints == joints; });
}

TEST(Screening, TheInjectedEffectScoresAboveTheNullAndNothingDoesWithoutIt) {
  const std::string joint = sysid::testing::LoadPlant("pendulum").joint_names()[0];
  for (const bool there : {true, false}) {
    const auto p = Prepare(
        "pendulum",
        there ? std::vector<effects::EffectSpec>{MakeSpec("viscous_friction", {joint}, {{"viscous", 0.1}})}
              : std::vector<effects::EffectSpec>{},
        4);
    const ScreenResult result = Screened(*p, {}, {});
    ASSERT_FALSE(result.hypotheses.empty());
    if (there) {
      EXPECT_GT(result.hypotheses.front().gain, result.null_gain + 20);
      double viscous = 0;
      for (const Scored& h : result.hypotheses) {
        if (h.effect == "viscous_friction") viscous = h.coefficients[0];
      }
      EXPECT_NEAR(viscous, 0.1, 0.02);
    } else {
      EXPECT_LT(result.hypotheses.front().gain, std::max(result.null_gain, 0.0) + 6);
    }
  }
}

TEST(Screening, DoesNotDependOnTheNumberOfThreads) {
  const auto p = Prepare("pendulum", {}, 21);
  const FeatureSet features = MakeFeatures(p->data, p->nominal, p->scales);
  const FitModel model{p->nominal, p->nominal.parameters().Nominal(), {}};
  const NodeStates states = InitialStates(p->data, model, {});
  const auto step_rule = StepRuleResiduals(p->data, model, states, {});
  LiftedOptions three;
  three.threads = 3;
  const Screen a = MakeScreen(p->data, model, states, features.block, {}, step_rule, 8, Rng(5));
  const Screen b = MakeScreen(p->data, model, states, features.block, three, step_rule, 8, Rng(5));
  EXPECT_EQ(a.gram, b.gram);
  EXPECT_EQ(a.null, b.null);
}

// The columns are not simulated themselves but combined from unit torques.
TEST(Screening, HasTheGramMatrixOfItsColumnsThemselves) {
  const auto p = Prepare("arm2", {}, 23);
  const FeatureSet features = MakeFeatures(p->data, p->nominal, p->scales);
  const EffectSpec lag = MakeSpec("actuator_lag", {"elbow"}, {{"time_constant", 0.02}}),
                   offset = MakeSpec("encoder_offset", {"elbow"}, {{"offset", 0.01}});
  for (const auto& effects : {std::vector<EffectSpec>{}, {lag, offset}}) {
    const sim::Plant plant = *sim::Plant::Create(p->nominal.shared_model(), p->nominal.options(), effects);
    const FitModel model{plant, plant.parameters().Nominal(), FreeParameters(plant, p->scales, true)};
    const NodeStates states = InitialStates(p->data, model, {});
    const Screen screen = MakeScreen(p->data, model, states, features.block, {}, {}, 0, Rng(5));
    Lineariser lin(p->data, model, true, {});
    MatrixXd gram = MatrixXd::Zero(screen.gram.rows(), screen.gram.cols());
    const auto C = std::ssize(features.block.joint), P = lin.P() + C;
    for (size_t w = 0; w < p->data.windows.size(); ++w) {
      // A column on the robot is the sum of its forces on each joint.
      const MatrixXd &phi = features.block.phi[w], &on_robot = features.block.on_robot[w];
      const auto N = phi.cols(), R = on_robot.cols();
      ASSERT_GT(R, 0);
      std::vector<int> joint = features.block.joint;
      MatrixXd all(C + 2 * R, N);
      all.topRows(C) = phi;
      for (const int j : {0, 1}) {
        joint.insert(joint.end(), R, j);
        all.middleRows(C + j * R, R) = on_robot.middleRows(j * N, N).transpose();
      }
      Linear l;
      lin.Run(0, static_cast<int>(w), states[w], &joint, &all, false, &l);
      ASSERT_TRUE(l.ok);
      RowMatrixXd rest(l.rows.rows(), P + R + 1);
      rest.leftCols(P) = l.rows.middleCols(l.nx, P);
      rest.middleCols(P, R) = l.rows.middleCols(l.nx + P, R) + l.rows.middleCols(l.nx + P + R, R);
      rest.rightCols<1>() = l.rows.rightCols<1>();
      ProjectOut(l.J_e(), &rest);
      gram += rest.transpose() * rest;
    }
    const VectorXd size = gram.diagonal().cwiseMax(1e-300).cwiseSqrt().cwiseInverse();
    EXPECT_LT((size.asDiagonal() * (screen.gram - gram) * size.asDiagonal()).cwiseAbs().maxCoeff(), 1e-8);
  }
}

TEST(Screening, FindsTheSurfaceAndThePointThatMeetsItBesideFriction) {
  // The forearm's own origin, the elbow, is what meets the floor.
  EffectSpec floor = MakeSpec("contact", {}, {{"stiffness", 60}, {"damping", 1}, {"height", 0.5}});
  floor.options["point"] = "last_link";
  const auto joints = sysid::testing::LoadPlant("arm2").joint_names();
  const auto p = Prepare("arm2", {floor, MakeSpec("viscous_friction", {joints[1]}, {{"viscous", 0.01}})}, 5);
  const ScreenResult r = Screened(*p, {}, {});
  const Scored& named =
      *std::ranges::find_if(r.hypotheses, [](const Scored& h) { return !IsUnnamed(h.effect); });
  EXPECT_EQ(named.effect, "contact");
  ASSERT_FALSE(r.pairs.empty());
  EXPECT_TRUE(Holds(r.pairs.front(), "contact", {}));
  const TrialSpecs start = SpecsFor(named, p->nominal, p->scales).front();
  EXPECT_EQ(start[0].options, floor.options);
  EXPECT_NEAR(effects::ValueOf(start[0], "stiffness"), 60, 20);
  EXPECT_NEAR(effects::ValueOf(start[0], "height"), 0.5, 0.02);
}

TEST(Screening, FindsTwoEffectsTogetherAndTheirStrengths) {
  const auto joints = sysid::testing::LoadPlant("arm2").joint_names();
  const auto p = Prepare("arm2",
                         {MakeSpec("viscous_friction", {joints[0]}, {{"viscous", 0.3}}),
                          MakeSpec("position_spring", {joints[1]}, {{"stiffness", 1.5}, {"center", 0.2}})},
                         22);
  const ScreenResult r = Screened(*p, {}, {});
  ASSERT_FALSE(r.pairs.empty());
  const Combination& best = r.pairs.front();
  EXPECT_TRUE(Holds(best, "viscous_friction", {0}));
  EXPECT_TRUE(Holds(best, "position_spring", {1}));
  // Either alone leaves the other's part unexplained.
  EXPECT_GT(best.gain, r.hypotheses.front().gain + 50);
  for (const Scored& h : best.parts) {
    if (h.effect != "viscous_friction") continue;
    EXPECT_NEAR(h.coefficients[0], 0.3, 0.06);
  }
}

// Two ways to the log evidence of any force on a joint: its columns eliminated, or estimated.
TEST(Screening, IntegratesOutAnyForceOnAJointAsItIsEstimated) {
  const auto joints = sysid::testing::LoadPlant("arm2").joint_names();
  effects::EffectSpec bump =
      MakeSpec("unknown_field", {joints[0]}, {{"low", -1.5}, {"high", 1.5}, {"w3", 0.4}, {"w4", 0.5}});
  bump.options["variable"] = "position";
  const auto p = Prepare("arm2", {bump}, 26);
  const FitModel model{p->nominal, p->nominal.parameters().Nominal(), {}};
  const NodeStates states = InitialStates(p->data, model, {});
  const auto evidence = [](const Screen& s) { return -0.5 * s.gram(0, 0) - s.force_log_det; };
  const MissingForce missing = EstimateMissingForce(p->data, model, states, p->scales.torque, 0.05, {});
  const Screen none = MakeScreen(p->data, model, states, {}, {}, {}, 0, Rng(5));
  EXPECT_EQ(none.force_log_det, 0.0);
  const FreeForce force{{0, 1}, p->scales.torque, 0.05};
  const std::vector<Screen> beside = MakeScreens(force, p->data, model, states, {}, {}, 0, Rng(5));
  ASSERT_EQ(beside.size(), 2);
  for (const int j : {0, 1}) {
    EXPECT_NEAR(evidence(beside[j]) - evidence(none), missing.evidence(j, j),
                1e-6 * std::abs(missing.evidence(j, j)));
    const double per_row = beside[j].gram(0, 0) / p->data.Rows();
    EXPECT_EQ(per_row < 1.2, j == 0) << per_row;
  }
}

// Segments as features of their own, eliminated from one large Gram matrix with a prior of one.
TEST(Screening, IntegratesOutWhatFeaturesOfEachSegmentWouldBe) {
  const auto joints = sysid::testing::LoadPlant("arm2").joint_names();
  auto p = Prepare("arm2", {MakeSpec("viscous_friction", {joints[1]}, {{"viscous", 0.3}})}, 27);
  p->data.windows.resize(3);
  const auto parameters = FreeParameters(p->nominal, p->scales, true);
  const FitModel model{p->nominal, p->nominal.parameters().Nominal(), parameters};
  const NodeStates states = InitialStates(p->data, model, {});
  const FeatureSet features = MakeFeatures(p->data, p->nominal, p->scales);
  const FreeForce force{{0, 1}, p->scales.torque, 0.1};
  const auto screens = [&](int threads) {
    LiftedOptions options;
    options.threads = threads;
    return MakeScreens(force, p->data, model, states, features.block, options, 20, Rng(5));
  };
  const std::vector<Screen> beside = screens(1), again = screens(3);
  const auto C = std::ssize(features.block.joint), P = std::ssize(parameters);
  for (const int on : {0, 1}) {
    EXPECT_TRUE(beside[on].gram == again[on].gram && beside[on].null == again[on].null) << "by threads";
    FeatureBlock block = features.block;
    std::vector<ForceSegments> segments;
    long S = 0;  // segments in all windows
    for (const NodeWindow& window : p->data.windows) {
      segments.push_back(SegmentsOf({{on}, force.prior, force.segment_s}, window));
      S += segments.back().phi.rows();
    }
    block.joint.insert(block.joint.end(), S, on);
    long at = C;
    for (size_t w = 0; w < segments.size(); ++w) {
      MatrixXd phi = MatrixXd::Zero(C + S, block.phi[w].cols());
      phi.topRows(C) = block.phi[w];
      phi.middleRows(at, segments[w].phi.rows()) = segments[w].phi;
      at += segments[w].phi.rows();
      block.phi[w] = phi;
    }
    const Screen large = MakeScreen(p->data, model, states, block, {}, {}, 0, Rng(5));
    std::vector<long> own, others;
    for (long i = 0; i < large.gram.rows(); ++i) (i >= P + C && i < P + C + S ? others : own).push_back(i);
    MatrixXd precision = large.gram(others, others);
    precision.diagonal().array() += 1.0;
    const MatrixXd cross = large.gram(others, own);
    const MatrixXd expected = large.gram(own, own) - cross.transpose() * precision.ldlt().solve(cross);
    EXPECT_LT((beside[on].gram - expected).norm(), 1e-7 * large.gram.norm());
    const double log_det = 0.5 * precision.ldlt().vectorD().array().log().sum();
    EXPECT_NEAR(beside[on].force_log_det, log_det, 1e-6 * log_det);
    const double unknowns = static_cast<double>(S) - precision.ldlt().solve(MatrixXd::Identity(S, S)).trace();
    EXPECT_NEAR(beside[on].force_unknowns, unknowns, 1e-6 * unknowns);
  }
}

// Draws of sensors' noise and of the force's prior together: their covariance is the Gram matrix.
TEST(Screening, DrawsTheNullBesideAnyForceWithTheGramMatrixAsCovariance) {
  auto p = Prepare("arm2", {}, 28);
  p->data.windows.resize(4);
  const FitModel model{p->nominal, p->nominal.parameters().Nominal(), {}};
  const NodeStates states = InitialStates(p->data, model, {});
  const FeatureSet features = MakeFeatures(p->data, p->nominal, p->scales);
  FeatureBlock one{{features.block.joint.front()}, {}, {}};
  for (const MatrixXd& phi : features.block.phi) one.phi.push_back(phi.topRows(1));
  const int draws = 4000;
  const FreeForce force{{0, 1}, p->scales.torque};
  for (const Screen& screen : MakeScreens(force, p->data, model, states, one, {}, draws, Rng(5))) {
    const double variance = screen.null.row(0).squaredNorm() / draws;
    EXPECT_NEAR(variance / screen.gram(0, 0), 1.0, 5 * std::sqrt(2.0 / draws));
  }
}

TEST(Screening, GrowsASetOfJointsToWhereTheEffectIs) {
  const auto joints = sysid::testing::LoadPlant("arm2").joint_names();
  const auto p = Prepare("arm2",
                         {MakeSpec("viscous_friction", {joints[0]}, {{"viscous", 0.3}}),
                          MakeSpec("viscous_friction", {joints[1]}, {{"viscous", 0.1}})},
                         23);
  const ScreenResult r = Screened(*p, {}, {});
  ASSERT_FALSE(r.sets.empty());
  EXPECT_TRUE(
      Holds(r.sets.front(), "viscous_friction", {0, 1}) ||
      (Holds(r.sets.front(), "viscous_friction", {0}) && Holds(r.sets.front(), "viscous_friction", {1})));
}

TEST(Screening, SeesAPayloadInTheLastLinksParameters) {
  const auto p = Prepare(
      "arm2", {MakeSpec("payload", {}, {{"mass", 0.3}, {"com_x", 0.0}, {"com_y", 0.0}, {"com_z", 0.0}})}, 24);
  const auto parameters = FreeParameters(p->nominal, p->scales, true);
  const auto& model = p->nominal.model();
  const std::string& last = model.link(model.joint(model.num_joints() - 1).child_link).name;
  std::vector<ParameterColumn> columns;
  for (const auto& q : parameters) {
    const sim::Parameter& row = p->nominal.parameters()[q.index];
    ParameterColumn c;
    c.prior_stddev = q.prior_stddev, c.base = true, c.last_link = row.owner == last;
    if (c.last_link) c.role = row.field;
    columns.push_back(c);
  }
  const ScreenResult r = Screened(*p, parameters, columns);
  const auto payload = std::find_if(r.hypotheses.begin(), r.hypotheses.end(),
                                    [](const Scored& h) { return h.effect == "payload"; });
  ASSERT_NE(payload, r.hypotheses.end());
  EXPECT_GT(payload->gain, r.null_gain + 50);
  EXPECT_GT(payload->gain, 0.5 * r.hypotheses.front().gain);
}

// A dead zone that all efforts exceed is a force against their sign, however small it is.
TEST(Screening, HasADeadZoneThatNextToNoEffortLiesIn) {
  const auto p = Prepare("arm2", {}, 25);
  double least = 1e300, small = 0, rows = 0;
  for (const Feature& f : MakeFeatures(p->data, p->nominal, p->scales).features) {
    if (f.regressor == effects::Regressor::kInBand && f.joint == 0) least = std::min(least, f.shape);
  }
  for (const FineMotion& m : p->data.fine) {
    small += static_cast<double>((m.u.row(0).array().abs() < least).count());
    rows += static_cast<double>(m.u.cols());
  }
  EXPECT_GT(least, 0);
  EXPECT_LT(small, 0.02 * rows);
}

}  // namespace
}  // namespace rg::diagnosis
