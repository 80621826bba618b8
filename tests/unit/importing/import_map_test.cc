#include "services/importing/import_map.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <nlohmann/json.hpp>

#include "common/base/file.h"
#include "services/importing/columns.h"
#include "services/importing/import.h"

namespace rg::importing {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::UnorderedElementsAreArray;

std::string SourceDir() {
  const char* dir = std::getenv("RG_SOURCE_DIR");
  return dir ? dir : ".";
}

std::string Map(const std::string& columns, const std::string& more = "") {
  return R"({"format": "realitygrad.import_map/1", )" + more + R"("columns": [)" + columns + "]}";
}

std::string Refusal(const std::string& columns, const std::string& more = "") {
  const auto map = ParseImportMap(Map(columns, more), "map.json");
  return map.ok() ? "accepted" : map.status().message();
}

TEST(ImportMap, EntriesAreReadWithTheirUnitsClocksAndHolds) {
  const auto map = ParseImportMap(
      Map(R"({"topic": "/a", "field": ["joint1", "joint2"], "joint": ["x", "y"], "column": "position", "unit": "deg",
              "clock": "log", "scale": -1, "offset": 0.5, "note": "words"},
             {"topic": "/b", "field": "data[*]", "joint": ["x", "y"], "column": "effort_command"},
             {"topic": "/c", "field": "data", "column": "temperature", "hold": "zero_order"})",
          R"("manifest": {"gravity": [0, 0, 9.81]}, )"),
      "map.json");
  ASSERT_TRUE(map.ok()) << map.status().ToString();
  EXPECT_THAT(map->entries[0].fields, ElementsAre("joint1", "joint2"));
  EXPECT_NEAR(map->entries[0].unit->to_si, 0.017453292519943295, 1e-18);
  EXPECT_EQ(map->entries[0].scale, -1.0);
  EXPECT_EQ(HoldOf(map->entries[0]), Hold::kLinear);
  EXPECT_EQ(HoldOf(map->entries[1]), Hold::kZeroOrder);
  EXPECT_EQ(HoldOf(map->entries[2]), Hold::kZeroOrder);
  EXPECT_EQ(nlohmann::json::parse(map->manifest_json)["gravity"][2], 9.81);
}

TEST(ImportMap, WhatIsWrittenReadsBackTheSame) {
  const std::string text = Map(
      R"({"topic": "/a", "field": "position[*]", "joint": "*", "column": "position", "unit": "mrad", "clock": "header",
          "scale": 2, "offset": -1, "hold": "linear", "note": "n"})",
      R"("time": {"column": "t", "unit": "ms"}, "note": "x", "manifest": {"drive": "effort_measured"}, )");
  const auto once = ParseImportMap(text, "a");
  ASSERT_TRUE(once.ok()) << once.status().ToString();
  const auto twice = ParseImportMap(FormatImportMap(*once), "b");
  ASSERT_TRUE(twice.ok()) << twice.status().ToString();
  EXPECT_EQ(FormatImportMap(*once), FormatImportMap(*twice));
  EXPECT_EQ(nlohmann::json::parse(FormatImportMap(*once)), nlohmann::json::parse(text));
}

