#include "services/importing/mcap.h"

#include <map>

#include "services/importing/byte_cursor.h"
#include "services/importing/crc32.h"
#include "services/importing/decompress.h"

namespace rg::importing {
namespace {

constexpr std::string_view kMcapMagic("\x89MCAP0\r\n", 8);

enum Opcode : uint8_t { kSchema = 3, kChannel = 4, kMessage = 5, kChunk = 6, kDataEnd = 0x0F, kFooter = 2 };

struct Schema {
  std::string name, encoding, data;
};

Encoding EncodingOf(std::string_view message_encoding) {
  if (message_encoding == "ros1") return Encoding::kRos1;
  if (message_encoding == "cdr") return Encoding::kCdr;
  return Encoding::kUnknown;
}

class McapReader {
 public:
  McapReader(std::string_view bytes, const std::string& source, LogSink& sink, const ReadLimits& limits)
      : bytes_(bytes),
        source_(source),
        sink_(sink),
        limits_(limits),
        topics_(sink, limits),
        decompressor_(limits, bytes.size()) {}

  Status Read() {
    ByteCursor file(bytes_);
    file.Bytes(kMcapMagic.size());
    while (!file.at_end()) {
      const uint64_t at = file.position();
      const uint8_t opcode = file.Number<uint8_t>();
      const uint64_t size = file.Number<uint64_t>();
      const bool cut = !file.ok() || size > file.remaining();
      if (opcode == kDataEnd || opcode == kFooter) return Status::Ok();  // a summary of what was read follows
      if (opcode == kChunk && file.ok()) {
        RG_RETURN_IF_ERROR(TakeChunk(cut ? file.Rest() : file.Bytes(size), at, cut));
      } else if (!cut) {
        RG_RETURN_IF_ERROR(Take(opcode, file.Bytes(size), at));
      }
      if (cut) return NoteCut(at);
      sink_.OnProgress(file.position(), bytes_.size());
    }
    return NoteCut(bytes_.size());
  }

 private:
  Status Error(uint64_t at, const std::string& what) const {
    return DataLossError(source_ + ": byte " + std::to_string(at) + ": " + what);
  }

  Status NoteCut(uint64_t at) {
    sink_.OnNote(source_ + ": was not closed, or is cut at byte " + std::to_string(at) +
                 ": read up to there");
    return Status::Ok();
  }

  Status Take(uint8_t opcode, std::string_view content, uint64_t at) {
    switch (opcode) {
      case kSchema:
        return TakeSchema(content, at);
      case kChannel:
        return TakeChannel(content, at);
      case kMessage:
        return TakeMessage(content, at);
      default:
        return Status::Ok();  // header, indexes, attachments, what later versions add
    }
  }

  Status TakeSchema(std::string_view content, uint64_t at) {
    ByteCursor cursor(content);
    const auto id = cursor.Number<uint16_t>();
    Schema schema;
    schema.name = cursor.Counted32();
    schema.encoding = cursor.Counted32();
    schema.data = cursor.Counted32();
    if (!cursor.ok() || id == 0) return Error(at, "is not a schema");
    schema_bytes_ += content.size();
    if (schema_bytes_ > limits_.max_definition_bytes) {
      return ResourceExhaustedError(source_ + ": more than " +
                                    std::to_string(limits_.max_definition_bytes >> 20) +
                                    " MB of message definitions");
    }
    schemas_[id] = std::move(schema);
    return Status::Ok();
  }

