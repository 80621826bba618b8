// Topics with clocks of their own in one log: one time base, commands held and never invented.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "common/base/file.h"
#include "common/base/ids.h"
#include "common/recordings/recording_set.h"
#include "services/importing/import.h"
#include "tests/support/importing/log_writers.h"

namespace rg::importing {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::Contains;
using ::testing::HasSubstr;

constexpr const char* kOneJoint = R"(<robot name="one"><link name="base"/>
<link name="rod"><inertial><origin xyz="0 0 0.1"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="pivot" type="continuous"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/></joint></robot>)";

constexpr const char* kMap = R"({"format": "realitygrad.import_map/1", "columns": [
 {"topic": "/joint_states", "field": "position[*]", "joint": "*", "column": "position", "clock": "header"},
 {"topic": "/commands", "field": "effort[*]", "joint": "*", "column": "effort_command", "clock": "header"},
 {"topic": "/sensor", "field": "data[0]", "joint": "pivot", "column": "torque_sensor", "clock": "log"}]})";

constexpr int64_t kStart = 1'700'000'000'000'000'000, kMs = 1'000'000;
constexpr int64_t kAhead = 3'200 * kMs;  // of the host that commands, before the other's clock
constexpr int64_t kLatency = 1 * kMs;    // of every message on its way to the log
constexpr int kCommands = 500;

double Position(double t) { return 0.5 * std::sin(2 * t); }
double Sensor(double t) { return 3 * t; }

// Positions at 100 Hz, commands of another host at 125 Hz that begin and end within them, one second of them
// lost; a sensor without stamps at 50 Hz.
std::vector<test::LoggedMessage> Messages() {
  std::vector<test::LoggedMessage> messages;
  for (int64_t k = 0; k < 500; ++k) {
    const int64_t ns = kStart + k * 10 * kMs;
    messages.push_back(
        {"/joint_states", "sensor_msgs/JointState", ns + kLatency,
         test::CdrJointState({ns, {"pivot"}, {Position(0.01 * static_cast<double>(k))}, {}, {}})});
  }
  for (int64_t k = 0; k < kCommands; ++k) {
    if (k >= 250 && k < 375) continue;
    const int64_t ns = kStart + 203 * kMs + k * 8 * kMs;
    messages.push_back({"/commands", "sensor_msgs/JointState", ns + kLatency,
                        test::CdrJointState({ns + kAhead, {"pivot"}, {}, {}, {static_cast<double>(k)}})});
  }
  for (int64_t k = 0; k < 260; ++k) {
    const int64_t ns = kStart + k * 20 * kMs;
    messages.push_back({"/sensor", "std_msgs/Float64MultiArray", ns + kLatency,
                        test::CdrArray({Sensor(0.02 * static_cast<double>(k))})});
  }
  std::stable_sort(messages.begin(), messages.end(),
                   [](const auto& a, const auto& b) { return a.log_ns < b.log_ns; });
  return messages;
}

TEST(Clocks, TopicsOfThreeClocksComeToTheTimeBaseOfThePositions) {
  const fs::path folder = fs::temp_directory_path() / ("rg_clocks_" + RandomHex(6));
  fs::create_directories(folder);
  ASSERT_TRUE(WriteFileAtomically((folder / "arm.urdf").string(), kOneJoint).ok());
  ASSERT_TRUE(WriteFileAtomically((folder / "map.json").string(), kMap).ok());
  ASSERT_TRUE(WriteFileAtomically((folder / "log.mcap").string(), test::McapBytes(Messages())).ok());
  ImportOptions options;
  options.files = {(folder / "log.mcap").string()};
  options.urdf = (folder / "arm.urdf").string();
  options.map = (folder / "map.json").string();
  options.out = (folder / "set").string();
  const auto report = Import(options, {});
  ASSERT_TRUE(report.ok()) << report.status().ToString();
  EXPECT_THAT(report->notes, Contains(AllOf(HasSubstr("/commands"), HasSubstr("3.2"))));
  recordings::ReadOptions read;
  read.keep_whole = true;
  const auto set = recordings::LoadSet(options.out, read);
  ASSERT_TRUE(set.ok()) << set.status().ToString();
  const recordings::Recording& r = set->recordings[0];
  // From the first command at 0.203 s to one period and a half after the last at 4.195 s, without the lost
  // second.
  EXPECT_NEAR(r.t[0], r.t[r.rows() - 1] - 3.99, 0.02);
  int checked = 0;
  for (int k = 0; k < r.rows(); ++k) {
    const double t = 0.21 + r.t[k] - r.t[0];
    const int held = static_cast<int>(std::floor((t - 0.203) / 0.008 + 1e-6));
    ASSERT_TRUE(held < 250 || held >= 375) << "a command was invented at " << t;
    EXPECT_EQ(r.effort_command(0, k), std::min(held, kCommands - 1)) << t;
    EXPECT_NEAR(r.q(0, k), Position(t), 1e-6);
    EXPECT_NEAR(r.other.at("torque_sensor.pivot")[k], Sensor(t), 1e-5);
    ++checked;
  }
  EXPECT_NEAR(checked, 300, 3);
  fs::remove_all(folder);
}

}  // namespace
}  // namespace rg::importing
