// An effect that its sibling stands for as well, told apart by the motion that the diagnosis proposes: on the
// simulated robot, through coordinator and agent. The drive of the elbow lags by 10 ms; slow swings do not
// show whether it lags or waits.
#include <cmath>
#include <nlohmann/json.hpp>

#include "tests/integration/cli/small_robot.h"

namespace rg {
namespace {

using nlohmann::json;

// The elbow swings about 0.5 rad by 0.3 rad at 0.3 rad/s, with soft reversals.
std::string SlowSwings() {
  constexpr double kSpeed = 0.3, kPeriod = 4.0, kSoft = 0.4, kDuration = 6.0;
  std::string csv = "time,position.shoulder,position.elbow,velocity.shoulder,velocity.elbow\n";
  double q = 0.5, before = 0;
  for (int k = 0; k <= 300; ++k) {
    const double t = 0.02 * k, w = 2 * M_PI / kPeriod;
    const double ends = std::min({1.0, t / 0.5, (kDuration - t) / 0.5});
    const double v = kSpeed * ends * std::tanh(std::sin(w * t) / (w * kSoft));
    q += 0.5 * 0.02 * (v + before), before = v;
    csv += std::to_string(t) + ",0.4," + std::to_string(q) + ",0," + std::to_string(v) + "\n";
  }
  return csv;
}

TEST(SeparatingMotion, TellsALagFromADelayThatSlowSwingsCannot) {
  const ScratchFolder scratch;
  WriteSmallRobot(
      scratch,
      {{{"effect", "actuator_lag"}, {"joints", {"elbow"}}, {"parameters", {{"time_constant", 0.01}}}}}, 0.0,
      1000);
  ASSERT_TRUE(WriteFileAtomically(scratch / "swings.csv", SlowSwings()).ok());
  const std::string address = "ipc://" + (scratch / "c.sock");
  const Background coordinator(scratch, "realitygrad-coordinator", "--listen " + address + " --db c.db");
  const Background agent(
      scratch, "realitygrad-agent",
      "--coordinator " + address + " --config small_agent.json --spool spool --folder w --lock-step");
  const auto play = [&](const std::string& motion, const std::string& out) {
    const Said said = RunProgram(scratch, "--coordinator " + address +
                                              " submit rollout --robot ./small.robot.json --model nominal "
                                              "--timeout 60 --trajectory " +
                                              motion + " --out " + out);
    ASSERT_EQ(said.code, 0) << said.err;
  };
  const auto diagnose = [&](const std::string& sets, const std::string& out) {
    const Said said = RunProgram(scratch, "diagnose " + sets + " --threads 2 --out " + out);
    EXPECT_EQ(said.code, 0) << said.err;
    return said;
  };
  const auto first_finding = [&](const std::string& out) {
    return json::parse(ReadFile(scratch / (out + "/diagnosis.json")).value())["findings"][0];
  };

  play("swings.csv", "swings");
  const Said before = diagnose("swings", "before");
  const json open = first_finding("before");
  ASSERT_EQ(open["class"].size(), 2u) << open.dump(1);
  for (const char* sibling : {"actuator_lag", "actuator_delay"})
    EXPECT_NE(open["class"].dump().find(sibling), std::string::npos) << open["class"];
  EXPECT_NE(before.out.find("cannot be told from"), std::string::npos) << before.out;
  EXPECT_NE(before.out.find("submit rollout --trajectory before/motion.csv"), std::string::npos)
      << before.out;
  EXPECT_NE(open["alternatives"][0]["experiment"].dump().find("elbow"), std::string::npos);
  const json motion = json::parse(ReadFile(scratch / "before/diagnosis.json").value())["motion"];
  EXPECT_GT(motion["expected_nats"], 10.0);

  play("before/motion.csv", "more");
  diagnose("swings more", "after");
  const json found = first_finding("after");
  EXPECT_EQ(found["effect"], "actuator_lag");
  EXPECT_EQ(found["class"], json({"actuator_lag"})) << found.dump(1);
  EXPECT_NEAR(found["parameters"]["elbow"]["time_constant"]["value"], 0.01, 0.0015);
  EXPECT_FALSE(std::filesystem::exists(scratch / "after/motion.csv"));
  EXPECT_NE(ReadFile(scratch / "before/report.html").value().find("motion.csv"), std::string::npos);
}

}  // namespace
}  // namespace rg