TEST(ImportMap, EveryMistakeIsOneLineWithFileAndField) {
  const std::string good = R"("topic": "/a", "field": "x", "joint": "j", "column": "position")";
  EXPECT_EQ(Refusal("{" + good + R"(, "unit": "grad"})").substr(0, 58),
            "map.json: columns[0].unit: unit 'grad' is not known (rad, ");
  EXPECT_EQ(Refusal("{" + good + R"(, "units": "rad"})"),
            "map.json: columns[0].units: unknown key (known: topic, field, joint, column, unit, clock, "
            "scale, offset, "
            "hold, note)");
  EXPECT_EQ(Refusal(R"({"topic": "/a", "joint": "j", "column": "position"})"),
            "map.json: columns[0].field: is missing");
  EXPECT_EQ(Refusal(R"({"field": "x", "column": "velocity"})"),
            "map.json: columns[0].joint: is missing: a velocity is a joint's");
  EXPECT_EQ(Refusal(R"({"field": ["x", "y"], "joint": ["j"], "column": "velocity"})"),
            "map.json: columns[0].field: 2 fields for 1 joints");
  EXPECT_EQ(Refusal(R"({"field": "x", "joint": "*", "column": "velocity"})"),
            "map.json: columns[0].joint: * needs a field with [*]");
  EXPECT_THAT(Refusal("{" + good + R"(, "scale": 0})"), HasSubstr("columns[0].scale: 0 makes every value 0"));
  EXPECT_THAT(Refusal("{" + good + R"(, "scale": "big"})"),
              HasSubstr("columns[0].scale: \"big\" is not a number"));
  EXPECT_THAT(Refusal("{" + good + R"(, "hold": "first"})"),
              HasSubstr("columns[0].hold: 'first', must be linear or zero_order"));
  EXPECT_THAT(Refusal(R"({"field": "x", "column": "a,b"})"),
              HasSubstr("columns[0].column: 'a,b' must be made of"));
  EXPECT_THAT(Refusal(R"({"field": ["x", "x"], "joint": ["j", "k"], "column": "velocity"})"),
              HasSubstr("columns[0].field: \"x\" is there twice"));
  EXPECT_THAT(Refusal("", ""), HasSubstr("columns: is not a list of at least one column"));
  EXPECT_THAT(Refusal("{" + good + "}", R"("time": {"column": "t", "unit": "h"}, )"),
              HasSubstr("time.unit: 'h' is not known"));
  EXPECT_THAT(Refusal("{" + good + "}", R"("manifest": {"joints": []}, )"),
              HasSubstr("manifest.joints: is written by the import"));
  EXPECT_THAT(ParseImportMap("{", "map.json").status().message(), HasSubstr("map.json: not JSON: parse error at line 1"));
  EXPECT_THAT(ParseImportMap(R"({"format": "x", "columns": []})", "map.json").status().message(),
              HasSubstr("map.json: format: 'x' is not known"));
}

// ---- columns ----

Inventory LogOfOneTopic() {
  Inventory log;
  TopicInfo info;
  info.topic = {"/a", "sensor_msgs/JointState", Encoding::kRos1, "", ""};
  info.has_header = true;
  info.names = {"slide", "elbow", "gripper"};
  log.topics.push_back(info);
  info.topic = {"/torque", "kinova_msgs/JointTorque", Encoding::kRos1, "", ""};
  info.has_header = false;
  info.names.clear();
  log.topics.push_back(info);
  return log;
}

const std::vector<RobotJoint> kRobot = {{"elbow", false, true}, {"slide", true, false}};

Result<std::vector<WantedColumn>> Resolved(const std::string& columns) {
  return ResolveColumns(ParseImportMap(Map(columns), "m").value(), "m", LogOfOneTopic(), "a.bag", kRobot);
}

TEST(ResolveColumns, AStarTakesTheRobotsJointsByTheNamesInTheMessages) {
  const auto columns =
      Resolved(R"({"topic": "/a", "field": "position[*]", "joint": "*", "column": "position"})");
  ASSERT_TRUE(columns.ok()) << columns.status().ToString();
  ASSERT_EQ(columns->size(), 2u);
  EXPECT_EQ((*columns)[0].field, "position[elbow]");
  EXPECT_EQ((*columns)[0].Name(), "position.elbow");
  EXPECT_EQ((*columns)[0].unit, "rad");
  EXPECT_EQ((*columns)[0].clock, "header");
  EXPECT_TRUE((*columns)[0].wraps);
  EXPECT_EQ((*columns)[1].unit, "m");
  EXPECT_FALSE((*columns)[1].wraps);
}

TEST(ResolveColumns, AListOfJointsIsByPlaceWhereMessagesHaveNoNames) {
  const auto columns =
      Resolved(R"({"topic": "/torque", "field": "data[*]", "joint": ["slide", "elbow"], "column": "x"})");
  ASSERT_TRUE(columns.ok()) << columns.status().ToString();
  EXPECT_EQ((*columns)[1].field, "data[1]");
  EXPECT_EQ((*columns)[1].joint, "elbow");
  EXPECT_EQ((*columns)[1].clock, "log");
}

