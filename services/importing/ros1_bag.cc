#include "services/importing/ros1_bag.h"

#include <map>

#include "services/importing/byte_cursor.h"
#include "services/importing/decompress.h"

namespace rg::importing {
namespace {

constexpr std::string_view kBagMagic = "#ROSBAG V";
constexpr std::string_view kVersion2 = "#ROSBAG V2.0\n";

enum Op : uint8_t {
  kMessageData = 2,
  kBagHeader = 3,
  kIndexData = 4,
  kChunk = 5,
  kChunkInfo = 6,
  kConnection = 7
};

// name=value fields of a record's header, each with its length before it.
class HeaderFields {
 public:
  static HeaderFields Parse(std::string_view bytes) {
    HeaderFields fields;
    ByteCursor cursor(bytes);
    while (!cursor.at_end()) {
      const std::string_view field = cursor.Counted32();
      const size_t equals = field.find('=');
      if (!cursor.ok() || equals == std::string_view::npos) {
        fields.ok_ = false;
        break;
      }
      fields.values_[field.substr(0, equals)] = field.substr(equals + 1);
    }
    return fields;
  }

  bool ok() const { return ok_; }
  std::string_view Text(std::string_view name) const {
    const auto found = values_.find(name);
    return found == values_.end() ? std::string_view() : found->second;
  }
  // False: not there, or of another size.
  template <class T>
  bool Number(std::string_view name, T* value) const {
    const std::string_view text = Text(name);
    if (text.size() != sizeof(T)) return false;
    *value = ByteCursor(text).Number<T>();
    return true;
  }

 private:
  std::map<std::string_view, std::string_view> values_;
  bool ok_ = true;
};

struct Record {
  uint8_t op = 0;
  HeaderFields header;
  std::string_view data;
};

class BagReader {
 public:
  BagReader(std::string_view bytes, const std::string& source, LogSink& sink, const ReadLimits& limits)
      : bytes_(bytes),
        source_(source),
        sink_(sink),
        topics_(sink, limits),
        decompressor_(limits, bytes.size()) {}

  Status Read() {
    ByteCursor file(bytes_);
    file.Bytes(kVersion2.size());
    while (!file.at_end()) {
      const uint64_t at = file.position();
      const std::string_view header = file.Counted32();
      const uint32_t size = file.Number<uint32_t>();
      const bool cut = !file.ok() || size > file.remaining();
      // A header that is cut says nothing; data that is cut may hold messages.
      if (!file.ok()) return NoteCut(at);
      const std::string_view data = cut ? file.Rest() : file.Bytes(size);
      RG_RETURN_IF_ERROR(Take(header, data, at, cut));
      if (cut) return NoteCut(at);
      sink_.OnProgress(file.position(), bytes_.size());
    }
    return Status::Ok();
  }

 private:
  Status Error(uint64_t at, const std::string& what) const {
    return DataLossError(source_ + ": byte " + std::to_string(at) + ": " + what);
  }

  Status NoteCut(uint64_t at) {
    sink_.OnNote(source_ + ": ends in the middle of the record at byte " + std::to_string(at) +
                 ": read up to there");
    return Status::Ok();
  }

  Result<Record> Parse(std::string_view header, std::string_view data, uint64_t at) const {
    Record record{0, HeaderFields::Parse(header), data};
    if (!record.header.ok() || !record.header.Number("op", &record.op))
      return Error(at, "is not a record of a bag");
    return record;
  }

  Status Take(std::string_view header, std::string_view data, uint64_t at, bool cut) {
    RG_ASSIGN_OR_RETURN(const Record record, Parse(header, data, at));
    if (record.op == kChunk) return TakeChunk(record, at, cut);
    if (cut) return Status::Ok();
    if (record.op == kConnection) return TakeConnection(record, at);
    if (record.op == kMessageData) return TakeMessage(record, at);
    if (record.op == kBagHeader && !record.header.Text("encryptor").empty())
      return Error(at, "the bag is encrypted, which this program does not read");
    return Status::Ok();  // indexes are not needed
  }

  Status TakeChunk(const Record& record, uint64_t at, bool cut) {
    uint32_t size = 0;
    const auto compression = ParseCompression(record.header.Text("compression"));
    if (!compression.ok()) return Error(at, "chunk: " + compression.status().message());
    if (!record.header.Number("size", &size)) return Error(at, "chunk without a size");
    const auto chunk = decompressor_.Run(*compression, record.data, size, cut);
    if (!chunk.ok()) return chunk.status().WithPrefix(source_ + ": byte " + std::to_string(at) + ": chunk");
    ByteCursor inside(chunk->bytes);
    while (!inside.at_end()) {
      const std::string_view header = inside.Counted32();
      const std::string_view data = inside.Counted32();
      if (!inside.ok()) return cut ? Status::Ok() : Error(at, "chunk: ends in the middle of a record");
      RG_ASSIGN_OR_RETURN(const Record record_inside, Parse(header, data, at));
      if (record_inside.op == kConnection) RG_RETURN_IF_ERROR(TakeConnection(record_inside, at));
      if (record_inside.op == kMessageData) RG_RETURN_IF_ERROR(TakeMessage(record_inside, at));
    }
    return Status::Ok();
  }

  Status TakeConnection(const Record& record, uint64_t at) {
    uint32_t id = 0;
    const HeaderFields fields = HeaderFields::Parse(record.data);
    if (!record.header.Number("conn", &id) || !fields.ok()) return Error(at, "is not a connection");
    if (topic_of_.contains(id)) return Status::Ok();
    Topic topic;
    topic.name = std::string(record.header.Text("topic"));
    topic.type = PlainTypeName(fields.Text("type"));
    topic.encoding = Encoding::kRos1;
    topic.encoding_name = "ros1";
    topic.definition = std::string(fields.Text("message_definition"));
    const auto number = topics_.Add(topic);
    if (!number.ok()) return number.status().WithPrefix(source_);
    topic_of_[id] = *number;
    return Status::Ok();
  }

  Status TakeMessage(const Record& record, uint64_t at) {
    uint32_t id = 0;
    uint64_t time = 0;
    if (!record.header.Number("conn", &id) || !record.header.Number("time", &time))
      return Error(at, "message without connection or time");
    const auto topic = topic_of_.find(id);
    if (topic == topic_of_.end()) return Error(at, "message of an unknown connection " + std::to_string(id));
    const auto seconds = static_cast<int64_t>(time & 0xffffffffu);
    const auto nanoseconds = static_cast<int64_t>(time >> 32);
    return sink_.OnMessage({topic->second, seconds * 1'000'000'000 + nanoseconds, record.data});
  }

  std::string_view bytes_;
  const std::string& source_;
  LogSink& sink_;
  TopicTable topics_;
  Decompressor decompressor_;
  std::map<uint32_t, size_t> topic_of_;
};

}  // namespace

bool LooksLikeRos1Bag(std::string_view bytes) { return bytes.substr(0, kBagMagic.size()) == kBagMagic; }

Status ReadRos1Bag(std::string_view bytes, const std::string& source_name, LogSink& sink,
                   const ReadLimits& limits) {
  if (!LooksLikeRos1Bag(bytes)) return InvalidError(source_name + ": is not a ROS 1 bag");
  if (bytes.substr(0, kVersion2.size()) != kVersion2) {
    return InvalidError(source_name + ": bag format " + Shown(bytes.substr(kBagMagic.size(), 3)) +
                        ", this program reads 2.0: convert it with 'rosbag fix'");
  }
  return BagReader(bytes, source_name, sink, limits).Read();
}

}  // namespace rg::importing
