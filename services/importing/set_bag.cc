#include "services/importing/set_bag.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <map>
#include <nlohmann/json.hpp>
#include <optional>

#include "common/recordings/manifest.h"
#include "services/importing/exact_set.h"
#include "services/importing/message_decoder.h"
#include "services/importing/tracks.h"

namespace rg::importing {
namespace {

using nlohmann::json;
using recordings::Recording;
using recordings::RecordingSet;

constexpr int64_t kNsPerSecond = 1'000'000'000;

// Messages of the same columns, one behind the other.
struct Block {
  std::vector<std::string> columns;
  std::vector<int64_t> stamps;  // K
  std::vector<double> values;   // K × columns, a message's values together
};

// Collects what the topics of a set's bag say, by stamp.
class SetBagSink final : public LogSink {
 public:
  SetBagSink(const std::string& source, const ProgressFn& progress) : source_(source), progress_(progress) {}

  Status OnTopic(const Topic& topic) override {
    Reader reader;
    if (topic.name == kStateTopic || topic.name == kCommandTopic) {
      RG_ASSIGN_OR_RETURN(reader.decoder, MessageDecoder::Make(topic, {"header.stamp", "name", "position",
                                                                       "velocity", "effort"}));
      reader.effort = topic.name == kStateTopic ? "effort_measured" : "effort_command";
    } else if (topic.name == kColumnsTopic) {
      RG_ASSIGN_OR_RETURN(reader.decoder, MessageDecoder::Make(topic, {"layout.dim[0].label", "data"}));
    }
    readers_.push_back(std::move(reader));
    return Status::Ok();
  }

  Status OnMessage(const Message& message) override {
    const Reader& reader = readers_[message.topic];
    if (!reader.decoder) return Status::Ok();
    const Status read = reader.decoder->Decode(message.bytes, &values_);
    if (!read.ok()) return read.WithPrefix(source_);
    return reader.effort.empty() ? TakeColumns(message.log_ns) : TakeJoints(reader.effort);
  }

  void OnNote(const std::string&) override {}
  void OnProgress(uint64_t done, uint64_t total) override {
    if (progress_)
      progress_({"reading " + source_, static_cast<double>(done), static_cast<double>(total), ""});
  }

  const std::vector<std::string>& joints() const { return joints_; }
  const std::vector<Block>& blocks() const { return blocks_; }

 private:
  struct Reader {
    std::optional<MessageDecoder> decoder;
    std::string effort;  // the kind of it, of a JointState topic
  };

  Status TakeJoints(const std::string& effort) {
    const int64_t stamp = values_[0].time_ns;
    const std::vector<std::string>& names = values_[1].texts;
    if (joints_.empty()) joints_ = names;
    const char* const kinds[] = {"position", "velocity", effort.c_str()};
    for (size_t kind = 0; kind < 3; ++kind) {
      const std::vector<double>& numbers = values_[2 + kind].numbers;
      if (numbers.empty()) continue;
      if (numbers.size() != names.size())
        return DataLossError(source_ + ": a JointState has " + std::to_string(numbers.size()) +
                             " values for " + std::to_string(names.size()) + " joints");
      std::vector<std::string>& columns = names_of_[kinds[kind]];
      columns.resize(names.size());
      for (size_t i = 0; i < names.size(); ++i) columns[i] = std::string(kinds[kind]) + "." + names[i];
      Add(columns, stamp, numbers);
    }
    return Status::Ok();
  }

  void Add(const std::vector<std::string>& columns, int64_t stamp, const std::vector<double>& numbers) {
    const auto same = [&](const Block& block) { return block.columns == columns; };
    auto block = std::find_if(blocks_.begin(), blocks_.end(), same);
    if (block == blocks_.end()) block = blocks_.insert(block, {columns, {}, {}});
    block->stamps.push_back(stamp);
    block->values.insert(block->values.end(), numbers.begin(), numbers.end());
  }

  Status TakeColumns(int64_t log_ns) {
    if (values_[0].texts.empty()) return Status::Ok();
    if (values_[0].texts[0] != label_) {
      label_ = values_[0].texts[0];
      const json names = json::parse(label_, nullptr, false);
      names_.clear();
      for (const json& name : names.is_array() ? names : json::array())
        names_.push_back(name.is_string() ? name.get<std::string>() : "");
    }
    const std::vector<double>& numbers = values_[1].numbers;
    if (numbers.size() != names_.size())
      return DataLossError(source_ + ": topic " + kColumnsTopic + ": " + std::to_string(numbers.size()) +
                           " values for " + std::to_string(names_.size()) + " names in its label");
    Add(names_, log_ns, numbers);
    return Status::Ok();
  }

