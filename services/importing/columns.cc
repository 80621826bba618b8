#include "services/importing/columns.h"

#include <algorithm>
#include <functional>
#include <set>

namespace rg::importing {
namespace {

const RobotJoint* FindJoint(const std::vector<RobotJoint>& robot, const std::string& name) {
  for (const RobotJoint& joint : robot) {
    if (joint.name == name) return &joint;
  }
  return nullptr;
}

std::string JointList(const std::vector<RobotJoint>& robot) {
  std::string list;
  for (const RobotJoint& joint : robot) list += (list.empty() ? "" : ", ") + joint.name;
  return list;
}

Quantity QuantityOf(const std::string& kind, bool prismatic) {
  if (kind == "position" || kind == "position_reference")
    return prismatic ? Quantity::kLength : Quantity::kAngle;
  if (kind == "velocity" || kind == "velocity_reference")
    return prismatic ? Quantity::kVelocity : Quantity::kAngularVelocity;
  if (kind == "effort_command" || kind == "effort_measured" || kind == "torque_sensor")
    return prismatic ? Quantity::kForce : Quantity::kTorque;
  return Quantity::kOther;
}

class Resolver {
 public:
  Resolver(const ImportMap& map, const std::string& map_name, const std::vector<RobotJoint>& robot)
      : map_(map), map_name_(map_name), robot_(robot) {}

  // Topic, fields and clock of an entry: what logs and CSV files differ in.
  using Expand = std::function<Status(const MapEntry&, const std::string& path, std::vector<WantedColumn>*)>;

  Result<std::vector<WantedColumn>> Resolve(const Expand& expand) {
    std::set<std::string> names;
    for (size_t i = 0; i < map_.entries.size(); ++i) {
      const MapEntry& entry = map_.entries[i];
      const std::string path = map_name_ + ": columns[" + std::to_string(i) + "]";
      std::vector<WantedColumn> columns;
      RG_RETURN_IF_ERROR(expand(entry, path, &columns));
      for (WantedColumn& column : columns) {
        column.entry = i;
        RG_RETURN_IF_ERROR(Finish(entry, path, &column));
        if (!names.insert(column.Name()).second)
          return InvalidError(path + ": column " + column.Name() + " is mapped twice");
        all_.push_back(std::move(column));
      }
    }
    return std::move(all_);
  }

 private:
  Status Finish(const MapEntry& entry, const std::string& path, WantedColumn* column) {
    column->kind = entry.column;
    column->hold = HoldOf(entry);
    bool prismatic = false;
    if (!column->joint.empty()) {
      const RobotJoint* joint = FindJoint(robot_, column->joint);
      if (joint == nullptr)
        return InvalidError(path + ".joint: the robot has no movable joint '" + column->joint + "' (" +
                            JointList(robot_) + ")");
      prismatic = joint->prismatic;
      column->wraps = joint->continuous && column->kind == "position";
    }
    const Quantity wanted = QuantityOf(column->kind, prismatic);
    column->unit = SiName(wanted);
    column->factor = entry.scale;
    column->offset = entry.offset;
    if (!entry.unit) return Status::Ok();
    if (wanted != Quantity::kOther && entry.unit->quantity != wanted) {
      return InvalidError(path + ".unit: " + entry.unit->name + " is no unit of " + column->Name() +
                          ", which is in " + SiName(wanted));
    }
    column->unit = entry.unit->name;
    column->factor = entry.scale * entry.unit->to_si;
    return Status::Ok();
  }

