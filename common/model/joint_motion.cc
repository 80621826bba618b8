#include "common/model/joint_motion.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "common/base/number_text.h"
#include "common/model/urdf_xml.h"

namespace rg::model {
namespace {

using Kind = JointMotion::Kind;

class MotionResolver {
 public:
  MotionResolver(const UrdfDocument& document, const std::string& source, const LoadOptions& options,
                 std::vector<std::string>* warnings)
      : document_(document),
        source_(source),
        options_(options),
        warnings_(warnings),
        out_(document.joints.size()),
        driver_(document.joints.size(), -1) {
    for (size_t j = 0; j < document.joints.size(); ++j) {
      index_[document.joints[j].name] = static_cast<int>(j);
    }
  }

  Result<std::vector<JointMotion>> Run() {
    RG_RETURN_IF_ERROR(CheckOptions());
    RG_RETURN_IF_ERROR(FindDrivers());
    std::vector<State> state(out_.size(), State::kOpen);
    for (size_t j = 0; j < out_.size(); ++j) RG_RETURN_IF_ERROR(Resolve(static_cast<int>(j), &state));
    for (size_t j = 0; j < out_.size(); ++j) RG_RETURN_IF_ERROR(SayWhatMimicsDo(static_cast<int>(j)));
    return std::move(out_);
  }

 private:
  enum class State { kOpen, kOnTheWay, kDone };

  Status Error(const std::string& what) const { return InvalidError(source_ + ": " + what); }
  const UrdfJoint& Joint(int j) const { return document_.joints[j]; }
  std::string Name(int j) const { return "joint " + Quoted(Joint(j).name); }
  bool IsAskedFor(int j) const {
    return std::find(options_.joints.begin(), options_.joints.end(), Joint(j).name) != options_.joints.end();
  }

  Status CheckOptions() const {
    for (const std::string& name : options_.joints) {
      const auto found = index_.find(name);
      if (found == index_.end()) return Error("joint " + Quoted(name) + " does not exist");
      if (Joint(found->second).is_fixed) return Error(Name(found->second) + " is fixed and cannot move");
      if (options_.locked.contains(name)) return Error(Name(found->second) + " is both moving and locked");
      if (std::count(options_.joints.begin(), options_.joints.end(), name) > 1) {
        return Error(Name(found->second) + " is asked for twice");
      }
    }
    for (const auto& [name, q] : options_.locked) {
      const auto found = index_.find(name);
      if (found == index_.end()) return Error("locked joint " + Quoted(name) + " does not exist");
      if (Joint(found->second).is_fixed && q != 0.0)
        return Error("locked " + Name(found->second) + " is fixed");
      if (!std::isfinite(q)) return Error("locked " + Name(found->second) + ": position is not finite");
    }
    return Status::Ok();
  }

  Status FindDrivers() {
    for (size_t j = 0; j < out_.size(); ++j) {
      const UrdfJoint& joint = document_.joints[j];
      if (!joint.mimic) continue;
      const auto driver = index_.find(joint.mimic->driver);
      if (driver == index_.end() && IsLocked(static_cast<int>(j))) continue;
      if (driver == index_.end()) {
        return Error(Name(static_cast<int>(j)) + " mimics joint " + Quoted(joint.mimic->driver) +
                     ", which does not exist");
      }
      driver_[j] = driver->second;
    }
    return Status::Ok();
  }

  bool IsLocked(int j) const { return options_.locked.contains(Joint(j).name); }

  // Goes along the chain of mimics to a joint whose motion is known, and back.
  Status Resolve(int start, std::vector<State>* state) {
    std::vector<int> chain;
    int at = start;
    while ((*state)[at] != State::kDone && driver_[at] >= 0 && !IsLocked(at)) {
      if ((*state)[at] == State::kOnTheWay) {
        return Error(Name(at) + " mimics itself" + (driver_[at] == at ? "" : ", through other mimic joints"));
      }
      (*state)[at] = State::kOnTheWay;
      chain.push_back(at);
      at = driver_[at];
    }
    if ((*state)[at] != State::kDone) {
      out_[at] = OwnMotion(at);
      (*state)[at] = State::kDone;
    }
    for (; !chain.empty(); chain.pop_back()) {
      RG_RETURN_IF_ERROR(Follow(chain.back()));
      (*state)[chain.back()] = State::kDone;
    }
    return Status::Ok();
  }

