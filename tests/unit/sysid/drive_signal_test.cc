#include "services/sysid/drive_signal.h"

#include <gtest/gtest.h>

#include "common/recordings/command_time.h"

namespace rg::sysid {
namespace {

using Eigen::VectorXd;

recordings::Recording Recorded() {
  recordings::Recording r;
  r.name = "rec_000.csv", r.joints = {"x"};
  r.t = VectorXd::LinSpaced(4, 0.0, 0.12);
  r.q = r.v = Eigen::MatrixXd::Zero(1, 4);
  r.effort_command = Eigen::RowVector4d(1, 2, 3, 4);
  return r;
}

TEST(DriveSignal, ACommandHoldsFromItsRow) {
  const sim::CommandSignal command = DriveSignal(Recorded());
  EXPECT_EQ(command.At(0, 0.039), 1.0);
  EXPECT_EQ(command.At(0, 0.041), 2.0);
}

TEST(DriveSignal, ACommandHoldsFromWhenItWasSentWhereTheRecordingSaysSo) {
  recordings::Recording r = Recorded();
  r.other[recordings::kCommandTime] = (r.t.array() + 0.007).matrix();
  const sim::CommandSignal command = DriveSignal(r);
  EXPECT_EQ(command.At(0, 0.046), 1.0);
  EXPECT_EQ(command.At(0, 0.048), 2.0);
  r.drive = recordings::EffortKind::kMeasured, r.effort_measured = r.effort_command;
  EXPECT_NEAR(DriveSignal(r).At(0, 0.02), 1.5, 1e-12) << "an effort that was measured is of its row";
}

TEST(DriveSignal, ACommandTimeThatCannotBeOneIsNotUsed) {
  const VectorXd early = VectorXd::LinSpaced(4, -0.01, 0.11), late = VectorXd::LinSpaced(4, 0.1, 0.22);
  VectorXd back = VectorXd::LinSpaced(4, 0.03, 0.15), unknown = VectorXd::LinSpaced(4, 0.0, 0.12);
  back[1] = 0.05, back[0] = 0.06, unknown[2] = std::nan("");
  for (const VectorXd& sent : {early, late, back, unknown, VectorXd(VectorXd::Zero(2))}) {
    recordings::Recording r = Recorded();
    r.other[recordings::kCommandTime] = sent;
    EXPECT_EQ(DriveSignal(r).times(), (std::vector<double>{r.t.data(), r.t.data() + 4})) << sent.transpose();
  }
}

}  // namespace
}  // namespace rg::sysid
