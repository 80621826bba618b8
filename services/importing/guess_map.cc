#include "services/importing/guess_map.h"

#include <algorithm>
#include <map>
#include <nlohmann/json.hpp>
#include <set>

#include "common/base/printf.h"
#include "services/importing/name_words.h"

namespace rg::importing {
namespace {

constexpr double kNeverMoved = 1e-3;  // rad or m between the ends of a joint's range

bool EndsIn(const std::string& text, const std::string& end) {
  if (text.size() <= end.size() || text.compare(text.size() - end.size(), end.size(), end) != 0) return false;
  const char before = text[text.size() - end.size() - 1];
  return before == '_' || before == '/' || before == '.' || before == '-';
}

// The robot's joint that a message's name means: the same, or the only one that one of the two ends in.
const RobotJoint* JointOf(const std::string& name, const std::vector<RobotJoint>& robot) {
  const RobotJoint* found = nullptr;
  for (const RobotJoint& joint : robot) {
    if (joint.name == name) return &joint;
    if (!EndsIn(name, joint.name) && !EndsIn(joint.name, name)) continue;
    if (found != nullptr) return nullptr;
    found = &joint;
  }
  return found;
}

// A topic's names for the robot's joints.
struct NamedTopic {
  const TopicInfo* info = nullptr;
  std::map<std::string, std::string> name_of;  // joint -> name in the messages

  const NamedJoint& Said(const std::string& joint) const { return info->joints.at(name_of.at(joint)); }
};

NamedTopic NamesOf(const TopicInfo& info, const std::vector<RobotJoint>& robot) {
  NamedTopic topic{&info, {}};
  std::set<std::string> twice;
  for (const auto& [name, said] : info.joints) {
    const RobotJoint* joint = JointOf(name, robot);
    if (joint == nullptr) continue;
    const auto [at, is_new] = topic.name_of.emplace(joint->name, name);
    if (is_new) continue;
    if (name == joint->name) at->second = name;
    if (at->second != joint->name) twice.insert(joint->name);
  }
  for (const std::string& joint : twice) topic.name_of.erase(joint);
  return topic;
}

class LogGuesser {
 public:
  LogGuesser(const Inventory& log, const std::string& log_name, const std::vector<RobotJoint>& robot)
      : log_(log), log_name_(log_name), robot_(robot) {}

  Result<GuessedMap> Guess() {
    SortTopics();
    RG_RETURN_IF_ERROR(TakePositions());
    LockWhatNeverMoves();
    AddEntries("position", [](const NamedJoint& said) { return said.position; });
    TakeVelocities();
    TakeMeasuredEfforts();
    TakeCommandedEfforts();
    RG_RETURN_IF_ERROR(CheckEffort());
    if (!locked_.empty()) out_.map.manifest_json = nlohmann::json{{"locked", locked_}}.dump();
    return std::move(out_);
  }

 private:
  void Say(const std::string& reason) { out_.reasons.push_back(reason); }
  void Ask(const std::string& question) { out_.questions.push_back(question); }

  // States and commands with names, those of most joints and messages first.
  void SortTopics() {
    for (const TopicInfo& info : log_.topics) {
      if (info.joints.empty()) continue;
      NamedTopic topic = NamesOf(info, robot_);
      if (topic.name_of.empty()) continue;
      (IsCommand(info.topic.name) ? commands_ : states_).push_back(std::move(topic));
    }
    const auto better = [](const NamedTopic& a, const NamedTopic& b) {
      if (a.name_of.size() != b.name_of.size()) return a.name_of.size() > b.name_of.size();
      if (a.info->messages != b.info->messages) return a.info->messages > b.info->messages;
      return a.info->topic.name.size() < b.info->topic.name.size();
    };
    std::stable_sort(states_.begin(), states_.end(), better);
    std::stable_sort(commands_.begin(), commands_.end(), better);
  }

