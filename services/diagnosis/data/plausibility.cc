#include "services/diagnosis/data/plausibility.h"

#include <Eigen/QR>
#include <cmath>

#include "common/model/robot_model.h"
#include "services/diagnosis/data/gravity_in_effort.h"
#include "services/diagnosis/data/words.h"
#include "services/sysid/joint_roles.h"

namespace rg::diagnosis {

namespace {

constexpr double kLeastSeconds = 0.5;  // of fitted recordings
constexpr long kLeastMotion = 20;      // samples of motion needed for a regression
constexpr double kClose = 0.8;     // share that the URDF's torque must explain for its slope to be meaningful
constexpr double kFlipped = 0.35;  // |slope + 1| of an effort with the other sign
constexpr double kOtherUnit = 20.0;  // factor beyond any gain error of a drive

std::string Guess(double slope, bool revolute) {
  const double factor = std::abs(slope);
  const std::string unit = revolute ? "N m" : "N";
  if (std::abs(factor / 1000 - 1) < 0.3) return "it looks like m" + unit + ", " + unit + " is expected";
  if (std::abs(factor * 1000 - 1) < 0.3) return "it looks like k" + unit + ", " + unit + " is expected";
  return "it may be a raw current, or the motor's side of a gear; " + unit + " at the joint is expected";
}

Status CheckMotion(const MotionSurvey& survey, const sim::Plant& plant) {
  double seconds = 0;
  for (const FileFigures& f : survey.files) {
    if (f.split == recordings::Split::kFit) seconds += (f.rows - 1) * f.period;
  }
  if (seconds < kLeastSeconds) {
    return InvalidError("the recordings to fit are " + Number(seconds) +
                        " s together: too little to say anything; record at least " + Number(kLeastSeconds) +
                        " s");
  }
  std::string widest;
  for (int j = 0; j < survey.n; ++j) {
    const JointFigures& f = survey.joints[j];
    if (f.prescribed) continue;
    if (f.moved) return Status::Ok();
    widest += (!widest.empty() ? ", " : "") + plant.joint_names()[j] + " by " + Number(f.high - f.low);
  }
  return InvalidError("no joint moves by more than its sensor's noise (" + widest +
                      "): too little motion to say anything");
}

// Torques that the effort must bring for the recorded motion, by the URDF, and the efforts in the file.
// rows × n each.
struct Torques {
  MatrixXd rigid, v, u;
};
Torques TorquesOf(const MotionSurvey& survey) {
  const long rows = survey.Samples();
  Torques out{MatrixXd(rows, survey.n), MatrixXd(rows, survey.n), MatrixXd(rows, survey.n)};
  for (int j = 0; j < survey.n; ++j) {
    out.rigid.col(j) = survey.Along(&MotionSamples::needed, j);
    out.v.col(j) = survey.Along(&MotionSamples::v, j), out.u.col(j) = survey.Along(&MotionSamples::u, j);
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

std::vector<EffortMatch> MatchEfforts(const MotionSurvey& survey) {
  const Torques torques = TorquesOf(survey);
  std::vector<EffortMatch> out;
  for (int j = 0; j < survey.n; ++j) out.push_back(MatchOf(torques, j, j));
  return out;
}

Status CheckPlausible(const recordings::RecordingSet& set, const MotionSurvey& survey,
                      const sim::Plant& plant, bool trust_effort, std::vector<std::string>* notes) {
  RG_RETURN_IF_ERROR(CheckMotion(survey, plant));
  if (survey.Samples() < kLeastMotion) return Status::Ok();
  const Torques torques = TorquesOf(survey);
  const std::vector<EffortMatch> match = MatchEfforts(survey);
  const char* column =
      set.recordings[0].drive == recordings::EffortKind::kMeasured ? "effort_measured." : "effort_command.";
  for (int j = 0; j < survey.n; ++j) {
    if (survey.joints[j].prescribed) continue;
    const std::string suspicion = Suspicion(torques, match, j, plant);
    if (suspicion.empty()) continue;
    const std::string line = column + plant.joint_names()[j] + suspicion;
    if (!trust_effort) return InvalidError(line + " (--trust-effort goes on all the same)");
    notes->push_back(line);
  }
  const std::string gravity =
      GravityContradiction(WeighGravity(survey, plant), set.effort_excludes_gravity, plant.joint_names());
  if (gravity.empty()) return Status::Ok();
  const bool denied = set.effort_excludes_gravity_given && !set.effort_excludes_gravity;
  if (!trust_effort && !denied) return InvalidError(gravity);
  notes->push_back(gravity);
  return Status::Ok();
}

}  // namespace rg::diagnosis