  const std::string& source_;
  const ProgressFn& progress_;
  std::vector<Reader> readers_;
  std::vector<FieldValue> values_;
  std::vector<std::string> joints_;
  std::vector<Block> blocks_;
  std::map<std::string, std::vector<std::string>> names_of_;  // columns of a kind
  std::string label_;
  std::vector<std::string> names_;
};

// The stamps of the states, once each and in order.
std::vector<int64_t> StampsOf(const SetBagSink& sink) {
  std::vector<int64_t> stamps;
  for (const Block& block : sink.blocks()) {
    if (!block.columns.empty() && block.columns[0].rfind("position.", 0) == 0)
      stamps.insert(stamps.end(), block.stamps.begin(), block.stamps.end());
  }
  std::sort(stamps.begin(), stamps.end());
  stamps.erase(std::unique(stamps.begin(), stamps.end()), stamps.end());
  return stamps;
}

void FillColumns(const Block& block, const std::vector<int64_t>& stamps, Recording* recording) {
  const auto rows = static_cast<Eigen::Index>(stamps.size());
  for (size_t c = 0; c < block.columns.size(); ++c) {
    Eigen::VectorXd& column = recording->other[block.columns[c]];
    if (column.size() == 0) column = Eigen::VectorXd::Constant(rows, kNone);
    for (size_t k = 0; k < block.stamps.size(); ++k) {
      const auto row = std::lower_bound(stamps.begin(), stamps.end(), block.stamps[k]);
      if (row == stamps.end() || *row != block.stamps[k]) continue;
      column[static_cast<Eigen::Index>(row - stamps.begin())] = block.values[k * block.columns.size() + c];
    }
  }
}

Result<Recording> RecordingOf(const SetBagSink& sink, const std::string& source, int64_t offset_ns) {
  Recording recording;
  recording.joints = sink.joints();
  const std::vector<int64_t> stamps = StampsOf(sink);
  for (const Block& block : sink.blocks()) FillColumns(block, stamps, &recording);
  recording.t.resize(static_cast<Eigen::Index>(stamps.size()));
  for (size_t k = 0; k < stamps.size(); ++k)
    recording.t[static_cast<Eigen::Index>(k)] = SecondsOf(stamps[k] - offset_ns);
  const auto exact = recording.other.find(kExactTime);
  if (exact != recording.other.end()) {
    recording.t = exact->second.array().isFinite().select(exact->second, recording.t);
    recording.other.erase(exact);
  }
  GatherKinds(&recording);
  if (recording.q.size() == 0)
    return InvalidError(source + ": topic " + std::string(kStateTopic) + ": positions are missing");
  return recording;
}

// What /realitygrad/recording says; where it is damaged, the manifest's first recording.
struct RecordingNote {
  std::string file;
  int64_t offset_ns = 0;
};

Result<RecordingNote> ParseNote(const std::string& text, const std::string& source) {
  const json note = json::parse(text, nullptr, false);
  const auto error = [&](const std::string& what) {
    return InvalidError(source + ": topic " + std::string(kRecordingTopic) + ": " + what);
  };
  if (!note.is_object() || note.value("format", json()) != kRecordingFormat)
    return error("is not " + std::string(kRecordingFormat));
  const json file = note.value("file", json()), offset = note.value("time_offset_ns", json());
  if (!file.is_string() || file.get<std::string>().empty()) return error("file: is not a text");
  if (!offset.is_number_integer() || std::abs(offset.get<double>()) > 4e18)
    return error("time_offset_ns: is not a number");
  return RecordingNote{file.get<std::string>(), offset.get<int64_t>()};
}

}  // namespace

int64_t NsOf(double seconds) {
  const double whole = std::floor(seconds);
  return static_cast<int64_t>(whole) * kNsPerSecond + std::llround((seconds - whole) * 1e9);
}

double SecondsOf(int64_t ns) {
  constexpr int64_t kExactInADouble = int64_t{1} << 53;
  if (std::abs(ns) < kExactInADouble) return static_cast<double>(ns) / 1e9;  // rounded once
  char text[48];
  const int size = std::snprintf(text, sizeof text, "%s%lld.%09lld", ns < 0 ? "-" : "",
                                 std::abs(static_cast<long long>(ns / kNsPerSecond)),
                                 std::abs(static_cast<long long>(ns % kNsPerSecond)));
  double seconds = 0.0;
  std::from_chars(text, text + size, seconds);
  return seconds;
}

bool IsSetBag(const Inventory& log) {
  const TopicInfo* manifest = log.Find(kManifestTopic);
  const TopicInfo* recording = log.Find(kRecordingTopic);
  return manifest != nullptr && recording != nullptr && !manifest->text.empty() && !recording->text.empty();
}

Result<RecordingSet> ReadSetBag(const LogFile& file, const Inventory& log, const ProgressFn& progress) {
  const std::string manifest_name = file.name + ": topic " + kManifestTopic;
  RG_ASSIGN_OR_RETURN(const recordings::Manifest manifest,
                      recordings::ParseManifest(log.Find(kManifestTopic)->text, manifest_name));
  RG_ASSIGN_OR_RETURN(const RecordingNote note, ParseNote(log.Find(kRecordingTopic)->text, file.name));
  SetBagSink sink(file.name, progress);
  RG_RETURN_IF_ERROR(ReadLog(file, sink));
  RG_ASSIGN_OR_RETURN(Recording recording, RecordingOf(sink, file.name, note.offset_ns));
  recording.name = note.file;
  for (const recordings::ManifestEntry& entry : manifest.recordings) {
    if (entry.file == note.file) recording.split = entry.split;
  }
  RecordingSet set = manifest.settings;
  set.joints = recording.joints;
  const TopicInfo* urdf = log.Find(kUrdfTopic);
  if (urdf != nullptr) set.urdf_text = urdf->text;
  set.recordings.push_back(std::move(recording));
  return set;
}

}  // namespace rg::importing
