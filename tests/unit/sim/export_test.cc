// Exported models loaded back: the URDF by our loader, the MJCF figure by figure from its XML.
#include <gtest/gtest.h>
#include <tinyxml.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <sstream>

#include "common/base/rng.h"
#include "common/dynamics/dynamics.h"
#include "common/sim/export_mjcf.h"
#include "common/sim/export_urdf.h"
#include "common/sim/simulator.h"
#include "tests/support/sim/plants.h"

namespace rg::sim {
namespace {

using Eigen::VectorXd;

std::vector<std::string> Joints() {
  return {"joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6"};
}

// Every inertial figure of every link that has some moved off its nominal; damping and friction too.
VectorXd Moved(const Plant& plant) {
  Rng rng(5);
  VectorXd p = plant.parameters().Nominal();
  for (int i = 0; i < p.size(); ++i) {
    const ParameterKind kind = plant.parameters()[i].kind;
    if (kind == ParameterKind::kMass || kind == ParameterKind::kInertia) p[i] *= rng.Uniform(0.8, 1.2);
    if (kind == ParameterKind::kCenterOfMass) p[i] += p[i] == 0 ? 0 : rng.Uniform(-0.01, 0.01);
    if (kind == ParameterKind::kDamping) p[i] = rng.Uniform(0.1, 3.0);
    if (kind == ParameterKind::kFriction) p[i] = rng.Uniform(0.1, 0.5);
  }
  p[plant.parameters().Find("inertia_xy.link_2")] = 1e-4;
  p[plant.parameters().Find("mass.end_effector")] = 0.05;  // a link without <inertial>
  return p;
}

void SetValue(const Plant& plant, const std::string& name, double value, VectorXd* p) {
  const int index = plant.parameters().Find(name);
  ASSERT_GE(index, 0) << name;
  (*p)[index] = value;
}

Plant LoadBack(const std::string& urdf) {
  model::LoadOptions options;
  options.joints = Joints();
  auto model = model::ParseUrdf(urdf, "exported", options);
  RG_CHECK(model.ok()) << model.status().ToString();
  return Plant::Create(std::make_shared<const model::RobotModel>(std::move(model).value())).value();
}

VectorXd Random(Rng& rng, int n, double size) {
  VectorXd x(n);
  for (int i = 0; i < n; ++i) x[i] = rng.Uniform(-size, size);
  return x;
}

TEST(ExportUrdf, LoadedBackHasTheSameInverseDynamicsAtRandomStates) {
  const Plant plant = testing::MakePlant("mico2");
  const VectorXd p = Moved(plant);
  const auto exported = ExportUrdf(plant, p);
  ASSERT_TRUE(exported.ok()) << exported.status().ToString();
  EXPECT_TRUE(exported->left_out.empty());
  const Plant back = LoadBack(exported->text);

  dynamics::LinkParametersMatrix links(model::kLinkParameters, plant.model().num_links());
  for (int l = 0; l < plant.model().num_links(); ++l) {
    for (int i = 0; i < model::kLinkParameters; ++i) {
      links(i, l) = p[plant.parameters().Find(std::string(model::kLinkParameterNames[i]) + "." +
                                              plant.model().link(l).name)];
    }
  }
  dynamics::Mechanism ours(plant.model()), theirs(back.model());
  ours.SetLinkParameters(plant.model(), links);
  dynamics::Workspace w;
  Rng rng(1);
  VectorXd a(6), b(6);
  for (int k = 0; k < 50; ++k) {
    const VectorXd q = Random(rng, 6, 3), v = Random(rng, 6, 2), dv = Random(rng, 6, 5);
    dynamics::Rnea(ours, w, q, v, dv, a);
    dynamics::Rnea(theirs, w, q, v, dv, b);
    EXPECT_LT((a - b).cwiseAbs().maxCoeff(), 1e-9);
  }
}

TEST(ExportUrdf, PutsFrictionDampingAndPayloadWhereTheLoaderFindsThem) {
  const Plant plant = testing::MakePlant(
      "mico2", {effects::MakeSpec("viscous_friction", Joints()),
                effects::MakeSpec("coulomb_friction", Joints()), effects::MakeSpec("payload")});
  VectorXd p = Moved(plant);
  for (const std::string& joint : Joints()) {
    SetValue(plant, "viscous_friction." + joint + ".viscous", 2.5, &p);
    SetValue(plant, "coulomb_friction." + joint + ".coulomb", 0.7, &p);
  }
  SetValue(plant, "payload.*.mass", 0.4, &p);
  SetValue(plant, "payload.*.com_x", 0.02, &p);
  SetValue(plant, "payload.*.com_z", -0.1, &p);
  const auto exported = ExportUrdf(plant, p);
  ASSERT_TRUE(exported.ok()) << exported.status().ToString();
  const Plant back = LoadBack(exported->text);
  Simulator ours(plant), theirs(back);
  ours.SetParameters(p);
  Rng rng(2);
  VectorXd a, b;
  for (int k = 0; k < 20; ++k) {
    const VectorXd q = Random(rng, 6, 3), v = Random(rng, 6, 1), u = Random(rng, 6, 5);
    ASSERT_TRUE(ours.Acceleration(ours.MakeState(q, v), u, &a));
    ASSERT_TRUE(theirs.Acceleration(theirs.MakeState(q, v), u, &b));
    EXPECT_LT((a - b).cwiseAbs().maxCoeff(), 1e-9 * (1 + a.cwiseAbs().maxCoeff()));
  }
}

TEST(ExportUrdf, KeepsWhatWasNotIdentifiedAndExportingNominalChangesNoNumber) {
  const Plant plant = testing::MakePlant("mico2");
  const auto exported = ExportUrdf(plant, plant.parameters().Nominal());
  ASSERT_TRUE(exported.ok());
  EXPECT_NE(exported->text.find("Kinova Mico, 6 joints and 2 fingers"), std::string::npos) << "the comment";
  const Plant back = LoadBack(exported->text);
  EXPECT_EQ(back.parameters().Nominal(), plant.parameters().Nominal());
  EXPECT_EQ(back.model().UpperLimits(), plant.model().UpperLimits());
  EXPECT_EQ(back.model().num_links(), plant.model().num_links());
  for (int l = 0; l < plant.model().num_links(); ++l)
    EXPECT_EQ(back.model().link(l).has_inertial, plant.model().link(l).has_inertial);
}

TEST(ExportUrdf, SaysInOneLineEachWhatItCannotHold) {
  const Plant plant = testing::MakePlant("mico2", {effects::MakeSpec("rotor_inertia", {"joint_1", "joint_2"}),
                                                   effects::MakeSpec("actuator_lag", {"joint_3"})});
  VectorXd p = plant.parameters().Nominal();
  SetValue(plant, "rotor_inertia.joint_1.armature", 0.3, &p);
  SetValue(plant, "force_gain.joint_2", 0.9, &p);
  SetValue(plant, "gravity.x", 0.2, &p);
  const auto exported = ExportUrdf(plant, p);
  ASSERT_TRUE(exported.ok());
  ASSERT_EQ(exported->left_out.size(), 3u) << "gravity, the gain, the rotor; a lag of 0 says nothing";
  EXPECT_NE(exported->left_out[0].find("gravity"), std::string::npos);
  EXPECT_NE(exported->left_out[1].find("joint_2 0.9"), std::string::npos);
  EXPECT_EQ(exported->left_out[2], "rotor_inertia (joint_1, joint_2): no place in URDF; left out");
}

TEST(ExportUrdf, SaysThatTheRotorOfABareFlangeHasNoPlace) {
  const std::string urdf = R"(<robot name="r"><link name="base"/><link name="arm"><inertial><mass value="2"/>
      <inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link><link name="flange"/>
    <joint name="slide" type="prismatic"><parent link="base"/><child link="arm"/><axis xyz="1 0 0"/>
      <limit lower="-1" upper="1" effort="9" velocity="1"/></joint>
    <joint name="wrist" type="continuous"><parent link="arm"/><child link="flange"/><axis xyz="0 0 1"/></joint></robot>)";
  auto model = model::ParseUrdf(urdf, "r.urdf", {});
  ASSERT_TRUE(model.ok()) << model.status().ToString();
  const Plant plant = Plant::Create(std::make_shared<const model::RobotModel>(std::move(model).value())).value();
  VectorXd p = plant.parameters().Nominal();
  SetValue(plant, "armature.wrist", 0.004, &p);
  const auto exported = ExportUrdf(plant, p);
  ASSERT_TRUE(exported.ok()) << exported.status().ToString();
  ASSERT_EQ(exported->left_out.size(), 1u);
  EXPECT_EQ(exported->left_out[0].find("armature.wrist 0.004 kg*m^2: no place in URDF"), 0u) << exported->left_out[0];
}

TEST(ExportUrdf, SpellsNumbersAsEveryReaderTakesThem) {
  const std::string urdf = "<robot name=\"r\"><link name=\"base\"/><link name=\"arm\"><inertial><origin xyz=\" .1\t+0\n3. \"/>"
                           "<mass value=\"+2.5E+0\"/><inertia ixx=\".1\" iyy=\"1.e-1\" izz=\"+.1\" ixy=\"-.0\" ixz=\"0.\" iyz=\"0\"/>"
                           "</inertial></link><joint name=\"hinge\" type=\"revolute\"><parent link=\"base\"/><child link=\"arm\"/>"
                           "<origin xyz=\"+1 .5\n0\" rpy=\"0.\t0 0\"/><axis xyz=\"0 0 +1\"/>"
                           "<limit lower=\"-1.\" upper=\"+1e0\" effort=\"4e1\" velocity=\".5\"/></joint></robot>";
  auto model = model::ParseUrdf(urdf, "r.urdf", {});
  ASSERT_TRUE(model.ok()) << model.status().ToString();
  const Plant plant = Plant::Create(std::make_shared<const model::RobotModel>(std::move(model).value())).value();
  const auto exported = ExportUrdf(plant, plant.parameters().Nominal());
  ASSERT_TRUE(exported.ok()) << exported.status().ToString();
  for (const char* plain : {"xyz=\"0.1 0 3\"", "value=\"2.5\"", "xyz=\"1 0.5 0\"", "rpy=\"0 0 0\"", "xyz=\"0 0 1\"",
                            "lower=\"-1\"", "upper=\"1\"", "effort=\"40\"", "velocity=\"0.5\""})
    EXPECT_NE(exported->text.find(plain), std::string::npos) << plain << " in\n" << exported->text;
}

TEST(ExportUrdf, AnInertialTurnedByAQuaternionGoesOutAlongTheLinksAxes) {
  const std::string urdf = "<robot name=\"r\"><link name=\"base\"/><link name=\"arm\"><inertial>"
                           "<origin xyz=\"0 0 1\" quat_xyzw=\"0 0 0.70710678118654752 0.70710678118654752\"/><mass value=\"2\"/>"
                           "<inertia ixx=\"1\" iyy=\"2\" izz=\"2.5\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial></link>"
                           "<joint name=\"hinge\" type=\"continuous\"><parent link=\"base\"/><child link=\"arm\"/></joint></robot>";
  auto model = model::ParseUrdf(urdf, "r.urdf", {});
  ASSERT_TRUE(model.ok()) << model.status().ToString();
  const Plant plant = Plant::Create(std::make_shared<const model::RobotModel>(std::move(model).value())).value();
  const auto exported = ExportUrdf(plant, plant.parameters().Nominal());
  ASSERT_TRUE(exported.ok()) << exported.status().ToString();
  const auto back = model::ParseUrdf(exported->text, "back.urdf", {});
  ASSERT_TRUE(back.ok()) << back.status().ToString();
  EXPECT_LT((back->link(1).parameters - plant.model().link(1).parameters).norm(), 1e-12);
}

TEST(ExportUrdf, RefusesANegativeMassByName) {
  const Plant plant = testing::MakePlant("arm2");
  VectorXd p = plant.parameters().Nominal();
  const int mass = plant.parameters().OfKind(ParameterKind::kMass).back();
  p[mass] = -0.5;
  const auto exported = ExportUrdf(plant, p);
  ASSERT_FALSE(exported.ok());
  EXPECT_NE(exported.status().message().find(plant.parameters()[mass].name), std::string::npos);
}

// ---- MJCF ----

struct Mjcf {
  explicit Mjcf(const std::string& text) {
    document.Parse(text.c_str());
    RG_CHECK(!document.Error()) << document.ErrorDesc();
  }
  const TiXmlElement* Root() const { return document.RootElement(); }
  static const TiXmlElement* Find(const TiXmlElement* from, const std::string& tag, const std::string& name) {
    for (const TiXmlElement* e = from->FirstChildElement(); e != nullptr; e = e->NextSiblingElement()) {
      const char* called = e->Attribute("name");
      if (e->ValueStr() == tag && called != nullptr && name == called) return e;
      if (const TiXmlElement* below = Find(e, tag, name)) return below;
    }
    return nullptr;
  }
  TiXmlDocument document;
};

std::vector<double> Numbers(const TiXmlElement* element, const char* attribute) {
  const char* text = element->Attribute(attribute);
  std::vector<double> values;
  std::istringstream in(text != nullptr ? text : "");
  for (double value; in >> value;) values.push_back(value);
  return values;
}
double Number(const TiXmlElement* element, const char* attribute) {
  const auto values = Numbers(element, attribute);
  return values.size() == 1 ? values[0] : std::nan("");
}

Plant WithDrives() {
  return testing::MakePlant(
      "mico2",
      {effects::MakeSpec("rotor_inertia", Joints()), effects::MakeSpec("viscous_friction", Joints()),
       effects::MakeSpec("stribeck_friction", {"joint_1"}), effects::MakeSpec("actuator_lag", Joints()),
       effects::MakeSpec("torque_gain", {"joint_2"}), effects::MakeSpec("torque_saturation", {"joint_2"}),
       effects::MakeSpec("position_spring", {"joint_3"}), effects::MakeSpec("gravity_misalignment"),
       effects::MakeSpec("backlash", {"joint_4"})});
}

VectorXd DriveValues(const Plant& plant) {
  VectorXd p = Moved(plant);
  for (int j = 0; j < 6; ++j) {
    const std::string& name = plant.joint_names()[static_cast<size_t>(j)];
    SetValue(plant, "rotor_inertia." + name + ".armature", 0.1 + 0.01 * j, &p);
    SetValue(plant, "viscous_friction." + name + ".viscous", 5.0 + j, &p);
    SetValue(plant, "actuator_lag." + name + ".time_constant", 0.02 + 0.001 * j, &p);
    SetValue(plant, "force_gain." + name, 1.0 - 0.02 * j, &p);
  }
  SetValue(plant, "stribeck_friction.joint_1.coulomb", 0.6, &p);
  SetValue(plant, "stribeck_friction.joint_1.static", 0.8, &p);
  SetValue(plant, "torque_gain.joint_2.gain", 0.5, &p);
  SetValue(plant, "torque_saturation.joint_2.limit", 9.0, &p);
  SetValue(plant, "position_spring.joint_3.stiffness", 4.0, &p);
  SetValue(plant, "position_spring.joint_3.center", 3.0, &p);
  SetValue(plant, "gravity_misalignment.*.tilt", 0.1, &p);
  SetValue(plant, "backlash.joint_4.gap", 0.02, &p);
  return p;
}

TEST(ExportMjcf, HoldsEveryFigureOfLinksJointsAndDrives) {
  const Plant plant = WithDrives();
  const VectorXd p = DriveValues(plant);
  const auto value = [&](const std::string& name) { return p[plant.parameters().Find(name)]; };
  const auto exported = ExportMjcf(plant, p, 0.002);
  ASSERT_TRUE(exported.ok()) << exported.status().ToString();
  const Mjcf mjcf(exported->text);
  const TiXmlElement* option = mjcf.Root()->FirstChildElement("option");
  EXPECT_EQ(Number(option, "timestep"), 0.002);
  const auto gravity = Numbers(option, "gravity");
  EXPECT_NEAR(gravity[0], 9.81 * std::sin(0.1), 1e-12);
  EXPECT_NEAR(gravity[2], -9.81 * std::cos(0.1), 1e-12);

  EXPECT_EQ(Mjcf::Find(mjcf.Root(), "body", "world"), nullptr) << "MuJoCo's own name";
  for (const model::Link& link : plant.model().links()) {
    if (link.name == "world") continue;
    const TiXmlElement* body = Mjcf::Find(mjcf.Root(), "body", link.name);
    ASSERT_NE(body, nullptr) << link.name;
    const TiXmlElement* inertial = body->FirstChildElement("inertial");
    if (value("mass." + link.name) == 0) {
      EXPECT_EQ(inertial, nullptr) << link.name;
      continue;
    }
    EXPECT_EQ(Number(inertial, "mass"), value("mass." + link.name));
    const auto com = Numbers(inertial, "pos"), inertia = Numbers(inertial, "fullinertia");
    for (int i = 0; i < 3; ++i) EXPECT_EQ(com[i], value("com_" + std::string(1, "xyz"[i]) + "." + link.name));
    const char* const axes[] = {"xx", "yy", "zz", "xy", "xz", "yz"};
    for (int i = 0; i < 6; ++i)
      EXPECT_EQ(inertia[i], value("inertia_" + std::string(axes[i]) + "." + link.name));
  }
  for (int j = 0; j < 6; ++j) {
    const std::string& name = plant.joint_names()[static_cast<size_t>(j)];
    const TiXmlElement* joint = Mjcf::Find(mjcf.Root(), "joint", name);
    ASSERT_NE(joint, nullptr);
    EXPECT_NEAR(Number(joint, "damping"), value("damping." + name) + 5.0 + j, 1e-12);
    EXPECT_NEAR(Number(joint, "frictionloss"), value("friction." + name) + (j == 0 ? 0.6 : 0.0), 1e-12);
    EXPECT_EQ(Number(joint, "armature"), 0.1 + 0.01 * j);
    const TiXmlElement* drive = Mjcf::Find(mjcf.Root(), "general", name);
    ASSERT_NE(drive, nullptr);
    EXPECT_NEAR(Number(drive, "gainprm"), (1.0 - 0.02 * j) * (j == 1 ? 0.5 : 1.0), 1e-12);
    EXPECT_STREQ(drive->Attribute("dyntype"), "filterexact");
    EXPECT_EQ(Number(drive, "dynprm"), 0.02 + 0.001 * j);
    EXPECT_EQ(Numbers(drive, "forcerange")[1], plant.model().joint(j).effort);
  }
  EXPECT_NEAR(Numbers(Mjcf::Find(mjcf.Root(), "general", "joint_2"), "ctrlrange")[1], 9.0 / 0.49, 1e-12);
  EXPECT_EQ(Number(Mjcf::Find(mjcf.Root(), "joint", "joint_3"), "stiffness"), 4.0);
  EXPECT_EQ(Number(Mjcf::Find(mjcf.Root(), "joint", "joint_3"), "springref"), 3.0);
  std::vector<std::string> effects;  // the moved inertias are not all such as a body can have
  for (const std::string& line : exported->left_out) {
    if (line.rfind("inertia", 0) != 0) effects.push_back(line);
  }
  ASSERT_EQ(effects.size(), 3u);
  EXPECT_EQ(effects[0].rfind("stribeck_friction (joint_1): only its Coulomb level", 0), 0u);
  EXPECT_EQ(effects[1].rfind("position_spring (joint_3)", 0), 0u);
  EXPECT_EQ(effects[2], "backlash (joint_4): no place in MJCF; left out");
}

// Pose of `body` in the world by MuJoCo's rules: pos and quat of each body, then its joint about its axis.
bool PoseOf(const TiXmlElement* at, const std::string& name, const std::map<std::string, double>& q,
            const Eigen::Isometry3d& X_WP, Eigen::Isometry3d* X_WB) {
  for (const TiXmlElement* body = at->FirstChildElement("body"); body != nullptr;
       body = body->NextSiblingElement("body")) {
    const auto pos = Numbers(body, "pos"), quat = Numbers(body, "quat");
    Eigen::Isometry3d X = X_WP;
    X.translate(Eigen::Vector3d(pos[0], pos[1], pos[2]));
    X.rotate(Eigen::Quaterniond(quat[0], quat[1], quat[2], quat[3]));
    if (const TiXmlElement* joint = body->FirstChildElement("joint")) {
      const auto axis = Numbers(joint, "axis");
      const Eigen::Vector3d z(axis[0], axis[1], axis[2]);
      const double position = q.at(joint->Attribute("name"));
      if (std::string(joint->Attribute("type")) == "hinge") {
        X.rotate(Eigen::AngleAxisd(position, z));
      } else {
        X.translate(position * z);
      }
    }
    if (name == body->Attribute("name")) return *X_WB = X, true;
    if (PoseOf(body, name, q, X, X_WB)) return true;
  }
  return false;
}

TEST(ExportMjcf, BodiesStandWhereTheModelHasTheirLinks) {
  for (const char* robot : {"mico2", "arm7", "slide"}) {
    const Plant plant = testing::MakePlant(robot);
    const auto exported = ExportMjcf(plant, plant.parameters().Nominal());
    ASSERT_TRUE(exported.ok()) << exported.status().ToString();
    const Mjcf mjcf(exported->text);
    dynamics::Mechanism mechanism(plant.model());
    dynamics::Workspace w;
    Rng rng(3);
    const VectorXd q = Random(rng, plant.num_joints(), 1.5);
    std::map<std::string, double> by_name;
    for (int j = 0; j < plant.num_joints(); ++j) by_name[plant.joint_names()[static_cast<size_t>(j)]] = q[j];
    for (const model::Link& link : plant.model().links()) {
      if (link.name == "world") continue;
      const model::Pose ours = dynamics::FramePose(mechanism, w, q, {link.body, link.X_BL});
      Eigen::Isometry3d theirs;
      ASSERT_TRUE(PoseOf(mjcf.Root()->FirstChildElement("worldbody"), link.name, by_name,
                         Eigen::Isometry3d::Identity(), &theirs))
          << robot << " " << link.name;
      EXPECT_LT((theirs.translation() - ours.translation).norm(), 1e-12) << robot << " " << link.name;
      EXPECT_LT((theirs.linear() - ours.rotation).norm(), 1e-12) << robot << " " << link.name;
    }
  }
}

// A finger that closes against its fellow: the mimic is a joint of its own, tied to its driver.
TEST(ExportMjcf, AMimicIsAJointThatAnEqualityTiesToItsDriver) {
  const std::string finger = R"(<inertial><origin xyz="0 0 .1"/><mass value=".2"/>
      <inertia ixx="1e-3" iyy="1e-3" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial>)";
  const std::string urdf = R"(<robot name="hand"><link name="palm"/><link name="left">)" + finger +
                           R"(</link><link name="right">)" + finger + R"(</link>
    <joint name="drive" type="revolute"><parent link="palm"/><child link="left"/><origin xyz="0 .05 0"/>
      <axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="5" velocity="3"/></joint>
    <joint name="mimic" type="revolute"><parent link="palm"/><child link="right"/><origin xyz="0 -.05 0"/>
      <axis xyz="1 0 0"/><limit lower="-2" upper="2" effort="5" velocity="3"/>
      <dynamics damping=".02" friction=".01"/><mimic joint="drive" multiplier="-1.5" offset=".2"/></joint></robot>)";
  auto model = model::ParseUrdf(urdf, "hand.urdf", {});
  ASSERT_TRUE(model.ok()) << model.status().ToString();
  const Plant plant = Plant::Create(std::make_shared<const model::RobotModel>(std::move(model).value())).value();
  const auto exported = ExportMjcf(plant, plant.parameters().Nominal());
  ASSERT_TRUE(exported.ok()) << exported.status().ToString();
  const Mjcf mjcf(exported->text);
  const TiXmlElement* tie = mjcf.Root()->FirstChildElement("equality")->FirstChildElement("joint");
  EXPECT_STREQ(tie->Attribute("joint1"), "mimic");
  EXPECT_STREQ(tie->Attribute("joint2"), "drive");
  EXPECT_EQ(Numbers(tie, "polycoef"), (std::vector<double>{0.2, -1.5, 0, 0, 0}));
  const TiXmlElement* joint = Mjcf::Find(mjcf.Root(), "joint", "mimic");
  ASSERT_NE(joint, nullptr);
  EXPECT_EQ(Number(joint, "damping"), 0.02);
  EXPECT_EQ(Number(joint, "frictionloss"), 0.01);
  EXPECT_EQ(Mjcf::Find(mjcf.Root()->FirstChildElement("actuator"), "general", "mimic"), nullptr);
  dynamics::Mechanism mechanism(plant.model());
  dynamics::Workspace w;
  const VectorXd q = VectorXd::Constant(1, 0.3);
  for (const model::Link& link : plant.model().links()) {
    const model::Pose ours = dynamics::FramePose(mechanism, w, q, {link.body, link.X_BL});
    Eigen::Isometry3d theirs;
    ASSERT_TRUE(PoseOf(mjcf.Root()->FirstChildElement("worldbody"), link.name, {{"drive", 0.3}, {"mimic", 0.2 - 1.5 * 0.3}},
                       Eigen::Isometry3d::Identity(), &theirs));
    EXPECT_LT((theirs.translation() - ours.translation).norm(), 1e-12) << link.name;
    EXPECT_LT((theirs.linear() - ours.rotation).norm(), 1e-12) << link.name;
  }
  EXPECT_NE(exported->left_out.back().find("joint mimic: mimics drive"), std::string::npos);
}

TEST(ExportMjcf, NamesAnInertiaThatMuJoCoWouldRefuse) {
  const Plant plant = testing::MakePlant("mico2");
  VectorXd p = plant.parameters().Nominal();
  SetValue(plant, "inertia_zz.link_3", 1.0, &p);
  const auto exported = ExportMjcf(plant, p);
  ASSERT_TRUE(exported.ok());
  ASSERT_EQ(exported->left_out.size(), 1u);
  EXPECT_NE(exported->left_out[0].find("inertia of link_3"), std::string::npos);
}

TEST(ExportMjcf, RefusesANegativeDampingByName) {
  const Plant plant = testing::MakePlant("pendulum");
  VectorXd p = plant.parameters().Nominal();
  p[plant.parameters().OfKind(ParameterKind::kDamping).front()] = -1;
  const auto exported = ExportMjcf(plant, p);
  ASSERT_FALSE(exported.ok());
  EXPECT_NE(exported.status().message().find("damping -1"), std::string::npos);
}

}  // namespace
}  // namespace rg::sim