  Status TakePositions() {
    for (const NamedTopic& topic : states_) {
      std::vector<std::string> taken;
      for (const RobotJoint& joint : robot_) {
        if (source_.contains(joint.name) || !topic.name_of.contains(joint.name)) continue;
        if (topic.Said(joint.name).position.count == 0) continue;
        source_[joint.name] = &topic;
        taken.push_back(joint.name);
      }
      if (taken.empty()) {
        Say(topic.info->topic.name + ": not taken, its joints are in " +
            source_.begin()->second->info->topic.name);
      } else {
        Say(topic.info->topic.name + ": states of " + Joined(taken) + ", the robot's joints by their names");
      }
    }
    if (source_.empty()) TakeKinovaAngles();
    if (!source_.empty() || !out_.map.entries.empty()) return Status::Ok();
    std::string names;
    for (const TopicInfo& info : log_.topics) {
      if (info.topic.type == "sensor_msgs/JointState")
        names += (names.empty() ? "" : ", ") + Joined(info.names);
    }
    std::vector<std::string> joints;
    for (const RobotJoint& joint : robot_) joints.push_back(joint.name);
    return InvalidError(log_name_ + ": no JointState names a joint of the robot (the robot has " +
                        Joined(joints) +
                        (names.empty() ? "; there is no JointState)" : "; the messages name " + names + ")") +
                        ": write a mapping");
  }

  // A joint that stands still and is not driven has no columns: it is locked where it stands.
  void LockWhatNeverMoves() {
    std::vector<std::string> still;
    for (const auto& [joint, topic] : source_) {
      const NamedJoint& said = topic->Said(joint);
      const bool moves = said.position.high - said.position.low > kNeverMoved;
      if (!moves && (said.effort.count == 0 || said.effort.all_zero())) still.push_back(joint);
    }
    if (still.size() == source_.size()) return;  // the robot stands still: for others to say
    for (const std::string& joint : still) {
      const Range& position = source_[joint]->Said(joint).position;
      locked_[joint] = 0.5 * (position.low + position.high);
      Say(joint + ": never moves and has no effort: locked at " + Printf("%.6g", locked_[joint]));
      source_.erase(joint);
    }
  }

  // One entry per topic, for the joints of which `range` holds something.
  template <class RangeOf>
  void AddEntries(const std::string& kind, const RangeOf& range_of) {
    for (const NamedTopic& topic : states_) {
      MapEntry entry;
      entry.topic = topic.info->topic.name;
      entry.column = kind;
      for (const RobotJoint& joint : robot_) {
        const auto source = source_.find(joint.name);
        if (source == source_.end() || source->second != &topic ||
            range_of(topic.Said(joint.name)).count == 0)
          continue;
        entry.fields.push_back(kind + "[" + topic.name_of.at(joint.name) + "]");
        if (kind == "effort_measured") entry.fields.back().replace(0, kind.size(), "effort");
        entry.joints.push_back(joint.name);
      }
      if (entry.joints.empty()) continue;
      entry.clock = ClockOf(*topic.info);
      out_.map.entries.push_back(std::move(entry));
    }
  }

  std::string ClockOf(const TopicInfo& info) {
    if (info.has_header && info.stamp_is_set) return "header";
    if (info.has_header && said_clock_.insert(info.topic.name).second)
      Say(info.topic.name + ": its header's stamp is always 0: the log's time");
    return "log";
  }

  void TakeVelocities() {
    bool all = true, any_motion = false;
    for (const auto& [joint, topic] : source_) {
      const Range& velocity = topic->Said(joint).velocity;
      all = all && velocity.count > 0;
      any_motion = any_motion || (velocity.count > 0 && !velocity.all_zero());
    }
    if (source_.empty()) return;
    if (all && any_motion)
      return AddEntries("velocity", [](const NamedJoint& said) { return said.velocity; });
    Say(all ? "velocities are 0 throughout: not taken"
            : "velocities are not there for every joint: not taken");
  }

  void TakeMeasuredEfforts() {
    bool any = false;
    for (const auto& [joint, topic] : source_) {
      const Range& effort = topic->Said(joint).effort;
      any = any || (effort.count > 0 && !effort.all_zero());
    }
    if (any) {
      Say("effort of the states: effort_measured");
      AddEntries("effort_measured", [](const NamedJoint& said) { return said.effort; });
      has_effort_ = true;
      return;
    }
    if (!source_.empty()) Say("the states' efforts are empty or 0 throughout: not taken");
    for (const TopicInfo& info : log_.topics) {
      const bool kinova =
          info.topic.type == "kinova_msgs/JointAngles" || info.topic.type == "kinova_msgs/JointTorque";
      if (has_effort_ || !kinova || IsCommand(info.topic.name) || !IsEffort(info.topic.name)) continue;
      TakeKinova(info, "effort_measured", "N*m");
      has_effort_ = true;
    }
  }

