#include "services/importing/mcap.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "services/importing/crc32.h"
#include "tests/support/importing/collected_log.h"
#include "tests/support/importing/log_writers.h"

namespace rg::importing {
namespace {

using test::CollectedLog;
using test::LoggedMessage;
using test::McapBytes;
using test::McapOptions;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

std::vector<LoggedMessage> Messages() {
  std::vector<LoggedMessage> messages;
  for (int64_t k = 0; k < 450; ++k) {
    const int64_t t = 1'700'000'000'000'000'000 + k * 10'000'007;
    messages.push_back({"/joint_states", "sensor_msgs/JointState", t,
                        test::CdrJointState({t - 5,
                                             {"a", "b"},
                                             {0.1 * static_cast<double>(k), -1.0 * static_cast<double>(k)},
                                             {1, 2},
                                             {3, 4}})});
    if (k % 3 == 0)
      messages.push_back({"/commands", "std_msgs/Float64MultiArray", t + 1,
                          test::CdrArray({1.0 * static_cast<double>(k), 2.0})});
  }
  return messages;
}

void ExpectAll(const CollectedLog& log) {
  const auto written = Messages();
  ASSERT_EQ(log.topics.size(), 2u);
  EXPECT_EQ(log.topics[0].type, "sensor_msgs/JointState");
  EXPECT_EQ(log.topics[1].encoding, Encoding::kCdr);
  ASSERT_EQ(log.messages.size(), written.size());
  for (size_t i = 0; i < written.size(); ++i) {
    EXPECT_EQ(log.topics[log.messages[i].topic].name, written[i].topic);
    EXPECT_EQ(log.messages[i].log_ns, written[i].log_ns);
    EXPECT_EQ(log.messages[i].bytes, written[i].bytes);
  }
}

TEST(Mcap, ReadsEveryCompressionChunkedOrNotClosedOrNot) {
  for (const char* compression : {"", "lz4", "zstd"}) {
    for (const bool chunked : {true, false}) {
      for (const bool closed : {true, false}) {
        McapOptions options;
        options.compression = compression;
        options.chunked = chunked;
        options.closed = closed;
        CollectedLog log;
        const Status status = ReadMcap(McapBytes(Messages(), options), "a.mcap", log);
        ASSERT_TRUE(status.ok()) << status.ToString();
        ExpectAll(log);
        EXPECT_EQ(log.notes.size(), closed ? 0u : 1u);
      }
    }
  }
}

TEST(Mcap, ATruncatedFileIsReadUpToTheCutWithANote) {
  for (const char* compression : {"", "lz4", "zstd"}) {
    McapOptions options;
    options.compression = compression;
    const std::string whole = McapBytes(Messages(), options);
    CollectedLog log;
    EXPECT_TRUE(ReadMcap(whole.substr(0, whole.size() / 2), "cut.mcap", log).ok());
    EXPECT_THAT(log.notes, ElementsAre(HasSubstr("cut.mcap: was not closed, or is cut at byte ")));
    EXPECT_GT(log.messages.size(), 150u);
    EXPECT_LT(log.messages.size(), 450u);
    const auto written = Messages();
    for (size_t i = 0; i < log.messages.size(); ++i) EXPECT_EQ(log.messages[i].bytes, written[i].bytes);
  }
}

TEST(Mcap, EveryCutEndsWell) {
  McapOptions options;
  options.compression = "zstd";
  const std::string whole = McapBytes(Messages(), options);
  for (size_t size = 0; size < whole.size(); size += 41) {
    CollectedLog log;
    (void)ReadMcap(whole.substr(0, size), "cut.mcap", log);
  }
}

TEST(Mcap, ADamagedChunkIsToldByItsChecksum) {
  McapOptions options;
  std::string bytes = McapBytes(Messages(), options);
  bytes[bytes.size() / 3] ^= 1;
  CollectedLog log;
  const Status status = ReadMcap(bytes, "a.mcap", log);
  EXPECT_EQ(status.code(), StatusCode::kDataLoss);
  EXPECT_THAT(status.message(), HasSubstr("chunk: its checksum does not match"));
}

TEST(Mcap, FlippedBytesNeitherCrashNorHang) {
  for (const char* compression : {"", "lz4", "zstd"}) {
    McapOptions options;
    options.compression = compression;
    options.with_crc = false;
    const std::string whole = McapBytes(Messages(), options);
    for (size_t at = 0; at < whole.size(); at += 37) {
      std::string damaged = whole;
      damaged[at] = static_cast<char>(damaged[at] ^ (1 << (at % 8)));
      CollectedLog log;
      (void)ReadMcap(damaged, "damaged.mcap", log);
    }
  }
}

TEST(Mcap, ChunksThatClaimMoreThanTheLimitAreRefused) {
  McapOptions options;
  options.compression = "zstd";
  ReadLimits limits;
  limits.max_chunk_bytes = 1000;
  CollectedLog log;
  const Status status = ReadMcap(McapBytes(Messages(), options), "bomb.mcap", log, limits);
  EXPECT_EQ(status.code(), StatusCode::kResourceExhausted);
  EXPECT_THAT(status.message(), HasSubstr("more than 1000"));
}

TEST(Mcap, AllChunksTogetherAreLimitedByTheFilesSize) {
  // Zeros shrink a thousandfold.
  const LoggedMessage zeros{"/x", "std_msgs/String", 1, std::string(1 << 20, '\0')};
  McapOptions options;
  options.compression = "zstd";
  options.messages_per_chunk = 1;
  ReadLimits limits;
  limits.max_total_bytes = 4 << 20;
  limits.max_expansion = 10;
  CollectedLog log;
  EXPECT_EQ(ReadMcap(McapBytes(std::vector<LoggedMessage>(20, zeros), options), "b.mcap", log, limits).code(),
            StatusCode::kResourceExhausted);
  EXPECT_LE(log.messages.size(), 5u);
}

TEST(Mcap, EncodingsThatAreNotReadAreListed) {
  McapOptions options;
  options.encoding = "protobuf";
  CollectedLog log;
  ASSERT_TRUE(ReadMcap(McapBytes({{"/p", "std_msgs/String", 1, "x"}}, options), "a.mcap", log).ok());
  EXPECT_EQ(log.topics[0].encoding, Encoding::kUnknown);
  EXPECT_EQ(log.topics[0].encoding_name, "protobuf");
}

TEST(Mcap, AnotherFileIsToldInOneLine) {
  CollectedLog log;
  EXPECT_EQ(ReadMcap("time,a\n", "x.csv", log).message(), "x.csv: is not an MCAP file");
  EXPECT_THAT(log.topics, IsEmpty());
}

TEST(Crc32, IsThatOfTheStandardsCheckValue) { EXPECT_EQ(Crc32("123456789"), 0xCBF43926u); }

}  // namespace
}  // namespace rg::importing
