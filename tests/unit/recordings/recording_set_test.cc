#include "common/recordings/recording_set.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <limits>

#include "common/base/file.h"
#include "common/base/ids.h"
#include "common/recordings/manifest.h"
#include "common/recordings/noise.h"
#include "common/recordings/windows.h"

namespace rg::recordings {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr const char* kUrdf = R"(<robot name="two">
  <link name="base"/>
  <link name="upper"><inertial><mass value="1"/><origin xyz="0 0 0.1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="fore"><inertial><mass value="1"/><origin xyz="0 0 0.1"/>
    <inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="hand"><inertial><mass value="0.1"/>
    <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="10" velocity="5"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/><axis xyz="0 1 0"/>
    <origin xyz="0 0 0.3"/><limit lower="-3" upper="3" effort="10" velocity="5"/></joint>
  <joint name="finger" type="prismatic"><parent link="fore"/><child link="hand"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.05" effort="10" velocity="5"/></joint>
</robot>)";

class Folder {
 public:
  Folder() : path_(fs::temp_directory_path() / ("rg_recordings_" + RandomHex(6))) {
    fs::create_directories(path_);
  }
  ~Folder() { fs::remove_all(path_); }
  std::string path() const { return path_.string(); }
  void Write(const std::string& file, const std::string& text) const {
    ASSERT_TRUE(WriteFileAtomically((path_ / file).string(), text).ok());
  }

 private:
  fs::path path_;
};

constexpr const char* kCsv =
    "time,position.elbow,position.shoulder,effort_command.elbow,effort_command.shoulder,position.finger\n"
    "0,0.2,0.1,2,1,0\n0.01,0.2,0.1,2,1,0\n0.02,0.2,0.1,2,1,0\n";

std::string ManifestText(const std::string& extra = "",
                         const std::string& recordings = R"([{"file": "a.csv", "split": "fit"}])",
                         const std::string& joints = R"(["elbow", "shoulder"])") {
  return R"({"format": "realitygrad.recordings/1", "robot": "robot.urdf", "joints": )" + joints + extra +
         R"(, "recordings": )" + recordings + "}";
}

Result<RecordingSet> Load(const std::string& manifest, const std::string& csv = kCsv) {
  Folder folder;
  folder.Write("robot.urdf", kUrdf);
  folder.Write("manifest.json", manifest);
  for (const char* file : {"a.csv", "b.csv", "c.csv", "d.csv"}) folder.Write(file, csv);
  return LoadSet(folder.path());
}

std::string SetError(const std::string& manifest, const std::string& csv = kCsv) {
  const auto set = Load(manifest, csv);
  EXPECT_EQ(set.status().message().find('\n'), std::string::npos);
  return set.ok() ? "accepted" : set.status().message();
}

// Rows at 100 Hz; rows in [gap, gap + 50) are missing, and time stands still for none of them.
std::string LongCsv(int rows, int gap = -1) {
  std::string text = "time,position.shoulder,position.elbow,effort_command.shoulder,effort_command.elbow\n";
  for (int k = 0; k < rows; ++k) {
    if (gap >= 0 && k >= gap && k < gap + 50) continue;
    const std::string t = std::to_string(0.01 * k), q = std::to_string(std::sin(0.02 * k));
    text += t + "," + q + "," + q + ",1,2\n";
  }
  return text;
}

