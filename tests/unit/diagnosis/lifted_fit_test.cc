#include "services/diagnosis/likelihood/lifted_fit.h"

#include <gtest/gtest.h>

#include <Eigen/QR>

#include <tuple>

#include "common/effects/effect_catalog.h"
#include "services/diagnosis/data/prepare_data.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/likelihood/fitted_motion.h"
#include "services/diagnosis/likelihood/linear_window.h"
#include "services/diagnosis/likelihood/lineariser.h"
#include "services/diagnosis/likelihood/missing_force.h"
#include "services/diagnosis/likelihood/row_products.h"
#include "services/diagnosis/search/fit_requests.h"
#include "services/sysid/sysid_on_set.h"
#include "tests/unit/diagnosis/prepared_set.h"

namespace rg::diagnosis {
namespace {

using effects::EffectSpec;
using effects::MakeSpec;

using testing::Prepare;
using testing::Prepared;

FitModel ModelOf(const Prepared& p, std::vector<effects::EffectSpec> specs) {
  auto plant = sim::Plant::Create(p.nominal.shared_model(), p.nominal.options(), std::move(specs));
  RG_CHECK(plant.ok()) << plant.status().ToString();
  return {*plant, plant->parameters().Nominal(), FreeParameters(*plant, p.scales, false)};
}

FitResult FitEffects(const Prepared& p, std::vector<effects::EffectSpec> specs,
                     const LiftedOptions& options = {}) {
  return Fit(p.data, ModelOf(p, std::move(specs)), options);
}

EffectSpec LagOf(const sim::Plant& robot, double seconds) {
  return MakeSpec("actuator_lag", {robot.joint_names()[0]}, {{"time_constant", seconds}});
}

std::unique_ptr<Prepared> Lagging(double seconds, uint64_t seed) {
  return Prepare("pendulum", {LagOf(sysid::testing::LoadPlant("pendulum"), seconds)}, seed);
}

// A joint that has all the effects it can have feels no push beside them.
TEST(MakeProbe, LeavesOutAJointThatIsFull) {
  const sim::Plant nominal = sysid::testing::LoadPlant("arm2");
  std::vector<EffectSpec> specs = {MakeSpec("unknown_field_pair", {"shoulder", "elbow"})};
  const auto stand = [&] { return sim::Plant::Create(nominal.shared_model(), nominal.options(), specs); };
  for (const effects::EffectInfo& info : effects::Catalog()) {
    if (info.scope != effects::Scope::kJoint || info.id == "external_disturbance") continue;
    specs.push_back(MakeSpec(info.id, {"elbow"}));
    if (!stand().ok()) specs.pop_back();
  }
  const auto full = stand();
  ASSERT_TRUE(full.ok()) << full.status().ToString();
  specs.push_back(MakeSpec("external_disturbance", {"elbow"}));
  ASSERT_FALSE(stand().ok());
  const Probe probe = MakeProbe({*full, full->parameters().Nominal(), {}}, true);
  EXPECT_GE(probe.torque[0], 0);
  EXPECT_EQ(probe.torque[1], -1);
}

TEST(Lineariser, ThePartOfAWindowIsItsFirstRows) {
  const auto p = Prepare("arm2", {}, 1);
  const FitModel model{p->nominal, p->nominal.parameters().Nominal(), {}};
  Lineariser lineariser(p->data, model, false, LiftedOptions{});
  const Eigen::VectorXd x0 = InitialStates(p->data, model, LiftedOptions{})[0].col(0);
  const Eigen::VectorXd rows = lineariser.Residuals(0, 0, x0);
  const std::vector<int> first = {0};
  const std::vector<Eigen::VectorXd> start = {x0};
  const double whole = lineariser.Simulated(0, first, start)[0];
  const double part = lineariser.Simulated(0, first, start, 0.4)[0];
  // Near the record a row counts its square.
  const auto count =
      static_cast<Eigen::Index>(std::lround(0.4 * static_cast<double>(p->data.windows[0].t.size())));
  EXPECT_NEAR(part, rows.head(count * 4).squaredNorm(), 0.02 * part);
  EXPECT_LT(part, whole);
}

TEST(Work, OfASimulationGoesWithItsStepsAndOfALinearisationWithItsRowsToo) {
  const auto p = Prepare("pendulum", {}, 1), slow = Prepare("pendulum", {}, 1, {.rate_hz = 25}),
             arm = Prepare("arm2", {}, 1);
  const LiftedOptions options;
  const double work = SimulationWork(p->data, options, 2), linear = LinearisationWork(p->data, options, 2, 5);
  EXPECT_LT(slow->data.Rows(), 0.3 * p->data.Rows());
  EXPECT_NEAR(SimulationWork(slow->data, options, 2), work, 0.1 * work);
  EXPECT_LT(LinearisationWork(slow->data, options, 2, 5), linear);
  EXPECT_GT(SimulationWork(arm->data, options, 4), 1.2 * work);
  EXPECT_GT(LinearisationWork(p->data, options, 2, 50), 2 * linear);
  LiftedOptions finer;
  finer.step_s = 0.5 * options.step_s;
  EXPECT_NEAR(SimulationWork(p->data, finer, 2), 2 * work, 1e-9 * work);
  FitData half = p->data;
  half.windows.resize(half.windows.size() / 2);
  EXPECT_NEAR(SimulationWork(half, options, 2), 0.5 * work, 0.05 * work);
  EXPECT_NEAR(LinearisationWork(half, options, 2, 5), 0.5 * linear, 0.05 * linear);
}

TEST(ProjectOut, LeavesWhatIsOrthogonalHoweverManyColumnsAreLike) {
  Rng rng(3);
  RowMatrixXd E(40, 4), J(40, 4);
  for (RowMatrixXd* m : {&E, &J})
    for (double& x : m->reshaped()) x = rng.Normal();
  E.col(3) = 1e6 * (E.col(0) - E.col(1));
  J.col(2) = E.col(2);
  RowMatrixXd rest = J;
  EXPECT_EQ(ProjectOut(E, &rest), 3);
  EXPECT_LT((E.leftCols(3).transpose() * rest).cwiseAbs().maxCoeff(), 1e-12);
  EXPECT_LT(rest.col(2).norm(), 1e-13);
  EXPECT_GT(rest.col(0).norm(), 3);
  // What is taken away lies in their span.
  const MatrixXd taken = J.col(0) - rest.col(0);
  EXPECT_LT((taken - E.leftCols(3) * E.leftCols(3).colPivHouseholderQr().solve(taken)).norm(), 1e-12);
  rest = J;
  EXPECT_EQ(ProjectOut(RowMatrixXd::Zero(40, 2), &rest), 0);
  EXPECT_EQ(rest, J);
}

// Formed once, it tells the start after any step of the parameters.
TEST(BestStart, LeavesNothingAlongTheStartsColumnsAfterAnyStep) {
  Rng rng(5);
  Linear l{RowMatrixXd(30, 3 + 2 + 1), {}, 3};
  for (double& x : l.rows.reshaped()) x = rng.Normal();
  l.rows.col(1) *= 10;
  const Eigen::VectorXd at = Eigen::VectorXd::Ones(3);
  const ArrivalCost nothing_known{at, Eigen::VectorXd::Zero(3)}, known{2 * at, 1e12 * at};
  const BestStart best(l, nothing_known), held(l, known);
  for (const double size : {0.0, 1.0, -3.0}) {
    const Eigen::VectorXd step = Eigen::VectorXd::Constant(2, size), rest = l.r() - l.J() * step;
    const Eigen::VectorXd along = l.J_e().transpose() * (rest - l.J_e() * best.After(step, at));
    EXPECT_LT(along.norm(), 1e-6 * (l.J_e().transpose() * rest).norm()) << size;
    EXPECT_LT((held.After(step, at) - at).norm(), 1e-6) << "goes to the mean of its prior";
  }
}

// A minimum is not found more closely than a wrong model is worth; of the true one to the end.
TEST(LiftedFit, EndsWhereItGoesNoFurtherFarFromTheNoise) {
  const std::string joint = sysid::testing::LoadPlant("pendulum").joint_names()[0];
  const auto p = Prepare(
      "pendulum",
      {MakeSpec("coulomb_friction", {joint}, {{"coulomb", 0.5}}),
       MakeSpec("torque_ripple", {joint}, {{"amplitude", 0.4}, {"cycles_per_rev", 3}, {"phase", 0.3}})},
      4);
  const FitResult fit =
      FitEffects(*p, {MakeSpec("coulomb_friction", {joint}, {{"coulomb", 0.1}})}, {.iterations = 40});
  ASSERT_TRUE(fit.ok);
  EXPECT_GT(fit.chi2, 10.0 * fit.rows);
  EXPECT_LT(fit.iterations, 12);
  const FitResult few =
      FitEffects(*p, {MakeSpec("coulomb_friction", {joint}, {{"coulomb", 0.1}})}, {.iterations = 3});
  EXPECT_LT(fit.chi2, 1.05 * few.chi2);
}

TEST(LiftedFit, TheTrueModelIsAtTheNoise) {
  const auto p = Prepare("pendulum", {}, 1);
  const FitResult fit = FitEffects(*p, {});
  ASSERT_TRUE(fit.ok);
  // Rows minus the unknown initial states.
  const double dof = fit.rows - 2.0 * static_cast<double>(p->data.windows.size());
  EXPECT_NEAR(fit.chi2 / dof, 1.0, 5.0 * std::sqrt(2.0 / dof));
}

// Five rows are one node; the motion bends within them by more than their mean is known to.
TEST(LiftedFit, TheTrueModelIsAtTheNoiseWhereSeveralRowsAreOneNode) {
  const auto p = Prepare("pendulum", {}, 1, {.rate_hz = 500, .finer = 10});
  const FitResult fit = FitEffects(*p, {});
  ASSERT_TRUE(fit.ok);
  const double dof = fit.rows - 2.0 * static_cast<double>(p->data.windows.size());
  EXPECT_NEAR(fit.chi2 / dof, 1.0, 5.0 * std::sqrt(2.0 / dof));
}

// Across the plane of a nearly planar arm hardly anything pushes its mount, and rows show that direction to
// second order: a start that follows their noise there is thrown, and takes the directions that matter with
// it.
TEST(LiftedFit, StartsOfAMountStayInThePlaneOfAPlanarArm) {
  const auto load =
      MakeSpec("payload", {}, {{"mass", 0.8}, {"com_x", 0.0}, {"com_y", 0.01}, {"com_z", -0.2}});
  const auto p =
      Prepare("arm2", {load, MakeSpec("base_flexibility", {}, {{"stiffness", 1200}, {"damping", 12}})}, 8,
              {.rate_hz = 25});
  const FitResult fit =
      FitEffects(*p, {load, MakeSpec("base_flexibility", {}, {{"stiffness", 800}, {"damping", 16}})});
  ASSERT_TRUE(fit.ok);
  for (const Eigen::MatrixXd& states : fit.states) {
    EXPECT_LT(std::abs(states(4, 0)), 2e-3) << "tilt about x";
    EXPECT_LT(std::abs(states(5, 0)), 5e-2) << "its rate";
  }
}

TEST(ArrivalCosts, AreOfBodiesThatEffectsAddAlone) {
  const auto plant =
      sim::Plant::Create(Prepare("arm2", {}, 1)->nominal.shared_model(), {},
                         {MakeSpec("joint_elasticity", {"elbow"}), MakeSpec("base_flexibility", {})});
  ASSERT_TRUE(plant.ok());
  const long nx = plant->num_states();
  NodeStates carried(3, Eigen::MatrixXd::Constant(nx, 5, 0.2));
  carried[1].row(nx - 3).setZero();
  const std::vector<ArrivalCost> loose = ArrivalCosts(*plant, carried);
  ASSERT_EQ(loose.size(), carried.size());
  EXPECT_EQ(loose[1].middle, carried[1].col(0));
  const Eigen::VectorXd& precision = loose[0].precision;
  EXPECT_EQ(precision.head(nx - 4).norm(), 0) << "joints, and the motor behind its spring";
  EXPECT_NEAR(precision[nx - 1], 0.25, 1e-12) << "ten times 0.2";
  EXPECT_GT(precision[nx - 3], precision[nx - 1]) << "what moves less is known better";
}

// Rows within one step of the sensor err alike: their mean is no better than one of them.
TEST(LiftedFit, TheTrueModelIsAtTheNoiseOfACoarseSensor) {
  const auto p = Prepare("pendulum", {}, 1, {.rate_hz = 500, .finer = 5, .resolution = 4e-3});
  const FitResult fit = FitEffects(*p, {});
  ASSERT_TRUE(fit.ok);
  const double dof = fit.rows - 2.0 * static_cast<double>(p->data.windows.size());
  EXPECT_NEAR(fit.chi2 / dof, 1.0, 0.15);
}

TEST(StddevOfMean, IsThatOfOneReadingWithinAStepAndFallsWithTheRootBeyond) {
  const std::vector<double> t = {0, 0.002, 0.004, 0.006, 0.008};
  const double step = 1e-3, alone = step / std::sqrt(12.0);
  EXPECT_NEAR(StddevOfMean(t, 0, alone, step), alone, 0.03 * alone);
  // Less than half a step of motion: a part of the error stays beside the white share.
  EXPECT_GT(StddevOfMean(t, 0.5 * step / 0.01, alone, step), 0.5 * alone);
  // A fifth of a step further each row and over again: the sawtooth averages out but for its fifth harmonic.
  EXPECT_NEAR(StddevOfMean(t, 0.2 * step / 0.002, alone, step), alone / 5, 0.02 * alone);
  // White noise of half a step and more blurs the steps away.
  const double white = std::hypot(0.6 * step, alone);
  EXPECT_NEAR(StddevOfMean(t, 0, white, step), white / std::sqrt(5.0), 0.01 * white);
  EXPECT_NEAR(StddevOfMean(t, 0, 1.0, 0), 1 / std::sqrt(5.0), 1e-12);
}

TEST(LiftedFit, FindsCoulombFrictionThroughSticking) {
  const std::string joint = sysid::testing::LoadPlant("pendulum").joint_names()[0];
  const auto p = Prepare("pendulum", {MakeSpec("coulomb_friction", {joint}, {{"coulomb", 0.15}})}, 2);
  const FitResult wrong = FitEffects(*p, {});
  const FitResult fit = FitEffects(*p, {MakeSpec("coulomb_friction", {joint}, {{"coulomb", 0.05}})});
  ASSERT_TRUE(fit.ok);
  EXPECT_NEAR(fit.theta[0], 0.15, 5 * fit.stddev[0] + 1e-3);
  EXPECT_GT(fit.evidence, wrong.evidence + 50);
}

// Scored at four times the noise and brought to the sensors' own it is what a fit at that noise says.
TEST(LiftedFit, IsBroughtToAnotherNoiseWithItsEvidence) {
  const std::string joint = sysid::testing::LoadPlant("pendulum").joint_names()[0];
  const auto p = Prepare("pendulum", {MakeSpec("coulomb_friction", {joint}, {{"coulomb", 0.15}})}, 2);
  const FitSetting setting{p->data, p->nominal, p->scales};
  const std::vector<EffectSpec> specs = {MakeSpec("coulomb_friction", {joint}, {{"coulomb", 0.05}}),
                                         MakeSpec("viscous_friction", {joint}, {{"viscous", 0.05}})};
  const auto at_noise = [&](double scale) {
    Candidate c = Unfitted(setting, specs, false);
    c.fit = FitEffects(*p, specs, {.iterations = 20, .noise_scale = scale});
    c.score = c.fit.evidence;
    return c;
  };
  Candidate moved = at_noise(4.0);
  const Candidate there = at_noise(1.0);
  Rescale(4.0, 1.0, &moved);
  EXPECT_NEAR(moved.score, there.score, 0.1);
  for (long k = 0; k < 2; ++k)
    EXPECT_NEAR(moved.fit.stddev[k], there.fit.stddev[k], 0.02 * there.fit.stddev[k]);
}

// How fast a joint slides that rests shows in the first rows alone: no window is lost to a start that noise
// has thrown off, nor the friction to such a window.
TEST(LiftedFit, ComesToTheNoiseWhereJointsRest) {
  const std::string joint = sysid::testing::LoadPlant("pendulum").joint_names()[0];
  const auto friction = [&](double level) {
    return MakeSpec("asymmetric_friction", {joint},
                    {{"coulomb_positive", level}, {"coulomb_negative", 0.5 * level}});
  };
  for (const uint64_t seed : {1, 2, 4, 6}) {
    const auto p = Prepare("pendulum", {friction(1.5)}, seed, {.rate_hz = 250, .finer = 5});
    p->data.use_velocity = false;
    const FitResult fit = FitEffects(*p, {friction(0.75)});
    ASSERT_TRUE(fit.ok);
    const double dof = fit.rows - 2.0 * static_cast<double>(p->data.windows.size());
    EXPECT_LT(fit.chi2 / dof, 1.15) << seed;
    EXPECT_NEAR(fit.theta[0], 1.5, 0.01) << seed;
  }
}

// A drive that is late follows commands from before the recording, which nobody knows.
TEST(Windows, BeginWhereWhatALateDriveFollowsIsRecorded) {
  const auto p = Prepare("pendulum", {}, 3, {.rate_hz = 250});
  int last = -1;
  for (const NodeWindow& w : p->data.windows) {
    const Eigen::VectorXd& t = p->data.recordings[static_cast<size_t>(w.recording)].recording->t;
    if (w.recording != last) {
      EXPECT_NEAR(w.t.front() - t[0], 0.1, 0.004);
      EXPECT_NEAR(w.t.back() - t[0], 0.5, 0.01);
    } else {
      EXPECT_GE(w.t.front() - t[0], 0.49);
    }
    last = w.recording;
  }
  EXPECT_GE(last, 0);
}

// What a lag is where a window begins is no free start of its own, which could follow another law.
TEST(LiftedFit, ALagStartsWhereCommandsBeforeTheWindowLeaveIt) {
  const auto p = Lagging(0.03, 5);
  const FitResult fit = FitEffects(*p, {LagOf(p->nominal, 0.01)}, {.iterations = 12});
  ASSERT_TRUE(fit.ok);
  EXPECT_NEAR(fit.theta[0], 0.03, 4 * fit.stddev[0] + 1e-4);
  const FitModel model = ModelOf(*p, {LagOf(p->nominal, fit.theta[0])});
  sim::Simulator simulator(model.plant);
  const auto filtered = [&](size_t w, double time_constant) {
    Eigen::VectorXd values = fit.values;
    values[model.parameters[0].index] = time_constant;
    simulator.SetParameters(values);
    const NodeWindow& window = p->data.windows[w];
    const sim::CommandSignal& command = p->data.recordings[static_cast<size_t>(window.recording)].command;
    const double begin = window.t[0] - 0.4;
    return simulator
        .Simulate(simulator.MakeState(window.q0.col(0), window.v0.col(0), begin, command), command,
                  {window.t[0]})
        .state(2, 0);
  };
  Lineariser lineariser(p->data, model, false, LiftedOptions{});
  int tied = 0;
  for (size_t w = 0; w < p->data.windows.size(); ++w) {
    if (p->data.windows[w].t[0] < 0.45) continue;  // the record does not go back so far
    EXPECT_NEAR(fit.states[w](2, 0), filtered(w, fit.theta[0]), 2e-3);
    Linear linear;
    lineariser.Run(0, static_cast<int>(w), fit.states[w], nullptr, nullptr, true, &linear);
    ASSERT_TRUE(linear.ok);
    EXPECT_EQ(linear.Node(0).leftCols(3).row(2).norm(), 0.0);
    const double h = 1e-4;
    const double slope = (filtered(w, fit.theta[0] + h) - filtered(w, fit.theta[0] - h)) / (2 * h);
    EXPECT_NEAR(linear.Node(0)(2, 3), slope, 0.02 * std::abs(slope) + 0.05);
    ++tied;
  }
  EXPECT_GT(tied, 5);
}

// A slow lag remembers commands from before half a second, and of a gap's nobody knows.
TEST(LiftedFit, ALagWhoseCommandsWereNotAllRecordedStartsAnywhere) {
  const auto p = Lagging(0.2, 6);
  const FitResult fit = FitEffects(*p, {LagOf(p->nominal, 0.1)}, {.iterations = 12});
  ASSERT_TRUE(fit.ok);
  EXPECT_NEAR(fit.theta[0], 0.2, 4 * fit.stddev[0] + 1e-3);
  EXPECT_NEAR(fit.chi2 / (fit.rows - 3.0 * static_cast<double>(p->data.windows.size())), 1.0, 0.1);

  const auto free_starts = [&](double seconds) {
    const FitModel model = ModelOf(*p, {LagOf(p->nominal, seconds)});
    const NodeStates states = InitialStates(p->data, model, LiftedOptions{});
    Lineariser lineariser(p->data, model, false, LiftedOptions{});
    size_t count = 0;
    for (size_t w = 0; w < p->data.windows.size(); ++w) {
      Linear linear;
      lineariser.Run(0, static_cast<int>(w), states[w], nullptr, nullptr, true, &linear);
      count += linear.Node(0)(2, 2) == 1.0;
    }
    return count;
  };
  EXPECT_EQ(free_starts(0.2), p->data.windows.size());
  EXPECT_EQ(free_starts(0.01), 0u);
  recordings::Recording gap = *p->data.recordings[0].recording;
  const double start = p->data.windows[1].t[0];
  for (double& t : gap.t) t -= t < start - 0.03 ? 0.1 : 0.0;
  p->data.fine[0] = FineMotionOf(gap, p->data.recordings[0].command, p->data.motions[0], p->data.nodes);
  EXPECT_EQ(p->data.fine[0].gaps.size(), 1u);
  EXPECT_EQ(free_starts(0.01), 1u);
}

// Hard faces bend a motion more between two nodes than a line says: on nodes of their own, off the
// simulation, fits stay where they start.
TEST(LiftedFit, FindsPlayBetweenHardFacesFromSoftOnes) {
  const std::string joint = sysid::testing::LoadPlant("pendulum").joint_names()[0];
  const auto play = [&](double gap, double stiffness, double damping, double inertia) {
    EffectSpec spec = MakeSpec("backlash", {joint},
                               {{"gap", gap},
                                {"contact_stiffness", stiffness},
                                {"contact_damping", damping},
                                {"motor_inertia", inertia},
                                {"motor_viscous", 0.001}});
    spec.options["sensor"] = "motor";
    return spec;
  };
  const auto p = Prepare("pendulum", {play(0.02, 1500, 2.6, 0.05)}, 3, {.rate_hz = 250, .finer = 2});
  // From rest: the drive is not late.
  p->data.nodes.unknown_s = 0;
  p->data.windows.clear();
  for (size_t r = 0; r < p->data.recordings.size(); ++r) {
    const auto windows = CutIntoNodes(*p->data.recordings[r].recording, static_cast<int>(r),
                                      p->data.motions[r], p->data.noise, p->data.nodes);
    p->data.windows.insert(p->data.windows.end(), windows.begin(), windows.end());
  }
  const FitResult fit = FitEffects(*p, {play(0.017, 450, 1.3, 0.05)}, {.iterations = 20});
  ASSERT_TRUE(fit.ok);
  EXPECT_LT(fit.chi2 / fit.rows, 20.0);  // from 150
  EXPECT_NEAR(fit.theta[0], 0.02, 2e-3);
}

// A step that is too long for hard faces bends their stiffness, and what is left hides it.
TEST(LiftedFit, HalvesItsStepWhereThatErrs) {
  const std::string joint = sysid::testing::LoadPlant("pendulum").joint_names()[0];
  auto play = MakeSpec("backlash", {joint},
                       {{"gap", 0.01},
                        {"contact_stiffness", 4000},
                        {"contact_damping", 5},
                        {"motor_inertia", 0.05},
                        {"motor_viscous", 0.001}});
  play.options["sensor"] = "link";
  const auto p = Prepare("pendulum", {play}, 3, {.rate_hz = 500, .finer = 2, .step_s = 1e-4});
  const LiftedOptions options, fixed{.shortest_step_s = options.step_s};
  const FitResult fit = FitEffects(*p, {play}, options), coarse = FitEffects(*p, {play}, fixed);
  ASSERT_TRUE(fit.ok && coarse.ok);
  EXPECT_EQ(coarse.step_s, options.step_s);
  EXPECT_LT(fit.step_s, 0.5 * options.step_s + 1e-9);
  EXPECT_GE(fit.step_s, options.shortest_step_s);
  EXPECT_LT(fit.chi2, 1.1 * fit.rows);
  EXPECT_GT(coarse.chi2, 1.3 * coarse.rows);
  // Slow motion needs no shorter one, and far from the recordings none helps.
  const auto still = Prepare("pendulum", {}, 1, {.rate_hz = 25});
  EXPECT_EQ(FitEffects(*still, {}, options).step_s, options.step_s);
  EXPECT_EQ(FitEffects(*p, {}, options).step_s, options.step_s);
}

// What the step does to a stiff spring is taken up by its stiffness: nothing is missing, but the value is
// off.
TEST(LiftedFit, HalvesItsStepForValuesThatTakeUpItsError) {
  const std::string joint = sysid::testing::LoadPlant("pendulum").joint_names()[0];
  auto spring =
      MakeSpec("joint_elasticity", {joint}, {{"stiffness", 800}, {"damping", 0.3}, {"motor_inertia", 0.05}});
  spring.options["sensor"] = "link";
  const auto p = Prepare("pendulum", {spring}, 3, {.rate_hz = 250, .finer = 2, .step_s = 1e-4});
  const LiftedOptions for_names{.iterations = 20}, for_values{.iterations = 20, .for_values = true};
  const FitResult fit = FitEffects(*p, {spring}, for_names), exact = FitEffects(*p, {spring}, for_values);
  ASSERT_TRUE(fit.ok && exact.ok);
  EXPECT_EQ(fit.step_s, for_names.step_s);
  EXPECT_LT(exact.step_s, for_values.step_s);
  EXPECT_LT(fit.chi2, 1.1 * fit.rows);
  const auto off = [&](const FitResult& of) { return std::abs(of.theta[0] / 800 - 1); };
  EXPECT_GT(off(fit), 0.01);
  EXPECT_LT(off(exact), 0.003);
}

// Three rows are lost in a row, every 0.6 s.
recordings::RecordingSet WithLostRows(recordings::RecordingSet set) {
  for (recordings::Recording& rec : set.recordings) {
    std::vector<int> kept;
    for (int k = 0; k < rec.rows(); ++k) {
      if (k < 20 || k % 60 > 2) kept.push_back(k);
    }
    rec.t = Eigen::VectorXd(rec.t(kept)), rec.q = Eigen::MatrixXd(rec.q(Eigen::all, kept));
    rec.v = Eigen::MatrixXd(rec.v(Eigen::all, kept));
    rec.effort_command = Eigen::MatrixXd(rec.effort_command(Eigen::all, kept));
  }
  return set;
}

// Commands that are not in the file move the robot too: no window is simulated through them, nor begins where
// a late drive still follows them.
TEST(LiftedFit, MeetsWhatIsLeftWhereRowsAreLost) {
  const auto truth = MakeSpec("actuator_delay", {"shoulder"}, {{"delay", 0.02}});
  const auto whole = testing::MakeSet("arm2", {truth}, 6);
  const auto p = testing::Prepare(WithLostRows(whole));
  const double gap = 0.04 - 1e-9;
  for (const NodeWindow& w : p->data.windows) {
    const Eigen::VectorXd& rows = p->data.recordings[static_cast<size_t>(w.recording)].recording->t;
    for (int k = 1; k < rows.size(); ++k) {
      if (rows[k] - rows[k - 1] < gap) continue;
      EXPECT_TRUE(w.t.back() < rows[k - 1] + 1e-9 || w.t.front() > rows[k] + 0.05 - 1e-9) << w.t.front();
    }
  }
  const FitResult fit = FitEffects(*p, {MakeSpec("actuator_delay", {"shoulder"}, {{"delay", 0.01}})});
  ASSERT_TRUE(fit.ok);
  EXPECT_LT(fit.chi2, fit.rows + 3 * std::sqrt(2.0 * fit.rows));
  EXPECT_NEAR(fit.theta[0], 0.02, 5e-4);
  // Short windows: more of them hold as much motion.
  EXPECT_GT(p->data.WindowsFor(8), testing::Prepare(whole)->data.WindowsFor(8));
}

// A motor behind a spring, which may stall for a while and then come near.
TEST(LiftedFit, EndsWhereItWouldNotComeToWhatItMust) {
  const std::string joint = sysid::testing::LoadPlant("pendulum").joint_names()[0];
  const auto truth = MakeSpec("coulomb_friction", {joint}, {{"coulomb", 1.0}});
  const auto p = Prepare("pendulum", {truth}, 4);
  auto start =
      MakeSpec("joint_elasticity", {joint}, {{"stiffness", 100}, {"damping", 0.1}, {"motor_inertia", 0.02}});
  start.options["sensor"] = "link";
  LiftedOptions options;
  options.iterations = 12;
  const FitResult wrong = FitEffects(*p, {start}, options);
  options.to_beat = 0.5 * wrong.chi2;
  const FitResult hopeless = FitEffects(*p, {start}, options);
  EXPECT_LT(hopeless.work, wrong.work);
  EXPECT_GT(hopeless.chi2, options.to_beat);
  EXPECT_LT(hopeless.chi2, 1.5 * wrong.chi2);
  const auto near = MakeSpec("coulomb_friction", {joint}, {{"coulomb", 0.3}});
  EXPECT_EQ(FitEffects(*p, {near}, options).chi2, FitEffects(*p, {near}, {.iterations = 12}).chi2);
}

TEST(LiftedFit, DoesNotDependOnTheNumberOfThreads) {
  const auto p = Prepare("pendulum", {}, 3);
  LiftedOptions one, three;
  three.threads = 3;
  const FitModel model{p->nominal, p->nominal.parameters().Nominal(),
                       FreeParameters(p->nominal, p->scales, true)};
  const FitResult a = Fit(p->data, model, one), b = Fit(p->data, model, three);
  EXPECT_EQ(a.chi2, b.chi2);
  EXPECT_EQ(a.work, b.work);
}

TEST(LiftedFit, EndsAtOnceWhereItStartsFromItsOwnEnd) {
  const std::string joint = sysid::testing::LoadPlant("pendulum").joint_names()[0];
  const auto p = Prepare("pendulum", {MakeSpec("viscous_friction", {joint}, {{"viscous", 0.1}})}, 8);
  const auto plant = sim::Plant::Create(p->nominal.shared_model(), p->nominal.options(),
                                        {MakeSpec("viscous_friction", {joint}, {{"viscous", 0.02}})});
  FitModel model{*plant, plant->parameters().Nominal(), FreeParameters(*plant, p->scales, false)};
  const FitResult cold = Fit(p->data, model, {});
  model.values = cold.values;
  const NodeStates carried = CarriedStates(p->data, model, *plant, cold.states, {});
  const FitResult warm = Fit(p->data, model, {}, &carried);
  EXPECT_LE(warm.iterations, 2);
  EXPECT_NEAR(warm.evidence, cold.evidence, 0.05);
}

TEST(LiftedFit, PiecesKeepWhatWasMeasured) {
  const auto p = Prepare("pendulum", {}, 4);
  const auto pieces = InPieces(p->data.windows, 0.1, p->data.noise);
  const auto count = [](const std::vector<NodeWindow>& windows) {
    int measured = 0;
    for (const NodeWindow& w : windows) {
      for (const char m : w.measured) measured += m;
      EXPECT_EQ(w.q.cols(), static_cast<long>(w.t.size()));
      EXPECT_EQ(w.q0.cols(), static_cast<long>(w.t.size()));
    }
    return measured;
  };
  EXPECT_GT(pieces.size(), 3 * p->data.windows.size());
  // Less the few at a window's end that make no piece of their own.
  const int all = count(p->data.windows), kept = count(pieces);
  EXPECT_LE(kept, all);
  EXPECT_GE(kept, all - 2 * static_cast<int>(p->data.windows.size()));
}

TEST(LiftedFit, FindsTheWayOverPiecesFromFarAndEndsOnWholeWindows) {
  const std::string joint = sysid::testing::LoadPlant("pendulum").joint_names()[0];
  const auto p = Prepare("pendulum", {MakeSpec("torque_gain", {joint}, {{"gain", 2.5}})}, 5);
  const FitSetting setting{p->data, p->nominal, p->scales};
  FitRequest request{{MakeSpec("torque_gain", {joint}, {{"gain", 0.3}})}, false, {}, {}, 0.1, false, nullptr};
  const FitResult whole = MakeFit(setting, request);
  ASSERT_TRUE(whole.ok);
  EXPECT_NEAR(whole.theta[0], 2.5, 5 * whole.stddev[0] + 1e-3);
  EXPECT_EQ(whole.states.size(), p->data.windows.size());
  request.pieces_alone = true;
  const FitResult pieces = MakeFit(setting, request);
  ASSERT_TRUE(pieces.ok);
  EXPECT_NEAR(pieces.theta[0], 2.5, 0.1);
  EXPECT_TRUE(pieces.states.empty());
}

TEST(LiftedFit, StartsWhereASensorThatReadsOffSaysTheJointIs) {
  const auto p = Prepare("arm2", {}, 64);
  const double offset = 0.2;
  const auto plant =
      *p->nominal.WithEffect(effects::MakeSpec("encoder_offset", {"elbow"}, {{"offset", offset}}));
  const NodeStates states = InitialStates(p->data, {plant, plant.parameters().Nominal(), {}}, {});
  for (size_t w = 0; w < states.size(); ++w) {
    const MatrixXd moved = p->data.windows[w].q0 - states[w].topRows(2);
    EXPECT_LT(moved.row(0).cwiseAbs().maxCoeff(), 1e-12);
    EXPECT_LT((moved.row(1).array() - offset).abs().maxCoeff(), 1e-12);
  }
}

TEST(LiftedFit, CarriesStatesToAModelWithMoreOfThem) {
  const std::string joint = sysid::testing::LoadPlant("pendulum").joint_names()[0];
  const auto p = Prepare("pendulum", {}, 9);
  const FitModel rigid{p->nominal, p->nominal.parameters().Nominal(), {}};
  const NodeStates states = Fit(p->data, rigid, {}).states;
  const auto elastic = sim::Plant::Create(p->nominal.shared_model(), p->nominal.options(),
                                          {MakeSpec("joint_elasticity", {joint})});
  const FitModel more{*elastic, elastic->parameters().Nominal(), {}};
  const NodeStates carried = CarriedStates(p->data, more, p->nominal, states, {});
  ASSERT_EQ(carried.size(), states.size());
  ASSERT_EQ(carried[0].rows(), elastic->num_states());
  EXPECT_EQ(carried[0].topRows(2), states[0].topRows(2));
  // And back, nothing is lost.
  EXPECT_EQ(CarriedStates(p->data, rigid, *elastic, carried, {})[0], states[0]);
}

TEST(RowProducts, AreWhatEigenSaysForEverySize) {
  Rng rng(3);
  for (const auto& [rows, a, b] : {std::tuple{1, 1, 1}, {70, 9, 21}, {130, 37, 64}}) {
    RowMatrixXd A(rows, a), B(rows, b), G = RowMatrixXd::Ones(a, b), H = RowMatrixXd::Zero(a, a);
    for (double& x : A.reshaped()) x = rng.Normal();
    for (double& x : B.reshaped()) x = rng.Normal();
    AddTransposedProduct(A, B, 0.5, G);
    EXPECT_LT((G - RowMatrixXd::Ones(a, b) - 0.5 * A.transpose() * B).norm(), 1e-11 * rows);
    AddGram(A, 2.0, H);
    const RowMatrixXd lower = H.triangularView<Eigen::Lower>(), product = 2.0 * A.transpose() * A;
    EXPECT_LT((lower - RowMatrixXd(product.triangularView<Eigen::Lower>())).norm(), 1e-11 * rows);
    // Of blocks, into a block.
    const auto left = B.leftCols(b / 2 + 1);
    RowMatrixXd all = RowMatrixXd::Ones(rows + 1, a + 2);
    RowMatrixXd right = RowMatrixXd::Random(b / 2 + 1, a);
    AddProduct(left, right, -0.5, all.bottomRows(rows).middleCols(1, a));
    RowMatrixXd expected = RowMatrixXd::Ones(rows + 1, a + 2);
    expected.bottomRows(rows).middleCols(1, a) -= 0.5 * left * right;
    EXPECT_LT((all - expected).norm(), 1e-11 * rows);
  }
}

// In windows they are the simulation from the fitted start, whose accelerations make its velocities; outside
// they are what was recorded. At 1 kHz the fine grid does not begin where windows do.
TEST(FittedMotions, AreThoseOfTheSimulationInItsWindows) {
  for (const double rate : {100.0, 1000.0}) {
    SCOPED_TRACE(rate);
    const EffectSpec friction = MakeSpec("viscous_friction", {"elbow"}, {{"viscous", 0.2}}),
                     late = MakeSpec("sensor_delay", {"elbow"}, {{"delay", 0.01}});
    const auto p = Prepare("arm2", {friction, late}, 68, {.rate_hz = rate});
    const FitModel model = ModelOf(*p, {friction, late});
    const FitResult fit = Fit(p->data, model, {});
    ASSERT_TRUE(fit.ok);
    const FitModel fitted{model.plant, fit.values, {}};
    const auto motions = FittedMotions(p->data, fitted, fit.states, {});
    ASSERT_EQ(motions.size(), p->data.fine.size());
    LiftedOptions two;
    two.threads = 2;
    const auto by_two = FittedMotions(p->data, fitted, fit.states, two);
    std::vector<std::vector<char>> inside;
    for (size_t r = 0; r < motions.size(); ++r) {
      inside.emplace_back(motions[r].t.size());
      EXPECT_EQ(motions[r].q, by_two[r].q);
      EXPECT_EQ(motions[r].a, by_two[r].a);
    }
    for (size_t w = 0; w < p->data.windows.size(); ++w) {
      const NodeWindow& window = p->data.windows[w];
      const FineMotion& motion = motions[window.recording];
      const double dt = motion.t[1] - motion.t[0];
      const auto states = [&](double t) -> VectorXd {  // between nodes on a straight line
        const auto k = std::clamp<long>(std::ranges::upper_bound(window.t, t) - window.t.begin(), 1,
                                        std::ssize(window.t) - 1);
        const double share = (t - window.t[k - 1]) / (window.t[k] - window.t[k - 1]);
        return (1 - share) * fit.states[w].col(k - 1) + share * fit.states[w].col(k);
      };
      for (size_t i = 0; i < motion.t.size(); ++i) {
        if (motion.t[i] < window.t.front() || motion.t[i] >= window.t.back()) continue;
        inside[window.recording][i] = 1;
        const auto at = static_cast<Eigen::Index>(i);
        const VectorXd x = states(motion.t[i]);
        EXPECT_LT((motion.q.col(at) - x.head(2)).cwiseAbs().maxCoeff(), 1e-3);
        EXPECT_LT((motion.v.col(at) - x.tail(2)).cwiseAbs().maxCoeff(), 0.1);
        if (i == 0 || motion.t[i - 1] < window.t.front()) continue;
        const VectorXd mean = 0.5 * (motion.a.col(at) + motion.a.col(at - 1));
        EXPECT_LT((motion.v.col(at) - motion.v.col(at - 1) - dt * mean).cwiseAbs().maxCoeff(),
                  0.1 * dt * (1 + mean.cwiseAbs().maxCoeff()));
      }
    }
    for (size_t r = 0; r < motions.size(); ++r) {
      const auto rows = std::ranges::count(inside[r], char{1});
      EXPECT_GT(rows, std::ssize(inside[r]) / 2);
      EXPECT_LT(rows, std::ssize(inside[r]));
      for (size_t i = 0; i < inside[r].size(); ++i) {
        const auto at = static_cast<Eigen::Index>(i);
        EXPECT_EQ(motions[r].v.col(at) == p->data.fine[r].v.col(at), !inside[r][i]) << r << ' ' << i;
      }
    }
  }
}

TEST(MissingForce, ShowsAConstantPush) {
  const std::string joint = sysid::testing::LoadPlant("pendulum").joint_names()[0];
  const auto p = Prepare(
      "pendulum",
      {MakeSpec("external_disturbance", {joint}, {{"start", 1.0}, {"end", 3.0}, {"torque", 0.3}})}, 6);
  const FitModel model{p->nominal, p->nominal.parameters().Nominal(), {}};
  const MissingForce force =
      EstimateMissingForce(p->data, model, InitialStates(p->data, model, {}), p->scales.torque, 0.1, {});
  double inside = 0, outside = 0;
  int count_inside = 0, count_outside = 0;
  for (size_t w = 0; w < force.force.size(); ++w) {
    for (size_t s = 0; s < force.t[w].size(); ++s) {
      const double t = force.t[w][s];
      if (t > 1.1 && t < 2.9) inside += force.force[w](0, static_cast<long>(s)), ++count_inside;
      if (t < 0.9 || t > 3.1) outside += force.force[w](0, static_cast<long>(s)), ++count_outside;
    }
  }
  EXPECT_NEAR(inside / count_inside, 0.3, 0.05);
  EXPECT_NEAR(outside / count_outside, 0.0, 0.05);
}

// Of an arm whose last joint weighs a hundredth of its first what is left is on the joint that was pushed,
// and a second joint brings little.
TEST(MissingForce, IsOnTheJointWhoseTorqueAloneExplainsMost) {
  for (const int pushed : {0, 2, 4}) {
    const std::string joint = sysid::testing::LoadPlant("mico2").joint_names()[static_cast<size_t>(pushed)];
    const auto p = Prepare(
        "mico2", {MakeSpec("torque_ripple", {joint}, {{"amplitude", 0.4}, {"cycles_per_rev", 6.0}})}, 3);
    const FitModel model{p->nominal, p->nominal.parameters().Nominal(), {}};
    const MissingForce force =
        EstimateMissingForce(p->data, model, InitialStates(p->data, model, {}), p->scales.torque, 0.05, {});
    int best = 0;
    const double alone = force.evidence.diagonal().maxCoeff(&best);
    EXPECT_EQ(best, pushed);
    EXPECT_GT(alone, 100);
    EXPECT_LT(force.evidence.row(pushed).maxCoeff(), 1.1 * alone);
  }
}

TEST(Hypotheses, ANewFrictionTakesThePlaceOfTheOld) {
  const auto specs = Joined({MakeSpec("coulomb_friction", {"a"}), MakeSpec("coulomb_friction", {"b"})},
                            {MakeSpec("stribeck_friction", {"a"})});
  ASSERT_EQ(specs.size(), 2u);
  EXPECT_EQ(specs[0].joints[0], "b");
  EXPECT_EQ(specs[1].id, "stribeck_friction");
}

}  // namespace
}  // namespace rg::diagnosis