  void TakeCommandedEfforts() {
    for (const NamedTopic& topic : commands_) {
      bool effort = false;
      for (const auto& [joint, name] : topic.name_of)
        effort = effort || topic.info->joints.at(name).effort.count > 0;
      if (!effort) {
        position_commands_.push_back(topic.info->topic.name);
      } else if (commanded_.empty()) {
        TakeNamedCommand(topic);
      } else {
        Ask("efforts are commanded by " + commanded_ + " and by " + topic.info->topic.name);
      }
    }
    for (const TopicInfo& info : log_.topics) {
      if (info.joints.empty()) TakeUnnamedCommand(info);
    }
  }

  void TakeNamedCommand(const NamedTopic& topic) {
    MapEntry entry;
    entry.topic = topic.info->topic.name;
    entry.column = "effort_command";
    entry.clock = ClockOf(*topic.info);
    for (const RobotJoint& joint : robot_) {
      if (!topic.name_of.contains(joint.name) || locked_.contains(joint.name)) continue;
      if (topic.Said(joint.name).effort.count == 0) continue;
      entry.fields.push_back("effort[" + topic.name_of.at(joint.name) + "]");
      entry.joints.push_back(joint.name);
    }
    if (entry.joints.empty()) return;
    AddCommand(std::move(entry), "effort of a topic that is a command by its name: effort_command");
  }

  void AddCommand(MapEntry entry, const std::string& why) {
    commanded_ = entry.topic;
    has_effort_ = true;
    Say(entry.topic + ": " + why);
    out_.map.entries.push_back(std::move(entry));
  }

  void TakeUnnamedCommand(const TopicInfo& info) {
    const std::string& name = info.topic.name;
    const std::string& type = info.topic.type;
    if (type.rfind("trajectory_msgs/", 0) == 0 ||
        Contains(type, {"FollowJointTrajectory", "JointTrajectoryController"})) {
      position_commands_.push_back(name);
      return;
    }
    if (!IsCommand(name)) return;
    if (type == "kinova_msgs/JointTorque") {
      TakeKinova(info, "effort_command", "N*m");
      commanded_ = name;
      has_effort_ = true;
    } else if (type == "std_msgs/Float64MultiArray" || type == "std_msgs/Float32MultiArray") {
      TakeList(info);
    } else if (type == "std_msgs/Float64" || type == "std_msgs/Float32") {
      TakeSingle(info);
    } else if (Contains(type, {"Joint"})) {
      position_commands_.push_back(name);
    }
  }

  // "data" of one number per joint, in an order that the message does not say.
  void TakeList(const TopicInfo& info) {
    const std::string& name = info.topic.name;
    if (Contains(name, {"position", "velocity", "trajectory"})) {
      position_commands_.push_back(name);
      return;
    }
    std::vector<std::string> joints = TakenJoints();
    if (info.list_length != joints.size()) {
      Say(name + ": " + std::to_string(info.list_length) + " numbers for " + std::to_string(joints.size()) +
          " joints: not taken");
      return;
    }
    if (!commanded_.empty()) Ask("efforts are commanded by " + commanded_ + " and by " + name);
    MapEntry entry;
    entry.topic = name;
    entry.column = "effort_command";
    entry.fields = {joints.size() == 1 ? "data[0]" : "data[*]"};
    entry.joints = joints;
    entry.clock = "log";
    if (!IsEffort(name)) Ask(name + ": does its name mean efforts? taken as effort_command");
    if (joints.size() > 1) {
      entry.note = "the order of the numbers is not in the message: the URDF's is assumed, check it";
      Ask(name + ": the message does not say which number is which joint's; " + Joined(joints) +
          " is assumed");
    }
    AddCommand(std::move(entry), "a list with a number for each joint: effort_command");
  }

