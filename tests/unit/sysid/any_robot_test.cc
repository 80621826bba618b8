// Identification on robots of other sizes and other joints than the Mico².
#include <gtest/gtest.h>

#include <cmath>

#include "common/base/file.h"
#include "services/sysid/paper_problem.h"
#include "services/sysid/sysid_on_set.h"
#include "tests/unit/sysid/simulated_recordings.h"

namespace rg::sysid {
namespace {

using Eigen::VectorXd;

// Three recordings of a robot whose masses, damping and dry friction its URDF does not know; the last is held
// out.
struct Set {
  sim::Plant plant;
  VectorXd truth;
  recordings::RecordingSet set;

  explicit Set(const std::string& robot) : plant(testing::LoadPlant(robot)) {
    plant = testing::LoadPlant(robot, {effects::MakeSpec("coulomb_friction", plant.joint_names())});
    truth = plant.parameters().Nominal();
    for (int i = 0; i < truth.size(); ++i) {
      const sim::Parameter& p = plant.parameters()[i];
      if (p.kind == sim::ParameterKind::kMass) truth[i] *= 1.15;
      if (p.kind == sim::ParameterKind::kDamping) truth[i] *= 2.0;
      if (p.kind == sim::ParameterKind::kEffect) truth[i] = IsSlide(p.owner) ? 8.0 : 0.5;
    }
    set.urdf_path = testing::RobotPath(robot);
    set.urdf_text = *ReadFile(set.urdf_path);
    set.joints = plant.joint_names();
    for (int k = 0; k < 3; ++k) {
      set.recordings.push_back(testing::MakeRecording(plant, truth, 40 + static_cast<uint64_t>(k),
                                                      {.duration_s = 6.0,
                                                       .rate_hz = 50.0,
                                                       .position_noise = 2e-4,
                                                       .velocity_noise = 5e-3,
                                                       .amplitude = 0.5}));
    }
    set.recordings.back().split = recordings::Split::kHoldout;
  }
  bool IsSlide(const std::string& joint) const {
    return plant.model().joint(plant.model().FindJoint(joint)).type == model::JointType::kPrismatic;
  }
  // A light wrist sticks under the torques of a weak controller: all that says of its friction is a least.
  bool Moves(const std::string& joint) const {
    const VectorXd q = set.recordings.front().q.row(plant.model().FindJoint(joint));
    return q.maxCoeff() - q.minCoeff() > 0.1;
  }
};

class AnyRobot : public ::testing::TestWithParam<const char*> {};

TEST_P(AnyRobot, IsIdentifiedAndPredictedOnHeldOutMotion) {
  const Set s(GetParam());
  SysidOptions options;
  options.threads = 2;
  const auto report = SysidOnSet(s.set, options, RealClock());
  ASSERT_TRUE(report.ok()) << report.status().ToString();
  EXPECT_LT(report->after_rms, 0.1 * report->before_rms) << report->chosen;
  EXPECT_FALSE(report->identifiability.base.parameters.empty());
  for (const std::string& joint : s.plant.joint_names()) {
    if (!s.Moves(joint)) continue;
    // Where the URDF declares friction, that is what moves.
    const int declared = report->plant->parameters().Find("friction." + joint);
    const int added = report->plant->parameters().Find("coulomb_friction." + joint + ".coulomb");
    double friction = declared >= 0 ? report->values[declared] : 0.0;
    if (added >= 0) friction += report->values[added];
    const double given = s.plant.model().joint(s.plant.model().FindJoint(joint)).friction;
    const double truth = given + (s.IsSlide(joint) ? 8.0 : 0.5);
    EXPECT_NEAR(friction, truth, 0.2 * truth) << joint;
  }
}

TEST_P(AnyRobot, HasThePapersProblemWithItsOwnCount) {
  const Set s(GetParam());
  const int n = s.plant.num_joints();
  auto paper = PaperProblem::Create(s.plant, s.plant.parameters().Nominal(), s.set.recordings[0]);
  ASSERT_TRUE(paper.ok()) << paper.status().ToString();
  // Gravity, four of each link, damping and gain of each joint.
  EXPECT_EQ(paper->parameters().size(), static_cast<size_t>(3 + 4 * s.plant.model().num_links() + 2 * n));
  double before = 0.0;
  ASSERT_TRUE(EvaluateCost(paper->problem(), paper->problem().initial, {}, &before));
  EXPECT_LT(Solve(paper->problem(), paper->problem().initial, {.max_iterations = 8}, {}).cost, 0.5 * before);
}

INSTANTIATE_TEST_SUITE_P(Robots, AnyRobot, ::testing::Values("pendulum", "arm7", "slide"),
                         [](const auto& info) { return std::string(info.param); });

}  // namespace
}  // namespace rg::sysid
