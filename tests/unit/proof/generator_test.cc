#include <gtest/gtest.h>

#include <cmath>
#include <dart/dynamics/DegreeOfFreedom.hpp>
#include <dart/dynamics/Joint.hpp>
#include <dart/utils/urdf/DartLoader.hpp>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "common/base/file.h"
#include "common/base/ids.h"
#include "services/proof/generator/engine.h"
#include "services/proof/generator/proof_case.h"

namespace rg::proof {
namespace {

using Eigen::VectorXd;

const char kPendulum[] = R"(<robot name="p"><link name="base"/>
  <link name="rod"><inertial><origin xyz="0 0 -0.3"/><mass value="1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="pivot" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="5" velocity="8"/></joint></robot>)";

dart::dynamics::SkeletonPtr Pendulum() {
  dart::utils::DartLoader::Options options;
  options.mDefaultRootJointType = dart::utils::DartLoader::RootJointType::FIXED;
  auto skeleton = dart::utils::DartLoader(options).parseSkeletonString(kPendulum, "");
  return skeleton;
}

Truth OneJoint() { return Truth{std::vector<JointTruth>(1)}; }

VectorXd One(double x) { return VectorXd::Constant(1, x); }

TEST(ProofEngine, SmallSwingsHaveThePendulumsPeriod) {
  Engine engine(Pendulum(), {"pivot"}, OneJoint(), 1e-4);
  engine.Reset(One(0.01), One(0), One(0), 0);
  const double omega = std::sqrt(1.0 * 9.81 * 0.3 / (0.01 + 0.09));
  const int half = static_cast<int>(std::lround(M_PI / omega / 1e-4));
  for (int i = 0; i < half; ++i) engine.Step(One(0));
  EXPECT_NEAR(engine.SensedPosition()[0], -0.01, 1e-5);
}

TEST(ProofEngine, FrictionHoldsAtRestAndSlipsAboveItsLevel) {
  Truth truth = OneJoint();
  truth.joint[0].dry.coulomb_positive = truth.joint[0].dry.coulomb_negative = 0.5;
  Engine engine(Pendulum(), {"pivot"}, truth, 1e-4);
  engine.Reset(One(0), One(0), One(0), 0);
  for (int i = 0; i < 5000; ++i) engine.Step(One(0.49));
  EXPECT_LT(std::abs(engine.SensedPosition()[0]), 1e-9);
  for (int i = 0; i < 5000; ++i) engine.Step(One(0.7));
  EXPECT_GT(engine.SensedPosition()[0], 0.01);
}

TEST(ProofEngine, WhatTheUrdfDeclaresIsNoConcealedEffect) {
  auto skeleton = Pendulum();
  skeleton->getDof(0)->setDampingCoefficient(0.2);
  Truth viscous = OneJoint();
  viscous.joint[0].viscous = 0.2;
  Engine declared(skeleton, {"pivot"}, OneJoint(), 1e-4), concealed(Pendulum(), {"pivot"}, viscous, 1e-4);
  for (Engine* engine : {&declared, &concealed}) {
    engine->Reset(One(0.5), One(0), One(0), 0);
    for (int i = 0; i < 3000; ++i) engine->Step(One(0));
  }
  EXPECT_DOUBLE_EQ(declared.SensedPosition()[0], concealed.SensedPosition()[0]);
  EXPECT_LT(declared.SensedPosition()[0], 0.49);
}

TEST(ProofEngine, DelayShiftsTheCommand) {
  Truth truth = OneJoint();
  truth.joint[0].delay = 0.02;
  Engine engine(Pendulum(), {"pivot"}, truth, 1e-4);
  engine.Reset(One(0), One(0), One(0), 0);
  for (int i = 0; i < 199; ++i) engine.Step(One(1));
  EXPECT_EQ(engine.SensedVelocity()[0], 0.0);
  for (int i = 0; i < 20; ++i) engine.Step(One(1));
  EXPECT_GT(engine.SensedVelocity()[0], 0.0);
}

TEST(ProofCase, ConcealsTheTruthFromTheSet) {
  const std::string folder = std::filesystem::temp_directory_path() / ("rg_proof_" + RandomHex(6));
  ASSERT_TRUE(WriteFileAtomically(folder + "/pendulum.urdf", kPendulum).ok());
  CaseRequest request;
  request.name = "case";
  request.urdf = folder + "/pendulum.urdf";
  request.robot = "pendulum";
  request.effects = {"coulomb_friction"};
  request.rate_hz = 25;
  const auto summary = MakeCase(request, folder + "/sets", folder + "/labels");
  ASSERT_TRUE(summary.ok()) << summary.status().ToString();
  EXPECT_GT(summary->ratio, 1.5);
  const auto label = nlohmann::json::parse(*ReadFile(folder + "/labels/case/label.json"));
  EXPECT_EQ(label["effects"][0]["id"], "coulomb_friction");
  EXPECT_TRUE(label["rate_hz"].is_number_integer()) << "scores count rows per second with it";
  for (const auto& entry : std::filesystem::recursive_directory_iterator(folder + "/sets")) {
    if (!entry.is_regular_file()) continue;
    const std::string text = *ReadFile(entry.path());
    EXPECT_EQ(text.find("true_"), std::string::npos) << entry.path();
    EXPECT_EQ(text.find("coulomb"), std::string::npos) << entry.path();
  }
  std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace rg::proof
