#include "common/sim/plant.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <set>

#include "common/model/robot_model.h"
#include "tests/support/sim/plants.h"

namespace rg::sim {
namespace {

using effects::MakeSpec;
using rg::testing::LoadRobot;
using rg::testing::MakePlant;
using ::testing::HasSubstr;

std::string Refusal(std::vector<effects::EffectSpec> effects) {
  const auto plant = Plant::Create(LoadRobot("arm2"), {}, std::move(effects));
  EXPECT_FALSE(plant.ok());
  return plant.ok() ? "" : plant.status().message();
}

TEST(Plant, HasTheSeventyOneParametersOfThePaperOnTheMico) {
  const Plant plant = MakePlant("mico2");
  const auto indices = PaperParameters(plant);
  EXPECT_EQ(indices.size(), 71u);
  EXPECT_EQ(std::set<int>(indices.begin(), indices.end()).size(), 71u);
  EXPECT_EQ(plant.parameters()[indices[0]].name, "gravity.x");
  EXPECT_GE(plant.parameters().Find("mass.link_6"), 0);
  EXPECT_EQ(plant.parameters()[plant.parameters().Find("force_gain.joint_3")].nominal, 1.0);
}

TEST(Plant, NamesEffectParametersAfterEffectAndJoint) {
  const Plant plant = MakePlant("arm2", {MakeSpec("coulomb_friction", {"elbow"}, {{"coulomb", 0.7}}),
                                         MakeSpec("payload", {}, {{"mass", 0.5}})});
  const ParameterTable& table = plant.parameters();
  EXPECT_EQ(table[table.Find("coulomb_friction.elbow.coulomb")].nominal, 0.7);
  EXPECT_EQ(table[table.Find("payload.*.mass")].nominal, 0.5);
  EXPECT_EQ(table[table.Find("payload.*.com_x")].nominal, 0.0);
}

TEST(Plant, UsesNewtonsForPrismaticJoints) {
  const Plant plant = MakePlant("slide", {MakeSpec("coulomb_friction", {"slide", "hinge"})});
  const ParameterTable& table = plant.parameters();
  EXPECT_EQ(table[table.Find("coulomb_friction.slide.coulomb")].unit, "N");
  EXPECT_EQ(table[table.Find("coulomb_friction.hinge.coulomb")].unit, "N*m");
}

TEST(Plant, RefusesBadEffectsByName) {
  EXPECT_THAT(Refusal({MakeSpec("magic", {"elbow"})}), HasSubstr("magic"));
  EXPECT_THAT(Refusal({MakeSpec("coulomb_friction")}), HasSubstr("needs at least one joint"));
  EXPECT_THAT(Refusal({MakeSpec("coulomb_friction", {"wrist"})}), HasSubstr("no moving joint wrist"));
  EXPECT_THAT(Refusal({MakeSpec("coulomb_friction", {"elbow"}, {{"coulomb", -1}})}),
              HasSubstr("outside [0, inf]"));
  EXPECT_THAT(Refusal({MakeSpec("coulomb_friction", {"elbow"}, {{"level", 1}})}),
              HasSubstr("no parameter level"));
  EXPECT_THAT(Refusal({MakeSpec("payload", {"elbow"})}), HasSubstr("takes no joints"));
  EXPECT_THAT(Refusal({MakeSpec("coulomb_friction", {"elbow"}), MakeSpec("coulomb_friction", {"elbow"})}),
              HasSubstr("stands twice on elbow"));
  EXPECT_THAT(Refusal({MakeSpec("joint_elasticity", {"elbow"}), MakeSpec("backlash", {"elbow"})}),
              HasSubstr("already has an elastic transmission"));
  EXPECT_THAT(Refusal({MakeSpec("joint_coupling", {"elbow"})}), HasSubstr("needs two joints"));
  auto option = MakeSpec("joint_elasticity", {"elbow"});
  option.options["sensor"] = "moon";
  EXPECT_THAT(Refusal({option}), HasSubstr("option sensor cannot be moon"));
  auto wrist = MakeSpec("joint_coupling", {"shoulder", "elbow"}, {{"coefficient", 1.0}});
  wrist.options["form"] = "kinematic";
  EXPECT_THAT(Refusal({wrist, MakeSpec("joint_elasticity", {"elbow"})}),
              HasSubstr("cannot end at elbow, whose transmission is elastic"));
  EXPECT_THAT(Refusal({wrist, MakeSpec("joint_coupling", {"elbow", "shoulder"})}), HasSubstr("stands twice"));
}

TEST(Plant, CarriesValuesOverByName) {
  const Plant small = MakePlant("arm2");
  const Plant large = small.WithEffect(MakeSpec("coulomb_friction", {"elbow"}, {{"coulomb", 0.4}})).value();
  Eigen::VectorXd values = small.parameters().Nominal();
  values[small.parameters().Find("mass.forearm")] = 9.0;
  const Eigen::VectorXd moved = large.ValuesFrom(small.parameters(), values);
  EXPECT_EQ(moved[large.parameters().Find("mass.forearm")], 9.0);
  EXPECT_EQ(moved[large.parameters().Find("coulomb_friction.elbow.coulomb")], 0.4);
  EXPECT_EQ(large.WithoutEffect("coulomb_friction").parameters().size(), small.parameters().size());
}

TEST(ParameterTable, NamesTheClosestWhenANameIsWrong) {
  const Plant plant = MakePlant("arm2");
  const auto index = plant.parameters().IndexOf("mass.forarm");
  ASSERT_FALSE(index.ok());
  EXPECT_THAT(index.status().message(), HasSubstr("mass.forearm"));
}

TEST(ParameterTable, ValidateNamesTheParameterOutOfBounds) {
  const Plant plant = MakePlant("arm2");
  Eigen::VectorXd values = plant.parameters().Nominal();
  EXPECT_TRUE(plant.parameters().Validate(values).ok());
  values[plant.parameters().Find("mass.forearm")] = -1.0;
  EXPECT_THAT(plant.parameters().Validate(values).message(), HasSubstr("mass.forearm"));
}

}  // namespace
}  // namespace rg::sim
