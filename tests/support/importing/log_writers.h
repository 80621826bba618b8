// Writes logs as other programs do, for tests of the readers: ROS 1 bags by librosbag-storage, messages of
// ROS 2 by Fast CDR, ROS 2 bags by SQLite, MCAP files by hand with chunks of liblz4 and libzstd.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace rg::test {

struct LoggedMessage {
  std::string topic, type;
  int64_t log_ns = 0;
  std::string bytes;
  std::string definition = "";  // empty: the type's own, where the program knows it
};

// ---- messages ----

struct JointStateMessage {
  int64_t stamp_ns = 0;
  std::vector<std::string> names;
  std::vector<double> position, velocity, effort;
};

std::string Ros1JointState(const JointStateMessage& message);
std::string CdrJointState(const JointStateMessage& message);
std::string Ros1Floats(const std::vector<float>& values);  // kinova_msgs: joint1, joint2, …
std::string Ros1Array(const std::vector<double>& values);  // std_msgs/Float64MultiArray without a layout
std::string CdrArray(const std::vector<double>& values);
std::string Ros1Text(const std::string& text);
std::string Ros1Double(double value);

// ---- files ----

enum class BagCompression { kNone, kLz4, kBz2 };
// Small chunks, so that a bag has several.
void WriteRos1BagFile(const std::string& path, const std::vector<LoggedMessage>& messages,
                      BagCompression compression = BagCompression::kNone);

// What librosbag-storage itself reads, in order of time.
std::vector<LoggedMessage> ReadByRosbag(const std::string& path);

struct McapOptions {
  std::string compression = "";  // "", "lz4", "zstd"
  bool chunked = true;
  bool closed = true;  // data end, summary, footer, magic
  bool with_crc = true;
  std::string encoding = "cdr";  // "ros1"
  size_t messages_per_chunk = 100;
};
std::string McapBytes(const std::vector<LoggedMessage>& messages, const McapOptions& options = {});

struct Db3Options {
  bool with_definitions = false;  // the table of newer files
  bool zstd_messages = false;
};
void WriteDb3File(const std::string& path, const std::vector<LoggedMessage>& messages,
                  const Db3Options& options = {});

}  // namespace rg::test
