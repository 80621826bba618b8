#include "services/proof/generator/proof_case.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <dart/dynamics/BodyNode.hpp>
#include <dart/dynamics/DegreeOfFreedom.hpp>
#include <dart/dynamics/Joint.hpp>
#include <dart/dynamics/WeldJoint.hpp>
#include <dart/utils/urdf/DartLoader.hpp>
#include <nlohmann/json.hpp>
#include <set>

#include "common/base/file.h"
#include "services/proof/generator/engine.h"
#include "services/proof/generator/hypotheses.h"
#include "services/proof/generator/references.h"

namespace rg::proof {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;
using nlohmann::json;

struct Noise {
  double position, velocity, resolution;
};

struct Track {
  MatrixXd q, v, u, true_q, true_v;  // n × K
  bool ok = true;
};

// Everything a case is made from.
class Maker {
 public:
  Maker(const CaseRequest& request, std::string urdf_text)
      : request_(request), urdf_(std::move(urdf_text)), rng_(request.seed) {}

  Result<CaseSummary> Run(const std::string& sets_folder, const std::string& labels_folder);

 private:
  Status LoadRobot();
  VectorXd Gravity(const VectorXd& q) const;  // and leaves the skeleton at rest in q
  MatrixXd Select(const MatrixXd& full) const;
  double GravityGrowth(const VectorXd& q) const;
  VectorXd CalmHome(Rng rng) const;
  void ChooseMotion();
  Truth Nominal() const { return Truth{std::vector<JointTruth>(joints_.size())}; }
  Track Record(const Truth& truth, const std::string& kind, double duration, uint64_t stream) const;
  void MeasureScales();
  Truth Draw(double strength, json* effects) const;
  // RMS of nominal and true model over windows of 1 s of a recording.
  void WindowErrors(const Truth& truth, const Track& track, std::vector<double>* nominal,
                    std::vector<double>* oracle) const;
  double Ratio(const Truth& truth) const;
  Truth SearchStrength(json* effects, std::string* warning) const;
  std::string Csv(const Track& track, bool concealed) const;
  json Manifest() const;
  VectorXd Controller(const VectorXd& q, const VectorXd& v, const VectorXd& q_ref,
                      const VectorXd& v_ref) const;

