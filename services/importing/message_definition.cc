#include "services/importing/message_definition.h"

#include <algorithm>
#include <charconv>
#include <map>
#include <set>

#include "services/importing/log.h"

namespace rg::importing {
namespace {

constexpr int kMaxDepth = 16;
constexpr size_t kMaxFields = 20000;  // of all messages of a type together
constexpr std::string_view kSeparator =
    "\n================================================================================\n";

const std::map<std::string, Primitive, std::less<>>& Primitives() {
  static const std::map<std::string, Primitive, std::less<>> names = {
      {"bool", Primitive::kUint8},      {"byte", Primitive::kUint8},
      {"char", Primitive::kUint8},      {"octet", Primitive::kUint8},
      {"int8", Primitive::kInt8},       {"uint8", Primitive::kUint8},
      {"int16", Primitive::kInt16},     {"uint16", Primitive::kUint16},
      {"int32", Primitive::kInt32},     {"uint32", Primitive::kUint32},
      {"int64", Primitive::kInt64},     {"uint64", Primitive::kUint64},
      {"float32", Primitive::kFloat32}, {"float64", Primitive::kFloat64},
      {"string", Primitive::kString},   {"wstring", Primitive::kWideString},
      {"time", Primitive::kTime},       {"duration", Primitive::kDuration}};
  return names;
}

// Known by themselves, as their packages define them; comments and constants are left out.
const std::map<std::string, std::string, std::less<>>& KnownTypes() {
  static const std::map<std::string, std::string, std::less<>> types = {
      {"builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n"},
      {"builtin_interfaces/Duration", "int32 sec\nuint32 nanosec\n"},
      {"std_msgs/Header", "uint32 seq\ntime stamp\nstring frame_id\n"},
      {"std_msgs/String", "string data\n"},
      {"std_msgs/Bool", "bool data\n"},
      {"std_msgs/Int32", "int32 data\n"},
      {"std_msgs/Float32", "float32 data\n"},
      {"std_msgs/Float64", "float64 data\n"},
      {"std_msgs/MultiArrayDimension", "string label\nuint32 size\nuint32 stride\n"},
      {"std_msgs/MultiArrayLayout", "MultiArrayDimension[] dim\nuint32 data_offset\n"},
      {"std_msgs/Float32MultiArray", "MultiArrayLayout layout\nfloat32[] data\n"},
      {"std_msgs/Float64MultiArray", "MultiArrayLayout layout\nfloat64[] data\n"},
      {"sensor_msgs/JointState",
       "Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n"},
      {"geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n"},
      {"geometry_msgs/Wrench", "Vector3 force\nVector3 torque\n"},
      {"geometry_msgs/WrenchStamped", "std_msgs/Header header\nWrench wrench\n"},
      {"trajectory_msgs/JointTrajectoryPoint",
       "float64[] positions\nfloat64[] velocities\nfloat64[] accelerations\nfloat64[] effort\n"
       "duration time_from_start\n"},
      {"trajectory_msgs/JointTrajectory",
       "Header header\nstring[] joint_names\nJointTrajectoryPoint[] points\n"},
      {"control_msgs/JointTrajectoryControllerState",
       "std_msgs/Header header\nstring[] joint_names\ntrajectory_msgs/JointTrajectoryPoint desired\n"
       "trajectory_msgs/JointTrajectoryPoint actual\ntrajectory_msgs/JointTrajectoryPoint error\n"},
      {"control_msgs/InterfaceValue", "string[] interface_names\nfloat64[] values\n"},
      {"control_msgs/DynamicJointState",
       "std_msgs/Header header\nstring[] joint_names\nInterfaceValue[] interface_values\n"},
      {"kinova_msgs/JointAngles",
       "float32 joint1\nfloat32 joint2\nfloat32 joint3\nfloat32 joint4\nfloat32 joint5\nfloat32 joint6\n"
       "float32 joint7\n"},
      {"kinova_msgs/JointVelocity",
       "float32 joint1\nfloat32 joint2\nfloat32 joint3\nfloat32 joint4\nfloat32 joint5\nfloat32 joint6\n"
       "float32 joint7\n"},
      {"kinova_msgs/JointTorque",
       "float32 joint1\nfloat32 joint2\nfloat32 joint3\nfloat32 joint4\nfloat32 joint5\nfloat32 joint6\n"
       "float32 joint7\n"}};
  return types;
}

std::string KnownText(const std::string& type, bool ros2) {
  const auto found = KnownTypes().find(type);
  if (found == KnownTypes().end()) return "";
  std::string text = found->second;
  if (!ros2) return text;
  if (type == "std_msgs/Header") return "builtin_interfaces/Time stamp\nstring frame_id\n";
  const auto replace = [&](const std::string& from, const std::string& to) {
    const size_t at = text.find(from);
    if (at != std::string::npos && (at == 0 || text[at - 1] == '\n')) text.replace(at, from.size(), to);
  };
  replace("Header header", "std_msgs/Header header");
  replace("duration time_from_start", "builtin_interfaces/Duration time_from_start");
  return text;
}

std::string_view Trimmed(std::string_view text) {
  const auto blank = [](char c) { return c == ' ' || c == '\t' || c == '\r'; };
  while (!text.empty() && blank(text.front())) text.remove_prefix(1);
  while (!text.empty() && blank(text.back())) text.remove_suffix(1);
  return text;
}

std::string_view TakeLine(std::string_view* text) {
  const size_t end = std::min(text->find('\n'), text->size());
  const std::string_view line = text->substr(0, end);
  text->remove_prefix(std::min(end + 1, text->size()));
  return line;
}

std::string_view PackageOf(std::string_view type) {
  return type.substr(0, std::min(type.find('/'), type.size()));
}

// The text's definitions by type: the first is the type's own.
std::map<std::string, std::string_view> Sections(const std::string& type, std::string_view text) {
  std::map<std::string, std::string_view> sections;
  std::string name = type;
  const char* start = text.data();
  const auto close = [&](const char* end) {
    sections.emplace(name, std::string_view(start, static_cast<size_t>(end - start)));
  };
  while (!text.empty()) {
    const char* line_start = text.data();
    const std::string_view line = Trimmed(TakeLine(&text));
    if (line.substr(0, 3) == "===") {
      close(line_start);
      start = text.data();
      const std::string_view head = Trimmed(TakeLine(&text));
      if (head.substr(0, 4) != "MSG:") continue;
      name = PlainTypeName(Trimmed(head.substr(4)));
      start = text.data();
    }
  }
  close(text.data());
  return sections;
}

class DefinitionParser {
 public:
  DefinitionParser(const std::string& type, std::string_view text, bool ros2)
      : root_(type), sections_(Sections(type, text)), ros2_(ros2) {}

