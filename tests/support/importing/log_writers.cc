#include "tests/support/importing/log_writers.h"

#include <fastcdr/Cdr.h>
#include <fastcdr/FastBuffer.h>
#include <lz4frame.h>
#include <sqlite3.h>
#include <zstd.h>

#include <cstdio>
#include <map>
#include <stdexcept>

#include "services/importing/crc32.h"
#include "services/importing/message_definition.h"

namespace rg::test {
namespace {

constexpr int64_t kNsPerSecond = 1'000'000'000;

// Little endian, packed.
class Bytes {
 public:
  template <class T>
  Bytes& Add(T value) {
    bytes_.append(reinterpret_cast<const char*>(&value), sizeof value);
    return *this;
  }
  Bytes& Text(const std::string& text) {
    Add(static_cast<uint32_t>(text.size()));
    bytes_ += text;
    return *this;
  }
  Bytes& Doubles(const std::vector<double>& values) {
    Add(static_cast<uint32_t>(values.size()));
    for (const double value : values) Add(value);
    return *this;
  }
  Bytes& Raw(const std::string& bytes) {
    bytes_ += bytes;
    return *this;
  }
  const std::string& get() const { return bytes_; }

 private:
  std::string bytes_;
};

std::string CdrMessage(auto&& write) {
  std::string zeros(1 << 16, '\0');  // Fast CDR leaves the bytes it aligns over as they are
  eprosima::fastcdr::FastBuffer buffer(zeros.data(), zeros.size());
  eprosima::fastcdr::Cdr cdr(buffer, eprosima::fastcdr::Cdr::DEFAULT_ENDIAN, eprosima::fastcdr::Cdr::DDS_CDR);
  cdr.serialize_encapsulation();
  write(cdr);
  return {buffer.getBuffer(), cdr.getSerializedDataLength()};
}

std::string DefinitionOf(const LoggedMessage& m, bool ros2) {
  return m.definition.empty() ? importing::KnownDefinition(m.type, ros2) : m.definition;
}

// "sensor_msgs/JointState" as ROS 2 writes it.
std::string Ros2Type(const std::string& type) {
  std::string name = type;
  return name.insert(name.find('/'), "/msg");
}

std::string Compressed(const std::string& compression, const std::string& bytes) {
  if (compression.empty()) return bytes;
  std::string out(compression == "lz4" ? LZ4F_compressFrameBound(bytes.size(), nullptr)
                                       : ZSTD_compressBound(bytes.size()),
                  '\0');
  const size_t size = compression == "lz4"
                          ? LZ4F_compressFrame(out.data(), out.size(), bytes.data(), bytes.size(), nullptr)
                          : ZSTD_compress(out.data(), out.size(), bytes.data(), bytes.size(), 3);
  out.resize(size);
  return out;
}

std::string Record(uint8_t opcode, const std::string& content) {
  return Bytes().Add(opcode).Add(static_cast<uint64_t>(content.size())).Raw(content).get();
}

void Run(sqlite3* database, const std::string& sql) {
  char* error = nullptr;
  if (sqlite3_exec(database, sql.c_str(), nullptr, nullptr, &error) != SQLITE_OK)
    throw std::runtime_error(error);
}

}  // namespace

std::string Ros1JointState(const JointStateMessage& m) {
  Bytes bytes;
  bytes.Add(uint32_t{0}).Add(static_cast<uint32_t>(m.stamp_ns / kNsPerSecond));
  bytes.Add(static_cast<uint32_t>(m.stamp_ns % kNsPerSecond)).Text("base");
  bytes.Add(static_cast<uint32_t>(m.names.size()));
  for (const std::string& name : m.names) bytes.Text(name);
  return bytes.Doubles(m.position).Doubles(m.velocity).Doubles(m.effort).get();
}

std::string CdrJointState(const JointStateMessage& m) {
  return CdrMessage([&](auto& cdr) {
    cdr << static_cast<int32_t>(m.stamp_ns / kNsPerSecond)
        << static_cast<uint32_t>(m.stamp_ns % kNsPerSecond);
    cdr << std::string("base") << m.names << m.position << m.velocity << m.effort;
  });
}

std::string Ros1Floats(const std::vector<float>& values) {
  Bytes bytes;
  for (const float value : values) bytes.Add(value);
  return bytes.get();
}

std::string Ros1Array(const std::vector<double>& values) {
  return Bytes().Add(uint32_t{0}).Add(uint32_t{0}).Doubles(values).get();
}

std::string CdrArray(const std::vector<double>& values) {
  return CdrMessage([&](auto& cdr) { cdr << uint32_t{0} << uint32_t{0} << values; });
}

std::string Ros1Text(const std::string& text) { return Bytes().Text(text).get(); }
std::string Ros1Double(double value) { return Bytes().Add(value).get(); }

std::string McapBytes(const std::vector<LoggedMessage>& messages, const McapOptions& options) {
  std::string file("\x89MCAP0\r\n", 8);
  file += Record(1, Bytes().Text("").Text("test").get());
  std::map<std::string, uint16_t> channels;
  std::string chunk;
  size_t in_chunk = 0;
  const auto close_chunk = [&] {
    if (chunk.empty()) return;
    if (options.chunked) {
      Bytes content;
      content.Add(uint64_t{0}).Add(uint64_t{0}).Add(static_cast<uint64_t>(chunk.size()));
      content.Add(options.with_crc ? importing::Crc32(chunk) : uint32_t{0}).Text(options.compression);
      const std::string packed = Compressed(options.compression, chunk);
      chunk = Record(6, content.Add(static_cast<uint64_t>(packed.size())).Raw(packed).get());
    }
    file += chunk;
    chunk.clear();
    in_chunk = 0;
  };
  for (const LoggedMessage& m : messages) {
    auto channel = channels.find(m.topic);
    if (channel == channels.end()) {
      const bool ros2 = options.encoding == "cdr";
      const auto id = static_cast<uint16_t>(channels.size() + 1);
      channel = channels.emplace(m.topic, id).first;
      Bytes schema, about;
      schema.Add(id).Text(ros2 ? Ros2Type(m.type) : m.type).Text(ros2 ? "ros2msg" : "ros1msg");
      chunk += Record(3, schema.Text(DefinitionOf(m, ros2)).get());
      about.Add(id).Add(id).Text(m.topic).Text(options.encoding).Add(uint32_t{0});
      chunk += Record(4, about.get());
    }
    Bytes content;
    content.Add(channel->second).Add(uint32_t{0}).Add(static_cast<uint64_t>(m.log_ns));
    chunk += Record(5, content.Add(static_cast<uint64_t>(m.log_ns)).Raw(m.bytes).get());
    if (++in_chunk == options.messages_per_chunk) close_chunk();
  }
  close_chunk();
  if (!options.closed) return file;
  file += Record(0x0F, Bytes().Add(uint32_t{0}).get());
  file += Record(2, Bytes().Add(uint64_t{0}).Add(uint64_t{0}).Add(uint32_t{0}).get());
  return file + std::string("\x89MCAP0\r\n", 8);
}

void WriteDb3File(const std::string& path, const std::vector<LoggedMessage>& messages,
                  const Db3Options& options) {
  std::remove(path.c_str());
  sqlite3* database = nullptr;
  if (sqlite3_open(path.c_str(), &database) != SQLITE_OK) throw std::runtime_error(path);
  Run(database,
      "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, "
      "serialization_format TEXT "
      "NOT NULL, offered_qos_profiles TEXT NOT NULL);"
      "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, "
      "data BLOB "
      "NOT NULL); CREATE INDEX timestamp_idx ON messages (timestamp ASC); BEGIN");
  if (options.with_definitions) {
    Run(database,
        "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT "
        "NOT NULL, "
        "encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL)");
  }
  std::map<std::string, int> topics;
  sqlite3_stmt* insert = nullptr;
  sqlite3_prepare_v2(database, "INSERT INTO messages(topic_id, timestamp, data) VALUES(?, ?, ?)", -1, &insert,
                     nullptr);
  for (const LoggedMessage& m : messages) {
    const auto [topic, is_new] = topics.emplace(m.topic, static_cast<int>(topics.size()) + 1);
    if (is_new) {
      Run(database, "INSERT INTO topics VALUES(" + std::to_string(topic->second) + ", '" + m.topic + "', '" +
                        Ros2Type(m.type) + "', 'cdr', '')");
      if (options.with_definitions) {
        Run(database,
            "INSERT INTO message_definitions(topic_type, encoding, encoded_message_definition, "
            "type_description_hash) VALUES('" +
                Ros2Type(m.type) + "', 'ros2msg', '" + DefinitionOf(m, true) + "', '')");
      }
    }
    const std::string data = options.zstd_messages ? Compressed("zstd", m.bytes) : m.bytes;
    sqlite3_bind_int(insert, 1, topic->second);
    sqlite3_bind_int64(insert, 2, m.log_ns);
    sqlite3_bind_blob(insert, 3, data.data(), static_cast<int>(data.size()), SQLITE_TRANSIENT);
    sqlite3_step(insert);
    sqlite3_reset(insert);
  }
  sqlite3_finalize(insert);
  Run(database, "COMMIT");
  sqlite3_close(database);
}

}  // namespace rg::test
