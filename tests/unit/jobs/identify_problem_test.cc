#include "services/jobs/identify_problem.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>

#include "common/effects/effect_catalog.h"
#include "common/model/robot_model.h"
#include "common/model/urdf_loader.h"
#include "common/recordings/command_time.h"
#include "common/sim/simulator.h"
#include "realitygrad/v1/payloads.pb.h"
#include "services/jobs/iteration_result.h"
#include "services/rollouts/scoring.h"

namespace rg::jobs {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

sim::ModelFile Arm2() {
  const char* source = std::getenv("RG_SOURCE_DIR");
  auto robot = model::LoadUrdf(std::string(source ? source : ".") + "/deploy/robots/arm2.urdf");
  const sim::Plant plant = *sim::Plant::Create(std::make_shared<const model::RobotModel>(*std::move(robot)));
  return {plant, plant.parameters().Nominal(), 3};
}

// What `model` does under a slow excitation, at 25 Hz.
recordings::Recording Record(const sim::ModelFile& model, double seconds) {
  const int rows = static_cast<int>(seconds * 25) + 1;
  recordings::Recording out;
  out.name = "made";
  out.joints = model.plant.joint_names();
  out.t = VectorXd::LinSpaced(rows, 0, (rows - 1) * 0.04);
  out.effort_command = MatrixXd(2, rows);
  for (int k = 0; k < rows; ++k) {
    out.effort_command.col(k) << 3.0 * std::sin(1.7 * out.t[k]), 1.2 * std::sin(2.9 * out.t[k] + 0.4);
  }
  std::vector<double> times(out.t.data(), out.t.data() + rows);
  const auto command = *sim::CommandSignal::Create(times, out.effort_command, sim::Hold::kZeroOrder);
  sim::Simulator simulator(model.plant);
  simulator.SetParameters(model.values);
  const sim::Trajectory truth = simulator.Simulate(
      simulator.MakeState(VectorXd::Zero(2), VectorXd::Zero(2), 0.0, command), command, times);
  EXPECT_TRUE(truth.outcome.ok()) << truth.outcome.ToString();
  out.q = truth.position;
  out.v = truth.velocity;
  return out;
}

IdentifyProblemOptions Options() {
  IdentifyProblemOptions options;
  options.window_s = 0.4;
  options.simulator.step_s = 0.002;
  return options;
}

TEST(IdentifyProblem, TruthLeavesNoResidualInAnyWindow) {
  const sim::ModelFile model = Arm2();
  IdentifyProblemOptions options = Options();
  options.long_weight = 0.5;
  options.simulator.step_s = 0.001;  // as it was made
  const auto problem = IdentifyProblem::Create(model.plant, model.values, Record(model, 1.6), options);
  ASSERT_TRUE(problem.ok()) << problem.status().ToString();
  EXPECT_EQ(problem->windows(), 5) << "four windows and the whole";
  double cost = 1;
  ASSERT_TRUE(sysid::EvaluateCost(problem->problem(), problem->problem().initial, {}, &cost));
  EXPECT_LT(cost, 1e-12);
}

// A controller's first command comes some ms after the first row, in which the robot still rests: what held it
// until then must be the same for both.
TEST(IdentifyProblem, CostIsTheErrorByWhichAFitIsJudged) {
  const sim::ModelFile arm = Arm2();
  IdentifyProblemOptions options = Options();
  options.friction = true;
  const sim::ModelFile model = *ModelToFit(arm, options);
  recordings::Recording recording = Record(arm, 1.6);
  recording.other[recordings::kCommandTime] = recording.t.array() + 0.02;
  recording.effort_command.col(0) << 4.0, -1.0;
  ASSERT_TRUE(recordings::StartsAtRest(recording));
  options.long_weight = 0.5;
  const auto problem = IdentifyProblem::Create(model.plant, model.values, recording, options);
  ASSERT_TRUE(problem.ok()) << problem.status().ToString();
  double cost = 0;
  ASSERT_TRUE(sysid::EvaluateCost(problem->problem(), problem->problem().initial, {}, &cost));
  rollouts::SimulationScoreOptions windows{.window_s = options.window_s, .simulator = options.simulator}, whole;
  whole.simulator = options.simulator;
  const double judged = rollouts::ScoreSimulation(model.plant, model.values, recording, windows).residual +
                        0.5 * rollouts::ScoreSimulation(model.plant, model.values, recording, whole).residual;
  EXPECT_NEAR(cost, judged, 1e-9 * judged);
}

TEST(IdentifyProblem, JacobianMatchesCentralDifferences) {
  const sim::ModelFile model = Arm2();
  sim::ModelFile other = model;
  other.values[model.plant.parameters().Find("damping.shoulder")] += 0.2;
  IdentifyProblemOptions options = Options();
  options.long_weight = 0.3;
  const auto problem = IdentifyProblem::Create(model.plant, model.values, Record(other, 0.8), options);
  ASSERT_TRUE(problem.ok()) << problem.status().ToString();
  sysid::ResidualFunction& residuals = *problem->problem().residuals;
  const VectorXd p = problem->problem().initial;
  VectorXd r(residuals.num_residuals()), up(r.size()), down(r.size());
  sysid::RowMatrix jacobian(r.size(), p.size());
  ASSERT_TRUE(residuals.Evaluate(p, {}, &r, &jacobian));
  for (Eigen::Index i = 0; i < p.size(); ++i) {
    const double h = 1e-6;
    VectorXd moved = p;
    moved[i] = p[i] + h;
    ASSERT_TRUE(residuals.Evaluate(moved, {}, &up, nullptr));
    moved[i] = p[i] - h;
    ASSERT_TRUE(residuals.Evaluate(moved, {}, &down, nullptr));
    const VectorXd difference = (up - down) / (2 * h);
    EXPECT_LT((jacobian.col(i) - difference).norm(), 1e-5 * (1 + difference.norm()))
        << model.plant.parameters()[problem->parameters()[static_cast<size_t>(i)]].name;
  }
}

TEST(IdentifyProblem, ASearchBeginsWhereTheRegressionEndsUnlessTheModelIsBetter) {
  sim::ModelFile other = Arm2();
  for (const int i : other.plant.parameters().OfKind(sim::ParameterKind::kDamping)) other.values[i] = 2.0;
  for (const int i : other.plant.parameters().OfKind(sim::ParameterKind::kMass)) other.values[i] *= 1.5;
  const recordings::Recording recording = Record(other, 4.0);
  const auto costs = [&](const VectorXd& initial) {
    const auto problem = IdentifyProblem::Create(other.plant, initial, recording, Options());
    EXPECT_TRUE(problem.ok()) << problem.status().ToString();
    const VectorXd start = problem->Start(other.plant, recording);
    const sysid::LeastSquaresProblem& ls = problem->problem();
    EXPECT_TRUE((start.array() >= ls.lower.array()).all() && (start.array() <= ls.upper.array()).all());
    std::pair<double, double> out;
    EXPECT_TRUE(sysid::EvaluateCost(ls, ls.initial, {}, &out.first));
    EXPECT_TRUE(sysid::EvaluateCost(ls, start, {}, &out.second));
    return out;
  };
  const auto [nominal, regressed] = costs(Arm2().values);
  EXPECT_LT(regressed, 0.02 * nominal);
  const auto [truth, kept] = costs(other.values);
  EXPECT_EQ(kept, truth) << "no regression is better than the truth";
}

// Rotors that the model lacks: raw inertias about the joints' axes grow alone, a body's cannot.
TEST(IdentifyProblem, LinksStayBodiesWhereRawOnesDoNot) {
  const sim::ModelFile model = Arm2();
  sim::ModelFile geared = model;
  geared.plant = *model.plant.WithEffect(
      effects::MakeSpec("rotor_inertia", model.plant.joint_names(), {{"armature", 0.2}}));
  geared.values = geared.plant.parameters().Nominal();
  const recordings::Recording recording = Record(geared, 4.0);
  struct Outcome {
    double before = 0.0, after = 0.0;
    std::vector<std::string> warnings;
  };
  const auto identify = [&](bool consistent) {
    IdentifyProblemOptions options = Options();
    options.alpha = 1e-6;
    options.consistent_inertias = consistent;
    const auto problem = IdentifyProblem::Create(model.plant, model.values, recording, options);
    EXPECT_TRUE(problem.ok()) << problem.status().ToString();
    const sysid::LeastSquaresProblem& ls = problem->problem();
    const auto found = sysid::Solve(ls, problem->Start(model.plant, recording), {.max_iterations = 50}, {});
    Outcome out;
    EXPECT_TRUE(sysid::EvaluateCost(ls, ls.initial, {}, &out.before));
    out.after = found.cost;
    out.warnings = Determine(model.plant, *problem, found.p, 1e-6).warnings;
    return out;
  };
  const Outcome raw = identify(false), bodies = identify(true);
  EXPECT_FALSE(raw.warnings.empty()) << "this recording is no test";
  EXPECT_TRUE(bodies.warnings.empty()) << bodies.warnings.front();
  EXPECT_NEAR(bodies.before, raw.before, 1e-6 * raw.before);
  EXPECT_LT(bodies.after, 0.01 * bodies.before);
}

// The raw beliefs, of coordinates in which a link is a body: what a mass may be, it may be.
TEST(IdentifyProblem, BodiesHaveTheRoomOfRawMassesAndInertias) {
  const sim::ModelFile model = Arm2();
  sim::ModelFile heavy = model;
  const int mass = model.plant.parameters().Find("mass.upper_arm");
  ASSERT_GE(mass, 0);
  heavy.values[mass] *= 2.0;
  for (const bool friction : {true, false}) {
    IdentifyProblemOptions options = Options();
    options.friction = friction;
    // From another model than the URDF's: bounds are about the URDF's.
    const sim::ModelFile fitted = *ModelToFit(heavy, options);
    const auto problem = IdentifyProblem::Create(fitted.plant, fitted.values, Record(model, 0.8), options);
    ASSERT_TRUE(problem.ok()) << problem.status().ToString();
    const sysid::LeastSquaresProblem& ls = problem->problem();
    EXPECT_NEAR(problem->FullValues(ls.initial)[mass], heavy.values[mass], 1e-9);
    const double nominal = model.values[mass];
    EXPECT_NEAR(problem->FullValues(ls.lower)[mass], 0.3 * nominal, 1e-6);
    EXPECT_NEAR(problem->FullValues(ls.upper)[mass], 3.0 * nominal, 1e-6);
    // A hop's start, two typical errors off: 0.2 of a mass each, as the raw one has.
    EXPECT_NEAR(problem->FullValues(ls.search_upper)[mass], 1.44 * heavy.values[mass], 1e-6);
    EXPECT_TRUE((ls.search_lower.array() <= ls.initial.array()).all());
    EXPECT_TRUE((ls.search_upper.array() >= ls.initial.array()).all());
    EXPECT_TRUE(sysid::ImpossibleInertias(fitted.plant, problem->FullValues(ls.search_lower)).empty());
    EXPECT_TRUE(sysid::ImpossibleInertias(fitted.plant, problem->FullValues(ls.search_upper)).empty());
  }
}

// A URDF's point mass, and an inertia that no body has: the search begins at the nearest bodies.
TEST(IdentifyProblem, ModelsThatAreNoBodiesAreIdentifiedToo) {
  const sim::ModelFile model = Arm2();
  sim::ModelFile odd = model;
  const auto set = [&](const char* name, double value) {
    const int i = model.plant.parameters().Find(name);
    ASSERT_GE(i, 0) << name;
    odd.values[i] = value;
  };
  for (const char* inertia : {"inertia_xx.upper_arm", "inertia_yy.upper_arm", "inertia_zz.upper_arm"})
    set(inertia, 0.0);
  set("inertia_zz.forearm", 0.5);
  ASSERT_FALSE(sysid::ImpossibleInertias(odd.plant, odd.values).empty());
  const recordings::Recording recording = Record(model, 2.0);
  IdentifyProblemOptions options = Options();
  options.alpha = 1e-6;
  const auto problem = IdentifyProblem::Create(odd.plant, odd.values, recording, options);
  ASSERT_TRUE(problem.ok()) << problem.status().ToString();
  const sysid::LeastSquaresProblem& ls = problem->problem();
  const VectorXd begin = problem->FullValues(ls.initial);
  EXPECT_TRUE(sysid::ImpossibleInertias(odd.plant, begin).empty());
  for (const char* kept : {"mass.upper_arm", "mass.forearm", "com_x.forearm", "damping.elbow"}) {
    const int i = model.plant.parameters().Find(kept);
    ASSERT_GE(i, 0) << kept;
    EXPECT_NEAR(begin[i], odd.values[i], 1e-9) << kept;
  }
  double before = 0.0;
  ASSERT_TRUE(sysid::EvaluateCost(ls, ls.initial, {}, &before));
  const auto found = sysid::Solve(ls, problem->Start(odd.plant, recording), {.max_iterations = 50}, {});
  EXPECT_LT(found.cost, 0.01 * before);
  EXPECT_TRUE(Determine(odd.plant, *problem, found.p, 1e-6).warnings.empty());
}

TEST(IdentifyProblem, ASingleWindowIsThePapersProblem) {
  const sim::ModelFile model = Arm2();
  IdentifyProblemOptions options = Options();
  options.whole_recording = false;
  options.window_s = 0.2;
  options.window_start_s = 0.4;
  const auto problem = IdentifyProblem::Create(model.plant, model.values, Record(model, 1.6), options);
  ASSERT_TRUE(problem.ok()) << problem.status().ToString();
  EXPECT_EQ(problem->windows(), 1);
  EXPECT_EQ(problem->problem().residuals->num_residuals(), 2 * 100) << "0.2 s on the 2 ms grid, two joints";
  options.window_start_s = 5.0;
  EXPECT_FALSE(IdentifyProblem::Create(model.plant, model.values, Record(model, 1.6), options).ok());
}

TEST(Determine, WarnsOfLinksThatCouldExistBeforeTheFitOnly) {
  const sim::ModelFile model = Arm2();
  IdentifyProblemOptions options = Options();
  options.bounds = BoundsKind::kNone;
  options.consistent_inertias = false;
  const auto problem = IdentifyProblem::Create(model.plant, model.values, Record(model, 1.2), options);
  ASSERT_TRUE(problem.ok()) << problem.status().ToString();
  VectorXd p = problem->problem().initial;
  EXPECT_TRUE(Determine(model.plant, *problem, p, 1e-6).warnings.empty());
  for (Eigen::Index i = 0; i < p.size(); ++i) {
    const std::string& name = model.plant.parameters()[problem->parameters()[static_cast<size_t>(i)]].name;
    if (name.starts_with("mass.")) p[i] = -std::abs(p[i]);
  }
  const auto warnings = Determine(model.plant, *problem, p, 1e-6).warnings;
  ASSERT_FALSE(warnings.empty());
  EXPECT_NE(warnings.front().find("negative mass"), std::string::npos) << warnings.front();

  // What was impossible before the fit is none of the fit's news.
  const auto given =
      IdentifyProblem::Create(model.plant, problem->FullValues(p), Record(model, 1.2), options);
  ASSERT_TRUE(given.ok()) << given.status().ToString();
  EXPECT_TRUE(Determine(model.plant, *given, p, 1e-6).warnings.empty());
}

TEST(ModelToFit, AddsFrictionOnceAndKeepsWhatWasFound) {
  const sim::ModelFile model = Arm2();
  IdentifyProblemOptions options = Options();
  EXPECT_TRUE(ModelToFit(model, options)->plant.effects().empty());
  options.friction = true;
  sim::ModelFile first = *ModelToFit(model, options);
  const int coulomb = first.plant.parameters().Find("coulomb_friction.elbow.coulomb");
  ASSERT_GE(coulomb, 0);
  EXPECT_GT(first.values[coulomb], 0.0) << "friction that starts on its bound may stay there";
  first.values[coulomb] = 0.77;
  const sim::ModelFile second = *ModelToFit(first, options);
  EXPECT_EQ(second.plant.parameters().size(), first.plant.parameters().size());
  EXPECT_EQ(second.values[coulomb], 0.77);
  EXPECT_EQ(second.version, 3);
}

TEST(OptionsOf, OnlyTheLastOfSeveralRoundsWeighsTheWholeRecording) {
  realitygrad::v1::IdentifyPayload payload;
  payload.set_window(realitygrad::v1::IDENTIFY_WINDOW_WHOLE);
  payload.set_rounds(3);
  payload.set_round(1);
  EXPECT_EQ(OptionsOf(payload).long_weight, 0.0);
  payload.set_round(2);
  EXPECT_GT(OptionsOf(payload).long_weight, 0.0);
  EXPECT_TRUE(OptionsOf(payload).regress);
  payload.set_window(realitygrad::v1::IDENTIFY_WINDOW_SINGLE);
  EXPECT_FALSE(OptionsOf(payload).regress) << "the paper's search begins at what is given";
  EXPECT_EQ(OptionsOf(payload).long_weight, 0.0);
}

}  // namespace
}  // namespace rg::jobs