  const ImportMap& map_;
  const std::string& map_name_;
  const std::vector<RobotJoint>& robot_;
  std::vector<WantedColumn> all_;
};

bool IsStar(const MapEntry& entry) { return entry.fields[0].find("[*]") != std::string::npos; }

std::string WithIndex(const std::string& field, const std::string& index) {
  std::string path = field;
  return path.replace(path.find("[*]"), 3, "[" + index + "]");
}

// The joints of "[*]", with the index that each has in the message.
Result<std::vector<std::pair<std::string, std::string>>> StarJoints(const MapEntry& entry,
                                                                    const std::string& path,
                                                                    const TopicInfo& topic,
                                                                    const std::vector<RobotJoint>& robot) {
  std::vector<std::pair<std::string, std::string>> joints;
  if (entry.joints[0] != "*") {
    for (size_t i = 0; i < entry.joints.size(); ++i)
      joints.emplace_back(entry.joints[i], topic.names.empty() ? std::to_string(i) : entry.joints[i]);
    return joints;
  }
  for (const RobotJoint& joint : robot) {
    if (std::find(topic.names.begin(), topic.names.end(), joint.name) != topic.names.end())
      joints.emplace_back(joint.name, joint.name);
  }
  if (!joints.empty()) return joints;
  std::string names;
  for (const std::string& name : topic.names) names += (names.empty() ? "" : ", ") + name;
  return InvalidError(path + ".joint: *: topic " + topic.topic.name + " names none of the robot's joints (" +
                      (names.empty() ? "its messages hold no names" : "it names " + names) +
                      "; the robot has " + JointList(robot) + ")");
}

}  // namespace

bool WantedColumn::IsRequired() const {
  return kind == "position" || kind == "velocity" || kind == "effort_command" || kind == "effort_measured";
}

Result<std::vector<WantedColumn>> ResolveColumns(const ImportMap& map, const std::string& map_name,
                                                 const Inventory& log, const std::string& log_name,
                                                 const std::vector<RobotJoint>& robot) {
  if (map.time) return InvalidError(map_name + ": time: is for CSV files, " + log_name + " is none");
  const auto expand = [&](const MapEntry& entry, const std::string& path,
                          std::vector<WantedColumn>* columns) {
    const TopicInfo* topic = log.Find(entry.topic);
    if (topic == nullptr) {
      return InvalidError(path + ".topic: " + log_name + " has no topic " + Shown(entry.topic));
    }
    WantedColumn column;
    column.topic = entry.topic;
    column.clock = !entry.clock.empty() ? entry.clock : topic->has_header ? "header" : "log";
    if (column.clock == "header" && !topic->has_header) {
      return InvalidError(path + ".clock: messages of " + entry.topic + " (" + topic->topic.type +
                          ") have no header: use \"log\"");
    }
    if (!IsStar(entry)) {
      for (size_t i = 0; i < entry.fields.size(); ++i) {
        column.field = entry.fields[i];
        column.joint = entry.joints.empty() ? "" : entry.joints[i];
        columns->push_back(column);
      }
      return Status::Ok();
    }
    const auto joints = StarJoints(entry, path, *topic, robot);
    if (!joints.ok()) return joints.status();
    for (const auto& [joint, index] : *joints) {
      column.field = WithIndex(entry.fields[0], index);
      column.joint = joint;
      columns->push_back(column);
    }
    return Status::Ok();
  };
  return Resolver(map, map_name, robot).Resolve(expand);
}

Result<std::vector<WantedColumn>> ResolveCsvColumns(const ImportMap& map, const std::string& map_name,
                                                    const std::vector<std::string>& header,
                                                    const std::string& csv_name,
                                                    const std::vector<RobotJoint>& robot) {
  const auto expand = [&](const MapEntry& entry, const std::string& path,
                          std::vector<WantedColumn>* columns) {
    if (!entry.topic.empty()) return InvalidError(path + ".topic: " + csv_name + " is a CSV, which has none");
    if (!entry.clock.empty())
      return InvalidError(path + ".clock: " + csv_name + " is a CSV: say \"time\" instead");
    std::vector<std::string> fields = entry.fields;
    std::vector<std::string> joints = entry.joints;
    if (IsStar(entry)) {
      if (joints[0] == "*") return InvalidError(path + ".joint: * is for messages that name their joints");
      fields.clear();
      for (size_t i = 0; i < joints.size(); ++i)
        fields.push_back(WithIndex(entry.fields[0], std::to_string(i)));
    }
    for (size_t i = 0; i < fields.size(); ++i) {
      if (std::find(header.begin(), header.end(), fields[i]) == header.end())
        return InvalidError(path + ".field: " + csv_name + " has no column " + Shown(fields[i]));
      WantedColumn column;
      column.field = fields[i];
      column.joint = joints.empty() ? "" : joints[i];
      columns->push_back(column);
    }
    return Status::Ok();
  };
  return Resolver(map, map_name, robot).Resolve(expand);
}

std::string Joined(const std::vector<std::string>& names) {
  std::string all;
  for (const std::string& name : names) all += (all.empty() ? "" : ", ") + name;
  return all;
}

}  // namespace rg::importing