TEST(LoadSet, RecordingsWithGapsAreFittedPieceByPieceAndWrittenWhole) {
  Folder folder;
  folder.Write("robot.urdf", kUrdf);
  folder.Write("manifest.json",
               ManifestText("", R"([{"file": "a.csv"}, {"file": "b.csv", "split": "holdout"}])"));
  folder.Write("a.csv", LongCsv(300, 100));
  folder.Write("b.csv", LongCsv(300, 5));
  const auto set = LoadSet(folder.path());
  ASSERT_TRUE(set.ok()) << set.status().ToString();
  ASSERT_EQ(set->Fit().size(), 2u);
  EXPECT_EQ(set->Fit()[0]->rows(), 100);
  EXPECT_EQ(set->Fit()[1]->rows(), 150);
  ASSERT_EQ(set->Holdout().size(), 1u) << "five rows are too short to fit";
  EXPECT_EQ(set->Holdout()[0]->window_origin, 0.0);
  EXPECT_THAT(set->warnings,
              ::testing::Contains(HasSubstr("a.csv: 1 gap, the longest 0.51 s: fits go round it")));
  EXPECT_THAT(set->warnings,
              ::testing::Contains(HasSubstr("b.csv: 1 gap, the longest 0.51 s: fits go round it, 1 pieces")));
  ReadOptions whole;
  whole.keep_whole = true;
  const auto kept = LoadSet(folder.path(), whole);
  ASSERT_TRUE(kept.ok());
  EXPECT_EQ(kept->recordings.size(), 2u);
  Folder copy;
  ASSERT_TRUE(WriteSet(copy.path(), *set).ok());
  const auto again = LoadSet(copy.path());
  ASSERT_TRUE(again.ok()) << again.status().ToString();
  EXPECT_EQ(again->Fit()[1]->q, set->Fit()[1]->q);
}

TEST(SetFromFiles, TakesAUrdfAndFilesAndKeepsTheLastThirdAside) {
  Folder folder;
  folder.Write("arm.urdf", kUrdf);
  std::vector<std::string> files;
  for (const char* name : {"r1.csv", "r2.csv", "r3.csv", "r4.csv", "r5.csv", "r6.csv"}) {
    folder.Write(name, LongCsv(100));
    files.push_back(folder.path() + "/" + name);
  }
  const std::string urdf = folder.path() + "/arm.urdf";
  const auto set = SetFromFiles(urdf, files, std::nullopt);
  ASSERT_TRUE(set.ok()) << set.status().ToString();
  EXPECT_EQ(set->joints, (std::vector<std::string>{"shoulder", "elbow"}));
  EXPECT_EQ(set->Fit().size(), 4u);
  EXPECT_EQ(set->Holdout()[0]->name, "r5.csv");
  const auto two = SetFromFiles(urdf, {files[0], files[1]}, std::nullopt);
  ASSERT_TRUE(two.ok());
  EXPECT_EQ(two->Holdout().size(), 1u);
}

TEST(SetFromFiles, ASingleFileIsRefusedOrCutInTime) {
  Folder folder;
  folder.Write("arm.urdf", kUrdf);
  folder.Write("r.csv", LongCsv(300));
  const std::string urdf = folder.path() + "/arm.urdf", file = folder.path() + "/r.csv";
  EXPECT_THAT(SetFromFiles(urdf, {file}, std::nullopt).status().message(),
              AllOf(HasSubstr("r.csv"), HasSubstr("--split-time")));
  const auto third = SetFromFiles(urdf, {file}, std::numeric_limits<double>::infinity());
  ASSERT_TRUE(third.ok()) << third.status().ToString();
  EXPECT_EQ(third->Fit()[0]->rows(), 200);
  EXPECT_EQ(third->Holdout()[0]->rows(), 100);
  const auto at = SetFromFiles(urdf, {file}, 0.5);
  ASSERT_TRUE(at.ok());
  EXPECT_EQ(at->Fit()[0]->rows(), 51);
  EXPECT_THAT(SetFromFiles(urdf, {file}, 9.0).status().message(), HasSubstr("--split-time 9"));
  EXPECT_THAT(SetFromFiles(urdf, {folder.path() + "/no.csv"}, 1.0).status().message(), HasSubstr("no.csv"));
}

TEST(LoadSet, PutsJointsInModelOrderWhateverTheManifestAndTheFileSay) {
  const auto set = Load(ManifestText());
  ASSERT_TRUE(set.ok()) << set.status().ToString();
  EXPECT_EQ(set->joints, (std::vector<std::string>{"shoulder", "elbow"}));
  EXPECT_EQ(set->recordings[0].q.col(0), Eigen::Vector2d(0.1, 0.2));
  EXPECT_EQ(set->recordings[0].effort_command.col(0), Eigen::Vector2d(1, 2));
  EXPECT_EQ(set->joint_info[1].name, "elbow");
  EXPECT_EQ(set->gravity, Eigen::Vector3d(0, 0, -9.81));
  EXPECT_FALSE(set->effort_excludes_gravity);
  EXPECT_EQ(set->recordings[0].name, "a.csv");
}

