// Identification of every robot of deploy/robots, and the page that shows it.
#include "services/report/sysid_page.h"

#include <gtest/gtest.h>

#include "common/base/file.h"
#include "services/report/page.h"
#include "tests/unit/sysid/simulated_recordings.h"

namespace rg::report {
namespace {

using Eigen::VectorXd;

struct Robot {
  const char* name;
  double amplitude, center;
};

void PrintTo(const Robot& robot, std::ostream* out) { *out << robot.name; }

// Robots heavier than their URDF's, with dry friction that it does not declare.
recordings::RecordingSet SetOf(const Robot& robot) {
  const sim::Plant nominal = sysid::testing::LoadPlant(robot.name);
  const sim::Plant plant = sysid::testing::LoadPlant(
      robot.name, {effects::MakeSpec("coulomb_friction", nominal.joint_names(), {{"coulomb", 0.3}})});
  VectorXd values = plant.parameters().Nominal();
  for (const int i : plant.parameters().OfKind(sim::ParameterKind::kMass)) values[i] *= 1.2;
  recordings::RecordingSet set;
  set.urdf_path = sysid::testing::RobotPath(robot.name);
  set.urdf_text = *ReadFile(set.urdf_path);
  set.joints = plant.joint_names();
  for (int k = 0; k < 3; ++k) {
    set.recordings.push_back(
        sysid::testing::MakeRecording(plant, values, 60 + k,
                                      {.duration_s = 5.0,
                                       .rate_hz = 50.0,
                                       .position_noise = 2e-4,
                                       .velocity_noise = 4e-3,
                                       .amplitude = robot.amplitude,
                                       .step_s = 2e-3,
                                       .center = VectorXd::Constant(plant.num_joints(), robot.center)}));
  }
  set.recordings.back().split = recordings::Split::kHoldout;
  return set;
}

class AnyRobot : public testing::TestWithParam<Robot> {};

TEST_P(AnyRobot, IsIdentifiedAndShown) {
  const recordings::RecordingSet set = SetOf(GetParam());
  sysid::SysidOptions options;
  options.threads = 1;
  const auto report = sysid::SysidOnSet(set, options, RealClock());
  ASSERT_TRUE(report.ok()) << report.status().ToString();
  EXPECT_LT(report->after_rms, 0.2 * report->before_rms) << report->chosen;
  EXPECT_FALSE(report->identifiability.base.parameters.empty());
  ASSERT_EQ(report->traces.size(), 1u);
  EXPECT_EQ(report->traces[0].after.cols(), report->traces[0].t.size());
  const std::string page = SysidPage(*report);
  for (const sysid::BaseParameter& b : report->identifiability.base.parameters) {
    EXPECT_NE(page.find(EscapeHtml(b.expression)), std::string::npos) << b.expression;
  }
  for (const sysid::ParameterVerdict& p : report->identifiability.parameters) {
    EXPECT_NE(page.find(p.name), std::string::npos) << p.name;
  }
  EXPECT_NE(page.find("not fitted"), std::string::npos);
  EXPECT_EQ(page.find("src=\"http"), std::string::npos) << "self-contained";
}

INSTANTIATE_TEST_SUITE_P(Robots, AnyRobot,
                         testing::Values(Robot{"pendulum", 1.0, 0.0}, Robot{"arm2", 0.9, 0.0},
                                         Robot{"arm7", 0.4, 0.3}, Robot{"slide", 0.1, 0.12}),
                         [](const auto& info) { return std::string(info.param.name); });

TEST(SysidPage, SaysWhichWindowsWereFittedAndWhatWarns) {
  const recordings::RecordingSet set = SetOf({"arm2", 0.9, 0.0});
  sysid::SysidOptions options;
  options.threads = 1;
  options.fit_window_s = 0.5;
  options.fit_windows = 2;
  options.window_choice = sysid::WindowChoice::kInformation;
  auto report = sysid::SysidOnSet(set, options, RealClock());
  ASSERT_TRUE(report.ok()) << report.status().ToString();
  ASSERT_EQ(report->windows.size(), 2u);
  EXPECT_GT(report->windows[0].gain_nats, report->windows[1].gain_nats);
  EXPECT_LT(report->after_rms, report->before_rms);
  report->warnings.push_back("link forearm: negative mass");
  const std::string page = SysidPage(*report);
  EXPECT_NE(page.find("Windows that were fitted"), std::string::npos);
  EXPECT_NE(page.find("link forearm: negative mass"), std::string::npos);
  options.fit_window_s = 60.0;
  const auto none = sysid::SysidOnSet(set, options, RealClock());
  ASSERT_FALSE(none.ok());
  EXPECT_NE(none.status().message().find("60 s"), std::string::npos) << none.status().message();
}

}  // namespace
}  // namespace rg::report
