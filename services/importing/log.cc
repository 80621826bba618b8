#include "services/importing/log.h"

namespace rg::importing {

std::string PlainTypeName(std::string_view type) {
  std::string plain(type);
  const size_t middle = plain.find("/msg/");
  if (middle != std::string::npos) plain.erase(middle, 4);
  return plain;
}

Result<size_t> TopicTable::Add(const Topic& topic) {
  for (size_t i = 0; i < topics_.size(); ++i) {
    const Topic& known = topics_[i];
    if (known.name == topic.name && known.type == topic.type && known.encoding == topic.encoding &&
        known.definition == topic.definition) {
      return i;
    }
  }
  definition_bytes_ += topic.definition.size() + topic.name.size() + topic.type.size();
  if (topics_.size() >= limits_.max_topics || definition_bytes_ > limits_.max_definition_bytes) {
    return ResourceExhaustedError("more than " + std::to_string(limits_.max_topics) + " topics, or " +
                                  std::to_string(limits_.max_definition_bytes >> 20) +
                                  " MB of message definitions");
  }
  topics_.push_back(topic);
  RG_RETURN_IF_ERROR(sink_.OnTopic(topic));
  return topics_.size() - 1;
}

std::string Shown(std::string_view text) {
  std::string shown = "'";
  for (const char c : text.substr(0, 60)) shown += (c >= ' ' && c <= '~') ? c : '?';
  if (text.size() > 60) shown += "...";
  return shown + "'";
}

}  // namespace rg::importing
