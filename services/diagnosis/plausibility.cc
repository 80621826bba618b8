#include "services/diagnosis/plausibility.h"

#include <Eigen/QR>
#include <algorithm>
#include <cmath>

#include "common/dynamics/dynamics.h"
#include "common/model/robot_model.h"
#include "common/recordings/velocity_lag.h"
#include "services/diagnosis/words.h"
#include "services/sysid/drive_signal.h"
#include "services/sysid/joint_roles.h"

namespace rg::diagnosis {

using Eigen::MatrixXd;
using Eigen::VectorXd;

namespace {

constexpr double kLeastSeconds = 0.5;  // of fitted recordings
constexpr double kClose = 0.8;     // share that the URDF's torque must explain before its slope says anything
constexpr double kFlipped = 0.35;  // |slope + 1| of an effort with the other sign
constexpr double kOtherUnit = 20.0;   // factor that no gain error of a drive reaches
constexpr double kWorthALag = 0.002;  // s
constexpr double kWorthANote = 0.05;  // of the effort's variance

std::string Guess(double slope, bool revolute) {
  const double factor = std::abs(slope);
  const std::string unit = revolute ? "N m" : "N";
  if (std::abs(factor / 1000 - 1) < 0.3) return "it looks like m" + unit + ", " + unit + " is expected";
  if (std::abs(factor * 1000 - 1) < 0.3) return "it looks like k" + unit + ", " + unit + " is expected";
  return "it may be a raw current, or the motor's side of a gear; " + unit + " at the joint is expected";
}

Status CheckMotion(const FitData& data, const sim::Plant& plant, const MotionScales& scales) {
  double seconds = 0;
  for (const FineMotion& m : data.fine) seconds += m.t.back() - m.t.front();
  if (seconds < kLeastSeconds) {
    return InvalidError("the fitted recordings are " + Number(seconds) +
                        " s together: too little to say anything");
  }
  std::string widest;
  for (int j = 0; j < data.n; ++j) {
    if (plant.IsPrescribed(j)) continue;
    const double range = scales.high[j] - scales.low[j];
    if (range >= kMovesBy * data.noise.position_stddev[j]) return Status::Ok();
    widest += (widest.empty() ? "" : ", ") + plant.joint_names()[j] + " by " + Number(range);
  }
  return InvalidError("no joint moves by more than its sensor's noise (" + widest +
                      "): too little motion to say anything");
}

// Torques that the URDF needs for the recorded motion and the efforts in the file, thinned. rows × n each.
struct Torques {
  MatrixXd rigid, v, u;
};
Torques TorquesOf(const FitData& data, const sim::Plant& plant) {
  const dynamics::Mechanism mechanism(sysid::MechanismOf(plant, plant.parameters().Nominal()));
  dynamics::Workspace workspace;
  constexpr int kStride = 8;
  long rows = 0;
  for (const FineMotion& m : data.fine) rows += (m.q.cols() + kStride - 1) / kStride;
  Torques out{MatrixXd(rows, data.n), MatrixXd(rows, data.n), MatrixXd(rows, data.n)};
  VectorXd tau(data.n);
  long row = 0;
  for (const FineMotion& m : data.fine) {
    for (long k = 0; k < m.q.cols(); k += kStride, ++row) {
      dynamics::Rnea(mechanism, workspace, m.q.col(k), m.v.col(k), m.a.col(k), tau);
      out.rigid.row(row) = tau.transpose(), out.v.row(row) = m.v.col(k).transpose();
      out.u.row(row) = m.u.col(k).transpose();
    }
  }
  return out;
}

// effort `u` of joint `i` against the torque that joint `j` needs.
EffortMatch MatchOf(const Torques& t, int i, int j) {
  const long rows = t.u.rows();
  MatrixXd X(rows, 4);
  X << VectorXd::Ones(rows), t.v.col(j), t.v.col(j).array().sign().matrix(), t.rigid.col(j);
  const MatrixXd others = X.leftCols(3);
  const double without = (t.u.col(i) - others * others.colPivHouseholderQr().solve(t.u.col(i))).squaredNorm();
  const VectorXd c = X.colPivHouseholderQr().solve(t.u.col(i));
  const double with = (t.u.col(i) - X * c).squaredNorm();
  return {c[3], without > 0 ? 1.0 - with / without : 0.0};
}

// A joint without any effort can only lose energy; one whose needed torque does work was driven.
std::string Undriven(const Torques& t, int j, const sim::Plant& plant) {
  if (plant.IsPassive(j) || t.u.col(j).cwiseAbs().maxCoeff() > 0) return "";
  if (sysid::WorkPutIn(t.rigid.col(j), t.v.col(j)) < sysid::kDriven) return "";
  const bool revolute = plant.model().joint(j).is_revolute();
  return " is zero throughout, but the recorded motion needs " +
         Number(std::sqrt(t.rigid.col(j).array().square().mean())) + (revolute ? " N m" : " N") +
         " (RMS) that does work: it is not what drove this joint (\"passive\" in the manifest says that "
         "nothing "
         "did, \"prescribed\" that it moves as measured)";
}

// Two efforts that each follow the other joint's torque; the other joint, or -1.
int ExchangedWith(const Torques& t, const std::vector<EffortMatch>& own, int i) {
  const auto follows = [](const EffortMatch& m) {
    return m.share > kClose && std::abs(m.slope - 1) < kFlipped;
  };
  for (int j = 0; j < t.u.cols(); ++j) {
    if (j == i || follows(own[i]) || follows(own[j])) continue;
    if (follows(MatchOf(t, i, j)) && follows(MatchOf(t, j, i))) return j;
  }
  return -1;
}

// What is wrong with a joint's effort, as it follows the column's name; empty where nothing is.
std::string Suspicion(const Torques& torques, const std::vector<EffortMatch>& match, int j,
                      const sim::Plant& plant) {
  if (plant.IsPrescribed(j)) return "";
  if (const std::string idle = Undriven(torques, j, plant); !idle.empty()) return idle;
  const bool revolute = plant.model().joint(j).is_revolute();
  if (const int other = ExchangedWith(torques, match, j); other >= 0)
    return " follows the torque that the URDF needs at " + plant.joint_names()[other] +
           ", and that joint's effort the torque of this one: the columns look exchanged";
  const double slope = match[j].slope, factor = std::abs(slope);
  if (match[j].share < kClose) return "";
  const bool flipped = std::abs(slope + 1) < kFlipped;
  const bool unit = factor > kOtherUnit || factor < 1.0 / kOtherUnit;
  if (!flipped && !unit) return "";
  return " is " + Number(slope) + " times the torque that the URDF needs for the recorded motion: " +
         (flipped ? "its sign looks turned around" : Guess(slope, revolute));
}

}  // namespace

std::vector<EffortMatch> MatchEfforts(const FitData& data, const sim::Plant& plant) {
  const Torques torques = TorquesOf(data, plant);
  std::vector<EffortMatch> out;
  for (int j = 0; j < data.n; ++j) out.push_back(MatchOf(torques, j, j));
  return out;
}

Status CheckPlausible(const recordings::RecordingSet& set, const FitData& data, const sim::Plant& plant,
                      const MotionScales& scales, bool trust_effort, std::vector<std::string>* notes) {
  RG_RETURN_IF_ERROR(CheckMotion(data, plant, scales));
  const Torques torques = TorquesOf(data, plant);
  const std::vector<EffortMatch> match = MatchEfforts(data, plant);
  const char* column =
      set.recordings[0].drive == recordings::EffortKind::kMeasured ? "effort_measured." : "effort_command.";
  for (int j = 0; j < data.n; ++j) {
    const std::string suspicion = Suspicion(torques, match, j, plant);
    if (suspicion.empty()) continue;
    const std::string line = column + plant.joint_names()[j] + suspicion;
    if (!trust_effort) return InvalidError(line + " (--trust-effort goes on all the same)");
    notes->push_back(line);
  }
  return Status::Ok();
}

std::vector<std::string> NotesOnMeasurement(const recordings::RecordingSet& set, const FitData& data,
                                            const sim::Plant& plant, const MeasuredEffort& measured) {
  std::vector<std::string> notes = set.warnings;
  for (std::string& note : sysid::NotesOnRoles(set, plant)) notes.push_back(std::move(note));
  const auto& names = plant.joint_names();
  std::vector<std::string> late;
  double least = 1e9, most = 0;
  const recordings::VelocityLag lag = recordings::EstimateVelocityLag(*data.recordings[0].recording);
  for (int j = 0; j < data.n; ++j) {
    if (plant.IsPrescribed(j)) continue;
    if (lag.error[j] <= 0 || lag.lag[j] < kWorthALag) continue;
    late.push_back(names[j]);
    least = std::min(least, lag.lag[j]), most = std::max(most, lag.lag[j]);
  }
  if (!late.empty()) {
    notes.push_back("the velocities of " + Listed(late) + " lag the positions' slope by " +
                    Number(1e3 * least) + " to " + Number(1e3 * most) +
                    " ms: they are filtered, and were weighed accordingly");
  }
  if (!measured.active) return notes;
  std::vector<std::string> early, rest;
  for (const int j : measured.early) early.push_back(names[j]);
  if (!early.empty()) {
    notes.push_back(
        "the effort of " + Listed(early) +
        " lags the motion that it makes: it is filtered or stamped late (no effect can say that)");
  }
  for (int j = 0; j < data.n; ++j) {
    if (measured.effort_share[j] > kWorthANote)
      rest.push_back(names[j] + " " + Number(100 * measured.effort_share[j]) + " %");
  }
  if (!rest.empty()) notes.push_back("of the effort's variance the findings leave: " + Listed(rest));
  return notes;
}

}  // namespace rg::diagnosis