  // Of a joint that mimics none, or is locked.
  JointMotion OwnMotion(int j) const {
    JointMotion motion;
    const auto locked = options_.locked.find(Joint(j).name);
    if (locked != options_.locked.end()) {
      motion.position = locked->second;
    } else if (!Joint(j).is_fixed && (options_.joints.empty() || IsAskedFor(j))) {
      motion.kind = Kind::kMoves;
    }
    return motion;
  }

  Status Follow(int j) {
    const JointMotion& driver = out_[driver_[j]];
    const UrdfMimic& mimic = *Joint(j).mimic;
    JointMotion& motion = out_[j];
    if (driver.kind == Kind::kStands) {
      motion.position = mimic.multiplier * driver.position + mimic.offset;
    } else {
      const bool direct = driver.kind == Kind::kMoves;
      motion.kind = Kind::kFollows;
      motion.driver = direct ? driver_[j] : driver.driver;
      motion.multiplier = direct ? mimic.multiplier : mimic.multiplier * driver.multiplier;
      motion.offset = direct ? mimic.offset : mimic.multiplier * driver.offset + mimic.offset;
      if (motion.multiplier == 0.0) motion = {.kind = Kind::kStands, .position = motion.offset};
    }
    if (std::isfinite(motion.position) && std::isfinite(motion.multiplier) && std::isfinite(motion.offset)) {
      return Status::Ok();
    }
    return Error(Name(j) + ": <mimic>: its position is out of a double's range");
  }

  Status SayWhatMimicsDo(int j) const {
    if (driver_[j] < 0) return Status::Ok();
    const JointMotion& motion = out_[j];
    const std::string mimics = "it mimics " + Name(driver_[j]);
    const auto say = [&](const std::string& what) { warnings_->push_back(source_ + ": " + Name(j) + what); };
    if (IsLocked(j)) {
      SayWhereItWouldBe(j);
    } else if (motion.kind == Kind::kFollows) {
      if (IsAskedFor(j)) say(": " + mimics + " and moves with it; its own columns are not used");
    } else if (IsAskedFor(j)) {
      return Error(Name(j) + " cannot move: " + mimics +
                   ", which stands (name that among the joints that move)");
    } else {
      const JointMotion& driver = out_[driver_[j]];
      say(" stands at " + NumberToText(motion.position) + ": " + mimics +
          (driver.kind == Kind::kStands ? ", which stands at " + NumberToText(driver.position)
                                        : " with multiplier 0"));
    }
    return Status::Ok();
  }

  // Of a mimic that is locked by name, if its driver would have it elsewhere.
  void SayWhereItWouldBe(int j) const {
    const JointMotion& driver = out_[driver_[j]];
    const UrdfMimic& mimic = *Joint(j).mimic;
    std::string would_be = "moves";
    if (driver.kind == Kind::kStands) {
      const double position = mimic.multiplier * driver.position + mimic.offset;
      if (std::abs(position - out_[j].position) <= 1e-9) return;
      would_be = "would have it at " + NumberToText(position);
    }
    warnings_->push_back(source_ + ": " + Name(j) + " is locked at " + NumberToText(out_[j].position) +
                         ", although it mimics " + Name(driver_[j]) + ", which " + would_be);
  }

  const UrdfDocument& document_;
  const std::string& source_;
  const LoadOptions& options_;
  std::vector<std::string>* warnings_;
  std::map<std::string, int> index_;
  std::vector<JointMotion> out_;
  std::vector<int> driver_;  // the joint that it mimics, or -1
};

}  // namespace

Result<std::vector<JointMotion>> MotionOfJoints(const UrdfDocument& document, const std::string& source_name,
                                                const LoadOptions& options,
                                                std::vector<std::string>* warnings) {
  return MotionResolver(document, source_name, options, warnings).Run();
}

}  // namespace rg::model
