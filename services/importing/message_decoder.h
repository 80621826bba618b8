// Reads chosen fields of messages, as their definition says, off ROS 1 serialisation or CDR.
//
// Paths: "header.stamp", "position[2]", "position[shoulder]" (the element whose place in the message's list
// of names (name, names, joint_names, interface_names) is shoulder's; the nearest list before the field
// counts), "actual.positions[shoulder]", "interface_values[shoulder].values[effort]", "position[*]" or
// "position" (all of a list), "joint1".
//
// Bytes are untrusted: nothing is read past their end, and no count is believed that they cannot hold.
#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.h"
#include "services/importing/log.h"
#include "services/importing/message_definition.h"

namespace rg::importing {

enum class FieldKind { kNumber, kTime, kText, kNumbers, kTexts };

struct FieldValue {
  bool present = false;  // false: the message has no such element
  double number = 0.0;
  int64_t time_ns = 0;
  std::vector<double> numbers;
  std::vector<std::string> texts;  // one for kText
};

class MessageDecoder {
 public:
  // Error: a path that the type does not have, or a definition that is not understood; names the topic.
  static Result<MessageDecoder> Make(const Topic& topic, const std::vector<std::string>& paths);

  // values[i] belongs to paths[i]; its memory is used again. Not thread-safe.
  Status Decode(std::string_view bytes, std::vector<FieldValue>* values) const;

  FieldKind kind(size_t path) const { return kinds_[path]; }

 private:
  friend class DecoderBuilder;
  friend class MessageWalk;
  struct Element {
    enum class By { kIndex, kName, kAll } by = By::kAll;
    uint32_t index = 0;
    std::string name;
    int node = -1;
  };
  // What is wanted of a message, a field or an element.
  struct Node {
    std::map<size_t, int> fields;  // of a message: field number -> node
    std::vector<Element> elements;
    std::vector<size_t> outputs;  // of a leaf: the paths that end here
    bool wants_names = false;     // an element in here is chosen by name
  };

  std::string topic_name_;
  Encoding encoding_ = Encoding::kUnknown;
  MessageTypes types_;
  std::vector<Node> nodes_;
  std::vector<FieldKind> kinds_;
};

// The names of a topic's own fields. Error as Make.
Result<std::vector<std::string>> FieldNames(const Topic& topic);

}  // namespace rg::importing
