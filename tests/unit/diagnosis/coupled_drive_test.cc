// A wrist whose last motor turns with two joints (joint_coupling, form "kinematic"), among ordinary drives
// and under a measured effort.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <optional>

#include "common/base/rng.h"
#include "common/model/urdf_loader.h"
#include "services/diagnosis/diagnosis.h"
#include "tests/unit/diagnosis/simulated_set.h"

namespace rg::diagnosis {
namespace {

using effects::EffectSpec;
using effects::MakeSpec;
using Eigen::Vector4d;
using Eigen::VectorXd;

// Waist, shoulder, and a wrist that bends and turns.
std::string Urdf() {
  struct Part {
    const char *joint, *axis, *at, *com;
    double mass, inertia;
  };
  const Part parts[] = {{"waist", "0 0 1", "0 0 0.3", "0.05 0 0.1", 8, 0.08},
                        {"shoulder", "0 1 0", "0 0 0.2", "0 0.02 0.25", 6, 0.15},
                        {"bend", "0 1 0", "0 0 0.5", "0.03 0 0.08", 2, 0.01},
                        {"turn", "0 0 1", "0 0 0.15", "0.04 0.02 0.06", 1.2, 0.005}};
  std::string text = "<robot name=\"wrist\"><link name=\"base\"/>";
  std::string parent = "base";
  for (const Part& p : parts) {
    const std::string link = std::string(p.joint) + "_link", inertia = std::to_string(p.inertia);
    text += "<link name=\"" + link + "\"><inertial><origin xyz=\"" + p.com + "\"/><mass value=\"" +
            std::to_string(p.mass) + "\"/><inertia ixx=\"" + inertia + "\" iyy=\"" + inertia + "\" izz=\"" +
            inertia + "\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial></link><joint name=\"" + p.joint +
            "\" type=\"revolute\"><parent link=\"" + parent + "\"/><child link=\"" + link +
            "\"/><origin xyz=\"" + p.at + "\"/><axis xyz=\"" + p.axis +
            "\"/><limit lower=\"-3\" upper=\"3\" effort=\"100\" velocity=\"5\"/></joint>";
    parent = link;
  }
  return text + "</robot>";
}

const std::vector<std::string> kJoints = {"waist", "shoulder", "bend", "turn"};
const Vector4d kViscous(6, 8, 1.5, 0.8), kCoulomb(5, 7, 2, 1.2), kRotor(0.8, 1.0, 0.1, 0.05);

// Friction and a rotor in every drive, of the last one over q̇_turn + ratio·q̇_bend; without a ratio the last
// one is as the others are.
std::vector<EffectSpec> Drives(std::optional<double> ratio) {
  EffectSpec viscous = MakeSpec("viscous_friction"), coulomb = MakeSpec("coulomb_friction"),
             rotor = MakeSpec("rotor_inertia");
  for (int j = 0; j < (ratio ? 3 : 4); ++j) {
    for (EffectSpec* s : {&viscous, &coulomb, &rotor}) s->joints.push_back(kJoints[j]);
    viscous.values[kJoints[j]]["viscous"] = kViscous[j];
    coulomb.values[kJoints[j]]["coulomb"] = kCoulomb[j];
    rotor.values[kJoints[j]]["armature"] = kRotor[j];
  }
  std::vector<EffectSpec> out = {viscous, coulomb, rotor};
  if (!ratio) return out;
  out.push_back(MakeSpec("joint_coupling", {"bend", "turn"},
                         {{"coefficient", *ratio},
                          {"viscous", kViscous[3]},
                          {"coulomb", kCoulomb[3]},
                          {"armature", kRotor[3]}}));
  out.back().options["form"] = "kinematic";
  return out;
}

sim::Plant MakeArm(std::vector<EffectSpec> effects) {
  const auto model = model::ParseUrdf(Urdf(), "wrist.urdf", {});
  RG_CHECK(model.ok()) << model.status().ToString();
  auto plant = sim::Plant::Create(std::make_shared<const model::RobotModel>(*model), {}, std::move(effects));
  RG_CHECK(plant.ok()) << plant.status().ToString();
  return *plant;
}

// The arm follows sines under a stiff controller with the rigid model in it.
recordings::Recording Follow(const sim::Plant& plant, uint64_t seed) {
  constexpr int kRows = 800;
  constexpr double kPeriod = 0.01;
  const Vector4d stiffness(600, 800, 120, 60), damping(60, 80, 8, 4);
  Rng rng(seed);
  Eigen::Matrix<double, 4, 3> frequency, phase;
  for (int i = 0; i < 12; ++i)
    frequency.data()[i] = 2 * M_PI * rng.Uniform(0.15, 0.9), phase.data()[i] = rng.Uniform(0, 2 * M_PI);
  const dynamics::Mechanism mechanism(plant.model());
  dynamics::Workspace workspace;
  sim::Simulator simulator(plant);
  recordings::Recording rec;
  rec.joints = kJoints;
  rec.t.resize(kRows);
  rec.q.resize(4, kRows), rec.v.resize(4, kRows), rec.effort_command.resize(4, kRows);
  sim::State x;
  for (int k = 0; k < kRows; ++k) {
    Vector4d q(0, 0.5, 0.4, 0), v = Vector4d::Zero(), a = v;
    for (int m = 0; m < 3; ++m) {
      const Eigen::Array4d w = frequency.col(m).array(), at = w * (k * kPeriod) + phase.col(m).array();
      q += (0.25 * at.sin()).matrix();
      v += (0.25 * w * at.cos()).matrix();
      a -= (0.25 * w * w * at.sin()).matrix();
    }
    if (k == 0) x = simulator.MakeState(q, v);
    VectorXd u(4);
    dynamics::Rnea(mechanism, workspace, q, v, a, u);
    u += stiffness.cwiseProduct(q - x.q) + damping.cwiseProduct(v - x.v);
    rec.t[k] = k * kPeriod;
    for (int j = 0; j < 4; ++j) {
      rec.q(j, k) = x.q[j] + testing::kPositionNoise * 0.1 * rng.Normal();
      rec.v(j, k) = x.v[j] + testing::kVelocityNoise * rng.Normal();
    }
    rec.effort_command.col(k) = u;
    RG_CHECK(simulator.Advance(x, u, kPeriod).ok());
  }
  return rec;
}

recordings::RecordingSet MeasuredArm(std::optional<double> ratio, uint64_t seed) {
  const sim::Plant truth = MakeArm(Drives(ratio));
  recordings::RecordingSet set;
  set.folder = ".";
  set.urdf_path = "wrist.urdf";
  set.urdf_text = Urdf();
  set.joints = kJoints;
  for (uint64_t k = 0; k < 4; ++k) {
    set.recordings.push_back(Follow(truth, 10 * seed + k));
    set.recordings.back().name = "rec_00" + std::to_string(k) + ".csv";
    set.recordings.back().split = k == 3 ? recordings::Split::kHoldout : recordings::Split::kFit;
  }
  testing::MeasureEffort(seed + 99, 0.03, &set);
  return set;
}

DiagnosisResult DiagnosedDrive(const recordings::RecordingSet& set) {
  DiagnosisOptions options;
  options.threads = 2;
  auto result = Diagnose(set, options, RealClock());
  RG_CHECK(result.ok()) << result.status().ToString();
  return *result;
}

TEST(CoupledDriveOfAWrist, IsNamedWithBothJointsItsRatioAndItsFriction) {
  for (const double ratio : {1.0, -0.7}) {
    const DiagnosisResult r = DiagnosedDrive(MeasuredArm(ratio, 7));
    const auto found = std::find_if(r.findings.begin(), r.findings.end(),
                                    [](const Finding& f) { return f.effect == "joint_coupling"; });
    ASSERT_NE(found, r.findings.end()) << ratio;
    EXPECT_EQ(found->joints, (std::vector<std::string>{"bend", "turn"}));
    std::map<std::string, double> values;
    for (const ParameterEstimate& p : found->parameters) values[p.name] = p.value;
    EXPECT_NEAR(values["coefficient"], ratio, 0.05 * std::abs(ratio));
    EXPECT_NEAR(values["viscous"], kViscous[3], 0.1 * kViscous[3]);
    EXPECT_NEAR(values["coulomb"], kCoulomb[3], 0.1 * kCoulomb[3]);
    for (const Finding& f : r.findings) {
      EXPECT_TRUE(f.effect == "joint_coupling" || f.effect == "viscous_friction" ||
                  f.effect == "coulomb_friction" || f.effect == "rotor_inertia" ||
                  f.effect == "parameters_only")
          << f.effect;
    }
    EXPECT_EQ(r.verdict, "unmodelled_physics");
    EXPECT_LT(r.holdout.after_rms, 0.2 * r.holdout.before_rms);
  }
}

TEST(CoupledDriveOfAWrist, IsNotNamedWhereEveryDriveTurnsWithItsOwnJoint) {
  for (const uint64_t seed : {7, 8, 9}) {
    for (const Finding& f : DiagnosedDrive(MeasuredArm({}, seed)).findings)
      EXPECT_NE(f.effect, "joint_coupling");
  }
}

}  // namespace
}  // namespace rg::diagnosis
