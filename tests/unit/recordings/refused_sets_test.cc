// Small sets with one thing wrong each, and the line that a user must get for it: file, place, value, remedy.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <regex>

#include "common/base/file.h"
#include "common/base/ids.h"
#include "common/recordings/recording_set.h"

namespace rg::recordings {
namespace {

namespace fs = std::filesystem;

constexpr const char* kArmUrdf = R"(<robot name="two">
<link name="base"/>
<link name="upper"><inertial><origin xyz="0 0 0.1"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="fore"><inertial><origin xyz="0 0 0.1"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="a" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="10" velocity="5"/></joint>
<joint name="b" type="continuous"><parent link="upper"/><child link="fore"/><axis xyz="0 1 0"/>
<origin xyz="0 0 0.3"/><limit effort="10" velocity="5"/></joint>
</robot>
)";

constexpr const char* kManifest =
    R"({"format": "realitygrad.recordings/1", "robot": "robot.urdf", "joints": ["a", "b"],
 "sample_rate_hz": 100, "noise": {"position_stddev": 5e-4},
 "recordings": [{"file": "one.csv", "split": "fit"}, {"file": "two.csv", "split": "holdout"}]}
)";

std::string Csv() {
  std::string text = "time,position.a,position.b,velocity.a,velocity.b,effort_command.a,effort_command.b\n";
  for (int k = 0; k < 150; ++k) {
    const double t = 0.01 * k;
    char line[200];
    std::snprintf(line, sizeof line, "%.2f,%.6f,%.6f,%.6f,%.6f,%.4f,%.4f\n", t, 0.5 * std::sin(2 * t),
                  0.4 * std::sin(3 * t), std::cos(2 * t), 1.2 * std::cos(3 * t), 1.1 + t, 0.6 - t);
    text += line;
  }
  return text;
}

struct Files {
  std::string urdf = kArmUrdf, manifest = kManifest, csv = Csv();
};

// Replaces the first occurrence; a test of a replacement that finds nothing tests nothing.
void Replace(std::string& text, const std::string& what, const std::string& by) {
  const size_t at = text.find(what);
  ASSERT_NE(at, std::string::npos) << what;
  text.replace(at, what.size(), by);
}

// Line `row` (data rows from 1) of a CSV, edited as fields.
void EditRow(std::string& csv, int row, const std::function<void(std::vector<std::string>&)>& edit) {
  size_t begin = 0;
  for (int k = 0; k < row; ++k) begin = csv.find('\n', begin) + 1;
  const size_t end = csv.find('\n', begin);
  std::vector<std::string> fields(1);
  for (size_t i = begin; i < end; ++i) {
    if (csv[i] == ',') {
      fields.emplace_back();
    } else {
      fields.back() += csv[i];
    }
  }
  edit(fields);
  std::string line;
  for (size_t i = 0; i < fields.size(); ++i) line += (i ? "," : "") + fields[i];
  csv.replace(begin, end - begin, line);
}

void EditColumn(std::string& csv, size_t column,
                const std::function<std::string(const std::string&, int)>& edit) {
  for (int row = 1; row <= 150; ++row)
    EditRow(csv, row, [&](std::vector<std::string>& f) { f[column] = edit(f[column], row); });
}

struct Wrong {
  const char* name;
  std::function<void(Files&)> edit;
  const char* line;  // what is said, without the folder
};

std::function<void(Files&)> Manifest(const std::string& what, const std::string& by) {
  return [=](Files& f) { Replace(f.manifest, what, by); };
}
std::function<void(Files&)> Urdf(const std::string& what, const std::string& by) {
  return [=](Files& f) { Replace(f.urdf, what, by); };
}
std::function<void(Files&)> Text(const std::string& what, const std::string& by) {
  return [=](Files& f) { Replace(f.csv, what, by); };
}
std::function<void(Files&)> Field(int row, size_t column, const std::string& value) {
  return [=](Files& f) { EditRow(f.csv, row, [&](std::vector<std::string>& v) { v[column] = value; }); };
}
std::function<void(Files&)> Scaled(size_t column, double factor) {
  return [=](Files& f) {
    EditColumn(f.csv, column,
               [&](const std::string& x, int) { return std::to_string(factor * std::stod(x)); });
  };
}

const std::vector<Wrong>& Table() {
  static const std::vector<Wrong> table = {
#include "tests/unit/recordings/refused_sets.inc"
  };
  return table;
}

TEST(RefusedSets, EachGetsItsOwnLine) {
  const fs::path folder = fs::temp_directory_path() / ("rg_refused_" + RandomHex(6));
  ASSERT_GE(Table().size(), 60u);
  for (const Wrong& wrong : Table()) {
    SCOPED_TRACE(wrong.name);
    Files files;
    wrong.edit(files);
    ASSERT_TRUE(WriteFileAtomically((folder / "robot.urdf").string(), files.urdf).ok());
    ASSERT_TRUE(WriteFileAtomically((folder / "manifest.json").string(), files.manifest).ok());
    ASSERT_TRUE(WriteFileAtomically((folder / "one.csv").string(), files.csv).ok());
    ASSERT_TRUE(WriteFileAtomically((folder / "two.csv").string(), Csv()).ok());
    const auto set = LoadSet(folder.string());
    std::string said = set.ok() ? "accepted" : set.status().message();
    const std::string prefix = folder.string() + "/";
    for (size_t at; (at = said.find(prefix)) != std::string::npos;) said.erase(at, prefix.size());
    EXPECT_EQ(said, wrong.line);
    EXPECT_EQ(said.find('\n'), std::string::npos);
  }
  fs::remove_all(folder);
}

TEST(RefusedSets, TheSetWithNothingWrongIsAccepted) {
  const fs::path folder = fs::temp_directory_path() / ("rg_refused_" + RandomHex(6));
  const Files files;
  ASSERT_TRUE(WriteFileAtomically((folder / "robot.urdf").string(), files.urdf).ok());
  ASSERT_TRUE(WriteFileAtomically((folder / "manifest.json").string(), files.manifest).ok());
  for (const char* name : {"one.csv", "two.csv"})
    ASSERT_TRUE(WriteFileAtomically((folder / name).string(), files.csv).ok());
  const auto set = LoadSet(folder.string());
  EXPECT_TRUE(set.ok()) << set.status().ToString();
  EXPECT_THAT(set->warnings, ::testing::IsEmpty());
  fs::remove_all(folder);
}

}  // namespace
}  // namespace rg::recordings
