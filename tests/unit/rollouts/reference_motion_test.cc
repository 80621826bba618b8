#include "services/rollouts/reference_motion.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>

#include "common/model/urdf_loader.h"

namespace rg::rollouts {
namespace {

using testing::HasSubstr;

model::RobotModel Arm() {
  return model::LoadUrdf(std::string(std::getenv("RG_SOURCE_DIR")) + "/deploy/robots/arm2.urdf", {}).value();
}

MotionBounds Bounds() { return {Eigen::Vector2d(-1, -1), Eigen::Vector2d(1, 1), Eigen::Vector2d(2, 2)}; }

constexpr const char* kHead = "time,position.elbow,position.shoulder\n";

TEST(ReferenceMotion, IsReadInModelOrderWithSlopesWhereVelocityIsMissing) {
  const auto motion = ParseMotion(std::string(kHead) + "1,0.1,0\n1.1,0.2,0.1\n1.2,0.3,0.2\n", "m.csv", Arm());
  ASSERT_TRUE(motion.ok()) << motion.status().ToString();
  EXPECT_EQ(motion->joints, (std::vector<std::string>{"shoulder", "elbow"}));
  EXPECT_EQ(motion->t[0], 0.0) << "time begins with the motion";
  EXPECT_EQ(motion->q(1, 0), 0.1);
  EXPECT_NEAR(motion->v(0, 1), 1.0, 1e-9);
  EXPECT_EQ(motion->v.col(0).norm() + motion->v.col(2).norm(), 0.0) << "at rest at both ends";
}

TEST(ReferenceMotion, BetweenRowsIsTheCubicAndOutsideItRests) {
  ReferenceMotion motion;
  motion.joints = {"a"};
  motion.t = Eigen::VectorXd::LinSpaced(11, 0, 2);
  motion.q.resize(1, 11), motion.v.resize(1, 11);
  const auto cubic = [](double t) { return 0.3 * t * t * (3 - t); };  // at rest at 0 and 2
  for (int k = 0; k < 11; ++k) {
    const double t = motion.t[k];
    motion.q(0, k) = cubic(t), motion.v(0, k) = 0.3 * (6 * t - 3 * t * t);
  }
  Eigen::VectorXd q, v, a;
  motion.At(0.77, &q, &v, &a);
  EXPECT_NEAR(q[0], cubic(0.77), 1e-12);
  EXPECT_NEAR(v[0], 0.3 * (6 * 0.77 - 3 * 0.77 * 0.77), 1e-12);
  EXPECT_NEAR(a[0], 0.3 * (6 - 6 * 0.77), 1e-12);
  motion.At(5.0, &q, &v, &a);
  EXPECT_EQ(q[0], motion.q(0, 10));
  EXPECT_EQ(v[0] + a[0], 0.0);
}

TEST(ReferenceMotion, OneLineSaysWhatIsOutsideWhichLimitWhen) {
  const auto check = [](const std::string& rows) {
    const auto motion = ParseMotion(kHead + rows, "m.csv", Arm());
    return motion.ok() ? CheckMotion(*motion, Bounds()).message() : motion.status().message();
  };
  EXPECT_EQ(check("0,0,0\n0.1,0,0\n"), "");
  EXPECT_EQ(check("0,0,0\n0.2,0,0.1\n0.4,0,0.5\n0.6,0,0.85\n0.8,0,1.2\n1,0,1.2\n"),
            "motion: shoulder has position 1.2 at 0.8 s, its limit is 1");
  EXPECT_THAT(check("0,0,0\n0.1,0.3,0\n0.2,0.6,0\n"), HasSubstr("elbow has velocity 3 at 0.1 s"));
  EXPECT_THAT(check("0,0,0\n0.4,0,0\n"), HasSubstr("rows may be 0.25 s apart"));
  EXPECT_THAT(check("0,0,0\n"), HasSubstr("only one row"));
  EXPECT_THAT(check("0,0,0\n0.1,nan,0\n"), HasSubstr("m.csv"));
  EXPECT_THAT(ParseMotion("time,position.elbow\n0,0\n1,0\n", "m.csv", Arm()).status().message(),
              HasSubstr("shoulder"));
}

}  // namespace
}  // namespace rg::rollouts