  Status TakeChannel(std::string_view content, uint64_t at) {
    ByteCursor cursor(content);
    const auto id = cursor.Number<uint16_t>();
    const auto schema_id = cursor.Number<uint16_t>();
    Topic topic;
    topic.name = cursor.Counted32();
    topic.encoding_name = cursor.Counted32();
    topic.encoding = EncodingOf(topic.encoding_name);
    if (!cursor.ok()) return Error(at, "is not a channel");
    if (topic_of_.contains(id)) return Status::Ok();  // chunks repeat their channels
    const auto schema = schemas_.find(schema_id);
    if (schema_id != 0 && schema == schemas_.end())
      return Error(at, "channel " + Shown(topic.name) + " without its schema");
    if (schema != schemas_.end()) {
      topic.type = PlainTypeName(schema->second.name);
      // Others (IDL, Protobuf) do not hold a definition that is read here.
      if (schema->second.encoding == "ros1msg" || schema->second.encoding == "ros2msg")
        topic.definition = schema->second.data;
    }
    const auto number = topics_.Add(topic);
    if (!number.ok()) return number.status().WithPrefix(source_);
    topic_of_[id] = *number;
    return Status::Ok();
  }

  Status TakeMessage(std::string_view content, uint64_t at) {
    ByteCursor cursor(content);
    const auto channel = cursor.Number<uint16_t>();
    cursor.Number<uint32_t>();  // sequence
    const auto log_time = cursor.Number<uint64_t>();
    cursor.Number<uint64_t>();  // publish time
    if (!cursor.ok()) return Error(at, "is not a message");
    const auto topic = topic_of_.find(channel);
    if (topic == topic_of_.end())
      return Error(at, "message of an unknown channel " + std::to_string(channel));
    return sink_.OnMessage({topic->second, static_cast<int64_t>(log_time), cursor.Rest()});
  }

  Status TakeChunk(std::string_view content, uint64_t at, bool cut) {
    ByteCursor cursor(content);
    cursor.Number<uint64_t>();  // first and last message's times
    cursor.Number<uint64_t>();
    const auto size = cursor.Number<uint64_t>();
    const auto crc = cursor.Number<uint32_t>();
    const std::string_view compression_name = cursor.Counted32();
    const auto stored = cursor.Number<uint64_t>();
    if (!cursor.ok()) return cut ? Status::Ok() : Error(at, "is not a chunk");
    if (stored > cursor.remaining() && !cut) return Error(at, "chunk: its records end behind it");
    const auto compression = ParseCompression(compression_name);
    if (!compression.ok()) return Error(at, "chunk: " + compression.status().message());
    const std::string_view records = cut ? cursor.Rest() : cursor.Bytes(stored);
    const auto chunk = decompressor_.Run(*compression, records, size, cut);
    if (!chunk.ok()) return chunk.status().WithPrefix(source_ + ": byte " + std::to_string(at) + ": chunk");
    if (crc != 0 && chunk->whole && Crc32(chunk->bytes) != crc)
      return Error(at, "chunk: its checksum does not match, the file is damaged");
    return TakeRecords(chunk->bytes, at, cut);
  }

  Status TakeRecords(std::string_view records, uint64_t at, bool cut) {
    ByteCursor inside(records);
    while (!inside.at_end()) {
      const uint8_t opcode = inside.Number<uint8_t>();
      const std::string_view content = inside.Counted64();
      if (!inside.ok()) return cut ? Status::Ok() : Error(at, "chunk: ends in the middle of a record");
      RG_RETURN_IF_ERROR(Take(opcode, content, at));
    }
    return Status::Ok();
  }

  std::string_view bytes_;
  const std::string& source_;
  LogSink& sink_;
  const ReadLimits& limits_;
  TopicTable topics_;
  Decompressor decompressor_;
  size_t schema_bytes_ = 0;
  std::map<uint16_t, Schema> schemas_;
  std::map<uint16_t, size_t> topic_of_;
};

}  // namespace

bool LooksLikeMcap(std::string_view bytes) { return bytes.substr(0, kMcapMagic.size()) == kMcapMagic; }

Status ReadMcap(std::string_view bytes, const std::string& source_name, LogSink& sink,
                const ReadLimits& limits) {
  if (!LooksLikeMcap(bytes)) return InvalidError(source_name + ": is not an MCAP file");
  return McapReader(bytes, source_name, sink, limits).Read();
}

}  // namespace rg::importing
