#include "services/importing/ros1_bag.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/base/file.h"
#include "tests/support/importing/collected_log.h"
#include "tests/support/importing/log_writers.h"

namespace rg::importing {
namespace {

using test::BagCompression;
using test::CollectedLog;
using test::LoggedMessage;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

// Two topics, enough for several chunks of 16 KB.
std::vector<LoggedMessage> ThousandMessages() {
  std::vector<LoggedMessage> messages;
  for (int k = 0; k < 500; ++k) {
    const int64_t t = 1'700'000'000'000'000'000 + int64_t{k} * 10'000'007;
    messages.push_back({"/joint_states", "sensor_msgs/JointState", t,
                        test::Ros1JointState({t - 5,
                                              {"a", "b"},
                                              {0.1 * static_cast<double>(k), -1.0 * static_cast<double>(k)},
                                              {1, 2},
                                              {3, 4}})});
    messages.push_back({"/note", "std_msgs/String", t + 1, test::Ros1Text("message " + std::to_string(k))});
  }
  return messages;
}

std::string BagBytes(BagCompression compression) {
  const test::TemporaryFolder folder;
  test::WriteRos1BagFile(folder / "a.bag", ThousandMessages(), compression);
  return ReadFile(folder / "a.bag").value();
}

void ExpectAllThousand(const CollectedLog& log) {
  const auto written = ThousandMessages();
  ASSERT_EQ(log.topics.size(), 2u);
  EXPECT_EQ(log.topics[0].name, "/joint_states");
  EXPECT_EQ(log.topics[0].type, "sensor_msgs/JointState");
  EXPECT_THAT(log.topics[0].definition, HasSubstr("float64[] effort"));
  ASSERT_EQ(log.messages.size(), written.size());
  for (size_t i = 0; i < written.size(); ++i) {
    EXPECT_EQ(log.topics[log.messages[i].topic].name, written[i].topic);
    EXPECT_EQ(log.messages[i].log_ns, written[i].log_ns);
    EXPECT_EQ(log.messages[i].bytes, written[i].bytes);
  }
}

TEST(Ros1Bag, ReadsWhatLibrosbagWroteInEveryCompression) {
  for (const auto compression : {BagCompression::kNone, BagCompression::kLz4, BagCompression::kBz2}) {
    CollectedLog log;
    ASSERT_EQ(ReadRos1Bag(BagBytes(compression), "a.bag", log).ToString(), Status::Ok().ToString());
    ExpectAllThousand(log);
    EXPECT_THAT(log.notes, IsEmpty());
  }
}

TEST(Ros1Bag, ACutBagIsReadUpToTheCutWithANote) {
  for (const auto compression : {BagCompression::kNone, BagCompression::kLz4}) {
    const std::string whole = BagBytes(compression);
    size_t before = 0;
    for (const double share : {0.2, 0.5, 0.7, 0.9, 0.99}) {
      CollectedLog log;
      const auto bytes = whole.substr(0, static_cast<size_t>(share * static_cast<double>(whole.size())));
      EXPECT_TRUE(ReadRos1Bag(bytes, "cut.bag", log).ok());
      EXPECT_THAT(log.notes, ElementsAre(HasSubstr("cut.bag: ends in the middle of the record at byte ")));
      EXPECT_GE(log.messages.size(), before);
      before = log.messages.size();
      const auto written = ThousandMessages();
      for (size_t i = 0; i < log.messages.size(); ++i) EXPECT_EQ(log.messages[i].bytes, written[i].bytes);
    }
    EXPECT_GT(before, 500u);
  }
}

TEST(Ros1Bag, EveryCutOfASmallBagEndsWell) {
  std::string whole = BagBytes(BagCompression::kLz4);
  for (size_t size = 0; size < whole.size(); size += 97) {
    CollectedLog log;
    (void)ReadRos1Bag(whole.substr(0, size), "cut.bag", log);
  }
}

TEST(Ros1Bag, FlippedBytesNeitherCrashNorHang) {
  // librosbag-storage follows such indexes out of its buffers.
  const std::string whole = BagBytes(BagCompression::kNone);
  for (size_t at = 0; at < whole.size(); at += 13) {
    std::string damaged = whole;
    damaged[at] = static_cast<char>(damaged[at] ^ (1 << (at % 8)));
    CollectedLog log;
    const Status status = ReadRos1Bag(damaged, "damaged.bag", log);
    if (!status.ok()) {
      EXPECT_THAT(status.message(), HasSubstr("damaged.bag"));
    }
  }
}

TEST(Ros1Bag, OtherFilesAndOtherVersionsAreToldInOneLine) {
  CollectedLog log;
  EXPECT_THAT(ReadRos1Bag("time,a\n", "x.csv", log).message(), "x.csv: is not a ROS 1 bag");
  EXPECT_THAT(ReadRos1Bag("#ROSBAG V1.2\n...", "old.bag", log).message(),
              HasSubstr("old.bag: bag format '1.2', this program reads 2.0"));
}

TEST(Ros1Bag, AChunkThatClaimsTooMuchIsRefusedWithoutTakingTheMemory) {
  std::string bytes = BagBytes(BagCompression::kLz4);
  const size_t size_field = bytes.find("size=");
  ASSERT_NE(size_field, std::string::npos);
  bytes.replace(size_field + 5, 4, "\xff\xff\xff\x7f");
  CollectedLog log;
  const Status status = ReadRos1Bag(bytes, "bomb.bag", log);
  EXPECT_EQ(status.code(), StatusCode::kResourceExhausted);
  EXPECT_THAT(status.message(), HasSubstr("would be 2147483647 bytes"));
}

}  // namespace
}  // namespace rg::importing
