#include "services/importing/message_decoder.h"

#include <algorithm>
#include <charconv>

#include "services/importing/field_source.h"

namespace rg::importing {
namespace {

bool HoldsNames(const FieldType& field) {
  return field.primitive == Primitive::kString && field.array != FieldType::Array::kNone &&
         (field.name == "name" || field.name == "names" || field.name == "joint_names" ||
          field.name == "interface_names");
}

// "values[effort]": a field and which element of it.
struct PathStep {
  std::string field;
  bool has_index = false;
  std::string index;
};

Result<std::vector<PathStep>> ParsePath(const std::string& path) {
  std::vector<PathStep> steps;
  std::string_view rest = path;
  const auto error = [&] { return InvalidError("field " + Shown(path) + " is no path like position[2]"); };
  while (true) {
    PathStep step;
    const size_t end = std::min(rest.find_first_of(".["), rest.size());
    step.field = rest.substr(0, end);
    rest.remove_prefix(end);
    if (step.field.empty()) return error();
    if (!rest.empty() && rest.front() == '[') {
      const size_t close = rest.find(']');
      if (close == std::string_view::npos || close < 2) return error();
      step.has_index = true;
      step.index = rest.substr(1, close - 1);
      rest.remove_prefix(close + 1);
    }
    steps.push_back(step);
    if (rest.empty()) return steps;
    if (rest.front() != '.') return error();
    rest.remove_prefix(1);
  }
}

Status TypesOf(const Topic& topic, MessageTypes* types) {
  if (topic.encoding == Encoding::kUnknown)
    return InvalidError("encoding " + Shown(topic.encoding_name) + " is not read (ros1, cdr)");
  RG_ASSIGN_OR_RETURN(*types,
                      ParseDefinition(topic.type, topic.definition, topic.encoding == Encoding::kCdr));
  return Status::Ok();
}

std::string FieldList(const MessageType& type) {
  std::string list;
  for (const FieldType& field : type.fields) list += (list.empty() ? "" : ", ") + field.name;
  return list;
}

}  // namespace

class DecoderBuilder {
 public:
  explicit DecoderBuilder(MessageDecoder* decoder) : d_(*decoder) { d_.nodes_.emplace_back(); }

  Status Add(const std::string& path) {
    RG_ASSIGN_OR_RETURN(const std::vector<PathStep> steps, ParsePath(path));
    size_t type = 0;
    int node = 0;
    std::vector<int> way = {0};
    for (size_t i = 0; i < steps.size(); ++i) {
      const bool last = i + 1 == steps.size();
      RG_ASSIGN_OR_RETURN(const size_t number, FieldNumber(type, steps[i], path));
      const FieldType& field = d_.types_.messages[type].fields[number];
      node = Child(node, number);
      way.push_back(node);
      if (field.array == FieldType::Array::kNone) {
        if (steps[i].has_index)
          return InvalidError("field " + Shown(path) + ": " + field.name + " is no list");
        if (last) return Finish(path, field, false, node);
      } else {
        const bool all = !steps[i].has_index || steps[i].index == "*";
        if (all && !last)
          return InvalidError("field " + Shown(path) + ": " + field.name + " is a list: say which element");
        const MessageDecoder::Element element = ElementOf(steps[i], all);
        if (field.primitive == Primitive::kMessage && MixesChoices(node, element))
          return InvalidError("field " + Shown(path) + ": elements of " + field.name +
                              " are chosen by place and by name at once");
        if (element.by == MessageDecoder::Element::By::kName)
          for (const int n : way) d_.nodes_[static_cast<size_t>(n)].wants_names = true;
        node = ElementNode(node, element);
        way.push_back(node);
        if (last) return Finish(path, field, all, node);
      }
      if (field.primitive != Primitive::kMessage)
        return InvalidError("field " + Shown(path) + ": " + field.name + " has no fields of its own");
      type = field.message;
    }
    return Status::Ok();
  }

