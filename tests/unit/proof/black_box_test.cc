#include "services/proof/black_box.h"

#include <gtest/gtest.h>

#include "common/effects/effect.h"
#include "tests/unit/sysid/simulated_recordings.h"

namespace rg::proof {
namespace {

using sysid::testing::MakeOptions;
using sysid::testing::MakeRecording;

sim::Plant Arm(double quadratic) {
  std::vector<effects::EffectSpec> effects;
  if (quadratic > 0) effects = {effects::MakeSpec("quadratic_drag", {"elbow"}, {{"quadratic", quadratic}})};
  return sysid::testing::LoadPlant("arm2", effects);
}

recordings::RecordingSet SetOf(const sim::Plant& truth, bool with_velocity) {
  MakeOptions options;
  options.position_noise = 3e-4, options.velocity_noise = 5e-3, options.with_velocity = with_velocity;
  options.duration_s = 6;
  recordings::RecordingSet set;
  set.joints = truth.joint_names();
  for (uint64_t seed = 1; seed <= 4; ++seed)
    set.recordings.push_back(MakeRecording(truth, truth.parameters().Nominal(), seed, options));
  return set;
}

double Rms(const Eigen::MatrixXd& a, const Eigen::MatrixXd& b) {
  return std::sqrt((a - b).squaredNorm() / static_cast<double>(a.size()));
}

TEST(BlackBox, LearnsADragItHasNoNameFor) {
  const sim::Plant truth = Arm(0.25), nominal = Arm(0);
  for (const bool with_velocity : {true, false}) {
    const auto box = BlackBox::Fit(nominal, SetOf(truth, with_velocity), Rng(3));
    ASSERT_TRUE(box.ok()) << box.status().ToString();
    Eigen::VectorXd q(2), v(2), u(2);
    q << 0.1, -0.1, v << 0.2, 0.9, u << 1, 0.5;
    EXPECT_NEAR(box->Residual(q, v, u)[1], -0.25 * 0.9 * 0.9, 0.08);
    EXPECT_NEAR(box->Residual(q, v, u)[0], 0, 0.08);
    const recordings::Recording unseen = MakeRecording(truth, truth.parameters().Nominal(), 9);
    const auto blind = BlackBox::Fit(nominal, SetOf(nominal, with_velocity), Rng(3));
    const double without = Rms(blind->Predict(unseen, 1.0), unseen.q),
                 with = Rms(box->Predict(unseen, 1.0), unseen.q);
    EXPECT_LT(with, 0.5 * without) << with_velocity;
  }
}

TEST(BlackBox, SaysNothingWhereThereIsNothing) {
  const sim::Plant nominal = Arm(0);
  const auto box = BlackBox::Fit(nominal, SetOf(nominal, true), Rng(3));
  Eigen::VectorXd q(2), v(2), u(2);
  q << 0.1, -0.1, v << 0.2, 0.9, u << 1, 0.5;
  EXPECT_LT(box->Residual(q, v, u).cwiseAbs().maxCoeff(), 0.02);
  recordings::RecordingSet one;
  one.joints = nominal.joint_names();
  one.recordings = {MakeRecording(nominal, nominal.parameters().Nominal(), 1)};
  EXPECT_FALSE(BlackBox::Fit(nominal, one, Rng(3)).ok()) << "nothing to leave out";
}

}  // namespace
}  // namespace rg::proof
