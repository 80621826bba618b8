// Sets out to bags and back, and logs of other programs in: value by value, or refused in one line.
#include "services/importing/import.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <cmath>
#include <filesystem>

#include "common/base/file.h"
#include "common/base/ids.h"
#include "common/recordings/recording_set.h"
#include "services/importing/exact_set.h"
#include "services/importing/set_bag.h"
#include "tests/support/importing/log_writers.h"

namespace rg::importing {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

constexpr const char* kUrdf = R"(<robot name="two">
<link name="base"/>
<link name="upper"><inertial><origin xyz="0 0 0.1"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="fore"><inertial><origin xyz="0 0 0.1"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="10" velocity="5"/></joint>
<joint name="elbow" type="continuous"><parent link="upper"/><child link="fore"/><axis xyz="0 1 0"/>
<origin xyz="0 0 0.3"/></joint>
</robot>
)";

class Folder {
 public:
  Folder() : path_(fs::temp_directory_path() / ("rg_import_" + RandomHex(6))) {
    fs::create_directories(path_);
  }
  ~Folder() { fs::remove_all(path_); }
  std::string operator/(const std::string& name) const { return (path_ / name).string(); }

 private:
  fs::path path_;
};

// Two efforts, velocities, a column with missing values, epoch stamps with odd nanoseconds.
std::string Csv(double start) {
  std::string text =
      "time,position.shoulder,position.elbow,velocity.shoulder,velocity.elbow,effort_command.shoulder,"
      "effort_command.elbow,effort_measured.shoulder,effort_measured.elbow,temperature.elbow\n";
  for (int k = 0; k < 40; ++k) {
    const double t = 0.01 * k;
    char line[300];
    std::snprintf(line, sizeof line, "%.9f,%.17g,%.17g,%.17g,%.17g,%.17g,%.17g,%.17g,%.17g,%s\n",
                  start + t + 1e-6 * (k % 3), std::sin(t), std::sin(3 * t), std::cos(t), 3 * std::cos(3 * t),
                  0.1 * k, -1.0 / 3 * k, 0.3 * k, std::exp(-t), k % 5 == 0 ? "" : "31.25");
    text += line;
  }
  return text;
}

TEST(Import, ASetThatWentOutAsBagsComesBackValueByValue) {
  const Folder folder;
  fs::create_directories(folder / "set");
  ASSERT_TRUE(WriteFileAtomically(folder / "set/robot.urdf", kUrdf).ok());
  ASSERT_TRUE(WriteFileAtomically(folder / "set/manifest.json",
                                  R"({"format": "realitygrad.recordings/1", "robot": "robot.urdf",
 "joints": ["shoulder", "elbow"], "gravity": [0, 0, -9.8], "noise": {"position_stddev": 0.0005}, "drive": "effort_measured",
 "recordings": [{"file": "a.csv", "split": "fit"}, {"file": "b.csv", "split": "holdout"}]})")
                  .ok());
  ASSERT_TRUE(WriteFileAtomically(folder / "set/a.csv", Csv(0.0)).ok());
  ASSERT_TRUE(WriteFileAtomically(folder / "set/b.csv", Csv(1607074831.25)).ok());
  const auto exact = LoadExactSet(folder / "set");
  ASSERT_TRUE(exact.ok()) << exact.status().ToString();
  const auto bags = WriteSetBags(folder / "bags", exact->set, exact->manifest_json, {});
  ASSERT_TRUE(bags.ok()) << bags.status().ToString();
  ImportOptions options;
  options.files = *bags;
  options.out = folder / "back";
  const auto report = Import(options, {});
  ASSERT_TRUE(report.ok()) << report.status().ToString();

  const auto back = LoadExactSet(folder / "back");
  ASSERT_TRUE(back.ok()) << back.status().ToString();
  ASSERT_EQ(back->set.recordings.size(), 2u);
  EXPECT_EQ(back->set.gravity, exact->set.gravity);
  EXPECT_EQ(back->set.noise.position_stddev, exact->set.noise.position_stddev);
  EXPECT_EQ(back->set.drive, exact->set.drive);
  for (size_t i = 0; i < 2; ++i) {
    const recordings::Recording &a = exact->set.recordings[i], &b = back->set.recordings[i];
    EXPECT_EQ(a.split, b.split);
    EXPECT_EQ(a.t, b.t);
    EXPECT_EQ(a.q, b.q);
    EXPECT_EQ(a.v, b.v);
    EXPECT_EQ(a.effort_command, b.effort_command);
    EXPECT_EQ(a.effort_measured, b.effort_measured);
    const auto &x = a.other.at("temperature.elbow"), &y = b.other.at("temperature.elbow");
    for (Eigen::Index k = 0; k < x.size(); ++k)
      EXPECT_TRUE(x[k] == y[k] || (std::isnan(x[k]) && std::isnan(y[k])));
  }
}

