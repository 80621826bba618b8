#include "services/importing/message_decoder.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>

#include "tests/support/importing/log_writers.h"

namespace rg::importing {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

Topic JointStateTopic(Encoding encoding) {
  return {"/joint_states", "sensor_msgs/JointState", encoding, "",
          KnownDefinition("sensor_msgs/JointState", encoding == Encoding::kCdr)};
}

const test::JointStateMessage kState{
    1'700'000'123'000'000'456, {"arm_a", "b", "longer_name"}, {0.25, -1.5, 3.0}, {}, {7.0, 8.0, 9.5}};

std::string StateBytes(Encoding encoding) {
  return encoding == Encoding::kCdr ? test::CdrJointState(kState) : test::Ros1JointState(kState);
}

std::vector<FieldValue> Decoded(const Topic& topic, const std::string& bytes,
                                const std::vector<std::string>& paths) {
  const auto decoder = MessageDecoder::Make(topic, paths);
  EXPECT_TRUE(decoder.ok()) << decoder.status().ToString();
  std::vector<FieldValue> values;
  const Status status = decoder->Decode(bytes, &values);
  EXPECT_TRUE(status.ok()) << status.ToString();
  return values;
}

TEST(MessageDecoder, ReadsFieldsByPlaceByNameAndWholeOffBothSerialisations) {
  for (const Encoding encoding : {Encoding::kRos1, Encoding::kCdr}) {
    const auto v =
        Decoded(JointStateTopic(encoding), StateBytes(encoding),
                {"effort[longer_name]", "header.stamp", "position[0]", "position[b]", "position", "name[*]",
                 "velocity[0]", "effort[2]", "position[nobody]", "header.frame_id", "effort[9]"});
    EXPECT_EQ(v[0].number, 9.5);
    EXPECT_EQ(v[1].time_ns, kState.stamp_ns);
    EXPECT_EQ(v[2].number, 0.25);
    EXPECT_EQ(v[3].number, -1.5);
    EXPECT_THAT(v[4].numbers, ElementsAre(0.25, -1.5, 3.0));
    EXPECT_THAT(v[5].texts, ElementsAre("arm_a", "b", "longer_name"));
    EXPECT_FALSE(v[6].present);
    EXPECT_EQ(v[7].number, 9.5);
    EXPECT_FALSE(v[8].present);
    EXPECT_THAT(v[9].texts, ElementsAre("base"));
    EXPECT_FALSE(v[10].present);
  }
}

TEST(MessageDecoder, ReadsKinovasMessagesWithoutAStamp) {
  const Topic topic{"/in/joint_torque", "kinova_msgs/JointTorque", Encoding::kRos1, "",
                    KnownDefinition("kinova_msgs/JointTorque", false)};
  const auto v =
      Decoded(topic, test::Ros1Floats({1.5f, -2.0f, 3.0f, 0.f, 0.f, 6.25f, 0.f}), {"joint6", "joint1"});
  EXPECT_EQ(v[0].number, 6.25);
  EXPECT_EQ(v[1].number, 1.5);
}

// float64 after a byte and a text: alignment is what differs.
constexpr const char* kOddDefinition =
    "# a comment\nuint8 KIND = 3\nstring NAME=with # sign\nbool on\nfloat32[3] three  # inline\nPart[] "
    "parts\n"
    "int8 small -3\nfloat64 last\n"
    "================================================================================\n"
    "MSG: odd_msgs/Part\nuint8 id\nfloat64 value\nstring[] names\nint16[<=4] counts\n";

TEST(MessageDecoder, WalksNestedMessagesConstantsDefaultsAndAlignment) {
  const auto types = ParseDefinition("odd_msgs/Odd", kOddDefinition, true);
  ASSERT_TRUE(types.ok()) << types.status().ToString();
  ASSERT_EQ(types->root().fields.size(), 5u);
  const std::string bytes(
      "\x00\x01\x00\x00"                                  // little endian
      "\x01\x00\x00\x00"                                  // on, padding
      "\x00\x00\x80\x3f\x00\x00\x00\x40\x00\x00\x40\x40"  // 1, 2, 3
      "\x01\x00\x00\x00"                                  // one part, at 16
      "\x07\x00\x00\x00"                                  // its id at 20, padding to 24
      "\x00\x00\x00\x00\x00\x00\xf8\x3f"                  // 1.5
      "\x01\x00\x00\x00\x03\x00\x00\x00hi\x00\x00"        // names: "hi", padding
      "\x02\x00\x00\x00\x05\x00\xfb\xff"                  // counts 5, -5
      "\xfe\x00\x00\x00"                                  // small -2 at 52, padding
      "\x00\x00\x00\x00\x00\x00\x04\x40",                 // 2.5
      4 + 4 + 12 + 4 + 4 + 8 + 12 + 8 + 4 + 8);
  const Topic topic{"/odd", "odd_msgs/Odd", Encoding::kCdr, "cdr", kOddDefinition};
  const auto v = Decoded(topic, bytes,
                         {"three[1]", "parts[0].value", "parts[0].counts[1]", "small", "last", "on",
                          "parts[0].id", "parts[1].value"});
  EXPECT_EQ(v[0].number, 2.0);
  EXPECT_EQ(v[1].number, 1.5);
  EXPECT_EQ(v[2].number, -5.0);
  EXPECT_EQ(v[3].number, -2.0);
  EXPECT_EQ(v[4].number, 2.5);
  EXPECT_EQ(v[5].number, 1.0);
  EXPECT_EQ(v[6].number, 7.0);
  EXPECT_FALSE(v[7].present);
}

TEST(MessageDecoder, NamesOfTheNearestListCount) {
  const Topic topic{"/dynamic_joint_states", "control_msgs/DynamicJointState", Encoding::kRos1, "",
                    KnownDefinition("control_msgs/DynamicJointState", false)};
  std::string bytes;
  const auto number = [&](auto x) { bytes.append(reinterpret_cast<const char*>(&x), sizeof x); };
  const auto text = [&](const std::string& s) {
    number(static_cast<uint32_t>(s.size()));
    bytes += s;
  };
  number(uint32_t{0}), number(uint32_t{5}), number(uint32_t{6}), text("");
  number(uint32_t{2}), text("elbow"), text("wrist");
  number(uint32_t{2});
  for (const double base : {10.0, 20.0}) {
    number(uint32_t{2}), text("position"), text("effort");
    number(uint32_t{2}), number(base + 1), number(base + 2);
  }
  const auto v = Decoded(
      topic, bytes, {"interface_values[wrist].values[effort]", "interface_values[elbow].values[position]"});
  EXPECT_EQ(v[0].number, 22.0);
  EXPECT_EQ(v[1].number, 11.0);
}

TEST(MessageDecoder, BigEndianCdrIsRead) {
  const std::string bytes(
      "\x00\x00\x00\x00"
      "\x40\x04\x00\x00\x00\x00\x00\x00",
      12);
  const auto v = Decoded({"/x", "std_msgs/Float64", Encoding::kCdr, "cdr", ""}, bytes, {"data"});
  EXPECT_EQ(v[0].number, 2.5);
}

TEST(MessageDecoder, WhatAPathCannotMeanIsToldWithTheTopic) {
  const Topic topic = JointStateTopic(Encoding::kRos1);
  const auto said = [&](const std::string& path) {
    return MessageDecoder::Make(topic, {path}).status().message();
  };
  EXPECT_EQ(
      said("positon[0]"),
      "topic /joint_states: field 'positon[0]': sensor_msgs/JointState has no field 'positon' (header, name, "
      "position, velocity, effort)");
  EXPECT_THAT(said("header"), HasSubstr("is no number (it holds seq, stamp, frame_id)"));
  EXPECT_THAT(said("header[2].seq"), HasSubstr("header is no list"));
  EXPECT_THAT(said("position[1].x"), HasSubstr("position has no fields of its own"));
  EXPECT_THAT(said("position["), HasSubstr("is no path"));
  const Topic unknown{"/y", "my_msgs/Secret", Encoding::kCdr, "cdr", ""};
  EXPECT_THAT(MessageDecoder::Make(unknown, {"x"}).status().message(),
              HasSubstr("topic /y: definition of 'my_msgs/Secret': is not in the file"));
}

TEST(MessageDecoder, BytesThatEndEarlyOrClaimTooMuchAreRefused) {
  for (const Encoding encoding : {Encoding::kRos1, Encoding::kCdr}) {
    const auto decoder = MessageDecoder::Make(JointStateTopic(encoding), {"effort[0]", "name"});
    ASSERT_TRUE(decoder.ok());
    const std::string whole = StateBytes(encoding);
    std::vector<FieldValue> values;
    for (size_t size = 0; size < whole.size() - 8; ++size) {
      EXPECT_FALSE(decoder->Decode(whole.substr(0, size), &values).ok()) << size;
    }
    for (size_t at = 0; at < whole.size(); ++at) {
      std::string damaged = whole;
      damaged[at] = '\xff';
      (void)decoder->Decode(damaged, &values);
    }
  }
}

TEST(MessageDecoder, EmptyMessagesNestedManyTimesDoNotHang) {
  // Sixteen levels of a hundred empty fields each would be walked 100^16 times.
  std::string text = "L1 a\n";
  for (int level = 1; level <= 14; ++level) {
    text += "===\nMSG: evil/L" + std::to_string(level) + "\n";
    for (int k = 0; k < 100; ++k) text += "L" + std::to_string(level + 1) + " f" + std::to_string(k) + "\n";
  }
  text += "===\nMSG: evil/L15\nuint8[0] nothing\n";
  text = "L1 a\nfloat64 x\n" + text.substr(5);
  const Topic topic{"/evil", "evil/Root", Encoding::kRos1, "ros1", text};
  const auto decoder = MessageDecoder::Make(topic, {"x"});
  ASSERT_TRUE(decoder.ok()) << decoder.status().ToString();
  std::vector<FieldValue> values;
  const auto start = std::chrono::steady_clock::now();
  EXPECT_FALSE(decoder->Decode("12345678", &values).ok());
  EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::seconds(1));
}