 private:
  Result<size_t> FieldNumber(size_t type, const PathStep& step, const std::string& path) const {
    const MessageType& message = d_.types_.messages[type];
    for (size_t i = 0; i < message.fields.size(); ++i) {
      if (message.fields[i].name == step.field) return i;
    }
    return InvalidError("field " + Shown(path) + ": " + message.name + " has no field '" + step.field +
                        "' (" + FieldList(message) + ")");
  }

  int NewNode() {
    d_.nodes_.emplace_back();
    return static_cast<int>(d_.nodes_.size()) - 1;
  }

  int Child(int node, size_t field) {
    const auto found = d_.nodes_[static_cast<size_t>(node)].fields.find(field);
    if (found != d_.nodes_[static_cast<size_t>(node)].fields.end()) return found->second;
    const int child = NewNode();
    d_.nodes_[static_cast<size_t>(node)].fields[field] = child;
    return child;
  }

  static MessageDecoder::Element ElementOf(const PathStep& step, bool all) {
    using Element = MessageDecoder::Element;
    Element element;
    if (all) return element;
    const char* end = step.index.data() + step.index.size();
    const auto number = std::from_chars(step.index.data(), end, element.index);
    const bool is_number = number.ec == std::errc() && number.ptr == end;
    element.by = is_number ? Element::By::kIndex : Element::By::kName;
    if (!is_number) element.name = step.index;
    return element;
  }

  bool MixesChoices(int node, const MessageDecoder::Element& element) const {
    const auto& elements = d_.nodes_[static_cast<size_t>(node)].elements;
    return std::any_of(elements.begin(), elements.end(), [&](const auto& e) { return e.by != element.by; });
  }

  int ElementNode(int node, MessageDecoder::Element element) {
    for (const auto& known : d_.nodes_[static_cast<size_t>(node)].elements) {
      if (known.by == element.by && known.index == element.index && known.name == element.name)
        return known.node;
    }
    element.node = NewNode();
    d_.nodes_[static_cast<size_t>(node)].elements.push_back(element);
    return element.node;
  }

  Status Finish(const std::string& path, const FieldType& field, bool list, int node) {
    const bool is_time = IsTime(d_.types_, field);
    if (field.primitive == Primitive::kWideString || (field.primitive == Primitive::kMessage && !is_time)) {
      const std::string inside =
          field.primitive == Primitive::kMessage ? FieldList(d_.types_.messages[field.message]) : "wide text";
      return InvalidError("field " + Shown(path) + " is no number (it holds " + inside + ")");
    }
    const bool text = field.primitive == Primitive::kString;
    d_.nodes_[static_cast<size_t>(node)].outputs.push_back(d_.kinds_.size());
    d_.kinds_.push_back(list      ? (text ? FieldKind::kTexts : FieldKind::kNumbers)
                        : is_time ? FieldKind::kTime
                        : text    ? FieldKind::kText
                                  : FieldKind::kNumber);
    return Status::Ok();
  }

  MessageDecoder& d_;
};

// One message on its way through its type.
class MessageWalk {
 public:
  MessageWalk(const MessageDecoder& decoder, FieldSource& source, std::vector<FieldValue>* values)
      : d_(decoder), source_(source), values_(*values), budget_(4096 + 4 * source.remaining()) {}

  // False: the bytes do not hold what the type says.
  bool Run() {
    Walk(0, 0);
    return source_.ok();
  }

 private:
  using Node = MessageDecoder::Node;
  using By = MessageDecoder::Element::By;
  struct Wanted {
    uint32_t index;
    const Node* node;
    bool operator<(const Wanted& other) const { return index < other.index; }
  };

  const Node* At(int node) const { return node < 0 ? nullptr : &d_.nodes_[static_cast<size_t>(node)]; }

  bool Spend() {
    if (budget_ == 0) source_.Fail();
    if (budget_ > 0) --budget_;
    return source_.ok();
  }

  void Walk(size_t type, int node_number) {
    WalkMessage(d_.types_.messages[type], At(node_number), type == 0);
  }

