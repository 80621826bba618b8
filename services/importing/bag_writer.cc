// Writes set bags. The one unit that sees ROS and Boost.
#include <rosbag/bag.h>
#include <rosbag/constants.h>

#include <cmath>
#include <cstring>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <set>

#include "common/recordings/recording_set.h"
#include "services/importing/message_definition.h"
#include "services/importing/set_bag.h"

namespace rg::importing {
namespace {

// A message that is serialised already.
struct SerialisedMessage {
  std::string type, md5, definition;
  std::string bytes;
};

}  // namespace
}  // namespace rg::importing

namespace ros::message_traits {

template <>
struct IsMessage<rg::importing::SerialisedMessage> : TrueType {};

template <>
struct MD5Sum<rg::importing::SerialisedMessage> {
  static const char* value(const rg::importing::SerialisedMessage& m) { return m.md5.c_str(); }
};
template <>
struct DataType<rg::importing::SerialisedMessage> {
  static const char* value(const rg::importing::SerialisedMessage& m) { return m.type.c_str(); }
};
template <>
struct Definition<rg::importing::SerialisedMessage> {
  static const char* value(const rg::importing::SerialisedMessage& m) { return m.definition.c_str(); }
};

}  // namespace ros::message_traits

namespace ros::serialization {

template <>
struct Serializer<rg::importing::SerialisedMessage> {
  template <class Stream>
  static void write(Stream& stream, const rg::importing::SerialisedMessage& m) {
    std::memcpy(stream.advance(static_cast<uint32_t>(m.bytes.size())), m.bytes.data(), m.bytes.size());
  }
  static uint32_t serializedLength(const rg::importing::SerialisedMessage& m) {
    return static_cast<uint32_t>(m.bytes.size());
  }
};

}  // namespace ros::serialization

namespace rg::importing {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using recordings::Recording;
using recordings::RecordingSet;

constexpr int64_t kNsPerSecond = 1'000'000'000;
// As roscpp and every bag has them.
constexpr char kJointStateMd5[] = "3066dcd76a6cfaef579bd0f34173e9fd";
constexpr char kStringMd5[] = "992ce8a1687cec8c8bd883ec73ca41d1";
constexpr char kArrayMd5[] = "4b7d974086d4060e7db4613a7e6c3ba4";

// ROS 1 serialisation: little endian, packed, counts before lists.
class Serialiser {
 public:
  template <class T>
  Serialiser& Number(T value) {
    bytes_.append(reinterpret_cast<const char*>(&value), sizeof value);
    return *this;
  }
  Serialiser& Text(const std::string& text) {
    Number(static_cast<uint32_t>(text.size()));
    bytes_ += text;
    return *this;
  }
  Serialiser& Doubles(const Eigen::VectorXd& values) {
    Number(static_cast<uint32_t>(values.size()));
    for (const double value : values) Number(value);
    return *this;
  }
  std::string Take() { return std::move(bytes_); }

 private:
  std::string bytes_;
};

ros::Time RosTime(int64_t ns) {
  return {static_cast<uint32_t>(ns / kNsPerSecond), static_cast<uint32_t>(ns % kNsPerSecond)};
}

SerialisedMessage Of(const char* type, const char* md5) {
  return {type, md5, KnownDefinition(type, false), ""};
}

// Columns that no JointState carries; and the exact times where nanoseconds do not tell them.
struct FurtherColumns {
  std::vector<std::string> names;
  std::vector<const Eigen::VectorXd*> values;
};

bool IsWholeNs(const Recording& r) {
  for (const double t : r.t) {
    if (SecondsOf(NsOf(t)) != t) return false;
  }
  return true;
}

FurtherColumns FurtherOf(const Recording& r) {
  FurtherColumns further;
  for (const auto& [name, column] : r.other) {
    further.names.push_back(name);
    further.values.push_back(&column);
  }
  if (!IsWholeNs(r)) {
    further.names.emplace_back(kExactTime);
    further.values.push_back(&r.t);
  }
  return further;
}

class BagWriter {
 public:
  BagWriter(const std::string& path, const RecordingSet& set, const Recording& recording,
            const std::string& manifest_json)
      : path_(path), set_(set), r_(recording), manifest_json_(manifest_json) {}

  Status Write() {
    RG_RETURN_IF_ERROR(ChooseTimes());
    const std::string partial = path_ + ".partial";
    std::error_code error;
    fs::create_directories(fs::path(path_).parent_path(), error);
    try {
      rosbag::Bag bag(partial, rosbag::bagmode::Write);
      bag.setCompression(rosbag::compression::LZ4);
      WriteTexts(&bag);
      WriteRows(&bag);
      bag.close();
      fs::rename(partial, path_);
    } catch (const std::exception& e) {  // rosbag's, and the file system's
      fs::remove(partial, error);
      return UnavailableError(path_ + ": cannot write: " + e.what());
    }
    return Status::Ok();
  }

