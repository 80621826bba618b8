// What a file of messages holds, whatever its container: topics with types, and messages with times.
//
// Readers hand topics and messages to a LogSink one by one, in the order of the file, and keep nothing;
// a message's bytes are valid during the call only. Files are untrusted: a reader checks every length
// against what is there, and its memory is bounded by ReadLimits.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.h"

namespace rg::importing {

enum class Encoding {
  kRos1,     // ROS 1 serialisation: little endian, packed
  kCdr,      // OMG CDR with its four bytes of encapsulation, as ROS 2 writes
  kUnknown,  // listed, never decoded
};

struct Topic {
  std::string name;  // "/joint_states"
  std::string type;  // "sensor_msgs/JointState", without ROS 2's "/msg/"
  Encoding encoding = Encoding::kUnknown;
  std::string encoding_name;  // as the file says it: "cdr", "protobuf"
  std::string definition;     // the message definition's text; empty where the file has none
};

struct Message {
  size_t topic = 0;  // number of an OnTopic call
  int64_t log_ns = 0;
  std::string_view bytes;
};

class LogSink {
 public:
  virtual ~LogSink() = default;
  // Topics are numbered 0, 1, … in the order of these calls. A topic comes before its first message.
  virtual Status OnTopic(const Topic& topic) = 0;
  // What is not Ok ends the reading and is returned by the reader.
  virtual Status OnMessage(const Message& message) = 0;
  // One line on what was odd and left out: a file that ends in the middle of a record.
  virtual void OnNote(const std::string& note) = 0;
  // Bytes of the file that are done with.
  virtual void OnProgress(uint64_t done, uint64_t total) {
    (void)done;
    (void)total;
  }
};

struct ReadLimits {
  uint64_t max_chunk_bytes = uint64_t{256} << 20;  // of one chunk, decompressed
  // Of all chunks together: this, and so many times the file's size.
  uint64_t max_total_bytes = uint64_t{256} << 20;
  uint64_t max_expansion = 200;
  size_t max_topics = 4096;
  size_t max_definition_bytes = 4 << 20;  // of all topics together
};

// ROS 2's "sensor_msgs/msg/JointState" as "sensor_msgs/JointState".
std::string PlainTypeName(std::string_view type);

// Numbers topics for a reader: equal ones get one number, and are told to the sink once.
class TopicTable {
 public:
  TopicTable(LogSink& sink, const ReadLimits& limits) : sink_(sink), limits_(limits) {}
  Result<size_t> Add(const Topic& topic);

 private:
  LogSink& sink_;
  const ReadLimits& limits_;
  std::vector<Topic> topics_;
  size_t definition_bytes_ = 0;
};

// Text of an untrusted file for a message: short and printable.
std::string Shown(std::string_view text);

}  // namespace rg::importing
