#include "services/sysid/sysid_on_set.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "common/base/file.h"
#include "services/sysid/prediction.h"
#include "services/sysid/shooting_fit.h"
#include "tests/unit/sysid/simulated_recordings.h"

namespace rg::sysid {
namespace {

using Eigen::VectorXd;

// Three recordings of arm2 with friction that its URDF does not declare; the third is held out.
struct Set {
  sim::Plant plant = testing::LoadPlant(
      "arm2", {effects::MakeSpec("coulomb_friction", {"shoulder", "elbow"}, {{"coulomb", 0.4}}),
               effects::MakeSpec("viscous_friction", {"shoulder", "elbow"}, {{"viscous", 0.2}})});
  recordings::RecordingSet set;

  explicit Set(testing::MakeOptions make = {
                   .duration_s = 8.0, .position_noise = 3e-4, .velocity_noise = 5e-3}) {
    set.urdf_path = testing::RobotPath("arm2");
    set.urdf_text = *ReadFile(set.urdf_path);
    set.joints = plant.joint_names();
    for (int k = 0; k < 3; ++k) {
      set.recordings.push_back(testing::MakeRecording(plant, plant.parameters().Nominal(), 20 + k, make));
    }
    set.recordings.back().split = recordings::Split::kHoldout;
  }
};

SysidOptions Quick() {
  SysidOptions options;
  options.threads = 1;
  return options;
}

double Of(const SysidReport& report, const std::string& name) {
  const int i = report.plant->parameters().Find(name);
  return i < 0 ? 0.0 : report.values[i];
}

TEST(SysidOnSet, FindsFrictionThatTheUrdfLacksAndPredictsHeldOutMotion) {
  Set s;
  std::vector<double> done;
  const auto report = SysidOnSet(s.set, Quick(), RealClock(),
                                 [&](const ProgressUpdate& u) { done.push_back(u.done / u.total); });
  ASSERT_TRUE(report.ok()) << report.status().ToString();
  EXPECT_LT(report->after_rms, 0.1 * report->before_rms);
  EXPECT_NEAR(Of(*report, "coulomb_friction.elbow.coulomb"), 0.4, 0.06) << report->chosen;
  EXPECT_NEAR(Of(*report, "damping.elbow"), 0.25, 0.06) << "what the URDF declares is what moves";
  EXPECT_EQ(Of(*report, "viscous_friction.elbow.viscous"), 0.0);
  EXPECT_TRUE(std::is_sorted(done.begin(), done.end())) << "progress never goes back";
  EXPECT_DOUBLE_EQ(done.back(), 1.0);
}

TEST(SysidOnSet, StartsFromADiagnosedModelAndKeepsItsEffects) {
  Set s;
  // What a diagnosis would hand over: the elbow's friction named, with a value that is not quite right.
  auto bare = NominalPlant(s.set);
  const sim::Plant diagnosed = *bare->WithEffect(effects::MakeSpec(
      "stribeck_friction", {"elbow"}, {{"coulomb", 0.4}, {"static", 0.4}, {"stribeck_velocity", 0.05}}));
  SysidOptions options = Quick();
  options.model = sim::ModelFile{diagnosed, diagnosed.parameters().Nominal()};
  const auto report = SysidOnSet(s.set, options, RealClock());
  ASSERT_TRUE(report.ok()) << report.status().ToString();
  EXPECT_EQ(Of(*report, "stribeck_friction.elbow.coulomb"), 0.4) << "what is not fitted stays";
  EXPECT_LT(report->plant->parameters().Find("coulomb_friction.elbow.coulomb"), 0);
  EXPECT_NEAR(Of(*report, "coulomb_friction.shoulder.coulomb"), 0.4, 0.08);
  const auto plain = SysidOnSet(s.set, Quick(), RealClock());
  EXPECT_LT(report->before_rms, plain->before_rms) << "the model is the start, not the URDF";

  options.model = sim::ModelFile{testing::LoadPlant("pendulum", {}), {}};
  const auto refused = SysidOnSet(s.set, options, RealClock());
  EXPECT_NE(refused.status().message().find("the recordings shoulder elbow"), std::string::npos)
      << refused.status().ToString();
}

TEST(SysidOnSet, WorksOnIrregularRowsWithoutVelocity) {
  Set s({.duration_s = 10.0, .rate_hz = 100.0, .position_noise = 2e-4, .with_velocity = false});
  for (recordings::Recording& rec : s.set.recordings) {  // drop rows, but keep the command piecewise constant
    std::vector<int> keep;
    for (int k = 0; k < rec.rows(); ++k) {
      const bool same = k > 0 && rec.effort_command.col(k) == rec.effort_command.col(k - 1);
      if (k % 7 != 3 || same) keep.push_back(k);
    }
    recordings::Recording thin = rec;
    thin.t.resize(keep.size());
    thin.q.resize(2, keep.size());
    thin.effort_measured.resize(2, keep.size());
    for (size_t i = 0; i < keep.size(); ++i) {
      thin.t[i] = rec.t[keep[i]];
      thin.q.col(i) = rec.q.col(keep[i]);
      // Measured effort is linear between rows: the mean around each row of what was held.
      const int k = keep[i];
      thin.effort_measured.col(i) =
          0.5 * (rec.effort_command.col(k) + rec.effort_command.col(std::max(0, k - 1)));
    }
    thin.effort_command.resize(0, 0);
    thin.drive = recordings::EffortKind::kMeasured;
    rec = thin;
  }
  const auto report = SysidOnSet(s.set, Quick(), RealClock());
  ASSERT_TRUE(report.ok()) << report.status().ToString();
  EXPECT_LT(report->after_rms, 0.2 * report->before_rms);
}

TEST(SysidOnSet, ADriveThatCompensatesGravityIsTakenIntoAccount) {
  Set s;
  s.set.effort_excludes_gravity = true;
  for (recordings::Recording& rec : s.set.recordings) {
    const auto all = DriveSignalWithGravity(rec, s.plant, s.plant.parameters().Nominal());
    rec.effort_command -= all.values() - rec.effort_command;  // what the drive adds by itself
  }
  const auto report = SysidOnSet(s.set, Quick(), RealClock());
  ASSERT_TRUE(report.ok()) << report.status().ToString();
  EXPECT_LT(report->after_rms, 0.25 * report->before_rms);
  EXPECT_NEAR(Of(*report, "coulomb_friction.elbow.coulomb"), 0.4, 0.1) << report->chosen;
}

TEST(SysidOnSet, RefusesASetWithoutAnythingToFit) {
  Set s;
  for (recordings::Recording& rec : s.set.recordings) rec.split = recordings::Split::kHoldout;
  const auto report = SysidOnSet(s.set, Quick(), RealClock());
  ASSERT_FALSE(report.ok());
  EXPECT_EQ(report.status().code(), StatusCode::kInvalid);
}

// Cancels at a count of the calls that identification makes on its clock and its progress.
class CancelAtCall final : public Clock {
 public:
  explicit CancelAtCall(int call) : call_(call) {}
  int64_t SteadyNanos() const override {
    Count();
    return 0;
  }
  int64_t WallNanos() const override { return 0; }
  ProgressFn Progress() const {
    return [this](const ProgressUpdate&) { Count(); };
  }
  const CancelToken& token() const { return cancel_; }
  int calls() const { return calls_; }

