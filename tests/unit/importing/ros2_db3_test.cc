#include "services/importing/ros2_db3.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sqlite3.h>

#include "common/base/file.h"
#include "services/importing/log_file.h"
#include "tests/support/importing/collected_log.h"
#include "tests/support/importing/log_writers.h"

namespace rg::importing {
namespace {

using test::CollectedLog;
using test::Db3Options;
using test::LoggedMessage;
using test::TemporaryFolder;
using ::testing::HasSubstr;

std::vector<LoggedMessage> Messages(int count, int64_t start = 0) {
  std::vector<LoggedMessage> messages;
  for (int k = 0; k < count; ++k) {
    const int64_t t = 1'700'000'000'000'000'000 + start + int64_t{k} * 10'000'007;
    messages.push_back({"/joint_states", "sensor_msgs/JointState", t,
                        test::CdrJointState({t - 5,
                                             {"a", "b"},
                                             {0.1 * static_cast<double>(k), -1.0 * static_cast<double>(k)},
                                             {1, 2},
                                             {3, 4}})});
  }
  return messages;
}

void Sql(const std::string& path, const char* sql) {
  sqlite3* database = nullptr;
  ASSERT_EQ(sqlite3_open(path.c_str(), &database), SQLITE_OK);
  ASSERT_EQ(sqlite3_exec(database, sql, nullptr, nullptr, nullptr), SQLITE_OK) << sqlite3_errmsg(database);
  sqlite3_close(database);
}

TEST(Db3, ReadsMessagesOfOldAndNewFilesAndCompressedOnes) {
  const TemporaryFolder folder;
  const auto written = Messages(300);
  for (const auto& [definitions, zstd] : {std::pair{false, false}, {true, false}, {true, true}}) {
    Db3Options options;
    options.with_definitions = definitions;
    options.zstd_messages = zstd;
    WriteDb3File(folder / "a.db3", written, options);
    CollectedLog log;
    const Status status = ReadDb3(folder / "a.db3", zstd, log);
    ASSERT_TRUE(status.ok()) << status.ToString();
    ASSERT_EQ(log.topics.size(), 1u);
    EXPECT_EQ(log.topics[0].type, "sensor_msgs/JointState");
    EXPECT_EQ(log.topics[0].definition.empty(), !definitions);
    ASSERT_EQ(log.messages.size(), written.size());
    for (size_t i = 0; i < written.size(); ++i) {
      EXPECT_EQ(log.messages[i].log_ns, written[i].log_ns);
      EXPECT_EQ(log.messages[i].bytes, written[i].bytes);
    }
  }
}

TEST(Db3, BytesInMemoryReadAsTheFileDoes) {
  const TemporaryFolder folder;
  WriteDb3File(folder / "a.db3", Messages(50), {});
  CollectedLog log;
  const std::string bytes = ReadFile(folder / "a.db3").value();
  ASSERT_TRUE(ReadDb3Bytes(bytes, "a.db3", false, log).ok());
  EXPECT_EQ(log.messages.size(), 50u);
}

TEST(Db3, FlippedBytesAndCutsNeitherCrashNorHang) {
  const TemporaryFolder folder;
  WriteDb3File(folder / "a.db3", Messages(40), {});
  const std::string whole = ReadFile(folder / "a.db3").value();
  for (size_t at = 0; at < whole.size(); at += 61) {
    std::string damaged = whole;
    damaged[at] = static_cast<char>(damaged[at] ^ (1 << (at % 8)));
    CollectedLog log;
    (void)ReadDb3Bytes(damaged, "damaged.db3", false, log);
    (void)ReadDb3Bytes(whole.substr(0, at), "cut.db3", false, log);
  }
}

TEST(Db3, AViewThatNeverEndsIsNoTable) {
  const TemporaryFolder folder;
  Sql(folder / "evil.db3",
      "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT, type TEXT, serialization_format TEXT);"
      "CREATE VIEW messages AS WITH RECURSIVE c(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM c) "
      "SELECT x AS topic_id, x AS timestamp, x AS data FROM c");
  CollectedLog log;
  EXPECT_THAT(ReadDb3(folder / "evil.db3", false, log).message(), HasSubstr("without a table 'messages'"));
}

TEST(Db3, OtherDatabasesAndTopicsThatAreMissingAreToldInOneLine) {
  const TemporaryFolder folder;
  Sql(folder / "other.db3", "CREATE TABLE a(x)");
  CollectedLog log;
  EXPECT_THAT(ReadDb3(folder / "other.db3", false, log).message(),
              HasSubstr("other.db3: an SQLite file without a table 'topics': not a ROS 2 bag"));
  WriteDb3File(folder / "a.db3", Messages(3), {});
  Sql(folder / "a.db3", "UPDATE messages SET topic_id = 7 WHERE id = 2");
  EXPECT_THAT(ReadDb3(folder / "a.db3", false, log).message(),
              HasSubstr("messages: row 2: topic_id 7 is not in topics"));
}

constexpr const char* kMetadata = R"(rosbag2_bagfile_information:
  version: 5
  storage_identifier: sqlite3
  relative_file_paths:
    - run_0.db3
    - run_1.db3
  duration:
    nanoseconds: 10
  topics_with_message_count:
    - topic_metadata:
        name: /joint_states
  compression_format: ""
  compression_mode: ""
)";

TEST(LogFile, AFolderOfSeveralPartsIsOneLogInTheirOrder) {
  const TemporaryFolder folder;
  WriteDb3File(folder / "run_1.db3", Messages(20, 1'000'000'000), {});
  WriteDb3File(folder / "run_0.db3", Messages(30), {});
  WriteDb3File(folder / "stray.db3", Messages(5), {});
  ASSERT_TRUE(WriteFileAtomically(folder / "metadata.yaml", kMetadata).ok());
  const auto file = OpenLog(folder / "");
  ASSERT_TRUE(file.ok()) << file.status().ToString();
  CollectedLog log;
  ASSERT_TRUE(ReadLog(*file, log).ok());
  EXPECT_EQ(log.topics.size(), 1u);
  ASSERT_EQ(log.messages.size(), 50u);
  EXPECT_LT(log.messages[29].log_ns, log.messages[30].log_ns);
}

TEST(LogFile, ContainersAreToldByTheirBytes) {
  const TemporaryFolder folder;
  const auto container = [&](const std::string& bytes) {
    EXPECT_TRUE(WriteFileAtomically(folder / "x", bytes).ok());
    return ContainerOf(folder / "x");
  };
  EXPECT_EQ(*container(test::McapBytes({})), Container::kMcap);
  EXPECT_EQ(*container("#ROSBAG V2.0\n"), Container::kRos1Bag);
  EXPECT_EQ(*container("\xEF\xBB\xBFtime,größe\r\n"), Container::kCsv);
  EXPECT_THAT(container(std::string("\x7f"
                                    "ELF\x01\x00",
                                    6))
                  .status()
                  .message(),
              HasSubstr("is no ROS 1 bag, ROS 2 bag, MCAP file or CSV"));
  EXPECT_THAT(container("\x28\xB5\x2F\xFD....").status().message(), HasSubstr("run 'zstd -d "));
  EXPECT_EQ(OpenLog(folder / "missing.bag").status().code(), StatusCode::kNotFound);
}

}  // namespace
}  // namespace rg::importing