  Result<MessageTypes> Parse() {
    RG_RETURN_IF_ERROR(Add(root_, 0).status());
    return std::move(types_);
  }

 private:
  Status Error(const std::string& type, const std::string& what) const {
    return InvalidError("definition of " + Shown(type) + ": " + what);
  }

  // The number of a type, read first if it is new.
  Result<size_t> Add(const std::string& type, int depth) {
    if (open_.contains(type)) return Error(type, "contains itself");
    const auto known = number_of_.find(type);
    if (known != number_of_.end()) return known->second;
    if (depth > kMaxDepth)
      return Error(root_, "messages inside messages more than " + std::to_string(kMaxDepth) + " deep");
    std::string own_text;
    std::string_view text;
    const auto section = sections_.find(type);
    if (section != sections_.end() && !(depth == 0 && section->second.empty())) {
      text = section->second;
    } else {
      own_text = KnownText(type, ros2_);
      if (own_text.empty()) return Error(type, "is not in the file, and is no type that this program knows");
      text = own_text;
    }
    const size_t number = types_.messages.size();
    number_of_[type] = number;
    types_.messages.push_back({type, {}});
    open_.insert(type);
    RG_RETURN_IF_ERROR(ReadFields(type, text, number, depth));
    open_.erase(type);
    return number;
  }

