#include "services/diagnosis/design/probe_motions.h"

#include <gtest/gtest.h>

#include <cmath>

#include "common/dynamics/dynamics.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/data/prepare_data.h"
#include "services/sysid/drive_signal.h"
#include "tests/unit/diagnosis/simulated_set.h"

namespace rg::diagnosis {
namespace {

using Eigen::VectorXd;

class ProbeMotionsOfAnArm : public ::testing::Test {
 protected:
  recordings::RecordingSet set_ = testing::MakeSet("arm2", {}, 5, 2.0);
  sim::Plant plant_ = sysid::testing::LoadPlant("arm2");
  FitData data_ = PrepareData(set_, plant_, {}).value();
  MotionScales scales_ = ScalesOf(data_, plant_);
};

TEST_F(ProbeMotionsOfAnArm, KeepTheRecordedRangeAndEveryLimit) {
  const auto motions = ProbeMotions({data_, plant_, scales_}, {0, 1});
  ASSERT_GE(motions.size(), 4u);
  const dynamics::Mechanism mechanism = sysid::MechanismOf(plant_, plant_.parameters().Nominal());
  dynamics::Workspace workspace;
  VectorXd torque(2);
  for (const ProbeMotion& m : motions) {
    for (int j = 0; j < 2; ++j) {
      const model::Joint& joint = plant_.model().joint(j);
      const double middle = 0.5 * (scales_.low[j] + scales_.high[j]);
      const double reach = std::max(0.25, 0.5 * (scales_.high[j] - scales_.low[j])) + 1e-9;
      EXPECT_GE(m.q.row(j).minCoeff(), std::max(joint.lower, middle - reach)) << m.description;
      EXPECT_LE(m.q.row(j).maxCoeff(), std::min(joint.upper, middle + reach)) << m.description;
      EXPECT_LE(m.v.row(j).cwiseAbs().maxCoeff(), joint.velocity) << m.description;
      EXPECT_GT(m.q.row(j).maxCoeff() - m.q.row(j).minCoeff(), 0.05) << m.description << ": it moves";
    }
    for (Eigen::Index k = 0; k < m.q.cols(); ++k) {
      dynamics::Rnea(mechanism, workspace, m.q.col(k), m.v.col(k), m.a.col(k), torque);
      for (int j = 0; j < 2; ++j)
        EXPECT_LE(std::abs(torque[j]), plant_.model().joint(j).effort) << m.description;
    }
  }
}

TEST_F(ProbeMotionsOfAnArm, BeginAndEndAtRestAndTheirVelocitiesAreTheirSlopes) {
  for (const ProbeMotion& m : ProbeMotions({data_, plant_, scales_}, {0, 1})) {
    const Eigen::Index last = m.q.cols() - 1;
    EXPECT_EQ(m.v.col(0).norm(), 0.0) << m.description;
    EXPECT_EQ(m.v.col(last).norm(), 0.0) << m.description;
    EXPECT_LT((m.q.col(1) - m.q.col(0)).norm(), 2e-2) << m.description;
    for (Eigen::Index k = 1; k < last; ++k) {
      const double dt = m.t[static_cast<size_t>(k) + 1] - m.t[static_cast<size_t>(k) - 1];
      EXPECT_LT((m.v.col(k) - (m.q.col(k + 1) - m.q.col(k - 1)) / dt).norm(), 0.25) << m.description << k;
    }
  }
}

TEST_F(ProbeMotionsOfAnArm, OtherJointsRestWhereTheyWereRecorded) {
  for (const ProbeMotion& m : ProbeMotions({data_, plant_, scales_}, {1})) {
    EXPECT_EQ(m.v.row(0).norm(), 0.0);
    EXPECT_EQ(m.q.row(0).maxCoeff(), m.q.row(0).minCoeff());
    EXPECT_GE(m.q(0, 0), scales_.low[0]);
    EXPECT_LE(m.q(0, 0), scales_.high[0]);
    EXPECT_EQ(m.description.rfind(plant_.joint_names()[1] + ":", 0), 0u) << m.description;
  }
  EXPECT_TRUE(ProbeMotions({data_, plant_, scales_}, {}).empty());
}

}  // namespace
}  // namespace rg::diagnosis