  void WalkMessage(const MessageType& type, const Node* node, bool is_root) {
    const size_t level = names_.size();
    names_.emplace_back();
    // Behind the last field wanted, the rest of the message need not be read.
    const size_t end = is_root && node != nullptr && !node->fields.empty() ? node->fields.rbegin()->first + 1
                                                                           : type.fields.size();
    for (size_t i = 0; i < end && Spend(); ++i) {
      const FieldType& field = type.fields[i];
      const Node* child = nullptr;
      if (node != nullptr) {
        const auto found = node->fields.find(i);
        if (found != node->fields.end()) child = At(found->second);
      }
      if (node != nullptr && node->wants_names && HoldsNames(field)) {
        ReadNames(field, child, level);
      } else if (field.array == FieldType::Array::kNone) {
        WalkScalar(field, child);
      } else {
        WalkList(field, child);
      }
    }
    names_.pop_back();
  }

  void WalkScalar(const FieldType& field, const Node* node) {
    if (field.primitive == Primitive::kMessage) {
      if (node != nullptr && !node->outputs.empty()) return EmitTime(node, ReadTimeMessage());
      return WalkMessage(d_.types_.messages[field.message], node, false);
    }
    if (field.primitive == Primitive::kString) {
      const std::string_view text = source_.Text();
      if (node != nullptr) EmitText(node, text);
    } else if (field.primitive == Primitive::kWideString) {
      source_.Fail();
    } else if (node == nullptr) {
      source_.Skip(field.primitive, 1);
    } else if (field.primitive == Primitive::kTime) {
      EmitTime(node, source_.TimeNs());
    } else {
      EmitNumber(node, source_.Number(field.primitive));
    }
  }

  int64_t ReadTimeMessage() {  // builtin_interfaces/Time
    const auto seconds = static_cast<int64_t>(source_.Number(Primitive::kInt32));
    return seconds * 1'000'000'000 + static_cast<int64_t>(source_.Number(Primitive::kUint32));
  }

  // The elements that a list has; a count that the rest of the message cannot hold fails.
  uint32_t ListCount(const FieldType& field) {
    const uint32_t count = field.array == FieldType::Array::kFixed ? field.count : source_.Count();
    const uint64_t least = std::max<uint32_t>(SizeOf(field.primitive), 1);
    if (count * least > source_.remaining()) source_.Fail();
    return source_.ok() ? count : 0;
  }

  void WalkList(const FieldType& field, const Node* node) {
    const uint32_t count = ListCount(field);
    const std::vector<Wanted> wanted = node == nullptr ? std::vector<Wanted>() : WantedOf(*node, count);
    if (SizeOf(field.primitive) > 0) {
      WalkNumbers(field.primitive, count, wanted);
    } else {
      WalkElements(field, count, wanted);
    }
    if (node == nullptr || !source_.ok()) return;
    for (const auto& element : node->elements) {
      if (element.by == By::kAll)
        for (const size_t output : At(element.node)->outputs) values_[output].present = true;
    }
  }

  std::vector<Wanted> WantedOf(const Node& node, uint32_t count) const {
    std::vector<Wanted> wanted;
    for (const auto& element : node.elements) {
      const Node* inner = At(element.node);
      if (element.by == By::kIndex && element.index < count) wanted.push_back({element.index, inner});
      if (element.by == By::kAll)
        for (uint32_t k = 0; k < count; ++k) wanted.push_back({k, inner});
      if (element.by != By::kName) continue;
      const uint32_t index = IndexOfName(element.name);
      if (index < count) wanted.push_back({index, inner});
    }
    std::sort(wanted.begin(), wanted.end());
    return wanted;
  }

  uint32_t IndexOfName(const std::string& name) const {
    for (size_t level = names_.size(); level-- > 0;) {
      const auto& names = names_[level];
      if (names.empty()) continue;
      const auto found = std::find(names.begin(), names.end(), name);
      return found == names.end() ? UINT32_MAX : static_cast<uint32_t>(found - names.begin());
    }
    return UINT32_MAX;
  }