 private:
  Status ChooseTimes() {
    for (const double t : r_.t) {
      if (!(std::abs(t) < 4e9))
        return InvalidError(r_.name + ": time " + std::to_string(t) + " s has no place in a bag");
      stamps_.push_back(NsOf(t));
    }
    for (size_t k = 1; k < stamps_.size(); ++k) {
      if (stamps_[k] <= stamps_[k - 1])
        return InvalidError(r_.name + ": row " + std::to_string(k + 1) +
                            ": less than 1 ns after the row before it");
    }
    // ROS has no times before 1970, and none at 0.
    if (!stamps_.empty() && stamps_[0] <= 0) offset_ns_ = (1 - stamps_[0] / kNsPerSecond) * kNsPerSecond;
    if (!stamps_.empty() && stamps_.back() + offset_ns_ >= kNsPerSecond * int64_t{UINT32_MAX})
      return InvalidError(r_.name + ": its times have no place in a bag");
    return Status::Ok();
  }

  void WriteTexts(rosbag::Bag* bag) const {
    const json note = {{"format", kRecordingFormat}, {"file", r_.name}, {"time_offset_ns", offset_ns_}};
    const std::pair<const char*, std::string> texts[] = {
        {kManifestTopic, manifest_json_}, {kUrdfTopic, set_.urdf_text}, {kRecordingTopic, note.dump()}};
    const int64_t start = stamps_.empty() ? kNsPerSecond : stamps_[0] + offset_ns_;
    for (const auto& [topic, text] : texts) {
      SerialisedMessage message = Of("std_msgs/String", kStringMd5);
      message.bytes = Serialiser().Text(text).Take();
      bag->write(topic, RosTime(start), message);
    }
  }

  std::string JointState(uint32_t seq, int64_t stamp, const Eigen::MatrixXd& q, const Eigen::MatrixXd& v,
                         const Eigen::MatrixXd& effort) const {
    Serialiser s;
    const ros::Time time = RosTime(stamp);
    s.Number(seq).Number(time.sec).Number(time.nsec).Text("");
    s.Number(static_cast<uint32_t>(r_.joints.size()));
    for (const std::string& joint : r_.joints) s.Text(joint);
    for (const Eigen::MatrixXd* list : {&q, &v, &effort}) {
      s.Doubles(list->size() > 0 ? Eigen::VectorXd(list->col(seq)) : Eigen::VectorXd());
    }
    return s.Take();
  }

  void WriteRows(rosbag::Bag* bag) const {
    const FurtherColumns further = FurtherOf(r_);
    const std::string label = json(further.names).dump();
    SerialisedMessage state = Of("sensor_msgs/JointState", kJointStateMd5);
    SerialisedMessage columns = Of("std_msgs/Float64MultiArray", kArrayMd5);
    for (size_t k = 0; k < stamps_.size(); ++k) {
      const int64_t stamp = stamps_[k] + offset_ns_;
      const auto seq = static_cast<uint32_t>(k);
      state.bytes = JointState(seq, stamp, r_.q, r_.v, r_.effort_measured);
      bag->write(kStateTopic, RosTime(stamp), state);
      if (r_.has_effort_command()) {
        state.bytes = JointState(seq, stamp, {}, {}, r_.effort_command);
        bag->write(kCommandTopic, RosTime(stamp), state);
      }
      if (further.names.empty()) continue;
      Serialiser s;
      const auto count = static_cast<uint32_t>(further.names.size());
      s.Number(uint32_t{1}).Text(label).Number(count).Number(count).Number(uint32_t{0}).Number(count);
      for (const Eigen::VectorXd* column : further.values) s.Number((*column)[static_cast<Eigen::Index>(k)]);
      columns.bytes = s.Take();
      bag->write(kColumnsTopic, RosTime(stamp), columns);
    }
  }

  const std::string& path_;
  const RecordingSet& set_;
  const Recording& r_;
  const std::string& manifest_json_;
  std::vector<int64_t> stamps_;
  int64_t offset_ns_ = 0;
};

std::string BagName(const std::string& recording) {
  std::string name = fs::path(recording).replace_extension(".bag").string();
  std::replace(name.begin(), name.end(), '/', '_');
  return name;
}

}  // namespace

Status WriteSetBag(const std::string& path, const RecordingSet& set, const Recording& recording,
                   const std::string& manifest_json) {
  return BagWriter(path, set, recording, manifest_json).Write();
}

Result<std::vector<std::string>> WriteSetBags(const std::string& folder, const RecordingSet& set,
                                              const std::string& manifest_json, const ProgressFn& progress) {
  std::vector<std::string> paths;
  for (const Recording& recording : set.recordings) {
    const std::string path = (fs::path(folder) / BagName(recording.name)).string();
    if (std::find(paths.begin(), paths.end(), path) != paths.end())
      return InvalidError(path + ": would be written for two recordings: rename " + recording.name);
    paths.push_back(path);
  }
  for (size_t i = 0; i < paths.size(); ++i) {
    if (progress)
      progress({"writing bags", static_cast<double>(i), static_cast<double>(paths.size()),
                set.recordings[i].name});
    RG_RETURN_IF_ERROR(WriteSetBag(paths[i], set, set.recordings[i], manifest_json));
  }
  return paths;
}

}  // namespace rg::importing