 private:
  void Count() const {
    if (calls_++ == call_) cancel_.Cancel();
  }
  int call_;
  mutable int calls_ = 0;
  mutable CancelToken cancel_;
};

TEST(SysidOnSet, ACancelAtAnyStageLeavesAReport) {
  Set s({.duration_s = 2.0, .rate_hz = 50.0, .position_noise = 3e-4, .velocity_noise = 5e-3});
  SysidOptions options = Quick();
  options.max_iterations = 2;
  const auto run = [&](const CancelAtCall& cancel) {
    return SysidOnSet(s.set, options, cancel, cancel.Progress(), &cancel.token());
  };
  const CancelAtCall never(-1);
  const auto whole = run(never);
  ASSERT_TRUE(whole.ok()) << whole.status().ToString();
  ASSERT_FALSE(whole->stopped_early);
  ASSERT_EQ(whole->identifiability_of, whole->chosen);
  ASSERT_GT(never.calls(), 20) << "stages to cancel at";
  size_t fewest = whole->candidates.size(), told = 0;
  for (int call = 0; call < never.calls() - 1; ++call) {  // the last: all is done
    const auto report = run(CancelAtCall(call));
    ASSERT_TRUE(report.ok()) << report.status().ToString();
    EXPECT_TRUE(report->stopped_early) << call;
    EXPECT_TRUE(std::isfinite(report->after_rms)) << call;
    EXPECT_LE(report->after_rms, report->before_rms) << call;
    EXPECT_EQ(report->identifiability_of.empty(), report->identifiability.parameters.empty()) << call;
    EXPECT_FALSE(FormatSysid(*report).empty());
    EXPECT_EQ(SysidToJson(*report)["candidates"].size(), report->candidates.size());
    fewest = std::min(fewest, report->candidates.size());
    told += report->identifiability_of.empty() ? 0 : 1;
  }
  EXPECT_EQ(fewest, 1u) << "before any fit";
  EXPECT_GT(told, 0u) << "half-way: what is known by then";
}

TEST(SysidOnSet, NothingToFitIsAReportWithoutParameters) {
  Set s({.duration_s = 2.0, .rate_hz = 50.0});
  SysidOptions options = Quick();
  options.fit_inertial = options.fit_joints = false;
  const auto report = SysidOnSet(s.set, options, RealClock());
  ASSERT_TRUE(report.ok()) << report.status().ToString();
  EXPECT_EQ(report->chosen, "nominal");
  EXPECT_TRUE(report->identifiability.parameters.empty());
  EXPECT_TRUE(report->identifiability_of.empty());
}

TEST(SysidOnSet, TableAndJsonHoldTheSameFigures) {
  Set s;
  SysidOptions options = Quick();
  options.fit_inertial = false;
  const auto report = SysidOnSet(s.set, options, RealClock());
  ASSERT_TRUE(report.ok()) << report.status().ToString();
  const auto j = SysidToJson(*report);
  EXPECT_EQ(j["holdout"]["after_rms"].get<double>(), report->after_rms);
  EXPECT_EQ(j["candidates"].size(), report->candidates.size());
  const std::string table = FormatSysid(*report);
  EXPECT_NE(table.find(report->chosen), std::string::npos);
  EXPECT_NE(table.find("simulated_22"), std::string::npos) << "the held-out recording";
}

TEST(ChooseStep, IsLongerWhereTheSensorsAreWorse) {
  const sim::Plant plant = testing::LoadPlant("arm2");
  const VectorXd values = plant.parameters().Nominal();
  const auto rec = testing::MakeRecording(plant, values, 1, {.duration_s = 2.0, .rate_hz = 50.0});
  const FitSpace space(InertialFitParameters(plant));
  const std::vector<FitRecording> fit{{&rec, DriveSignal(rec)}};
  const auto step = [&](double noise) {
    const recordings::SensorNoise sensors{VectorXd::Constant(2, noise), VectorXd::Constant(2, 1e-3),
                                          VectorXd::Zero(2)};
    return ChooseStep(plant, values, space, space.nominal(), fit, sensors);
  };
  EXPECT_LT(step(1e-6), step(1e-3));
  EXPECT_GE(step(1e-9), 1e-3);
  EXPECT_LE(step(1.0), 8e-3);
}

TEST(PredictionWithHiddenStates, MotorsBehindSpringsStartFromWhatPrecedes) {
  const sim::Plant plant = testing::LoadPlant(
      "arm2", {effects::MakeSpec("joint_elasticity", {"shoulder", "elbow"},
                                 {{"stiffness", 800.0}, {"damping", 1.0}, {"motor_inertia", 0.05}})});
  ASSERT_GT(plant.num_internal_states(), 0);
  const VectorXd values = plant.parameters().Nominal();
  // The sensors read the link; a row's torque alone does not say where the motor is.
  const auto rec = testing::MakeRecording(plant, values, 4, {.duration_s = 6.0, .rate_hz = 200.0});
  PredictionOptions options;
  options.noise = {VectorXd::Constant(2, 1e-5), VectorXd::Constant(2, 1e-4), VectorXd::Zero(2)};
  options.window_s = 0.5;
  options.restart = RestartState::kMeasured;
  const double plain = ErrorOf(PredictRecording(plant, values, rec, options), rec).rms;
  options.restart = RestartState::kFiltered;
  EXPECT_LT(ErrorOf(PredictRecording(plant, values, rec, options), rec).rms, 0.5 * plain);
}

}  // namespace
}  // namespace rg::sysid