  void WalkNumbers(Primitive primitive, uint32_t count, const std::vector<Wanted>& wanted) {
    uint32_t at = 0;
    double value = 0.0;
    for (const Wanted& w : wanted) {
      if (w.index >= at) {
        source_.Skip(primitive, w.index - at);
        value = source_.Number(primitive);
        at = w.index + 1;
      }
      if (!source_.ok()) return;
      EmitNumber(w.node, value);
    }
    source_.Skip(primitive, count - at);
  }

  void WalkElements(const FieldType& field, uint32_t count, const std::vector<Wanted>& wanted) {
    FieldType element = field;
    element.array = FieldType::Array::kNone;
    auto next = wanted.begin();
    for (uint32_t k = 0; k < count && Spend(); ++k) {
      const Node* node = nullptr;
      for (; next != wanted.end() && next->index == k; ++next) node = next->node;
      WalkScalar(element, node);
    }
  }

  void ReadNames(const FieldType& field, const Node* node, size_t level) {
    const uint32_t count = ListCount(field);
    std::vector<std::string_view> names;
    for (uint32_t k = 0; k < count && Spend(); ++k) names.push_back(source_.Text());
    if (!source_.ok()) return;
    if (node != nullptr) {
      for (const Wanted& w : WantedOf(*node, count)) EmitText(w.node, names[w.index]);
      for (const auto& element : node->elements)
        for (const size_t output : At(element.node)->outputs)
          if (element.by == By::kAll) values_[output].present = true;
    }
    names_[level] = std::move(names);
  }

  void EmitNumber(const Node* node, double number) {
    for (const size_t output : node->outputs) {
      FieldValue& value = values_[output];
      value.present = true;
      value.number = number;
      if (d_.kinds_[output] == FieldKind::kNumbers) value.numbers.push_back(number);
    }
  }
  void EmitTime(const Node* node, int64_t time_ns) {
    for (const size_t output : node->outputs) {
      values_[output].present = source_.ok();
      values_[output].time_ns = time_ns;
      values_[output].number = static_cast<double>(time_ns) * 1e-9;
    }
  }
  void EmitText(const Node* node, std::string_view text) {
    for (const size_t output : node->outputs) {
      values_[output].present = true;
      values_[output].texts.emplace_back(text);
    }
  }

  const MessageDecoder& d_;
  FieldSource& source_;
  std::vector<FieldValue>& values_;
  uint64_t budget_;
  std::vector<std::vector<std::string_view>> names_;  // by level of nesting
};

Result<MessageDecoder> MessageDecoder::Make(const Topic& topic, const std::vector<std::string>& paths) {
  MessageDecoder decoder;
  decoder.topic_name_ = topic.name;
  decoder.encoding_ = topic.encoding;
  Status status = TypesOf(topic, &decoder.types_);
  DecoderBuilder builder(&decoder);
  for (const std::string& path : paths) {
    if (status.ok()) status = builder.Add(path);
  }
  if (!status.ok()) return status.WithPrefix("topic " + topic.name);
  return decoder;
}

Status MessageDecoder::Decode(std::string_view bytes, std::vector<FieldValue>* values) const {
  values->resize(kinds_.size());
  for (FieldValue& value : *values) {
    value.present = false;
    value.numbers.clear();
    value.texts.clear();
  }
  const auto source = MakeFieldSource(encoding_, bytes);
  if (source == nullptr || !MessageWalk(*this, *source, values).Run())
    return DataLossError("topic " + topic_name_ + ": a message of " + std::to_string(bytes.size()) +
                         " bytes is not a " + types_.root().name);
  return Status::Ok();
}

Result<std::vector<std::string>> FieldNames(const Topic& topic) {
  MessageTypes types;
  const Status status = TypesOf(topic, &types);
  if (!status.ok()) return status.WithPrefix("topic " + topic.name);
  std::vector<std::string> names;
  for (const FieldType& field : types.root().fields) names.push_back(field.name);
  return names;
}

}  // namespace rg::importing