TEST(LoadSet, WarnsOfKeysThatNobodyKnowsAndOfNoOther) {
  const auto plain = Load(ManifestText(R"(, "noise": {"position_stddev": 5e-4})"));
  ASSERT_TRUE(plain.ok());
  EXPECT_TRUE(plain->warnings.empty());
  const auto set = Load(ManifestText(R"(, "nois": {}, "control": {"rate": 50})"));
  ASSERT_TRUE(set.ok()) << set.status().ToString();
  EXPECT_THAT(set->warnings, ::testing::UnorderedElementsAre(HasSubstr("nois: unknown key"),
                                                             HasSubstr("control.rate: unknown key")));
}

TEST(LoadSet, WarnsOfWhatAManifestHardlyMeans) {
  const auto up = Load(ManifestText(R"(, "gravity": [0, 0, 9.81])"));
  ASSERT_TRUE(up.ok()) << up.status().ToString();
  EXPECT_THAT(up->warnings, ::testing::ElementsAre(HasSubstr("points up")));
  EXPECT_THAT(Load(ManifestText(R"(, "gravity": [0, 0, -981])"))->warnings,
              ::testing::ElementsAre(HasSubstr("981")));
  EXPECT_THAT(Load(ManifestText(R"(, "gravity": [0, 0, 0])"))->warnings, ::testing::IsEmpty());
  EXPECT_THAT(Load(ManifestText(R"(, "locked": {"finger": 20})"))->warnings,
              ::testing::ElementsAre(AllOf(HasSubstr("finger at 20"), HasSubstr("0 to 0.05"))));
}

TEST(LoadSet, ReadsPathsAsWindowsWritesThem) {
  Folder folder;
  folder.Write("robot.urdf", kUrdf);
  folder.Write("manifest.json", ManifestText("", R"([{"file": "data\\a.csv"}])"));
  folder.Write("data/a.csv", kCsv);
  const auto set = LoadSet(folder.path());
  ASSERT_TRUE(set.ok()) << set.status().ToString();
  EXPECT_EQ(set->recordings[0].rows(), 3);
}

TEST(LoadSet, SaysWhichRecordingLacksAnEffortThatOthersHave) {
  Folder folder;
  folder.Write("robot.urdf", kUrdf);
  folder.Write("manifest.json",
               ManifestText("", R"([{"file": "a.csv"}, {"file": "b.csv", "split": "holdout"}])"));
  folder.Write("a.csv", kCsv);
  std::string silent = kCsv;
  for (size_t at; (at = silent.find(",2,1,")) != std::string::npos;) silent.replace(at, 5, ",2,0,");
  folder.Write("b.csv", silent);
  const auto set = LoadSet(folder.path());
  ASSERT_TRUE(set.ok()) << set.status().ToString();
  EXPECT_THAT(
      set->warnings,
      ::testing::ElementsAre("b.csv: the effort of shoulder is 0 throughout, in other recordings it is not"));
}

