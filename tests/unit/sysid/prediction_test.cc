#include "services/sysid/prediction.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/unit/sysid/simulated_recordings.h"

namespace rg::sysid {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

PredictionOptions Measured(double window_s) {
  PredictionOptions options;
  options.window_s = window_s;
  options.restart = RestartState::kMeasured;
  return options;
}

// The slide of a single mass on rails under no force: it keeps its speed, so every prediction can be
// written down by hand.
sim::Plant Cart() {
  auto model = model::ParseUrdf(R"(<robot name="cart"><link name="rail"/><link name="cart"><inertial>
      <mass value="2"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
      <joint name="x" type="prismatic"><parent link="rail"/><child link="cart"/><axis xyz="1 0 0"/>
      <limit lower="-100" upper="100" effort="10" velocity="10"/></joint></robot>)",
                                "cart");
  RG_CHECK(model.ok()) << model.status().ToString();
  return *sim::Plant::Create(std::make_shared<const model::RobotModel>(*model));
}

recordings::Recording Rows(std::vector<double> t, std::vector<double> q, std::vector<double> v) {
  recordings::Recording rec;
  rec.name = "hand.csv";
  rec.joints = {"x"};
  const int K = static_cast<int>(t.size());
  rec.t = Eigen::Map<VectorXd>(t.data(), K);
  rec.q = Eigen::Map<MatrixXd>(q.data(), 1, K);
  if (!v.empty()) rec.v = Eigen::Map<MatrixXd>(v.data(), 1, K);
  rec.effort_command = MatrixXd::Zero(1, K);
  return rec;
}

TEST(Prediction, ARestartRowCarriesTheWindowThatEndsThereAndTheFirstRowIsMeasured) {
  const sim::Plant cart = Cart();
  // Position jumps by 1 at t = 1, where the second window starts with another speed.
  const auto rec = Rows({0, 0.5, 1.0, 1.5, 2.0}, {0.0, 9.0, 1.0, 9.0, 9.0}, {0.2, 9, 0.6, 9, 9});
  const Prediction p = PredictRecording(cart, cart.parameters().Nominal(), rec, Measured(1.0));
  const std::vector<double> expected = {0.0, 0.1, 0.2, 1.3, 1.6};
  for (int k = 0; k < 5; ++k) EXPECT_NEAR(p.q(0, k), expected[k], 1e-9) << "row " << k;
  EXPECT_EQ(p.restarts,
            (std::vector<int>{0, 2, 4}).size() == p.restarts.size() ? p.restarts : (std::vector<int>{0, 2}));
}

TEST(Prediction, RestartsAtTheFirstRowAtOrAfterTheWindowOnIrregularRows) {
  const sim::Plant cart = Cart();
  const auto rec = Rows({10.0, 10.4, 10.9, 11.3, 11.6, 12.4}, {0, 0, 0, 5, 0, 0}, {1, 1, 1, 2, 1, 1});
  const Prediction p = PredictRecording(cart, cart.parameters().Nominal(), rec, Measured(1.0));
  // Windows from 10.0 and from 11.3 (or 10.9, within half a sample of 11.0).
  const double at_last = p.q(0, 3);
  EXPECT_NEAR(p.q(0, 1), 0.4, 1e-9);
  EXPECT_NEAR(p.q(0, 2), 0.9, 1e-9);
  const bool early = p.restarts.size() > 1 && p.restarts[1] == 2;
  EXPECT_NEAR(at_last, early ? 0.4 : 1.3, 1e-9);
}

TEST(Prediction, LaterRowsChangeNothingBefore) {
  const sim::Plant plant = testing::LoadPlant("arm2");
  const VectorXd values = plant.parameters().Nominal();
  auto rec = testing::MakeRecording(plant, values, 5, {.position_noise = 1e-3, .with_velocity = false});
  for (const RestartState restart : {RestartState::kMeasured, RestartState::kFiltered}) {
    PredictionOptions options;
    options.restart = restart;
    options.noise.position_stddev = VectorXd::Constant(2, 1e-3);
    const Prediction a = PredictRecording(plant, values, rec, options);
    auto changed = rec;
    changed.q.rightCols(changed.rows() - 251).array() += 0.3;  // rows after t = 2.5
    const Prediction b = PredictRecording(plant, values, changed, options);
    EXPECT_EQ(a.q.leftCols(301), b.q.leftCols(301)) << "the window from 2 to 3 s restarts at 2 s";
    EXPECT_NE(a.q, b.q);
  }
}