  Status ReadFields(const std::string& type, std::string_view text, size_t number, int depth) {
    while (!text.empty()) {
      std::string_view line = TakeLine(&text);
      line = Trimmed(line.substr(0, line.find('#')));
      if (line.empty()) continue;
      const size_t blank = line.find_first_of(" \t");
      if (blank == std::string_view::npos) return Error(type, Shown(line) + " is no field");
      const std::string_view rest = Trimmed(line.substr(blank));
      const size_t name_end = std::min(rest.find_first_of(" \t="), rest.size());
      const std::string_view behind = Trimmed(rest.substr(name_end));
      if (!behind.empty() && behind.front() == '=') continue;  // a constant
      if (++field_count_ > kMaxFields)
        return Error(root_, "more than " + std::to_string(kMaxFields) + " fields");
      RG_ASSIGN_OR_RETURN(FieldType field, ReadType(type, line.substr(0, blank), depth));
      field.name = rest.substr(0, name_end);
      types_.messages[number].fields.push_back(std::move(field));
    }
    return Status::Ok();
  }

  Result<FieldType> ReadType(const std::string& owner, std::string_view text, int depth) {
    FieldType field;
    std::string_view element = text;
    if (!text.empty() && text.back() == ']') {
      const size_t open = text.rfind('[');
      if (open == std::string_view::npos) return Error(owner, Shown(text) + " is no type");
      RG_RETURN_IF_ERROR(ReadArray(owner, text.substr(open + 1, text.size() - open - 2), &field));
      element = text.substr(0, open);
    }
    element = element.substr(0, element.find("<="));  // a bounded string
    const auto primitive = Primitives().find(element);
    if (primitive != Primitives().end()) {
      field.primitive = primitive->second;
      return field;
    }
    RG_ASSIGN_OR_RETURN(field.message, Add(FullName(owner, element), depth + 1));
    return field;
  }

  Status ReadArray(const std::string& owner, std::string_view count, FieldType* field) const {
    field->array = FieldType::Array::kVariable;
    if (count.empty() || count.substr(0, 2) == "<=") return Status::Ok();
    field->array = FieldType::Array::kFixed;
    const auto end = std::from_chars(count.data(), count.data() + count.size(), field->count);
    if (end.ec != std::errc() || end.ptr != count.data() + count.size() || field->count > (1u << 28))
      return Error(owner, "[" + Shown(count) + "] is no array");
    return Status::Ok();
  }

  std::string FullName(const std::string& owner, std::string_view element) const {
    const std::string plain = PlainTypeName(element);
    if (plain.find('/') != std::string::npos) return plain;
    const std::string beside = std::string(PackageOf(owner)) + "/" + plain;
    if (plain == "Header" && !sections_.contains(beside)) return "std_msgs/Header";
    return beside;
  }

  std::string root_;
  std::map<std::string, std::string_view> sections_;
  bool ros2_ = false;
  MessageTypes types_;
  std::map<std::string, size_t> number_of_;
  std::set<std::string> open_;
  size_t field_count_ = 0;
};

}  // namespace

Result<MessageTypes> ParseDefinition(const std::string& type, std::string_view text, bool ros2) {
  if (type.empty()) return InvalidError("the file does not say of which type it is");
  return DefinitionParser(type, text, ros2).Parse();
}

std::string KnownDefinition(const std::string& type, bool ros2) {
  std::string all = KnownText(type, ros2);
  if (all.empty()) return "";
  const auto types = DefinitionParser(type, all, ros2).Parse();
  if (!types.ok()) return "";
  for (size_t i = 1; i < types->messages.size(); ++i) {
    const std::string& name = types->messages[i].name;
    all += std::string(kSeparator.substr(1)) + "MSG: " + name + "\n" + KnownText(name, ros2);
  }
  return all;
}

bool IsTime(const MessageTypes& types, const FieldType& field) {
  if (field.array != FieldType::Array::kNone) return false;
  return field.primitive == Primitive::kTime ||
         (field.primitive == Primitive::kMessage &&
          types.messages[field.message].name == "builtin_interfaces/Time");
}

}  // namespace rg::importing