TEST(LoadSet, ReadsEverySettingOfTheManifest) {
  const auto set = Load(ManifestText(
      R"(, "gravity": [1, 2, 3], "sample_rate_hz": 100, "control": {"rate_hz": 50, "hold": "linear"},
         "noise": {"position_stddev": 5e-4, "position_resolution": 1e-4}, "locked": {"finger": 0.02},
         "effort_excludes_gravity": true, "drive": "effort_command")"));
  ASSERT_TRUE(set.ok()) << set.status().ToString();
  EXPECT_EQ(set->gravity, Eigen::Vector3d(1, 2, 3));
  EXPECT_EQ(set->sample_rate_hz, 100.0);
  EXPECT_EQ(set->control_rate_hz, 50.0);
  EXPECT_EQ(set->control_hold, CommandHold::kLinear);
  EXPECT_EQ(set->noise.position_stddev, 5e-4);
  EXPECT_FALSE(set->noise.velocity_stddev.has_value());
  EXPECT_EQ(set->locked.at("finger"), 0.02);
  EXPECT_TRUE(set->effort_excludes_gravity);
  EXPECT_EQ(set->drive, EffortKind::kCommand);
}

TEST(LoadSet, NamesTheFieldOfTheManifestThatIsWrong) {
  const std::string twice = R"([{"file": "a.csv"}, {"file": "a.csv", "split": "holdout"}])";
  EXPECT_THAT(SetError("{"), HasSubstr("manifest.json: not JSON"));
  EXPECT_THAT(SetError("[]"), HasSubstr("not a JSON object"));
  EXPECT_THAT(SetError("{}"), HasSubstr("format: is missing"));
  EXPECT_THAT(SetError(R"({"format": "realitygrad.recordings/2"})"),
              AllOf(HasSubstr("format"), HasSubstr("recordings/2"), HasSubstr("recordings/1")));
  EXPECT_THAT(SetError(ManifestText("", "{}")), HasSubstr("recordings: {} is not a list"));
  EXPECT_THAT(SetError(ManifestText("", "[]")), HasSubstr("recordings: is empty"));
  EXPECT_THAT(SetError(ManifestText("", R"([{"file": "a.csv", "split": "test"}])")),
              AllOf(HasSubstr("recordings[0].split"), HasSubstr("'test'")));
  EXPECT_THAT(SetError(ManifestText("", R"([{"split": "fit"}])")),
              HasSubstr("recordings[0].file: is missing"));
  EXPECT_THAT(SetError(ManifestText("", twice)), AllOf(HasSubstr("recordings[1].file"), HasSubstr("twice")));
  EXPECT_THAT(SetError(ManifestText("", R"([{"file": "z.csv"}])")), HasSubstr("z.csv"));
  EXPECT_THAT(SetError(ManifestText(R"(, "gravity": [0, 0])")), HasSubstr("gravity"));
  EXPECT_THAT(SetError(ManifestText(R"(, "gravity": [0, 0, "g"])")), HasSubstr("gravity[2]"));
  EXPECT_THAT(SetError(ManifestText(R"(, "sample_rate_hz": 0)")), HasSubstr("sample_rate_hz"));
  EXPECT_THAT(SetError(ManifestText(R"(, "sample_rate_hz": "100")")), HasSubstr("sample_rate_hz"));
  EXPECT_THAT(SetError(ManifestText(R"(, "noise": {"position_stddev": -1})")),
              HasSubstr("noise.position_stddev"));
  EXPECT_THAT(SetError(ManifestText(R"(, "control": {"hold": "spline"})")), HasSubstr("control.hold"));
  EXPECT_THAT(SetError(ManifestText(R"(, "drive": "current")")), HasSubstr("drive"));
  EXPECT_THAT(SetError(ManifestText(R"(, "effort_excludes_gravity": 1)")),
              HasSubstr("effort_excludes_gravity"));
  EXPECT_THAT(SetError(ManifestText(R"(, "locked": {"wrist": 0})")), AllOf(HasSubstr("locked.wrist")));
  EXPECT_THAT(SetError(ManifestText("", "[]", R"(["elbow", "wrist"])")), HasSubstr("recordings"));
}

TEST(LoadSet, RefusesJointsThatTheRobotLacks) {
  const std::string one = R"([{"file": "a.csv"}])";
  EXPECT_THAT(SetError(ManifestText("", one, R"(["elbow", "wrist"])")),
              AllOf(HasSubstr("manifest.json: joints[1]"), HasSubstr("'wrist'")));
  EXPECT_THAT(SetError(ManifestText("", one, R"(["elbow", "elbow"])")), HasSubstr("joints[1]"));
  EXPECT_THAT(SetError(ManifestText(), "time,position.wrist,position.elbow,position.shoulder\n0,0,0,0\n"),
              AllOf(HasSubstr("a.csv"), HasSubstr("column 2"), HasSubstr("position.wrist")));
}

TEST(LoadSet, RefusesARecordingWithoutTheEffortThatDrives) {
  EXPECT_THAT(SetError(ManifestText(R"(, "drive": "effort_measured")")),
              AllOf(HasSubstr("a.csv"), HasSubstr("effort_measured.shoulder")));
}

TEST(LoadSet, ChoosesWholeRecordingsAsHoldoutWhereTheManifestNamesNone) {
  const auto four = Load(ManifestText(
      "", R"([{"file":"a.csv"},{"file":"b.csv"},{"file":"c.csv"},{"file":"d.csv","split":"fit"}])"));
  ASSERT_TRUE(four.ok()) << four.status().ToString();
  EXPECT_TRUE(four->holdout_was_chosen);
  ASSERT_EQ(four->Holdout().size(), 1u);
  EXPECT_EQ(four->Holdout()[0]->name, "d.csv");
  EXPECT_EQ(four->Fit().size(), 3u);

  const auto two = Load(ManifestText("", R"([{"file":"a.csv"},{"file":"b.csv"}])"));
  ASSERT_TRUE(two.ok());
  EXPECT_EQ(two->Holdout()[0]->name, "b.csv");
  const auto one = Load(ManifestText());
  ASSERT_TRUE(one.ok());
  EXPECT_FALSE(one->holdout_was_chosen);
  EXPECT_TRUE(one->Holdout().empty());
  const auto named = Load(ManifestText("", R"([{"file":"a.csv","split":"holdout"},{"file":"b.csv"}])"));
  ASSERT_TRUE(named.ok());
  EXPECT_FALSE(named->holdout_was_chosen);
  EXPECT_EQ(named->Fit()[0]->name, "b.csv");
}

TEST(MergeSets, MakesOneOfTwoAndNamesWhatDiffers) {
  const Folder folder;
  folder.Write("robot.urdf", kUrdf);
  folder.Write("a.csv", kCsv);
  folder.Write("manifest.json",
               ManifestText(R"(, "noise": {"position_stddev": 0.001, "velocity_stddev": 0.1})"));
  const RecordingSet one = LoadSet(folder.path()).value();
  RecordingSet other = one;
  other.folder = "/data/second";
  other.noise.position_stddev = 0.002, other.noise.velocity_stddev.reset();
  other.recordings[0].split = Split::kHoldout;
  const auto both = MergeSets({one, other});
  ASSERT_TRUE(both.ok()) << both.status().ToString();
  ASSERT_EQ(both->recordings.size(), 2u);
  EXPECT_EQ(both->recordings[1].name, "second_a.csv");
  EXPECT_EQ(both->Holdout().size(), 1u);
  EXPECT_EQ(both->noise.position_stddev, 0.002);
  EXPECT_FALSE(both->noise.velocity_stddev.has_value());

  other.gravity.x() = 1.0;
  EXPECT_THAT(MergeSets({one, other}).status().message(),
              AllOf(HasSubstr("/data/second"), HasSubstr("gravity")));
  other = one;
  other.urdf_text += " ";
  EXPECT_THAT(MergeSets({one, other}).status().message(), HasSubstr("URDF"));
}

TEST(LoadSets, ReadsSeveralFoldersAsOneSetAndNamesTheOneThatIsBad) {
  const Folder one, two;
  for (const Folder* folder : {&one, &two}) {
    folder->Write("robot.urdf", kUrdf);
    folder->Write("a.csv", kCsv);
    folder->Write("manifest.json", ManifestText(""));
  }
  const auto both = LoadSets({one.path(), two.path()});
  ASSERT_TRUE(both.ok()) << both.status().ToString();
  EXPECT_EQ(both->recordings.size(), 2u);
  EXPECT_THAT(LoadSets({one.path(), "/nowhere"}).status().message(), HasSubstr("/nowhere"));
  EXPECT_FALSE(LoadSets({}).ok());
}

TEST(WriteSet, IsReadBackTheSame) {
  const auto set = Load(ManifestText(R"(, "noise": {"velocity_stddev": 0.005}, "locked": {"finger": 0.01})",
                                     R"([{"file":"a.csv"},{"file":"b.csv","split":"holdout"}])"));
  ASSERT_TRUE(set.ok());
  Folder folder;
  ASSERT_TRUE(WriteSet(folder.path(), *set).ok());
  const auto back = LoadSet(folder.path());
  ASSERT_TRUE(back.ok()) << back.status().ToString();
  EXPECT_EQ(back->joints, set->joints);
  EXPECT_EQ(back->urdf_text, set->urdf_text);
  EXPECT_EQ(back->locked, set->locked);
  EXPECT_EQ(back->noise.velocity_stddev, 0.005);
  EXPECT_EQ(back->recordings[0].q, set->recordings[0].q);
  EXPECT_EQ(back->recordings[1].split, Split::kHoldout);
  EXPECT_EQ(FormatManifest(*back, "robot.urdf"), FormatManifest(*set, "robot.urdf"));
}

TEST(LoadSet, SaysThatTheFolderOrTheRobotIsNotThere) {
  EXPECT_THAT(LoadSet("/no/such/folder").status().message(), HasSubstr("/no/such/folder"));
  Folder folder;
  folder.Write("manifest.json", ManifestText());
  EXPECT_THAT(LoadSet(folder.path()).status().message(), HasSubstr("robot.urdf"));
}

// The recordings that come with the project's data are not part of the source tree.
std::string DataFolder() {
  if (const char* dir = std::getenv("RG_RECORDINGS_DIR")) return dir;
  const char* source = std::getenv("RG_SOURCE_DIR");
  return std::string(source ? source : ".") + "/../shared/recordings";
}

std::vector<std::string> DataSets() {
  std::vector<std::string> sets;
  for (const char* group : {"practice", "real"}) {
    const fs::path folder = fs::path(DataFolder()) / group;
    if (!fs::is_directory(folder)) continue;
    for (const auto& entry : fs::directory_iterator(folder)) {
      if (fs::exists(entry.path() / "manifest.json")) sets.push_back(entry.path().string());
    }
  }
  return sets;
}

TEST(RecordingData, EverySetLoadsAndItsNoiseEstimateAgreesWithTheDataSheet) {
  const auto folders = DataSets();
  if (folders.empty()) GTEST_SKIP() << "no recordings in " << DataFolder() << " (set RG_RECORDINGS_DIR)";
  for (const std::string& folder : folders) {
    const auto set = LoadSet(folder);
    ASSERT_TRUE(set.ok()) << set.status().ToString();
    EXPECT_FALSE(set->Fit().empty()) << folder;
    EXPECT_FALSE(set->Holdout().empty()) << folder;
    if (!set->noise.position_stddev || !set->noise.position_resolution) continue;
    const double known =
        std::hypot(*set->noise.position_stddev, *set->noise.position_resolution / std::sqrt(12.0));
    RecordingSet unknown = *set;
    unknown.noise = {};
    const SensorNoise noise = EstimateSensorNoise(unknown);
    for (Eigen::Index i = 0; i < noise.position_stddev.size(); ++i) {
      EXPECT_NEAR(noise.position_stddev[i], known, 0.25 * known) << folder << " " << set->joints[i];
      EXPECT_NEAR(noise.position_resolution[i], *set->noise.position_resolution,
                  0.02 * *set->noise.position_resolution)
          << folder << " " << set->joints[i];
      EXPECT_NEAR(noise.velocity_stddev[i], *set->noise.velocity_stddev, 0.35 * *set->noise.velocity_stddev)
          << folder << " " << set->joints[i];
    }
  }
}

TEST(RecordingData, SecondsAreWindowsOfAsManyRowsAsTheRate) {
  const std::string folder = DataFolder() + "/practice/p05_elasticity";
  if (!fs::exists(folder)) GTEST_SKIP() << "no recordings in " << DataFolder() << " (set RG_RECORDINGS_DIR)";
  const auto set = LoadSet(folder);
  ASSERT_TRUE(set.ok()) << set.status().ToString();
  for (const Recording& r : set->recordings) {
    const auto windows = SplitIntoWindows(r.t, 1.0);
    for (size_t w = 0; w + 1 < windows.size(); ++w) EXPECT_EQ(windows[w].rows(), 500) << r.name;
  }
}

}  // namespace
}  // namespace rg::recordings