TEST(MessageDefinition, TypesThatContainThemselvesAndTextThatIsNoneAreRefused) {
  EXPECT_THAT(ParseDefinition("a/A", "A again\n", false).status().message(), HasSubstr("contains itself"));
  EXPECT_THAT(ParseDefinition("a/A", "float64\n", false).status().message(),
              HasSubstr("'float64' is no field"));
  EXPECT_THAT(ParseDefinition("a/A", "float64[x] y\n", false).status().message(), HasSubstr("is no array"));
  EXPECT_THAT(ParseDefinition("a/A", "B b\n", false).status().message(), HasSubstr("is not in the file"));
}

TEST(MessageDefinition, EveryKnownTypeParsesAsBothRosesHaveIt) {
  for (const char* type :
       {"std_msgs/Header", "sensor_msgs/JointState", "std_msgs/Float64MultiArray", "std_msgs/String",
        "trajectory_msgs/JointTrajectory", "control_msgs/JointTrajectoryControllerState",
        "control_msgs/DynamicJointState", "geometry_msgs/WrenchStamped", "kinova_msgs/JointAngles"}) {
    for (const bool ros2 : {false, true}) {
      const auto types = ParseDefinition(type, KnownDefinition(type, ros2), ros2);
      EXPECT_TRUE(types.ok()) << type << ": " << types.status().ToString();
    }
  }
  const auto header = ParseDefinition("std_msgs/Header", "", true);
  EXPECT_EQ(header->root().fields.size(), 2u);  // no seq
}

}  // namespace
}  // namespace rg::importing