  CaseRequest request_;
  std::string urdf_;
  Rng rng_;
  dart::dynamics::SkeletonPtr skeleton_;  // nominal
  std::vector<std::string> joints_, links_;
  std::vector<Eigen::Index> at_;  // skeleton index of joint i
  ReferenceLimits limits_;
  VectorXd effort_;
  Scales scales_;
  Noise noise_{};
  double dt_ = 2e-4, wn_ = 8;
};

double Rms(const std::vector<double>& squares) {
  double sum = 0;
  for (double s : squares) sum += s;
  return squares.empty() ? 0.0 : std::sqrt(sum / static_cast<double>(squares.size()));
}

bool IsFinger(const std::string& name) { return name.find("finger") != std::string::npos; }

// The manifest names the arm's joints only: everything else is locked at 0.
void LockFingers(const dart::dynamics::SkeletonPtr& skeleton) {
  std::vector<dart::dynamics::BodyNode*> fingers;
  for (auto* body : skeleton->getBodyNodes()) {
    const auto* joint = body->getParentJoint();
    if (joint->getNumDofs() > 0 && IsFinger(joint->getName())) fingers.push_back(body);
  }
  for (auto* body : fingers) {
    const auto* joint = body->getParentJoint();
    dart::dynamics::WeldJoint::Properties weld;
    weld.mName = joint->getName();
    weld.mT_ParentBodyToJoint = joint->getTransformFromParentBodyNode();
    weld.mT_ChildBodyToJoint = joint->getTransformFromChildBodyNode();
    body->changeParentJointType<dart::dynamics::WeldJoint>(weld);
  }
}

Status Maker::LoadRobot() {
  dart::utils::DartLoader::Options options;
  options.mDefaultInertia =
      dart::dynamics::Inertia(1e-9, Eigen::Vector3d::Zero(), 1e-12 * Eigen::Matrix3d::Identity());
  options.mDefaultRootJointType = dart::utils::DartLoader::RootJointType::FIXED;
  dart::utils::DartLoader loader(options);
  skeleton_ = loader.parseSkeletonString(urdf_, "");
  if (!skeleton_) return InvalidError(request_.urdf + ": DART cannot read this URDF");
  LockFingers(skeleton_);
  for (size_t i = 0; i < skeleton_->getNumJoints(); ++i) {
    auto* joint = skeleton_->getJoint(i);
    if (joint->getNumDofs() != 1) continue;
    joints_.push_back(joint->getName());
    links_.push_back(joint->getChildBodyNode()->getName());
    at_.push_back(static_cast<Eigen::Index>(joint->getDof(0)->getIndexInSkeleton()));
  }
  if (joints_.empty()) return InvalidError(request_.urdf + ": no movable joint");
  skeleton_->setGravity(Eigen::Vector3d(0, 0, -9.81));
  return Status::Ok();
}

// How fast a small deviation grows under gravity at constant torque, 1/s; 0: stable.
double Maker::GravityGrowth(const VectorXd& q) const {
  const int n = static_cast<int>(joints_.size());
  MatrixXd stiffness(n, n);
  for (int i = 0; i < n; ++i) {
    VectorXd up = q, down = q;
    up[i] += 1e-4, down[i] -= 1e-4;
    stiffness.col(i) = (Gravity(up) - Gravity(down)) / 2e-4;
  }
  Gravity(q);
  const VectorXd eigenvalues =
      -(Select(skeleton_->getMassMatrix()).llt().solve(stiffness)).eigenvalues().real();
  return std::sqrt(std::max(0.0, eigenvalues.maxCoeff()));
}

// A pose round which the arm hangs calmly, so that a second of open-loop prediction says something
// about the model and not only about the noise of the restart.
VectorXd Maker::CalmHome(Rng rng) const {
  const int n = static_cast<int>(joints_.size());
  VectorXd best;
  double best_growth = 1e9;
  for (int attempt = 0; attempt < 3000; ++attempt) {
    VectorXd q(n);
    for (int i = 0; i < n; ++i) {
      const auto* dof = skeleton_->getJoint(joints_[static_cast<size_t>(i)])->getDof(0);
      const double low = std::max(-3.1, dof->getPositionLowerLimit()),
                   high = std::min(6.2, dof->getPositionUpperLimit());
      const double margin = std::min(0.6, 0.3 * (high - low));
      q[i] = rng.Uniform(low + margin, high - margin);
    }
    double growth = GravityGrowth(q);
    for (int i = 0; i < n && growth < best_growth; ++i) {
      for (const double side : {-0.45, 0.45}) {
        VectorXd beside = q;
        beside[i] += side;
        growth = std::max(growth, GravityGrowth(beside));
      }
    }
    if (growth < best_growth) best = q, best_growth = growth;
  }
  return best;
}

void Maker::ChooseMotion() {
  const int n = static_cast<int>(joints_.size());
  limits_.home = limits_.amplitude = limits_.velocity = effort_ = VectorXd::Zero(n);
  Rng rng = rng_.Split(1);
  const VectorXd home = CalmHome(rng.Split(0));
  for (int i = 0; i < n; ++i) {
    const auto* dof = skeleton_->getJoint(joints_[static_cast<size_t>(i)])->getDof(0);
    const double low = std::max(-10.0, dof->getPositionLowerLimit()),
                 high = std::min(10.0, dof->getPositionUpperLimit());
    const bool bounded = high - low < 12.0;
    limits_.home[i] = home[i];
    const double room = bounded ? std::min(home[i] - low, high - home[i]) : 3.0;
    limits_.amplitude[i] = std::min(room, n > 2 ? 0.45 : 0.9) * rng.Uniform(0.7, 1.0);
    // Arms of one or two joints may swing fast, as far as their speed limit lets them.
    limits_.velocity[i] = std::min(n > 2 ? 1.2 : 5.0, dof->getVelocityUpperLimit());
    effort_[i] = dof->getForceUpperLimit();
  }
  dt_ = n > 2 ? 2e-4 : 1e-4;
  wn_ = request_.rate_hz < 40 ? 5 : request_.rate_hz < 150 ? 7.5 : 9;
  noise_ = {rng.Uniform(2e-4, 8e-4), rng.Uniform(3e-3, 1e-2), rng.Uniform(1e-4, 4e-4)};
}

VectorXd Maker::Gravity(const VectorXd& q) const {
  VectorXd full = VectorXd::Zero(static_cast<Eigen::Index>(skeleton_->getNumDofs()));
  for (size_t i = 0; i < joints_.size(); ++i) full[at_[i]] = q[static_cast<Eigen::Index>(i)];
  skeleton_->setPositions(full);
  skeleton_->setVelocities(VectorXd::Zero(full.size()));
  return skeleton_->getGravityForces()(at_);
}

MatrixXd Maker::Select(const MatrixXd& full) const { return full(at_, at_); }

VectorXd Maker::Controller(const VectorXd& q, const VectorXd& v, const VectorXd& q_ref,
                           const VectorXd& v_ref) const {
  const VectorXd gravity = Gravity(q);
  const VectorXd wish = wn_ * wn_ * (q_ref - q) + 2 * 0.8 * wn_ * (v_ref - v);
  const VectorXd torque = Select(skeleton_->getMassMatrix()) * wish + gravity;
  return torque.cwiseMax(-effort_).cwiseMin(effort_);
}

Track Maker::Record(const Truth& truth, const std::string& kind, double duration, uint64_t stream) const {
  const int n = static_cast<int>(joints_.size());
  Rng rng = rng_.Split(100 + stream);
  const Reference reference = MakeReference(kind, limits_, duration, request_.rate_hz, rng.Split(0));
  const int rows = static_cast<int>(reference.q.cols());
  Track track{MatrixXd(n, rows), MatrixXd(n, rows), MatrixXd(n, rows), MatrixXd(n, rows), MatrixXd(n, rows)};
  Engine engine(skeleton_, joints_, truth, dt_);
  const VectorXd zero = VectorXd::Zero(n);
  engine.Reset(reference.q.col(0), zero, Controller(reference.q.col(0), zero, reference.q.col(0), zero), 0.0);
  long fine = 0;
  for (int k = 0; k < rows; ++k) {
    track.true_q.col(k) = engine.SensedPosition();
    track.true_v.col(k) = engine.SensedVelocity();
    for (int i = 0; i < n; ++i) {
      const double noisy = track.true_q(i, k) + noise_.position * rng.Normal();
      track.q(i, k) = std::round(noisy / noise_.resolution) * noise_.resolution;
      track.v(i, k) = track.true_v(i, k) + noise_.velocity * rng.Normal();
    }
    track.u.col(k) = Controller(track.q.col(k), track.v.col(k), reference.q.col(k), reference.v.col(k));
    for (int i = 0; i < n; ++i) track.u(i, k) = std::round(track.u(i, k) * 1e6) * 1e-6;  // as the file has it
    const long end = std::lround((k + 1) / (request_.rate_hz * dt_));
    for (; fine < end; ++fine) engine.Step(track.u.col(k));
    if (!engine.finite() || track.true_q.col(k).cwiseAbs().maxCoeff() > 50) {
      track.ok = false;
      return track;
    }
  }
  return track;
}

void Maker::MeasureScales() {
  const int n = static_cast<int>(joints_.size());
  const Track track = Record(Nominal(), "multisine", 7.0, 50);
  scales_.joints = joints_;
  scales_.links = links_;
  scales_.home = limits_.home;
  scales_.amplitude = limits_.amplitude;
  const double rows = static_cast<double>(track.u.cols());
  scales_.torque = (track.u.rowwise().squaredNorm() / rows).cwiseSqrt();
  scales_.velocity = (track.true_v.rowwise().squaredNorm() / rows).cwiseSqrt();
  MatrixXd motion(n, track.u.cols());
  scales_.tip_low = 1e9, scales_.tip_high = -1e9;
  for (Eigen::Index k = 0; k < track.u.cols(); ++k) {
    motion.col(k) = track.u.col(k) - Controller(track.true_q.col(k), VectorXd::Zero(n), track.true_q.col(k),
                                                VectorXd::Zero(n));
    const double tip = skeleton_->getBodyNode(links_.back())->getTransform().translation().z();
    scales_.tip_low = std::min(scales_.tip_low, tip);
    scales_.tip_high = std::max(scales_.tip_high, tip);
  }
  scales_.motion_torque = (motion.rowwise().squaredNorm() / rows).cwiseSqrt();
  Gravity(limits_.home);
  scales_.inertia = Select(skeleton_->getMassMatrix()).diagonal();
  scales_.last_mass = skeleton_->getBodyNode(links_.back())->getMass();
  scales_.duration_s = 7.0;
}

Truth Maker::Draw(double strength, json* effects) const {
  Truth truth = Nominal();
  *effects = json::array();
  uint64_t stream = 10;
  for (const std::string& id : request_.effects) {
    if (id != "none") effects->push_back(AddEffect(id, strength, scales_, rng_.Split(stream), &truth));
    ++stream;
  }
  if (request_.wrong_parameters)
    effects->push_back(AddEffect("parameters_only", 1.0, scales_, rng_.Split(stream), &truth));
  return truth;
}

void Maker::WindowErrors(const Truth& truth, const Track& track, std::vector<double>* nominal,
                         std::vector<double>* oracle) const {
  Engine real(skeleton_, joints_, truth, dt_), model(skeleton_, joints_, truth, dt_),
      plain(skeleton_, joints_, Nominal(), dt_);
  const int rate = static_cast<int>(request_.rate_hz), rows = static_cast<int>(track.q.cols());
  real.Reset(track.true_q.col(0), track.true_v.col(0), track.u.col(0), 0.0);
  model.Reset(track.q.col(0), track.v.col(0), track.u.col(0), 0.0);
  long fine = 0;
  const int last = (rows - 1) / rate * rate;
  for (int k = 0; k <= last; ++k) {
    if (k > 0) {
      nominal->push_back(
          std::min(1e6, (plain.SensedPosition() - track.true_q.col(k)).squaredNorm() / track.q.rows()));
      oracle->push_back(
          std::min(1e6, (model.SensedPosition() - track.true_q.col(k)).squaredNorm() / track.q.rows()));
    }
    if (k % rate == 0) {
      model.ResetLike(real, track.q.col(k), track.v.col(k));
      plain.Reset(track.q.col(k), track.v.col(k), track.u.col(k), k / request_.rate_hz);
    }
    if (k == last) break;
    for (const long end = std::lround((k + 1) / (request_.rate_hz * dt_)); fine < end; ++fine) {
      real.Step(track.u.col(k)), model.Step(track.u.col(k)), plain.Step(track.u.col(k));
    }
  }
}

double Maker::Ratio(const Truth& truth) const {
  std::vector<double> nominal, oracle;
  const Track track = Record(truth, "chirp", 5.0, 70);
  if (!track.ok) return 1e9;
  WindowErrors(truth, track, &nominal, &oracle);
  return Rms(nominal) / std::max(1e-12, Rms(oracle));
}

// Makes the effect as strong as was asked: by bisection on the logarithm of the strength.
Truth Maker::SearchStrength(json* effects, std::string* warning) const {
  const double low = request_.weak ? 1.5 : 4.0, high = request_.weak ? 2.5 : 30.0;
  double strength = request_.weak ? 0.25 : 1.0, below = 0.01, above = 8.0;
  for (int attempt = 0; attempt < 9; ++attempt) {
    const Truth truth = Draw(strength, effects);
    const double ratio = Ratio(truth);
    if (ratio >= low && ratio <= high) return truth;
    (ratio < low ? below : above) = strength;
    strength = std::sqrt(below * above);
  }
  *warning = "no strength gives the error ratio that was asked for";
  return Draw(strength, effects);
}

std::string Maker::Csv(const Track& track, bool concealed) const {
  const int n = static_cast<int>(joints_.size());
  std::string text = "time";
  const auto header = [&](const std::string& kind) {
    for (const std::string& j : joints_) text += "," + kind + "." + j;
  };
  header("position");
  if (request_.with_velocity) header("velocity");
  header("effort_command");
  if (concealed) header("true_position"), header("true_velocity");
  text += "\n";
  char number[40];
  const auto put = [&](double x, const char* format) {
    std::snprintf(number, sizeof number, format, x);
    text += number;
  };
  for (Eigen::Index k = 0; k < track.q.cols(); ++k) {
    put(static_cast<double>(k) / request_.rate_hz, "%.9g");
    for (int i = 0; i < n; ++i) put(track.q(i, k), ",%.7g");
    for (int i = 0; request_.with_velocity && i < n; ++i) put(track.v(i, k), ",%.6g");
    for (int i = 0; i < n; ++i) put(track.u(i, k), ",%.9g");
    for (int i = 0; concealed && i < n; ++i) put(track.true_q(i, k), ",%.9g");
    for (int i = 0; concealed && i < n; ++i) put(track.true_v(i, k), ",%.9g");
    text += "\n";
  }
  return text;
}

const std::vector<std::pair<std::string, std::string>> kPlan = {
    {"fit", "multisine"},      {"fit", "p2p"},      {"fit", "ramps"},
    {"fit", "multisine"},      {"fit", "holds"},    {"holdout", "chirp"},
    {"holdout", "sequential"}, {"hidden", "chirp"}, {"hidden", "p2p"}};

json Maker::Manifest() const {
  json recordings = json::array();
  for (size_t r = 0; r < kPlan.size(); ++r) {
    if (kPlan[r].first == "hidden") continue;
    recordings.push_back({{"file", "rec_00" + std::to_string(r) + ".csv"}, {"split", kPlan[r].first}});
  }
  return {{"format", "realitygrad.recordings/1"},
          {"robot", "robot.urdf"},
          {"joints", joints_},
          {"gravity", {0, 0, -9.81}},
          {"sample_rate_hz", request_.rate_hz},
          {"control", {{"rate_hz", request_.rate_hz}, {"hold", "zero_order"}}},
          {"noise",
           {{"position_stddev", noise_.position},
            {"velocity_stddev", noise_.velocity},
            {"position_resolution", noise_.resolution}}},
          {"recordings", recordings}};
}

json AcceptedVerdicts(const json& effects) {
  std::set<std::string> verdicts;
  for (const json& e : effects) {
    const std::string id = e["id"];
    if (id == "parameters_only") continue;
    verdicts.insert("unmodelled_physics");
    if (id == "unknown_field" || id == "base_flexibility" || id == "sloshing_payload")
      verdicts.insert("unexplained");
    for (const json& q : e["equivalents"]) {
      if (q == "parameters_only" && effects.size() == 1) verdicts.insert("parameters_only");
    }
  }
  if (verdicts.empty()) verdicts.insert(effects.empty() ? "no_mismatch" : "parameters_only");
  return verdicts;
}

Result<CaseSummary> Maker::Run(const std::string& sets_folder, const std::string& labels_folder) {
  RG_RETURN_IF_ERROR(LoadRobot());
  ChooseMotion();
  MeasureScales();
  CaseSummary summary;
  json effects;
  const bool control = request_.effects == std::vector<std::string>{"none"};
  const Truth truth = control || request_.effects == std::vector<std::string>{"parameters_only"}
                          ? Draw(1.0, &effects)
                          : SearchStrength(&effects, &summary.warning);
  const std::string set = sets_folder + "/" + request_.name, label = labels_folder + "/" + request_.name;
  RG_RETURN_IF_ERROR(WriteFileAtomically(set + "/robot.urdf", urdf_));
  RG_RETURN_IF_ERROR(WriteFileAtomically(set + "/manifest.json", Manifest().dump(1)));
  std::vector<double> nominal, oracle;
  int hidden = 0;
  json oracle_recordings = json::array();
  for (size_t r = 0; r < kPlan.size(); ++r) {
    Rng rng = rng_.Split(200 + r);
    const Track track = Record(truth, kPlan[r].second, 6.0 + 0.5 * static_cast<double>(rng.Index(5)), r);
    if (!track.ok) return InternalError(request_.name + ": the true robot ran away");
    const bool concealed = kPlan[r].first == "hidden";
    const std::string file = concealed ? label + "/hidden_00" + std::to_string(hidden++) + ".csv"
                                       : set + "/rec_00" + std::to_string(r) + ".csv";
    RG_RETURN_IF_ERROR(WriteFileAtomically(file, Csv(track, concealed)));
    if (concealed) WindowErrors(truth, track, &nominal, &oracle);
  }
  summary.nominal_rms = Rms(nominal), summary.oracle_rms = Rms(oracle);
  summary.ratio = summary.nominal_rms / summary.oracle_rms;
  const json oracle_json = {{"window_s", 1},
                            {"nominal_rms", summary.nominal_rms},
                            {"oracle_rms", summary.oracle_rms},
                            {"ratio", summary.ratio},
                            {"recordings", oracle_recordings}};
  const json label_json = {{"name", request_.name},
                           {"robot", request_.robot},
                           {"rate_hz", std::lround(request_.rate_hz)},
                           {"weak", request_.weak},
                           {"verdict", AcceptedVerdicts(effects)},
                           {"effects", effects},
                           {"truth_dt", dt_},
                           {"warnings", summary.warning.empty() ? json::array() : json{summary.warning}}};
  RG_RETURN_IF_ERROR(WriteFileAtomically(label + "/oracle.json", oracle_json.dump(1)));
  RG_RETURN_IF_ERROR(WriteFileAtomically(label + "/label.json", label_json.dump(1)));
  return summary;
}

}  // namespace

Result<CaseSummary> MakeCase(const CaseRequest& request, const std::string& sets_folder,
                             const std::string& labels_folder) {
  RG_ASSIGN_OR_RETURN(std::string urdf, ReadFile(request.urdf));
  return Maker(request, std::move(urdf)).Run(sets_folder, labels_folder);
}

}  // namespace rg::proof