TEST(Prediction, TheTrueModelWithoutNoisePredictsWhatWasRecorded) {
  const sim::Plant plant =
      testing::LoadPlant("arm2", {effects::MakeSpec("viscous_friction", {"elbow"}, {{"viscous", 0.2}})});
  const VectorXd values = plant.parameters().Nominal();
  const auto rec = testing::MakeRecording(plant, values, 5);
  const PredictionError error = ErrorOf(PredictRecording(plant, values, rec, Measured(1.0)), rec);
  EXPECT_LT(error.rms, 1e-6);
  EXPECT_EQ(error.windows.size(), 4u);
}

TEST(Prediction, FilteringTheNoisyStateBeatsTakingItAsMeasured) {
  const sim::Plant plant = testing::LoadPlant("arm2");
  const VectorXd values = plant.parameters().Nominal();
  const auto rec = testing::MakeRecording(
      plant, values, 5, {.duration_s = 10.0, .position_noise = 6e-4, .velocity_noise = 0.01});
  PredictionOptions filtered = Measured(1.0);
  filtered.restart = RestartState::kFiltered;
  const double plain = ErrorOf(PredictRecording(plant, values, rec, Measured(1.0)), rec).rms;
  EXPECT_LT(ErrorOf(PredictRecording(plant, values, rec, filtered), rec).rms, 0.8 * plain);
}

TEST(Prediction, AWrongModelDoesNotMisleadTheFilter) {
  const sim::Plant plant = testing::LoadPlant("arm2");
  const VectorXd values = plant.parameters().Nominal();
  VectorXd wrong = values;
  for (const int i : plant.parameters().OfKind(sim::ParameterKind::kMass)) wrong[i] *= 1.3;
  const auto rec = testing::MakeRecording(
      plant, values, 5, {.duration_s = 10.0, .position_noise = 6e-4, .velocity_noise = 0.01});
  PredictionOptions filtered = Measured(1.0);
  filtered.restart = RestartState::kFiltered;
  const double plain = ErrorOf(PredictRecording(plant, wrong, rec, Measured(1.0)), rec).rms;
  EXPECT_LT(ErrorOf(PredictRecording(plant, wrong, rec, filtered), rec).rms, 1.05 * plain);
}

effects::EffectSpec With(effects::EffectSpec spec, const std::string& option, const std::string& value) {
  spec.options[option] = value;
  return spec;
}

// Where a window begins, what no sensor reads (a lag, a bristle, a motor) and what sensors read late is found
// from the rows before, as well as a state that they read.
TEST(Prediction, TheTrueModelOfWhatHasAMemoryPredictsAsWellAsOneWithout) {
  using effects::MakeSpec;
  const std::string j = "elbow";
  const auto spring =
      MakeSpec("joint_elasticity", {j}, {{"stiffness", 60}, {"damping", 0.2}, {"motor_inertia", 0.02}});
  const auto play = MakeSpec("backlash", {j},
                             {{"gap", 0.02},
                              {"contact_stiffness", 200},
                              {"contact_damping", 0.5},
                              {"motor_inertia", 0.02},
                              {"motor_viscous", 0.05}});
  const auto late = MakeSpec("sensor_delay", {j}, {{"delay", 0.03}});
  const std::vector<std::pair<std::string, effects::EffectSpec>> cases = {
      {"lag", MakeSpec("actuator_lag", {j}, {{"time_constant", 0.04}})},
      {"delay", MakeSpec("actuator_delay", {j}, {{"delay", 0.03}})},
      {"bristle", MakeSpec("presliding_hysteresis", {j},
                           {{"bristle_stiffness", 20}, {"coulomb", 0.3}, {"bristle_damping", 0.2}})},
      {"spring, link", With(spring, "sensor", "link")},
      {"spring, motor", With(spring, "sensor", "motor")},
      {"play, link", With(play, "sensor", "link")},
      {"play, motor", With(play, "sensor", "motor")},
      {"late", late},
      {"late position", With(late, "signal", "position")},
      {"late velocity", With(late, "signal", "velocity")}};
  const auto error = [&](const std::vector<effects::EffectSpec>& effects, bool with_velocity) {
    const sim::Plant plant = testing::LoadPlant("arm2", effects);
    const VectorXd values = plant.parameters().Nominal();
    const auto rec = testing::MakeRecording(plant, values, 5,
                                            {.duration_s = 10.0,
                                             .position_noise = 3e-4,
                                             .velocity_noise = 0.005,
                                             .with_velocity = with_velocity});
    PredictionOptions options;
    options.noise.position_stddev = VectorXd::Constant(2, 3e-4);
    if (with_velocity) options.noise.velocity_stddev = VectorXd::Constant(2, 0.005);
    return ErrorOf(PredictRecording(plant, values, rec, options), rec).rms;
  };
  for (const bool with_velocity : {true, false}) {
    const double without = error({}, with_velocity);
    for (const auto& [name, spec] : cases)
      EXPECT_LT(error({spec}, with_velocity), 3 * without)
          << name << (with_velocity ? "" : ", positions only");
  }
}

