#include "services/sysid/drive_signal.h"

#include <string>
#include <utility>

#include "common/base/check.h"
#include "common/model/robot_model.h"
#include "common/recordings/command_time.h"
#include "common/recordings/prescribed.h"

namespace rg::sysid {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

std::shared_ptr<const sim::GivenMotion> MotionOf(const recordings::Recording& recording) {
  recordings::SmoothMotionRows rows = recordings::SmoothPrescribed(recording);
  auto motion = sim::GivenMotion::Create(recording.prescribed,
                                         {recording.t.data(), recording.t.data() + recording.t.size()},
                                         std::move(rows.q), std::move(rows.v), std::move(rows.a));
  RG_CHECK(motion.ok()) << recording.name << ": " << motion.status().ToString();
  return std::make_shared<const sim::GivenMotion>(std::move(motion).value());
}

sim::CommandSignal Signal(const recordings::Recording& recording, MatrixXd effort) {
  const bool held = recording.drive == recordings::EffortKind::kCommand;
  const VectorXd& at = held ? recordings::CommandTimes(recording) : recording.t;
  std::vector<double> times(at.data(), at.data() + at.size());
  auto signal = sim::CommandSignal::Create(std::move(times), std::move(effort),
                                           held ? sim::Hold::kZeroOrder : sim::Hold::kLinear);
  RG_CHECK(signal.ok()) << recording.name << ": " << signal.status().ToString();
  if (recording.prescribed.empty()) return std::move(signal).value();
  return signal->WithMotion(MotionOf(recording));
}

double ValueOf(const sim::Plant& plant, const VectorXd& values, const std::string& name) {
  const int i = plant.parameters().Find(name);
  RG_CHECK(i >= 0) << name;
  return values[i];
}

}  // namespace

sim::CommandSignal DriveSignal(const recordings::Recording& recording) {
  RG_CHECK(recording.drive_effort().size() > 0) << recording.name << " has no effort";
  return Signal(recording, recording.drive_effort());
}

sim::CommandSignal DriveSignalWithGravity(const recordings::Recording& recording, const sim::Plant& plant,
                                          const VectorXd& drive_values) {
  RG_CHECK(recording.drive_effort().size() > 0) << recording.name << " has no effort";
  MatrixXd effort = recording.drive_effort();
  const dynamics::Mechanism mechanism = MechanismOf(plant, drive_values);
  dynamics::Workspace workspace;
  VectorXd gravity(recording.n());
  const bool held = recording.drive == recordings::EffortKind::kCommand;
  for (int k = 0; k < recording.rows(); ++k) {
    VectorXd q = recording.q.col(k);
    if (held && k + 1 < recording.rows()) q = 0.5 * (q + recording.q.col(k + 1));
    dynamics::GravityTorque(mechanism, workspace, q, gravity);
    effort.col(k) += gravity;
  }
  return Signal(recording, std::move(effort));
}

dynamics::LinkParametersMatrix LinkParametersOf(const sim::Plant& plant, const VectorXd& values) {
  const model::RobotModel& model = plant.model();
  dynamics::LinkParametersMatrix out(model::kLinkParameters, model.num_links());
  for (int i = 0; i < model.num_links(); ++i) {
    for (int k = 0; k < model::kLinkParameters; ++k) {
      out(k, i) =
          ValueOf(plant, values, std::string(model::kLinkParameterNames[k]) + "." + model.link(i).name);
    }
  }
  return out;
}

Eigen::Vector3d GravityOf(const sim::Plant& plant, const VectorXd& values) {
  return {ValueOf(plant, values, "gravity.x"), ValueOf(plant, values, "gravity.y"),
          ValueOf(plant, values, "gravity.z")};
}

dynamics::Mechanism MechanismOf(const sim::Plant& plant, const VectorXd& values) {
  dynamics::Mechanism mechanism(plant.model());
  mechanism.SetLinkParameters(plant.model(), LinkParametersOf(plant, values));
  mechanism.SetGravity(GravityOf(plant, values));
  return mechanism;
}

}  // namespace rg::sysid
