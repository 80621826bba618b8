// Who may do what, and who it was. The role is the key's (on a local socket: what the peer says). A viewer reads; an
// operator submits and cancels, with the right to robots also what moves one; a worker takes and returns
// tasks, and submits under the lease of a task what that task's kind may; an agent runs what moves robots.
// All that the coordinator knows of kinds is here.
#pragma once

#include <map>
#include <set>
#include <string>

#include "common/base/status.h"
#include "common/transport/envelope.h"
#include "coordinator/core/types.h"
#include "realitygrad/v1/job.pb.h"
#include "realitygrad/v1/worker.pb.h"

namespace rg::coordinator {

struct Policy {
  std::set<std::string> robot_kinds = {"rollout"};  // move a robot: run at most once, by agents only
  std::map<std::string, std::set<std::string>> may_submit = {{"diagnose", {"fit"}}};  // by the task's kind
};

// Errors are kPermissionDenied, one line.
Status CheckRequest(const transport::Message& message);
// `asking_kind`: of the task under whose lease it is submitted; empty: a client submits.
Status CheckSubmit(const Policy& policy, const transport::Credentials& who, const std::string& asking_kind,
                   const realitygrad::v1::JobSpec& job);
// Whoever acts on a job that moves a robot needs the right to robots, but for a pause.
Status CheckAction(const Policy& policy, const transport::Credentials& who, const JobPlan& plan);
Status CheckHello(const Policy& policy, const transport::Credentials& who,
                  const realitygrad::v1::WorkerHello& hello);

// The name of the key, and the client's own `remark` (user@host) in brackets; without a key the remark alone.
std::string NameOf(const transport::Credentials& who, const std::string& remark);

// kInvalid, naming `what`: empty text is fine, control characters and the like are not.
Status CheckPlain(const std::string& what, const std::string& text);

}  // namespace rg::coordinator