std::vector<test::LoggedMessage> JointStates(bool with_effort) {
  std::vector<test::LoggedMessage> messages;
  for (int64_t k = 0; k < 300; ++k) {
    const int64_t ns = 1'700'000'000'000'000'000 + k * 10'000'000;
    const double t = 0.01 * static_cast<double>(k);
    messages.push_back(
        {"/joint_states", "sensor_msgs/JointState", ns + 1'000'000,
         test::CdrJointState({ns,
                              {"elbow", "shoulder"},
                              {std::sin(t), 0.5 * std::sin(2 * t)},
                              {std::cos(t), std::cos(2 * t)},
                              with_effort ? std::vector<double>{0.1 * t, 2.0} : std::vector<double>{}})});
  }
  return messages;
}

TEST(Import, AnMcapOfJointStatesIsGuessedByTheUrdfsNames) {
  const Folder folder;
  ASSERT_TRUE(WriteFileAtomically(folder / "arm.urdf", kUrdf).ok());
  test::McapOptions lz4;
  lz4.compression = "lz4";
  ASSERT_TRUE(WriteFileAtomically(folder / "log.mcap", test::McapBytes(JointStates(true), lz4)).ok());
  ImportOptions options;
  options.files = {folder / "log.mcap"};
  options.urdf = folder / "arm.urdf";
  options.out = folder / "set";
  const auto report = Import(options, {});
  ASSERT_TRUE(report.ok()) << report.status().ToString();
  EXPECT_TRUE(report->guessed);
  const auto set = recordings::LoadSet(folder / "set");
  ASSERT_TRUE(set.ok()) << set.status().ToString();
  EXPECT_EQ(set->joints, (std::vector<std::string>{"shoulder", "elbow"}));
  const recordings::Recording& r = set->recordings[0];
  EXPECT_EQ(r.rows(), 300);
  EXPECT_TRUE(r.has_effort_measured());
  EXPECT_NEAR(r.q(1, 100), std::sin(1.0), 1e-12);
  EXPECT_NEAR(r.q(0, 100), 0.5 * std::sin(2.0), 1e-12);
}

TEST(Import, PositionsWithoutAnyEffortAreRefusedAndNothingIsWritten) {
  const Folder folder;
  ASSERT_TRUE(WriteFileAtomically(folder / "arm.urdf", kUrdf).ok());
  ASSERT_TRUE(WriteFileAtomically(folder / "log.mcap", test::McapBytes(JointStates(false))).ok());
  ImportOptions options;
  options.files = {folder / "log.mcap"};
  options.urdf = folder / "arm.urdf";
  options.out = folder / "set";
  const auto report = Import(options, {});
  ASSERT_FALSE(report.ok());
  EXPECT_EQ(report.status().message().find('\n'), std::string::npos);
  EXPECT_THAT(report.status().message(), HasSubstr("effort"));
  EXPECT_FALSE(fs::exists(folder / "set"));
}

TEST(Import, FilesThatAreNoneAndFilesGivenTwiceAreRefused) {
  const Folder folder;
  ASSERT_TRUE(WriteFileAtomically(folder / "arm.urdf", kUrdf).ok());
  ASSERT_TRUE(WriteFileAtomically(folder / "a.csv", Csv(0.0)).ok());
  fs::create_symlink("loop.csv", folder / "loop.csv");
  ASSERT_EQ(::mkfifo((folder / "pipe.csv").c_str(), 0600), 0);
  ImportOptions options;
  options.urdf = folder / "arm.urdf";
  options.out = folder / "set";
  for (const auto& files : std::vector<std::vector<std::string>>{{folder / "loop.csv"},
                                                                 {folder / "pipe.csv"},
                                                                 {folder / "arm.urdf"},
                                                                 {folder / "a.csv", folder / "./a.csv"}}) {
    options.files = files;
    const auto report = Import(options, {});
    ASSERT_FALSE(report.ok()) << files.back();
    EXPECT_THAT(report.status().message(), HasSubstr(files.back()));
    EXPECT_EQ(report.status().message().find('\n'), std::string::npos);
    EXPECT_FALSE(fs::exists(folder / "set"));
  }
}

}  // namespace
}  // namespace rg::importing