  // One topic per joint, as ros_control's joint_effort_controller has them.
  void TakeSingle(const TopicInfo& info) {
    if (!IsEffort(info.topic.name)) {
      position_commands_.push_back(info.topic.name);
      return;
    }
    std::string best;
    for (const std::string& joint : TakenJoints()) {
      if (info.topic.name.find(joint) != std::string::npos && joint.size() > best.size()) best = joint;
    }
    if (best.empty()) return;
    MapEntry entry;
    entry.topic = info.topic.name;
    entry.column = "effort_command";
    entry.fields = {"data"};
    entry.joints = {best};
    entry.clock = "log";
    AddCommand(std::move(entry), "the commanded effort of " + best + " by its name");
  }

  std::vector<std::string> TakenJoints() const {
    std::vector<std::string> joints;
    for (const RobotJoint& joint : robot_) {
      const bool by_kinova = std::find(kinova_.begin(), kinova_.end(), joint.name) != kinova_.end();
      if (source_.contains(joint.name) || by_kinova) joints.push_back(joint.name);
    }
    return joints;
  }

  // joint1 … joint7 of kinova_msgs are the robot's joints whose names end in these numbers.
  std::vector<std::string> KinovaJoints() const {
    std::vector<std::string> joints;
    for (int k = 1; k <= 7; ++k) {
      std::string found;
      for (const RobotJoint& joint : robot_) {
        const std::string number = std::to_string(k);
        const bool ends = joint.name == "joint" + number || EndsIn(joint.name, number) ||
                          EndsIn(joint.name, "joint" + number);
        if (!ends || Contains(joint.name, {"finger"})) continue;
        if (!found.empty()) return {};
        found = joint.name;
      }
      if (found.empty()) break;
      joints.push_back(found);
    }
    return joints;
  }

  void TakeKinova(const TopicInfo& info, const std::string& column, const std::string& unit) {
    const std::vector<std::string> joints = KinovaJoints();
    if (joints.empty()) {
      Say(info.topic.name + ": the robot has no joints numbered 1, 2, …: not taken");
      return;
    }
    MapEntry entry;
    entry.topic = info.topic.name;
    entry.column = column;
    const std::vector<std::string> taken = TakenJoints();
    for (size_t k = 0; k < joints.size(); ++k) {
      if (!taken.empty() && std::find(taken.begin(), taken.end(), joints[k]) == taken.end()) continue;
      entry.fields.push_back("joint" + std::to_string(k + 1));
      entry.joints.push_back(joints[k]);
    }
    if (entry.joints.empty()) return;
    const auto parsed = ParseUnit(unit);
    if (parsed.ok()) entry.unit = *parsed;
    entry.clock = "log";
    Say(info.topic.name + ": joint1 … are " + Joined(entry.joints) + " by their numbers, in " + unit +
        "; the messages carry no stamp: the log's time");
    if (column == "position") kinova_ = entry.joints;
    out_.map.entries.push_back(std::move(entry));
  }

  void TakeKinovaAngles() {
    for (const TopicInfo& info : log_.topics) {
      if (info.topic.type != "kinova_msgs/JointAngles" || IsCommand(info.topic.name) ||
          IsEffort(info.topic.name))
        continue;
      TakeKinova(info, "position", "deg");
      Ask(info.topic.name + ": are its angles degrees, as kinova's driver has them?");
      return;
    }
  }

  Status CheckEffort() const {
    if (has_effort_) return Status::Ok();
    if (!position_commands_.empty()) {
      return InvalidError(log_name_ + ": holds position commands (" + position_commands_[0] +
                          ") and no effort: position-commanded drives are not modelled yet");
    }
    return InvalidError(log_name_ +
                        ": holds no effort, commanded or measured: nothing says what drives the robot");
  }

  const Inventory& log_;
  const std::string& log_name_;
  const std::vector<RobotJoint>& robot_;
  GuessedMap out_;
  std::vector<NamedTopic> states_, commands_;
  std::map<std::string, const NamedTopic*> source_;  // joint -> the topic of its position
  std::vector<std::string> kinova_;                  // joints by kinova's angles
  std::map<std::string, double> locked_;
  std::set<std::string> said_clock_;
  std::vector<std::string> position_commands_;
  std::string commanded_;
  bool has_effort_ = false;
};

}  // namespace

Result<GuessedMap> GuessMap(const Inventory& log, const std::string& log_name,
                            const std::vector<RobotJoint>& robot) {
  return LogGuesser(log, log_name, robot).Guess();
}

}  // namespace rg::importing
