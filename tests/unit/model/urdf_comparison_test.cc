#include "common/model/urdf_comparison.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>

#include "common/model/urdf_loader.h"
#include "tests/support/model/urdf_text.h"

namespace rg::model {
namespace {

using testing_support::JointXml;
using testing_support::LinkXml;
using testing_support::MimicXml;
using testing_support::RobotXml;

RobotModel::Parts PartsOf(const RobotModel& model) {
  RobotModel::Parts parts;
  parts.name = model.name();
  parts.urdf_text = model.urdf_text();
  parts.locked = model.locked();
  parts.joints = model.joints();
  parts.followers = model.followers();
  parts.links = model.links();
  parts.end_effector = model.FindLink(model.end_effector().name);
  return parts;
}

RobotModel Example() {
  const std::string turned =
      R"(<inertial><origin xyz="+.1 0 0" rpy=".3 .2 -1"/><mass value="2"/>
         <inertia ixx="1" iyy="2" izz="2.5" ixy=".1" ixz="0" iyz="0"/></inertial>)";
  const std::string in_joint =
      R"(<origin xyz="0 .4 0" rpy="1 2 3"/><axis xyz="0 3 4"/><limit lower="-2" upper="3" effort="5" velocity="6"/>
         <dynamics damping=".7" friction=".8"/>)";
  const std::string xml = RobotXml(
      LinkXml("base", "") + LinkXml("arm", turned) + LinkXml("tool") + LinkXml("finger") + LinkXml("thumb") +
      JointXml("j", "revolute", "base", "arm", in_joint) +
      JointXml("held", "revolute", "arm", "tool", in_joint) +
      JointXml("f", "revolute", "tool", "finger", in_joint) +
      JointXml("t", "prismatic", "tool", "thumb", in_joint + MimicXml("f", "multiplier='2' offset='.1'")));
  auto model = ParseUrdf(xml, "a.urdf", {.joints = {}, .locked = {{"held", 0.6}}, .end_effector = ""});
  RG_CHECK(model.ok()) << model.status().message();
  return std::move(model).value();
}

struct Damage {
  const char* name;
  std::function<void(RobotModel::Parts&)> apply;
  std::string message;
};

class DamagedModel : public testing::TestWithParam<Damage> {};

TEST_P(DamagedModel, DiffersFromItsDocument) {
  RobotModel::Parts parts = PartsOf(Example());
  GetParam().apply(parts);
  const Status status = CompareWithDocument(RobotModel(parts), "a.urdf");
  EXPECT_EQ(status.code(), StatusCode::kInternal);
  EXPECT_THAT(status.message(), testing::StartsWith("a.urdf: " + GetParam().message));
  EXPECT_THAT(status.message(), testing::EndsWith(" (a bug of this program: please report it)"));
}

using Parts = RobotModel::Parts;

