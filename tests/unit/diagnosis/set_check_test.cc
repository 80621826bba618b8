// What is said before a search: the same as the search itself then says, in a schema that stays.
#include "services/diagnosis/reporting/set_check.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>
#include <set>

#include "services/diagnosis/diagnosis.h"
#include "services/sysid/sysid_on_set.h"
#include "tests/unit/diagnosis/simulated_set.h"

namespace rg::diagnosis {
namespace {

using nlohmann::json;
using ::testing::Contains;
using ::testing::HasSubstr;

SetCheck CheckOf(const recordings::RecordingSet& set) {
  auto check = CheckSet(set, *sysid::NominalPlant(set), false);
  RG_CHECK(check.ok()) << check.status().ToString();
  return *std::move(check);
}

// With something to say of a joint, of rates and of the manifest.
recordings::RecordingSet OddSet() {
  auto set = testing::MakeSet("arm2", {}, 71);
  set.sample_rate_hz = 25.0;
  set.holdout_was_chosen = true;
  set.warnings = {"manifest.json: nois: unknown key, left alone"};
  for (auto& rec : set.recordings) rec.q.row(0).setConstant(0.3), rec.v.row(0).setZero();
  return set;
}

TEST(SetCheck, SaysBeforeASearchWhatItsResultSays) {
  const auto set = OddSet();
  const SetCheck check = CheckOf(set);
  ASSERT_TRUE(check.refusal.ok()) << check.refusal.ToString();
  const auto r = Diagnose(set, {.threads = 1, .work_limit = 0}, RealClock());
  ASSERT_TRUE(r.ok()) << r.status().ToString();
  ASSERT_GE(r->notes.size(), check.warnings.size());
  EXPECT_EQ(
      std::vector<std::string>(r->notes.begin(), r->notes.begin() + static_cast<long>(check.warnings.size())),
      check.warnings);
  for (const char* part :
       {"unknown key", "shoulder never moved", "the manifest says 25 Hz", "rec_003.csv was kept"})
    EXPECT_THAT(check.warnings, Contains(HasSubstr(part)));
  for (const std::string& warning : check.warnings)
    EXPECT_EQ(warning.find('\n'), std::string::npos) << warning;
}

TEST(SetCheck, RefusesWithTheLineOfTheDiagnosis) {
  auto set = testing::MakeSet("arm2", {}, 72);
  for (auto& rec : set.recordings) rec.effort_command.row(1) *= -1.0;
  const SetCheck check = CheckOf(set);
  EXPECT_THAT(check.refusal.message(), HasSubstr("effort_command.elbow"));
  const auto r = Diagnose(set, {.threads = 1, .work_limit = 0}, RealClock());
  EXPECT_EQ(r.status().message(), check.refusal.message());
}

TEST(SetCheck, HasNothingToSayOfAnOrdinarySet) {
  const SetCheck check = CheckOf(testing::MakeSet("arm2", {}, 73));
  EXPECT_THAT(check.warnings, ::testing::IsEmpty());
  EXPECT_TRUE(check.refusal.ok());
}

std::set<std::string> KeysOf(const json& object) {
  std::set<std::string> out;
  for (const auto& [key, value] : object.items()) out.insert(key);
  return out;
}

TEST(SetCheck, KeepsItsSchema) {
  const auto set = OddSet();
  const SetCheck check = CheckOf(set);
  const auto plant = sysid::NominalPlant(set);
  const json out = CheckJson(set, *plant, check, WhatShows(check.survey, *plant));
  using Keys = std::set<std::string>;
  EXPECT_EQ(KeysOf(out), (Keys{"set", "robot", "recordings", "joints", "effects", "warnings", "refusal"}));
  EXPECT_EQ(KeysOf(out["robot"]),
            (Keys{"name", "urdf", "joints", "locked", "gravity", "drive", "effort_excludes_gravity"}));
  ASSERT_EQ(out["recordings"].size(), 4u);
  EXPECT_EQ(KeysOf(out["recordings"][0]),
            (Keys{"file", "split", "rows", "duration_s", "rate_hz", "gaps", "missing_rows", "columns"}));
  EXPECT_EQ(out["recordings"][3]["split"], "holdout");
  EXPECT_NEAR(out["recordings"][0]["rate_hz"].get<double>(), 100.0, 1e-6);
  ASSERT_EQ(out["joints"].size(), 2u);
  EXPECT_EQ(KeysOf(out["joints"][0]),
            (Keys{"joint", "type", "moved", "prescribed", "position", "speed", "effort", "holds_against"}));
  EXPECT_FALSE(out["joints"][0]["moved"].get<bool>());
  EXPECT_GT(out["joints"][0]["holds_against"].get<double>(), 0.0);
  EXPECT_TRUE(out["joints"][1]["holds_against"].is_null());
  EXPECT_EQ(out["joints"][1]["position"]["stddev_manifest"], testing::kPositionNoise);
  EXPECT_EQ(KeysOf(out["effects"][0]), (Keys{"effect", "shows", "joints", "within", "not"}));
  EXPECT_TRUE(out["refusal"].is_null());
  EXPECT_EQ(out["warnings"].size(), check.warnings.size());
}

TEST(LockedJoints, StandWhereTheManifestSaysOrAtZero) {
  auto set = testing::MakeSet("mico2", {}, 74, 1.0);
  set.locked["joint_finger_1"] = 0.4;
  const auto locked = LockedJoints(set);
  for (const std::string& joint : set.joints) EXPECT_EQ(locked.count(joint), 0u) << joint;
  ASSERT_EQ(locked.count("joint_finger_1"), 1u);
  EXPECT_EQ(locked.at("joint_finger_1"), 0.4);
}

}  // namespace
}  // namespace rg::diagnosis
