// What other people established about real robots comes out of their recordings, loosely held
// (docs/real-robots.md has the figures). The sets lie in $RG_RECORDINGS_DIR, or in shared/recordings beside
// the source tree; without them these tests skip.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <set>
#include <string>

#include "services/diagnosis/diagnosis.h"

namespace rg::diagnosis {
namespace {

std::string RecordingsDir() {
  if (const char* dir = std::getenv("RG_RECORDINGS_DIR")) return dir;
  const char* root = std::getenv("RG_SOURCE_DIR");
  return std::string(root != nullptr ? root : ".") + "/../shared/recordings";
}

#define RG_DIAGNOSE_SET(set)                                                     \
  const std::string folder = RecordingsDir() + "/" set;                          \
  if (!std::filesystem::exists(folder + "/manifest.json")) {                     \
    GTEST_SKIP() << "no recordings in " << folder << " (set RG_RECORDINGS_DIR)"; \
  }                                                                              \
  const auto loaded = recordings::LoadSet(folder);                               \
  ASSERT_TRUE(loaded.ok()) << loaded.status().ToString();                        \
  const auto diagnosed = Diagnose(*loaded, {}, RealClock());                     \
  ASSERT_TRUE(diagnosed.ok()) << diagnosed.status().ToString();                  \
  const DiagnosisResult& r = *diagnosed

double Value(const DiagnosisResult& r, const std::string& effect, const std::string& joint,
             const std::string& name) {
  for (const Finding& f : r.findings) {
    for (const ParameterEstimate& p : f.parameters) {
      if (f.effect == effect && p.owner == joint && p.name == name) return p.value;
    }
  }
  return NAN;
}

// Joints on which some form of dry friction was named.
int DryJoints(const DiagnosisResult& r) {
  std::set<std::string> joints;
  for (const Finding& f : r.findings) {
    const bool dry = f.effect == "coulomb_friction" || f.effect == "asymmetric_friction" ||
                     f.effect == "load_dependent_friction" || f.effect == "stribeck_friction";
    if (dry) joints.insert(f.joints.begin(), f.joints.end());
  }
  return static_cast<int>(joints.size());
}

// Janot, Gautier, Brunot 2019: 20.4 N, 203.5 N·s/m, an offset of −3.2 N on the effort's side; asymmetric in the
// variant of 2017.
TEST(RealRobots, EmpsSlideHasItsFrictionAndItsOffset) {
  RG_DIAGNOSE_SET("real/emps");
  EXPECT_EQ(r.verdict, "unmodelled_physics");
  EXPECT_NEAR(Value(r, "coulomb_friction", "slide", "coulomb"), 20.4, 2.0);
  EXPECT_NEAR(Value(r, "torque_offset", "slide", "offset"), 3.2, 1.0);
  EXPECT_NEAR(Value(r, "viscous_friction", "slide", "viscous"), 203.5, 25.0);
  EXPECT_LT(r.holdout.after_rms, 0.05 * r.holdout.before_rms);
  EXPECT_LT(r.holdout.after_rms, 0.2 * r.holdout.calibrated_rms);
}

TEST(RealRobots, Ur10eHasFrictionAndRotorsOnAllItsJoints) {
  RG_DIAGNOSE_SET("real/ur10e");
  EXPECT_EQ(r.verdict, "unmodelled_physics");
  EXPECT_EQ(DryJoints(r), 6);
  EXPECT_NEAR(Value(r, "viscous_friction", "shoulder_pan_joint", "viscous"), 21.3, 4.0);
  EXPECT_NEAR(Value(r, "viscous_friction", "wrist_3_joint", "viscous"), 3.03, 0.4);
  EXPECT_NEAR(Value(r, "coulomb_friction", "shoulder_pan_joint", "coulomb"), 12.5, 2.0);
  EXPECT_NEAR(Value(r, "coulomb_friction", "wrist_3_joint", "coulomb"), 2.30, 0.3);
  EXPECT_NEAR(Value(r, "rotor_inertia", "wrist_3_joint", "armature"), 0.4365, 0.08);
  EXPECT_LT(r.holdout.after_rms, 0.03);
}

TEST(RealRobots, Gen3HasFrictionAndDampingOnAllItsJointsAndAToolInItsHand) {
  RG_DIAGNOSE_SET("real/kinova_gen3");
  EXPECT_EQ(r.verdict, "unmodelled_physics");
  EXPECT_EQ(DryJoints(r), 7);
  EXPECT_NEAR(Value(r, "viscous_friction", "joint_1", "viscous"), 3.3, 1.0);
  EXPECT_NEAR(Value(r, "viscous_friction", "joint_7", "viscous"), 1.1, 0.4);
  EXPECT_NEAR(Value(r, "payload", "*", "mass"), 0.9, 0.3);
  EXPECT_LT(r.holdout.after_rms, 0.3 * r.holdout.calibrated_rms);
}

TEST(RealRobots, PandaLacksFriction) {
  RG_DIAGNOSE_SET("real/franka_panda");
  EXPECT_EQ(r.verdict, "unmodelled_physics");
  EXPECT_EQ(DryJoints(r), 7);
  EXPECT_LT(r.holdout.after_rms, 0.15 * r.holdout.before_rms);
  EXPECT_LT(r.holdout.after_rms, r.holdout.calibrated_rms);
}

TEST(RealRobots, PendulumHasDryFrictionAndLagsItsEffort) {
  RG_DIAGNOSE_SET("real/dfki_simple_pendulum");
  EXPECT_EQ(r.verdict, "unmodelled_physics");
  EXPECT_NEAR(Value(r, "coulomb_friction", "shoulder", "coulomb"), 0.19, 0.04);
  EXPECT_NEAR(Value(r, "actuator_delay", "shoulder", "delay"), 0.016, 0.004);
  EXPECT_LT(r.holdout.after_rms, r.holdout.calibrated_rms);
}

}  // namespace
}  // namespace rg::diagnosis