INSTANTIATE_TEST_SUITE_P(Each, DamagedModel,
                         testing::ValuesIn(std::vector<Damage>{
                             {"Mass", [](Parts& p) { p.links[1].parameters[0] = 0.0; },
                              "link 'arm': <mass value>: the document has 2, the model 0"},
                             {"Com", [](Parts& p) { p.links[1].parameters[1] = 0.0; },
                              "link 'arm': <origin xyz>: the document has 0.1 0 0, the model 0 0 0"},
                             {"Inertia", [](Parts& p) { p.links[1].parameters[4] *= 1.0 + 1e-9; },
                              "link 'arm': <inertia ixx>: the document has 1, the model 1.0000000"},
                             {"InertialLost",
                              [](Parts& p) {
                                p.links[1].has_inertial = false;
                                p.links[1].parameters.setZero();
                              },
                              "link 'arm': <inertial> is in the document, but not in the model"},
                             {"InertialFromNowhere", [](Parts& p) { p.links[0].has_inertial = true; },
                              "link 'base': <inertial> is not in the document, but in the model"},
                             {"MassFromNowhere", [](Parts& p) { p.links[0].parameters[0] = 1.0; },
                              "link 'base': <mass value>: the document has 0, the model 1"},
                             {"LinkLost", [](Parts& p) { p.links[0].name = "socket"; },
                              "link 'base': is not in the model"},
                             {"JointFromNowhere", [](Parts& p) { p.joints[0].name = "k"; },
                              "joint 'j': stands, but its links are in different bodies"},
                             {"JointOrigin", [](Parts& p) { p.joints[0].X_PB.translation[0] += 1e-6; },
                              "joint 'j': <origin xyz>: the document has 0 0.4 0, the model 1"},
                             {"JointTurn", [](Parts& p) { p.joints[0].X_PB.rotation.rightCols<2>() *= -1.0; },
                              "joint 'j': <origin rpy>, column "},
                             {"StandingElsewhere", [](Parts& p) { p.locked["held"] = 0.5; },
                              "joint 'held': <origin rpy>, column "},
                             {"Axis", [](Parts& p) { p.joints[0].axis = Eigen::Vector3d(0, 0.8, 0.6); },
                              "joint 'j': <axis xyz>: the document has 0 0.6"},
                             {"Lower", [](Parts& p) { p.joints[0].lower = -3.0; },
                              "joint 'j': <limit lower>: the document has -2, the model -3"},
                             {"Upper", [](Parts& p) { p.joints[0].upper = 2.0; },
                              "joint 'j': <limit upper>: the document has 3, the model 2"},
                             {"Effort", [](Parts& p) { p.joints[0].effort = 4.0; },
                              "joint 'j': <limit effort>: the document has 5, the model 4"},
                             {"Velocity", [](Parts& p) { p.joints[0].velocity = 7.0; },
                              "joint 'j': <limit velocity>: the document has 6, the model 7"},
                             {"Damping", [](Parts& p) { p.joints[0].damping = 0.0; },
                              "joint 'j': <dynamics damping>: the document has 0.7, the model 0"},
                             {"Friction", [](Parts& p) { p.joints[0].friction = 0.0; },
                              "joint 'j': <dynamics friction>: the document has 0.8, the model 0"},
                             {"Multiplier", [](Parts& p) { p.followers[0].multiplier = 1.0; },
                              "joint 't': <mimic multiplier>: the document has 2, the model 1"},
                             {"Offset", [](Parts& p) { p.followers[0].offset = 0.0; },
                              "joint 't': <mimic offset>: the document has 0.1, the model 0"},
                             {"Driver", [](Parts& p) { p.followers[0].driver = 0; },
                              "joint 't': <mimic joint>: follows another joint"},
                         }),
                         [](const auto& info) { return std::string(info.param.name); });

TEST(UrdfComparison, TheUndamagedModelIsItsDocument) {
  const Status status = CompareWithDocument(RobotModel(PartsOf(Example())), "a.urdf");
  EXPECT_TRUE(status.ok()) << status.message();
}

// ParseUrdf compares each time; these documents make all of it matter.
TEST(UrdfComparison, RandomRobotsAreTheirDocuments) {
  int loaded = 0, followers = 0, standing = 0;
  for (uint64_t seed = 0; seed < 500; ++seed) {
    Rng rng(seed);
    const std::string text = testing_support::RandomUrdf(rng.Split(0), true).Text();
    LoadOptions options;
    for (const char* name : {"j1", "j2", "j3"}) {
      if (text.find("\"" + std::string(name) + "\" type=\"fixed\"") == std::string::npos &&
          text.find("\"" + std::string(name) + "\" type") != std::string::npos && rng.Index(3) == 0) {
        options.locked[name] = rng.Uniform(-2.0, 2.0);
      }
    }
    const auto model = ParseUrdf(text, "random.urdf", options);
    if (!model.ok()) {
      EXPECT_THAT(model.status().message(),
                  testing::AnyOf("random.urdf: no joint is left to move",
                                 testing::StartsWith("random.urdf: nothing that moves has mass")));
      continue;
    }
    ++loaded;
    followers += static_cast<int>(model->followers().size());
    for (const std::string& line : model->warnings())
      standing += line.find(" stands at ") != std::string::npos;
  }
  EXPECT_GT(loaded, 400);
  EXPECT_GT(followers, 50);
  EXPECT_GT(standing, 50);
}

}  // namespace
}  // namespace rg::model
