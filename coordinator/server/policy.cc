#include "coordinator/server/policy.h"

#include "common/base/utf8.h"
#include "coordinator/core/types.h"
#include "realitygrad/v1/artifact.pb.h"
#include "realitygrad/v1/control.pb.h"
#include "realitygrad/v1/parameters.pb.h"

namespace rg::coordinator {
namespace {

namespace pb = realitygrad::v1;
using transport::Is;

constexpr char kHowToGetTheRight[] = "the right is given by `realitygrad keys allow NAME --robots`";

bool IsWorker(pb::Role role) { return role == pb::ROLE_WORKER || role == pb::ROLE_AGENT; }

std::string Named(const transport::Credentials& who) {
  return who.name.empty() ? "a " + std::string(transport::RoleName(who.role)) : "the key '" + who.name + "'";
}

}  // namespace

Status CheckRequest(const transport::Message& message) {
  const pb::Role role = message.credentials.role;
  if (Is<pb::PromoteParametersRequest>(message) && role == pb::ROLE_OPERATOR &&
      !message.credentials.may_move_robots()) {
    return PermissionDeniedError(Named(message.credentials) + " may not say which parameters a robot is driven with: " +
                                 kHowToGetTheRight);
  }
  if (role == pb::ROLE_OPERATOR) return Status::Ok();
  const bool is_job = Is<pb::SubmitRequest>(message) || Is<pb::JobActionRequest>(message);
  const bool is_change = is_job || Is<pb::SubmitManyRequest>(message) || Is<pb::ManyJobActionsRequest>(message) ||
                         Is<pb::DrainWorkerRequest>(message) || Is<pb::HoldRobotRequest>(message) ||
                         Is<pb::GcArtifactsRequest>(message) || Is<pb::PinArtifactRequest>(message) ||
                         Is<pb::PromoteParametersRequest>(message) || Is<pb::BackupRequest>(message) ||
                         Is<pb::ArchiveJobsRequest>(message);
  const bool is_upload = Is<pb::PutArtifactRequest>(message);
  if (!is_change && !is_upload) return Status::Ok();
  if (IsWorker(role) && (is_upload || (is_job && message.envelope.fencing_token() != 0))) return Status::Ok();
  return PermissionDeniedError("the role " + std::string(transport::RoleName(role)) + " may not do this");
}

Status CheckSubmit(const Policy& policy, const transport::Credentials& who, const std::string& asking_kind,
                   const pb::JobSpec& job) {
  const auto allowed = policy.may_submit.find(asking_kind);
  for (const pb::TaskSpec& task : job.tasks()) {
    if (!asking_kind.empty() &&
        (allowed == policy.may_submit.end() || allowed->second.count(task.kind()) == 0)) {
      return PermissionDeniedError("a task of kind '" + asking_kind + "' may not submit one of kind '" +
                                   VisibleText(task.kind()) + "'");
    }
    if (asking_kind.empty() && policy.robot_kinds.count(task.kind()) > 0 && !who.may_move_robots()) {
      return PermissionDeniedError(Named(who) + " may not have a robot moved (task '" +
                                   VisibleText(task.name()) + "' is of kind '" + task.kind() +
                                   "'): " + kHowToGetTheRight);
    }
  }
  return Status::Ok();
}

Status CheckAction(const Policy& policy, const transport::Credentials& who, const JobPlan& plan) {
  if (who.may_move_robots()) return Status::Ok();
  for (const TaskPlan& task : plan.tasks) {
    if (!task.at_most_once && policy.robot_kinds.count(task.kind) == 0) continue;
    return PermissionDeniedError(Named(who) + " may only pause a job that moves a robot (task '" + task.name + "'): " +
                                 kHowToGetTheRight);
  }
  return Status::Ok();
}

std::string NameOf(const transport::Credentials& who, const std::string& remark) {
  if (who.name.empty()) return remark;
  return remark.empty() ? who.name : who.name + " (" + remark + ")";
}

Status CheckHello(const Policy& policy, const transport::Credentials& who, const pb::WorkerHello& hello) {
  constexpr int kMaxNameBytes = 200;
  if (hello.name().size() > kMaxNameBytes) return InvalidError("a worker's name of over 200 bytes");
  RG_RETURN_IF_ERROR(CheckPlain("the worker's name", hello.name()));
  RG_RETURN_IF_ERROR(CheckPlain("the worker's host", hello.host()));
  RG_RETURN_IF_ERROR(CheckPlain("the worker's version", hello.version()));
  for (const std::string& tag : hello.tags()) {
    RG_RETURN_IF_ERROR(CheckPlain("a tag of the worker", tag));
    if (who.role != pb::ROLE_AGENT && tag.rfind(kRobotTag, 0) == 0) {
      return PermissionDeniedError(Named(who) + " is no agent's: the tag '" + tag +
                                   "' belongs to the agent beside that robot");
    }
  }
  for (const std::string& kind : hello.kinds()) {
    RG_RETURN_IF_ERROR(CheckPlain("a kind of the worker", kind));
    const bool moves = policy.robot_kinds.count(kind) > 0;
    if (moves && who.role != pb::ROLE_AGENT)
      return PermissionDeniedError(Named(who) + " is no agent's: tasks of kind '" + kind +
                                   "' are not for it");
    if (!moves && who.role == pb::ROLE_AGENT)
      return PermissionDeniedError(Named(who) + " is an agent's: tasks of kind '" + kind +
                                   "' are for workers");
  }
  return Status::Ok();
}

Status CheckPlain(const std::string& what, const std::string& text) {
  if (IsPlainText(text)) return Status::Ok();
  return InvalidError(what + " '" + VisibleText(text.substr(0, 100)) +
                      "' has characters that a terminal would obey");
}

}  // namespace rg::coordinator
