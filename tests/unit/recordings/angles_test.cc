#include "common/recordings/angles.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <functional>
#include <numbers>

#include "common/base/rng.h"

namespace rg::recordings {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
constexpr double kTurn = 2 * std::numbers::pi;

Recording Of(int rows, double dt, const std::function<double(double)>& q) {
  Recording r;
  r.name = "rec.csv";
  r.joints = {"a"};
  r.t = Eigen::VectorXd::LinSpaced(rows, 0, (rows - 1) * dt);
  r.q.resize(1, rows);
  for (int k = 0; k < rows; ++k) r.q(0, k) = q(r.t[k]);
  return r;
}

JointInfo Continuous() {
  JointInfo joint;
  joint.name = "a";
  joint.type = JointInfo::Type::kContinuous;
  return joint;
}
JointInfo Revolute(double lower, double upper) { return {"a", JointInfo::Type::kRevolute, lower, upper, 5}; }

double Wrapped(double q, double low) { return q - kTurn * std::floor((q - low) / kTurn); }

TEST(UnwrapAngles, UndoesAnEncodersWrappingAndItsOwnUndoing) {
  for (const double low : {-std::numbers::pi, 0.0}) {
    for (const double dt : {0.001, 0.01, 0.04, 0.1}) {
      Rng rng(3);
      const auto q = [](double t) { return 2.6 + 9.0 * std::sin(0.8 * t); };  // several turns, 7 rad/s
      const Recording truth =
          Of(static_cast<int>(8 / dt), dt, [&](double t) { return q(t) + 5e-4 * rng.Normal(); });
      Recording r = truth;
      for (int k = 0; k < r.rows(); ++k) r.q(0, k) = Wrapped(r.q(0, k), low);
      const Recording file = r;
      ASSERT_TRUE(UnwrapAngles({Continuous()}, &r).ok()) << dt;
      EXPECT_LT((r.q.array() - r.q(0, 0) - (truth.q.array() - truth.q(0, 0))).abs().maxCoeff(), 1e-9) << dt;
      ASSERT_EQ(r.notes.size(), 1u);
      EXPECT_THAT(r.notes[0], HasSubstr("full turn"));
      EXPECT_LT((InFilesWrapping(r, r.q) - file.q).cwiseAbs().maxCoeff(), 1e-9);
    }
  }
}

TEST(UnwrapAngles, LeavesFastMotionAlone) {
  for (const double dt : {0.002, 0.01, 0.04}) {
    Recording r = Of(400, dt, [](double t) { return 45.0 * t; });  // 1.8 rad a row at 25 Hz
    const Recording before = r;
    ASSERT_TRUE(UnwrapAngles({Continuous()}, &r).ok());
    EXPECT_EQ(r.q, before.q);
    EXPECT_TRUE(r.notes.empty());
    Recording swing = Of(400, dt, [](double t) { return 2.5 * std::sin(8.0 * t); });
    EXPECT_TRUE(UnwrapAngles({Revolute(-1, 1)}, &swing).ok());
  }
}

TEST(UnwrapAngles, RevoluteJointsTurnOnlyWithinTheirLimits) {
  const auto q = [](double t) { return Wrapped(2.5 + 1.5 * std::sin(t), -std::numbers::pi); };
  Recording wide = Of(900, 0.01, q);
  ASSERT_TRUE(UnwrapAngles({Revolute(-6.3, 6.3)}, &wide).ok());
  EXPECT_NEAR(wide.q.maxCoeff(), 4.0, 1e-3);
  Recording shifted =
      Of(900, 0.01, [](double t) { return Wrapped(4.5 + 1.5 * std::sin(t), -std::numbers::pi); });
  ASSERT_TRUE(UnwrapAngles({Revolute(0.5, 6.9)}, &shifted).ok());
  EXPECT_NEAR(shifted.q(0, 0), 4.5, 1e-9) << "the turn that keeps it within its limits";
  Recording narrow = Of(900, 0.01, q);
  EXPECT_THAT(UnwrapAngles({Revolute(-3, 3)}, &narrow).message(),
              AllOf(HasSubstr("rec.csv: row "), HasSubstr("position.a"), HasSubstr("limits -3 to 3")));
}

TEST(UnwrapAngles, RefusesAJumpThatIsNoTurnByRowAndColumn) {
  for (const auto& joint : {Continuous(), Revolute(-3, 3)}) {
    Recording r = Of(300, 0.01, [](double t) { return 0.5 * std::sin(t) + (t > 1.4951 ? 2.0 : 0.0); });
    EXPECT_THAT(
        UnwrapAngles({joint}, &r).message(),
        AllOf(HasSubstr("rec.csv: row 151, column position.a: jumps from 0.49"), HasSubstr("within 0.01 s")));
    Recording glitch =
        Of(300, 0.01, [](double t) { return 0.5 * std::sin(t) + (std::abs(t - 1) < 1e-3 ? 150.0 : 0); });
    EXPECT_THAT(UnwrapAngles({joint}, &glitch).message(), HasSubstr("row 101"));
  }
}

TEST(UnwrapAngles, AGapIsNoJump) {
  Recording r = Of(300, 0.01, [](double t) { return 0.5 * std::sin(t); });
  r.t.tail(100).array() += 3.0;
  r.q.rightCols(100).array() += 1.5;
  EXPECT_TRUE(UnwrapAngles({Revolute(-3, 3)}, &r).ok());
}

TEST(UnwrapAngles, LooksNotAtSlides) {
  Recording r = Of(300, 0.01, [](double t) { return t > 1 ? 7.0 : 0.0; });
  EXPECT_TRUE(UnwrapAngles({{"a", JointInfo::Type::kPrismatic, 0, 9, 1}}, &r).ok());
}

}  // namespace
}  // namespace rg::recordings
