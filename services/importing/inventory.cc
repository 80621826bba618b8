#include "services/importing/inventory.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "services/importing/message_decoder.h"

namespace rg::importing {
namespace {

constexpr size_t kMaxNames = 4096;
constexpr double kLastTimeNs = 4.5e18;  // the year 2112; differences of two such times do not overflow

bool Has(const std::vector<std::string>& fields, const char* name) {
  return std::find(fields.begin(), fields.end(), name) != fields.end();
}

// What is looked at in the messages of a topic: those of these paths that its type has.
const char* const kPaths[] = {"header.stamp", "name",   "joint_names", "position",
                              "velocity",     "effort", "data"};
enum Path { kStamp, kName, kJointNames, kPosition, kVelocity, kEffort, kData, kPathCount };

class InventorySink final : public LogSink {
 public:
  InventorySink(std::string source, Inventory* inventory, const ProgressFn& progress)
      : source_(std::move(source)), inventory_(*inventory), progress_(progress) {}

  Status OnTopic(const Topic& topic) override {
    TopicInfo info;
    info.topic = topic;
    const auto fields = FieldNames(topic);
    if (fields.ok()) {
      info.fields = *fields;
    } else {
      info.unreadable = fields.status().message();
    }
    lookers_.push_back(LookerOf(topic, info));
    info.has_header = lookers_.back().place[kStamp] >= 0;
    inventory_.topics.push_back(std::move(info));
    return Status::Ok();
  }

  Status OnMessage(const Message& message) override {
    TopicInfo& info = inventory_.topics[message.topic];
    if (std::abs(static_cast<double>(message.log_ns)) > kLastTimeNs) {
      return DataLossError(source_ + ": topic " + info.topic.name + ": message " +
                           std::to_string(info.messages + 1) + ": time " + std::to_string(message.log_ns) +
                           " ns is no time");
    }
    if (info.messages == 0) info.first_ns = info.last_ns = message.log_ns;
    info.first_ns = std::min(info.first_ns, message.log_ns);
    info.last_ns = std::max(info.last_ns, message.log_ns);
    ++info.messages;
    const Looker& looker = lookers_[message.topic];
    if (!looker.decoder) return Status::Ok();
    const Status read = looker.decoder->Decode(message.bytes, &values_);
    if (!read.ok()) {
      return read.WithPrefix(source_ + ": message " + std::to_string(info.messages));
    }
    Look(looker, &info);
    return Status::Ok();
  }

  void OnNote(const std::string& note) override { inventory_.notes.push_back(note); }
  void OnProgress(uint64_t done, uint64_t total) override {
    if (progress_)
      progress_({"looking through " + source_, static_cast<double>(done), static_cast<double>(total), ""});
  }

 private:
  struct Looker {
    std::optional<MessageDecoder> decoder;
    int place[kPathCount];  // in the decoder's values; -1: the type has no such field
  };

  static Looker LookerOf(const Topic& topic, const TopicInfo& info) {
    Looker looker;
    std::fill(std::begin(looker.place), std::end(looker.place), -1);
    std::vector<std::string> paths;
    const bool state = topic.type == "sensor_msgs/JointState";
    const bool array =
        topic.type == "std_msgs/Float64MultiArray" || topic.type == "std_msgs/Float32MultiArray";
    const bool text = topic.type == "std_msgs/String" && topic.name.rfind("/realitygrad/", 0) == 0;
    const bool wanted[kPathCount] = {Has(info.fields, "header"),
                                     state,
                                     !state && Has(info.fields, "joint_names"),
                                     state,
                                     state,
                                     state,
                                     array || text};
    for (int i = 0; i < kPathCount; ++i) {
      if (!wanted[i] || !MessageDecoder::Make(topic, {kPaths[i]}).ok()) continue;
      looker.place[i] = static_cast<int>(paths.size());
      paths.emplace_back(kPaths[i]);
    }
    if (paths.empty()) return looker;
    auto decoder = MessageDecoder::Make(topic, paths);
    if (decoder.ok()) looker.decoder = std::move(*decoder);
    return looker;
  }

  const FieldValue* ValueOf(const Looker& looker, Path path) const {
    if (looker.place[path] < 0) return nullptr;
    const FieldValue& value = values_[static_cast<size_t>(looker.place[path])];
    return value.present ? &value : nullptr;
  }

  void Look(const Looker& looker, TopicInfo* info) {
    const FieldValue* stamp = ValueOf(looker, kStamp);
    if (stamp != nullptr && stamp->time_ns != 0) info->stamp_is_set = true;
    const FieldValue* names = ValueOf(looker, kName);
    if (names == nullptr) names = ValueOf(looker, kJointNames);
    if (names != nullptr) LookAtJoints(looker, names->texts, info);
    const FieldValue* data = ValueOf(looker, kData);
    if (data == nullptr) return;
    info->list_length = std::max(info->list_length, data->numbers.size());
    if (info->text.empty() && !data->texts.empty()) info->text = data->texts[0];
  }

  void LookAtJoints(const Looker& looker, const std::vector<std::string>& names, TopicInfo* info) {
    for (size_t i = 0; i < names.size() && info->names.size() < kMaxNames; ++i) {
      // The same names in the same order, as a rule.
      if (i < info->names.size() && info->names[i] == names[i]) continue;
      if (std::find(info->names.begin(), info->names.end(), names[i]) == info->names.end())
        info->names.push_back(names[i]);
    }
    if (looker.place[kPosition] < 0) return;
    for (size_t i = 0; i < names.size() && i < kMaxNames; ++i) {
      const auto take = [&](Path path, Range* range) {
        const FieldValue* list = ValueOf(looker, path);
        if (list != nullptr && i < list->numbers.size()) range->Take(list->numbers[i]);
      };
      if (info->joints.size() >= kMaxNames && !info->joints.contains(names[i])) continue;
      NamedJoint& joint = info->joints[names[i]];
      take(kPosition, &joint.position);
      take(kVelocity, &joint.velocity);
      take(kEffort, &joint.effort);
    }
  }

  std::string source_;
  Inventory& inventory_;
  const ProgressFn& progress_;
  std::vector<Looker> lookers_;
  std::vector<FieldValue> values_;
};

}  // namespace

void Range::Take(double value) {
  if (!std::isfinite(value)) return;
  low = std::min(low, value);
  high = std::max(high, value);
  ++count;
}

double TopicInfo::rate_hz() const {
  const double seconds = (static_cast<double>(last_ns) - static_cast<double>(first_ns)) * 1e-9;
  return messages < 2 || seconds <= 0.0 ? 0.0 : static_cast<double>(messages - 1) / seconds;
}

const TopicInfo* Inventory::Find(const std::string& topic) const {
  const TopicInfo* best = nullptr;
  for (const TopicInfo& info : topics) {
    if (info.topic.name == topic && (best == nullptr || info.messages > best->messages)) best = &info;
  }
  return best;
}

Result<Inventory> TakeInventory(const LogFile& file, const ProgressFn& progress) {
  Inventory inventory;
  InventorySink sink(file.name, &inventory, progress);
  RG_RETURN_IF_ERROR(ReadLog(file, sink));
  return inventory;
}

}  // namespace rg::importing
