#include "services/importing/tracks.h"

#include <algorithm>
#include <optional>

#include "services/importing/message_decoder.h"

namespace rg::importing {
namespace {

// Tracks of one topic share a decoder: its paths are the stamps of the tracks, then their columns.
struct TopicReader {
  const TopicInfo* info = nullptr;
  std::vector<size_t> tracks;
  std::vector<std::string> paths;
  std::vector<int> stamp_path;                  // per track; -1: the log's time
  std::vector<std::vector<size_t>> value_path;  // per track and column
  std::optional<MessageDecoder> decoder;
};

size_t TrackOf(const WantedColumn& column, std::vector<Track>* tracks) {
  for (size_t i = 0; i < tracks->size(); ++i) {
    if ((*tracks)[i].topic == column.topic && (*tracks)[i].clock == column.clock) return i;
  }
  tracks->push_back({});
  tracks->back().topic = column.topic;
  tracks->back().clock = column.clock;
  return tracks->size() - 1;
}

class TrackSink final : public LogSink {
 public:
  TrackSink(const LogFile& file, const Inventory& inventory, const std::vector<WantedColumn>& wanted,
            const ProgressFn& progress)
      : file_(file), inventory_(inventory), wanted_(wanted), progress_(progress) {}

  Status Prepare() {
    for (size_t i = 0; i < wanted_.size(); ++i) {
      Track& track = tracks_[TrackOf(wanted_[i], &tracks_)];
      track.columns.push_back(i);
      track.values.emplace_back();
    }
    readers_.resize(inventory_.topics.size());
    for (size_t t = 0; t < tracks_.size(); ++t) {
      const TopicInfo* info = inventory_.Find(tracks_[t].topic);
      TopicReader& reader = readers_[static_cast<size_t>(info - inventory_.topics.data())];
      reader.info = info;
      reader.tracks.push_back(t);
    }
    for (TopicReader& reader : readers_) {
      if (reader.info != nullptr) RG_RETURN_IF_ERROR(MakeDecoder(&reader));
    }
    return Status::Ok();
  }

  Status OnTopic(const Topic&) override { return Status::Ok(); }

  Status OnMessage(const Message& message) override {
    if (message.topic >= readers_.size() || readers_[message.topic].info == nullptr) return Status::Ok();
    TopicReader& reader = readers_[message.topic];
    const Status read = reader.decoder->Decode(message.bytes, &values_);
    if (!read.ok()) return read.WithPrefix(file_.name);
    for (size_t k = 0; k < reader.tracks.size(); ++k) Take(reader, k, message.log_ns);
    return Status::Ok();
  }

  void OnNote(const std::string&) override {}  // the inventory has them
  void OnProgress(uint64_t done, uint64_t total) override {
    if (progress_)
      progress_({"reading " + file_.name, static_cast<double>(done), static_cast<double>(total), ""});
  }

  Result<std::vector<Track>> Finish() {
    for (const Track& track : tracks_) {
      const bool unset =
          std::all_of(track.stamps_ns.begin(), track.stamps_ns.end(), [](int64_t s) { return s == 0; });
      if (unset && !track.stamps_ns.empty() && track.clock != "log") {
        return InvalidError(file_.name + ": topic " + track.topic +
                            ": every stamp is 0: say \"clock\": \"log\" in the mapping");
      }
    }
    return std::move(tracks_);
  }

 private:
  Status MakeDecoder(TopicReader* reader) {
    for (const size_t t : reader->tracks) {
      const Track& track = tracks_[t];
      reader->stamp_path.push_back(-1);
      if (track.clock != "log") {
        reader->stamp_path.back() = static_cast<int>(reader->paths.size());
        reader->paths.push_back(track.clock == "header" ? "header.stamp" : track.clock);
      }
      reader->value_path.emplace_back();
      for (const size_t column : track.columns) {
        reader->value_path.back().push_back(reader->paths.size());
        reader->paths.push_back(wanted_[column].field);
      }
    }
    auto decoder = MessageDecoder::Make(reader->info->topic, reader->paths);
    if (!decoder.ok()) return decoder.status().WithPrefix(file_.name);
    for (size_t k = 0; k < reader->tracks.size(); ++k) {
      RG_RETURN_IF_ERROR(CheckKinds(*reader, *decoder, k));
    }
    reader->decoder = std::move(*decoder);
    return Status::Ok();
  }

  Status CheckKinds(const TopicReader& reader, const MessageDecoder& decoder, size_t k) const {
    const Track& track = tracks_[reader.tracks[k]];
    const auto error = [&](const std::string& what) {
      return InvalidError(file_.name + ": topic " + track.topic + ": field '" + what);
    };
    if (reader.stamp_path[k] >= 0 &&
        decoder.kind(static_cast<size_t>(reader.stamp_path[k])) != FieldKind::kTime)
      return error(track.clock + "' is no time");
    for (const size_t path : reader.value_path[k]) {
      const FieldKind kind = decoder.kind(path);
      if (kind == FieldKind::kNumbers)
        return error(reader.paths[path] + "' is a list: say which element, as " + reader.paths[path] + "[0]");
      if (kind != FieldKind::kNumber) return error(reader.paths[path] + "' is no number");
    }
    return Status::Ok();
  }

  void Take(const TopicReader& reader, size_t k, int64_t log_ns) {
    Track& track = tracks_[reader.tracks[k]];
    bool any = false;
    for (const size_t path : reader.value_path[k]) any = any || values_[path].present;
    const int stamp = reader.stamp_path[k];
    // A message of another publisher on this topic, without any of these joints.
    if (!any || (stamp >= 0 && !values_[static_cast<size_t>(stamp)].present)) return;
    track.stamps_ns.push_back(stamp < 0 ? log_ns : values_[static_cast<size_t>(stamp)].time_ns);
    if (stamp >= 0) track.log_ns.push_back(log_ns);
    for (size_t c = 0; c < track.columns.size(); ++c) {
      const FieldValue& value = values_[reader.value_path[k][c]];
      const WantedColumn& column = wanted_[track.columns[c]];
      track.values[c].push_back(value.present ? value.number * column.factor + column.offset : kNone);
    }
  }

  const LogFile& file_;
  const Inventory& inventory_;
  const std::vector<WantedColumn>& wanted_;
  const ProgressFn& progress_;
  std::vector<Track> tracks_;
  std::vector<TopicReader> readers_;  // by number of topic; without info where nothing is wanted
  std::vector<FieldValue> values_;
};

}  // namespace

Result<std::vector<Track>> ReadTracks(const LogFile& file, const Inventory& inventory,
                                      const std::vector<WantedColumn>& wanted, const ProgressFn& progress) {
  TrackSink sink(file, inventory, wanted, progress);
  RG_RETURN_IF_ERROR(sink.Prepare());
  RG_RETURN_IF_ERROR(ReadLog(file, sink));
  return sink.Finish();
}

}  // namespace rg::importing
