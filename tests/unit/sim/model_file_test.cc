#include "common/sim/model_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "common/sim/simulator.h"
#include "tests/support/sim/plants.h"

namespace rg::sim {
namespace {

using effects::MakeSpec;
using ::testing::HasSubstr;

Plant WithEffects() {
  auto elastic = MakeSpec("joint_elasticity", {"elbow"}, {{"stiffness", 900.0}});
  elastic.options["sensor"] = "motor";
  PlantOptions options;
  options.gravity = {0.1, 0.0, -9.8};
  return rg::testing::MakePlant("arm2",
                                {MakeSpec("coulomb_friction", {"shoulder", "elbow"}, {{"coulomb", 0.4}}),
                                 elastic, MakeSpec("payload", {}, {{"mass", 0.7}})},
                                options);
}

TEST(ModelFile, ReadsBackTheSameModel) {
  const Plant plant = WithEffects();
  Eigen::VectorXd values = plant.parameters().Nominal();
  values[plant.parameters().Find("mass.forearm")] = 1.2345678901234567;
  values[plant.parameters().Find("coulomb_friction.elbow.coulomb")] = -0.01;  // where an unbounded fit went
  const auto file = ModelFromJson(ModelToJson(plant, values, 7), "model.json");
  ASSERT_TRUE(file.ok()) << file.status().ToString();
  EXPECT_EQ(file->version, 7);
  ASSERT_EQ(file->values.size(), values.size());
  EXPECT_EQ(file->values, values);
  for (int i = 0; i < values.size(); ++i) {
    EXPECT_EQ(file->plant.parameters()[i].name, plant.parameters()[i].name);
  }
  EXPECT_EQ(file->plant.internal_state_names(), plant.internal_state_names());
  EXPECT_EQ(file->plant.options().gravity, plant.options().gravity);
  EXPECT_EQ(file->plant.effects()[1].options.at("sensor"), "motor");

  Simulator a(plant), b(file->plant);
  a.SetParameters(values);
  b.SetParameters(file->values);
  const Eigen::Vector2d q(0.3, -0.5), v(0.1, 0.2);
  const auto command = CommandSignal::Constant(Eigen::Vector2d(1.0, 0.5));
  EXPECT_EQ(a.Simulate(a.MakeState(q, v), command, {0.2}).state,
            b.Simulate(b.MakeState(q, v), command, {0.2}).state);
}

TEST(ModelFile, KeepsTheFormOfACoupling) {
  auto wrist = MakeSpec("joint_coupling", {"shoulder", "elbow"},
                        {{"coefficient", 0.9}, {"viscous", 0.2}, {"coulomb", 0.3}, {"armature", 0.04}});
  wrist.options["form"] = "kinematic";
  const Plant plant = rg::testing::MakePlant("arm2", {wrist});
  const auto file = ModelFromJson(ModelToJson(plant, plant.parameters().Nominal()), "model.json");
  ASSERT_TRUE(file.ok()) << file.status().ToString();
  EXPECT_EQ(file->values, plant.parameters().Nominal());
  ASSERT_EQ(file->plant.effects().size(), 1u);
  EXPECT_EQ(file->plant.effects()[0].options, wrist.options);
  EXPECT_EQ(file->plant.effects()[0].joints, wrist.joints);
  EXPECT_GE(file->plant.parameters().Find("joint_coupling.*.armature"), 0);
}

TEST(ModelFile, SaysWhatDrivesFollowBeforeARecording) {
  const Plant plant = WithEffects();
  const Eigen::VectorXd values = plant.parameters().Nominal();
  EXPECT_TRUE(ModelFromJson(ModelToJson(plant, values), "m.json")->held_before);
  EXPECT_FALSE(ModelFromJson(ModelToJson(plant, values, 0, false), "m.json")->held_before);
}

std::string Refusal(const std::function<void(nlohmann::json&)>& change) {
  const Plant plant = WithEffects();
  auto root = nlohmann::json::parse(ModelToJson(plant, plant.parameters().Nominal()));
  change(root);
  const auto file = ModelFromJson(root.dump(), "m.json");
  EXPECT_FALSE(file.ok());
  return file.ok() ? "" : file.status().message();
}

TEST(ModelFile, NamesFileAndFieldOfWhatIsWrong) {
  EXPECT_THAT(Refusal([](auto& m) { m["format"] = "realitygrad.model/9"; }), HasSubstr("m.json: format"));
  EXPECT_THAT(Refusal([](auto& m) { m.erase("urdf"); }), HasSubstr("m.json: urdf is missing"));
  EXPECT_THAT(Refusal([](auto& m) { m["urdf"] = "<robot"; }), HasSubstr("m.json"));
  EXPECT_THAT(Refusal([](auto& m) { m["joints"] = 3; }), HasSubstr("m.json: joints"));
  EXPECT_THAT(Refusal([](auto& m) { m["gravity"] = {1, 2}; }), HasSubstr("m.json: gravity"));
  EXPECT_THAT(Refusal([](auto& m) { m["effects"][0]["effect"] = "magic"; }), HasSubstr("magic"));
  EXPECT_THAT(Refusal([](auto& m) { m["effects"][0]["joints"] = {"wrist"}; }),
              HasSubstr("m.json: effect coulomb_friction"));
  EXPECT_THAT(Refusal([](auto& m) { m["effects"][1]["parameters"]["elbow"]["stiffness"] = "soft"; }),
              HasSubstr("m.json: effects[1].parameters: elbow.stiffness"));
  EXPECT_THAT(Refusal([](auto& m) { m["parameters"]["mass.forarm"] = 1.0; }),
              HasSubstr("closest is mass.forearm"));
  EXPECT_THAT(ModelFromJson("{", "m.json").status().message(), HasSubstr("m.json: not valid JSON"));
}

}  // namespace
}  // namespace rg::sim
