#include "services/cli/model_source.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

#include "common/base/file.h"
#include "common/base/ids.h"

namespace rg::cli {
namespace {

using ::testing::HasSubstr;

// A slide with a disc on it that turns about its own axis; `disc` is its <inertial>.
Result<std::string> NominalOf(const std::string& disc) {
  const std::string path = (std::filesystem::temp_directory_path() / ("rg_flange_" + RandomHex(6) + ".urdf")).string();
  const Status written = WriteFileAtomically(path, R"(<robot name="r"><link name="base"/><link name="arm"><inertial>
      <mass value="2"/><inertia ixx=".1" iyy=".1" izz=".1" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <link name="flange">)" + disc + R"(</link>
    <joint name="slide" type="prismatic"><parent link="base"/><child link="arm"/><axis xyz="1 0 0"/>
      <limit lower="-1" upper="1" effort="9" velocity="1"/></joint>
    <joint name="wrist" type="continuous"><parent link="arm"/><child link="flange"/><axis xyz="0 0 1"/></joint></robot>)");
  if (!written.ok()) return written;
  RobotProfile profile;
  profile.name = "r", profile.urdf = path;
  auto json = NominalModelJson(profile);
  std::filesystem::remove(path);
  return json;
}

TEST(NominalModel, OfABareFlangeIsRefusedWithTheRemedies) {
  const auto bare = NominalOf("");
  ASSERT_FALSE(bare.ok());
  EXPECT_THAT(bare.status().message(), HasSubstr("the link on joint 'wrist' has no inertia about its axis"));
  EXPECT_THAT(bare.status().message(), HasSubstr("<inertial>"));
  EXPECT_THAT(bare.status().message(), HasSubstr("armature.wrist"));
  EXPECT_EQ(bare.status().message().find('\n'), std::string::npos);
}

TEST(NominalModel, OfAFlangeWithInertiaIsMade) {
  const auto heavy = NominalOf(
      R"(<inertial><mass value=".2"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial>)");
  EXPECT_TRUE(heavy.ok()) << heavy.status().ToString();
}

}  // namespace
}  // namespace rg::cli
