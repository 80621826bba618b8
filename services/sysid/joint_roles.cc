#include "services/sysid/joint_roles.h"

#include <algorithm>

#include "common/dynamics/dynamics.h"
#include "common/recordings/noise.h"
#include "common/recordings/prescribed.h"
#include "services/sysid/drive_signal.h"
#include "services/sysid/initial_regression.h"

namespace rg::sysid {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr double kMovesBy = 20.0;  // stddev of the position: less is not a motion

bool Moves(const recordings::RecordingSet& set, int joint, double stddev) {
  return std::any_of(set.recordings.begin(), set.recordings.end(), [&](const recordings::Recording& r) {
    return r.rows() > 0 && r.q.row(joint).maxCoeff() - r.q.row(joint).minCoeff() >= kMovesBy * stddev;
  });
}

// Torques that the rigid bodies need for the recorded motion, and its speeds: samples × n each.
struct Needed {
  MatrixXd tau, v;
};
Needed NeededTorques(const recordings::RecordingSet& set, const sim::Plant& nominal) {
  std::vector<FitRecording> recordings;
  for (const recordings::Recording& r : set.recordings) {
    if (r.drive_effort().size() > 0) recordings.push_back({&r, DriveSignal(r)});
  }
  const std::vector<MotionSample> samples = SampleMotion(recordings);
  const dynamics::Mechanism mechanism = MechanismOf(nominal, nominal.parameters().Nominal());
  dynamics::Workspace workspace;
  const auto n = nominal.num_joints();
  Needed out{MatrixXd(static_cast<long>(samples.size()), n), MatrixXd(static_cast<long>(samples.size()), n)};
  VectorXd tau(n);
  for (size_t k = 0; k < samples.size(); ++k) {
    dynamics::Rnea(mechanism, workspace, samples[k].q, samples[k].v, samples[k].a, tau);
    out.tau.row(static_cast<long>(k)) = tau.transpose();
    out.v.row(static_cast<long>(k)) = samples[k].v.transpose();
  }
  return out;
}

std::string Joined(const std::vector<std::string>& names) {
  std::string out;
  for (const std::string& name : names) out += (out.empty() ? "" : ", ") + name;
  return out;
}

}  // namespace

double WorkPutIn(const VectorXd& tau, const VectorXd& v) {
  const Eigen::ArrayXd power = tau.array() * v.array();
  const double all = power.abs().sum();
  return all > 0 ? power.max(0.0).sum() / all : 0.0;
}

std::vector<char> ZeroEfforts(const recordings::RecordingSet& set) {
  std::vector<char> zero(set.joints.size(), 1);
  for (const recordings::Recording& r : set.recordings) {
    for (int j = 0; j < r.n(); ++j) {
      if (r.drive_effort().size() == 0 || r.drive_effort().row(j).cwiseAbs().maxCoeff() > 0)
        zero[static_cast<size_t>(j)] = 0;
    }
  }
  return zero;
}

std::vector<std::string> PassiveJoints(const recordings::RecordingSet& set, const sim::Plant& nominal) {
  std::vector<std::string> out;
  if (set.passive) {
    for (const std::string& joint : set.joints) {
      if (std::count(set.passive->begin(), set.passive->end(), joint) > 0) out.push_back(joint);
    }
    return out;
  }
  std::vector<char> zero = ZeroEfforts(set);
  for (const int j : nominal.prescribed()) zero[static_cast<size_t>(j)] = 0;
  // A robot of which nothing is driven is more likely a file of which something is missing.
  const auto driven = std::count(zero.begin(), zero.end(), char{0}) - std::ssize(nominal.prescribed());
  if (driven == 0 || std::count(zero.begin(), zero.end(), char{1}) == 0) return out;
  const VectorXd stddev = recordings::EstimateSensorNoise(set).position_stddev;
  const Needed needed = NeededTorques(set, nominal);
  for (int j = 0; j < nominal.num_joints(); ++j) {
    const bool passive = zero[static_cast<size_t>(j)] && Moves(set, j, stddev[j]) && needed.tau.rows() > 0 &&
                         WorkPutIn(needed.tau.col(j), needed.v.col(j)) < kDriven;
    if (passive) out.push_back(set.joints[static_cast<size_t>(j)]);
  }
  return out;
}

std::vector<std::string> NotesOnRoles(const recordings::RecordingSet& set, const sim::Plant& nominal) {
  std::vector<std::string> out;
  if (std::string note = recordings::NoteOnPrescribed(set); !note.empty()) out.push_back(std::move(note));
  std::vector<std::string> passive;
  for (int j = 0; j < nominal.num_joints(); ++j) {
    if (nominal.IsPassive(j)) passive.push_back(nominal.joint_names()[static_cast<size_t>(j)]);
  }
  if (passive.empty()) return out;
  const bool one = passive.size() == 1;
  out.push_back(Joined(passive) + (one ? " has" : " have") + " no drive (passive): " +
                (set.passive ? "the manifest says so"
                             : std::string(one ? "its" : "their") +
                                   " effort is zero throughout, and the rigid bodies move so without one"));
  return out;
}

}  // namespace rg::sysid