TEST(Prediction, DriveThatAddsItsOwnGravityTorqueHoldsTheArmUnderNoCommand) {
  const sim::Plant plant = testing::LoadPlant("arm2");
  const VectorXd values = plant.parameters().Nominal();
  recordings::Recording rec;
  rec.name = "still.csv";
  rec.joints = plant.joint_names();
  rec.t = VectorXd::LinSpaced(201, 0.0, 2.0);
  rec.q = Eigen::Vector2d(0.4, -0.7).replicate(1, 201);
  rec.v = MatrixXd::Zero(2, 201);
  rec.effort_command = MatrixXd::Zero(2, 201);
  PredictionOptions options = Measured(1.0);
  EXPECT_GT(ErrorOf(PredictRecording(plant, values, rec, options), rec).rms, 0.1);
  options.effort_excludes_gravity = true;
  EXPECT_LT(ErrorOf(PredictRecording(plant, values, rec, options), rec).rms, 1e-6);
}

TEST(Prediction, CsvHasOneLinePerRowAndReadsBackExactly) {
  const sim::Plant cart = Cart();
  const auto rec = Rows({0, 0.1, 0.2}, {0.1, 0.2, 0.3}, {1, 1, 1});
  const std::string csv =
      FormatPredictionCsv(PredictRecording(cart, cart.parameters().Nominal(), rec, Measured(1.0)), rec);
  EXPECT_EQ(csv.substr(0, csv.find('\n')), "time,position.x");
  EXPECT_EQ(std::count(csv.begin(), csv.end(), '\n'), 4);
  EXPECT_EQ(csv.substr(16, 6), "0,0.1\n");
}

TEST(Prediction, StartsAnewBehindAGapAndCountsNoErrorThere) {
  const sim::Plant cart = Cart();
  // Rows ten times a second, none between 0.4 and 3 s; the cart is somewhere else then.
  std::vector<double> t, q, u;
  for (int k = 0; k < 5; ++k) t.push_back(0.1 * k), q.push_back(0.0), u.push_back(0.0);
  for (int k = 0; k < 5; ++k) t.push_back(3.0 + 0.1 * k), q.push_back(2.0), u.push_back(0.0);
  auto rec = Rows(t, q, u);
  rec.v = MatrixXd::Zero(1, rec.rows());
  const Prediction p = PredictRecording(cart, cart.parameters().Nominal(), rec, Measured(10.0));
  EXPECT_EQ(p.restarts, (std::vector<int>{0, 5}));
  EXPECT_EQ(p.measured, (std::vector<int>{0, 5}));
  EXPECT_EQ(p.q(0, 5), 2.0);
  EXPECT_LT(ErrorOf(p, rec).rms, 1e-9);
  EXPECT_EQ(ErrorOf(p, rec).windows.size(), 2u);
  rec.turns_added = MatrixXd::Constant(1, rec.rows(), 1.0);
  rec.time_offset = 1600000000;
  const std::string csv = FormatPredictionCsv(p, rec);
  EXPECT_NE(csv.find("1600000003,1\n"), std::string::npos) << csv;
}

TEST(Prediction, AWindowThatBreaksDownIsReportedAndStaysFinite) {
  const sim::Plant plant = testing::LoadPlant("arm2");
  VectorXd values = plant.parameters().Nominal();
  for (const int i : plant.parameters().OfKind(sim::ParameterKind::kMass)) values[i] = -1.0;
  const auto rec = testing::MakeRecording(plant, plant.parameters().Nominal(), 5, {.duration_s = 2.0});
  const Prediction p = PredictRecording(plant, values, rec, Measured(1.0));
  EXPECT_FALSE(p.failures.empty());
  EXPECT_TRUE(p.q.allFinite());
}

}  // namespace
}  // namespace rg::sysid
