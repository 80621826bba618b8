#include "services/sysid/rotor_start.h"

#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <limits>

#include "common/base/printf.h"
#include "common/dynamics/dynamics.h"
#include "services/sysid/drive_signal.h"
#include "services/sysid/initial_regression.h"

namespace rg::sysid {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr double kUsual = 0.1;                 // of the least inertia that another joint carries
constexpr double kLeast = 1e-3, kMost = 10.0;  // of that, within which efforts are believed
constexpr double kNothingElse = 1e-2;          // kg·m² (or kg) where no other joint carries any

std::vector<MotionSample> SamplesOf(const recordings::RecordingSet& set) {
  std::vector<FitRecording> recordings;
  for (const recordings::Recording* r : set.Fit()) {
    if (r->drive_effort().size() > 0) recordings.push_back({r, DriveSignal(*r)});
  }
  return SampleMotion(recordings);
}

// The least inertia about a joint's axis of those that carry any.
double LeastInertia(const sim::Plant& plant, const dynamics::Mechanism& mechanism, const VectorXd& q) {
  dynamics::Workspace workspace;
  const auto n = plant.num_joints();
  MatrixXd M(n, n);
  dynamics::Crba(mechanism, workspace, q, M);
  double least = std::numeric_limits<double>::infinity();
  const double largest = M.diagonal().maxCoeff();
  for (int j = 0; j < n; ++j) {
    if (M(j, j) > 1e-9 * largest) least = std::min(least, M(j, j));
  }
  return std::isfinite(least) && least > 0 ? least : kNothingElse;
}

// J of effort − rigid = J·a + d·v + c·sign(v) + o.
double FromEfforts(const std::vector<MotionSample>& samples, const dynamics::Mechanism& mechanism,
                   int joint) {
  const auto rows = static_cast<Eigen::Index>(samples.size());
  if (rows < 20) return 0.0;
  dynamics::Workspace workspace;
  MatrixXd X(rows, 4);
  VectorXd y(rows), tau(samples[0].q.size());
  for (Eigen::Index k = 0; k < rows; ++k) {
    const MotionSample& s = samples[static_cast<size_t>(k)];
    dynamics::Rnea(mechanism, workspace, s.q, s.v, s.a, tau);
    X.row(k) << s.a[joint], s.v[joint], s.v[joint] > 0 ? 1.0 : -1.0, 1.0;
    y[k] = s.effort[joint] - tau[joint];
  }
  const VectorXd c = X.colPivHouseholderQr().solve(y);
  return std::isfinite(c[0]) ? c[0] : 0.0;
}

}  // namespace

std::vector<std::string> JointsThatDoNotRun(const sim::Plant& plant, const VectorXd& values) {
  std::vector<std::string> out;
  for (const int i : plant.parameters().OfKind(sim::ParameterKind::kArmature)) {
    const bool given = plant.IsPrescribed(plant.model().FindJoint(plant.parameters()[i].owner));
    if (!given && !(values[i] > 0)) out.push_back(plant.parameters()[i].owner);
  }
  return out;
}

bool Runs(const sim::Plant& plant, const VectorXd& values) {
  return JointsThatDoNotRun(plant, values).empty();
}

Result<sim::Plant> WithRotors(const recordings::RecordingSet& set, const sim::Plant& plant,
                              const VectorXd& values) {
  const std::vector<int> rotors = plant.parameters().OfKind(sim::ParameterKind::kArmature);
  if (rotors.empty()) return plant;
  sim::PlantOptions options = plant.options();
  for (const int i : rotors) {
    if (values[i] > 0) options.nominal[plant.parameters()[i].name] = values[i];
  }
  if (Runs(plant, values)) return sim::Plant::Create(plant.shared_model(), options, plant.effects());
  const std::vector<MotionSample> samples = SamplesOf(set);
  const dynamics::Mechanism mechanism = MechanismOf(plant, values);
  const VectorXd q = samples.empty() ? VectorXd::Zero(plant.num_joints()) : samples[samples.size() / 2].q;
  const double least = LeastInertia(plant, mechanism, q);
  for (const std::string& joint : JointsThatDoNotRun(plant, values)) {
    const int j = plant.model().FindJoint(joint);
    const bool driven = !plant.IsPrescribed(j) && !plant.IsPassive(j);
    const double found = driven ? FromEfforts(samples, mechanism, j) : 0.0;
    options.nominal["armature." + joint] =
        found > kLeast * least && found < kMost * least ? found : kUsual * least;
  }
  return sim::Plant::Create(plant.shared_model(), options, plant.effects());
}

std::vector<std::string> NotesOnRotors(const sim::Plant& plant, const VectorXd& values) {
  std::vector<std::string> out;
  for (const int i : plant.parameters().OfKind(sim::ParameterKind::kArmature)) {
    const sim::Parameter& p = plant.parameters()[i];
    const int link = plant.model().joint(plant.model().FindJoint(p.owner)).child_link;
    out.push_back(p.owner + " moves link " + plant.model().link(link).name +
                  ", which has no inertia about its axis: the inertia of its drive's rotor was calibrated, " +
                  Printf("%.3g", values[i]) + " " + p.unit);
  }
  return out;
}

}  // namespace rg::sysid