TEST(ResolveColumns, MistakesAreOneLineWithTheEntry) {
  const auto said = [](const std::string& columns) { return Resolved(columns).status().message(); };
  EXPECT_EQ(said(R"({"topic": "/b", "field": "x", "joint": "elbow", "column": "position"})"),
            "m: columns[0].topic: a.bag has no topic '/b'");
  EXPECT_EQ(said(R"({"topic": "/a", "field": "x", "joint": "knee", "column": "position"})"),
            "m: columns[0].joint: the robot has no movable joint 'knee' (elbow, slide)");
  EXPECT_EQ(said(R"({"topic": "/a", "field": "x", "joint": "slide", "column": "position", "unit": "deg"})"),
            "m: columns[0].unit: deg is no unit of position.slide, which is in m");
  EXPECT_EQ(
      said(
          R"({"topic": "/torque", "field": "x", "joint": "elbow", "column": "position", "clock": "header"})"),
      "m: columns[0].clock: messages of /torque (kinova_msgs/JointTorque) have no header: use \"log\"");
  EXPECT_THAT(said(R"({"topic": "/a", "field": "x", "joint": "elbow", "column": "position"},
                      {"topic": "/a", "field": "y", "joint": "elbow", "column": "position"})"),
              HasSubstr("m: columns[1]: column position.elbow is mapped twice"));
  EXPECT_THAT(said(R"({"topic": "/torque", "field": "data[*]", "joint": "*", "column": "effort_command"})"),
              HasSubstr("topic /torque names none of the robot's joints (its messages hold no names"));
}

// ---- the files under deploy/examples ----

TEST(ImportMapExamples, AreAcceptedAndFitTheirRobots) {
  for (const auto& [name, urdf] :
       {std::pair{"import_mico2.json", "mico2.urdf"}, {"import_arm.json", "arm2.urdf"}}) {
    const std::string path = SourceDir() + "/deploy/examples/" + name;
    const auto text = ReadFile(path);
    ASSERT_TRUE(text.ok()) << text.status().ToString();
    const auto map = ParseImportMap(*text, path);
    ASSERT_TRUE(map.ok()) << map.status().ToString();
    const std::string urdf_path = SourceDir() + "/deploy/robots/" + urdf;
    const auto robot = RobotJoints(ReadFile(urdf_path).value(), urdf_path);
    ASSERT_TRUE(robot.ok()) << robot.status().ToString();
    for (const MapEntry& entry : map->entries) {
      for (const std::string& joint : entry.joints) {
        const bool there = joint == "*" || std::any_of(robot->begin(), robot->end(),
                                                       [&](const RobotJoint& j) { return j.name == joint; });
        EXPECT_TRUE(there) << name << ": " << joint;
      }
    }
  }
}

TEST(ImportMapSchema, HasTheKeysThatTheReaderHas) {
  const auto text = ReadFile(SourceDir() + "/deploy/examples/import_map.schema.json");
  ASSERT_TRUE(text.ok()) << text.status().ToString();
  const auto schema = nlohmann::json::parse(*text);
  const auto keys = [](const nlohmann::json& properties) {
    std::vector<std::string> names;
    for (const auto& [name, value] : properties.items()) names.push_back(name);
    return names;
  };
  EXPECT_THAT(keys(schema["properties"]), UnorderedElementsAreArray(MapKeys()));
  const auto& entry = schema["properties"]["columns"]["items"];
  EXPECT_THAT(keys(entry["properties"]), UnorderedElementsAreArray(MapEntryKeys()));
  EXPECT_EQ(schema["additionalProperties"], false);
  EXPECT_EQ(entry["additionalProperties"], false);
  for (const auto& unit : entry["properties"]["unit"]["enum"])
    EXPECT_TRUE(ParseUnit(unit.get<std::string>()).ok()) << unit;
  EXPECT_EQ(schema["properties"]["format"]["const"], kImportMapFormat);
}

}  // namespace
}  // namespace rg::importing
