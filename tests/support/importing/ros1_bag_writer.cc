// ROS 1 bags by librosbag-storage: what other programs write, and what they can read.
#include <rosbag/bag.h>
#include <rosbag/view.h>

#include <boost/make_shared.hpp>
#include <cstring>

#include "services/importing/message_definition.h"
#include "tests/support/importing/log_writers.h"

namespace rg::test {

struct RawMessage {
  std::string type, definition, bytes;
};

}  // namespace rg::test

namespace ros::message_traits {
template <>
struct IsMessage<rg::test::RawMessage> : TrueType {};
template <>
struct MD5Sum<rg::test::RawMessage> {
  static const char* value(const rg::test::RawMessage&) { return "00000000000000000000000000000000"; }
};
template <>
struct DataType<rg::test::RawMessage> {
  static const char* value(const rg::test::RawMessage& m) { return m.type.c_str(); }
};
template <>
struct Definition<rg::test::RawMessage> {
  static const char* value(const rg::test::RawMessage& m) { return m.definition.c_str(); }
};
}  // namespace ros::message_traits

namespace ros::serialization {
template <>
struct Serializer<rg::test::RawMessage> {
  template <class Stream>
  static void write(Stream& stream, const rg::test::RawMessage& m) {
    std::memcpy(stream.advance(static_cast<uint32_t>(m.bytes.size())), m.bytes.data(), m.bytes.size());
  }
  static uint32_t serializedLength(const rg::test::RawMessage& m) {
    return static_cast<uint32_t>(m.bytes.size());
  }
};
}  // namespace ros::serialization

namespace rg::test {

void WriteRos1BagFile(const std::string& path, const std::vector<LoggedMessage>& messages,
                      BagCompression compression) {
  rosbag::Bag bag(path, rosbag::bagmode::Write);
  bag.setCompression(compression == BagCompression::kLz4   ? rosbag::compression::LZ4
                     : compression == BagCompression::kBz2 ? rosbag::compression::BZ2
                                                           : rosbag::compression::Uncompressed);
  bag.setChunkThreshold(16 * 1024);
  for (const LoggedMessage& m : messages) {
    const std::string definition =
        m.definition.empty() ? importing::KnownDefinition(m.type, false) : m.definition;
    bag.write(m.topic,
              ros::Time(static_cast<uint32_t>(m.log_ns / 1'000'000'000),
                        static_cast<uint32_t>(m.log_ns % 1'000'000'000)),
              RawMessage{m.type, definition, m.bytes});
  }
  bag.close();
}

std::vector<LoggedMessage> ReadByRosbag(const std::string& path) {
  std::vector<LoggedMessage> all;
  rosbag::Bag bag(path, rosbag::bagmode::Read);
  rosbag::View view(bag);
  for (const rosbag::MessageInstance& instance : view) {
    LoggedMessage m;
    m.topic = instance.getTopic();
    m.type = instance.getDataType();
    m.definition = instance.getMessageDefinition();
    m.log_ns = static_cast<int64_t>(instance.getTime().toNSec());
    std::string bytes(instance.size(), '\0');
    ros::serialization::OStream stream(reinterpret_cast<uint8_t*>(bytes.data()),
                                       static_cast<uint32_t>(bytes.size()));
    instance.write(stream);
    m.bytes = bytes;
    all.push_back(std::move(m));
  }
  return all;
}

}  // namespace rg::test
