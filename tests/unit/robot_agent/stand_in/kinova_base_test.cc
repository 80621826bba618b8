#include "robot_agent/stand_in/kinova_base.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "common/base/file.h"
#include "common/base/ids.h"

namespace rg::robot_agent::stand_in {
namespace {

using kinova::Degrees;
using nlohmann::json;
using testing::HasSubstr;

std::string RobotsFolder() { return std::string(std::getenv("RG_SOURCE_DIR")) + "/deploy/robots/"; }

Result<StandInConfig> LoadEdited(const json& edits) {
  json config = json::parse(ReadFile(RobotsFolder() + "mico2_stand_in.json").value());
  config["truth"] = std::filesystem::absolute(RobotsFolder() + config["truth"].get<std::string>());
  config.update(edits);
  const auto path = std::filesystem::temp_directory_path() / ("rg-stand-in-" + RandomHex(6) + ".json");
  EXPECT_TRUE(WriteFileAtomically(path.string(), config.dump()).ok());
  auto loaded = LoadStandInConfig(path.string());
  std::filesystem::remove(path);
  return loaded;
}

// A base and its time, s.
struct Base {
  explicit Base(const json& edits = json::object())
      : base(KinovaBase::Create(LoadEdited(edits).value(), 1).value()) {
    Wait(0.1);
  }
  void Wait(double seconds) {
    time += seconds;
    base->AdvanceTo(std::llround(1e9 * time));
  }
  // The same torques at 100 Hz.
  void Torque(const std::vector<double>& tau, double seconds) {
    for (int k = 0; k < std::lround(100 * seconds); ++k) {
      base->SendTorque(tau);
      Wait(0.01);
    }
  }
  void Upright() {
    base->MoveTo({{360}, {180}, {180}, {-360}, {0}, {0}});
    Wait(4.0);
  }
  void InTorqueMode() {
    Upright();
    base->ZeroTorques();
    base->SetTorqueMode(false);
    base->SetTorqueMode(true);
    ASSERT_TRUE(base->in_torque_mode());
  }
  std::unique_ptr<KinovaBase> base;
  double time = 0.0;
};
const json kWilling = {{"refuse_torque_mode", 0}};
const std::vector<double> kZero(6, 0.0);

TEST(KinovaBase, CountsTurns) {
  Base arm;
  EXPECT_NEAR(arm.base->Angles()[0].value, 360.0 + 0.30 * 180 / kinova::kPi, 0.2);
  EXPECT_NEAR(arm.base->Angles()[3].value, -360.0 + 0.10 * 180 / kinova::kPi, 0.2);
}

TEST(KinovaBase, RefusesTorqueModeInSilenceUntilItsSensorsAreZeroed) {
  Base arm(kWilling);
  arm.Upright();
  arm.base->SetTorqueMode(true);
  EXPECT_FALSE(arm.base->in_torque_mode());
  EXPECT_EQ(arm.base->refusals(), 1);
  arm.base->ZeroTorques();
  arm.Wait(0.1);
  for (const double torque : arm.base->Torques()) EXPECT_NEAR(torque, 0.0, 0.4);
  arm.base->SetTorqueMode(true);
  EXPECT_TRUE(arm.base->in_torque_mode());
}

TEST(KinovaBase, SensorsZeroedUnderLoadStayWrongElsewhere) {
  Base arm(kWilling);
  arm.base->MoveTo({{360}, {120}, {180}, {-360}, {0}, {0}});
  arm.Wait(6.0);
  arm.base->ZeroTorques();
  arm.Upright();
  EXPECT_GT(std::abs(arm.base->Torques()[1]), 3.0);
  arm.base->SetTorqueMode(true);
  EXPECT_FALSE(arm.base->in_torque_mode());
}

TEST(KinovaBase, ItsDeadBandSwallowsSmallTorques) {
  Base arm(kWilling);
  arm.InTorqueMode();
  const double before = arm.base->Angles()[3].value;
  arm.Torque({0, 0, 0, 0.09, 0, 0}, 0.5);
  EXPECT_NEAR(arm.base->Angles()[3].value, before, 0.2);
  arm.Torque({0, 0, 0, 0.8, 0, 0}, 0.5);
  EXPECT_GT(arm.base->Angles()[3].value, before + 2.0);
}

TEST(KinovaBase, SilenceOfAQuarterSecondEndsTheTorque) {
  Base arm(kWilling);
  arm.InTorqueMode();
  arm.Torque({0, 0, 0, 0, 0, 1.0}, 0.3);
  arm.Wait(0.5);  // the last torque for 0.25 s of it
  const double before = arm.base->Angles()[5].value;
  arm.Wait(0.5);
  EXPECT_NEAR(arm.base->Angles()[5].value, before, 0.3);
  EXPECT_TRUE(arm.base->in_torque_mode());
}

TEST(KinovaBase, FallsBackNearAStop) {
  Base arm(kWilling);
  arm.InTorqueMode();
  for (int k = 0; k < 600 && arm.base->in_torque_mode(); ++k) arm.Torque({0, 0, 12.0, 0, 0, 0}, 0.05);
  EXPECT_FALSE(arm.base->in_torque_mode());
  EXPECT_LT(arm.base->Angles()[2].value, 325.0);
}

TEST(KinovaBase, VelocitiesAreWrongByItsFactors) {
  Base arm(kWilling);
  arm.InTorqueMode();
  arm.Torque({0, 0, 0, 0, 0, 1.5}, 0.5);
  const double before = arm.base->Angles()[5].value;
  double said = 0.0;
  for (int k = 0; k < 20; ++k) {
    arm.Torque({0, 0, 0, 0, 0, 1.5}, 0.02);
    said += arm.base->Velocities()[5].value / 20;
  }
  const double true_speed = (arm.base->Angles()[5].value - before) / 0.4;
  EXPECT_NEAR(said / true_speed, 1.055, 0.03);
}

TEST(StandInConfig, RefusalsNameFileFieldAndValue) {
  const auto message = [](const json& edits) { return LoadEdited(edits).status().message(); };
  EXPECT_THAT(message({{"fault", 1}}), HasSubstr("unknown field \"fault\""));
  EXPECT_THAT(message({{"turns", {1}}}), HasSubstr("turns has 1 entries for 6 joints"));
  EXPECT_THAT(message({{"call_s", -1}}), HasSubstr("call_s is -1"));
  EXPECT_THAT(message({{"robot_type", "m"}}), HasSubstr("robot_type is \"m\""));
  const std::string honest = RobotsFolder() + "mico2_truth.json";
  const auto base = KinovaBase::Create(LoadEdited({{"truth", std::filesystem::absolute(honest)}}).value(), 1);
  EXPECT_THAT(base.status().message(), HasSubstr("gravity_compensation is none"));
}

}  // namespace
}  // namespace rg::robot_agent::stand_in
