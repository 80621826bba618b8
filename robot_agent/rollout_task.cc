#include "robot_agent/rollout_task.h"

#include <nlohmann/json.hpp>

#include "common/base/clock.h"
#include "common/base/hash.h"
#include "common/sim/model_file.h"
#include "robot_agent/controllers.h"
#include "robot_agent/rollout_runner.h"
#include "robot_agent/spool_delivery.h"

namespace rg::robot_agent {
namespace {

using nlohmann::json;

Result<std::unique_ptr<Controller>> MakeController(const RolloutTaskInput& input, const sim::ModelFile& model,
                                                   const RolloutPlan& plan) {
  if (input.controller == "mpc") {
    const auto& torque = plan.limits.torque;
    const Eigen::VectorXd limit =
        Eigen::Map<const Eigen::VectorXd>(torque.data(), static_cast<Eigen::Index>(torque.size()));
    return MakeMpcController(model.plant, model.values, plan.spec.goal, limit, plan.spec.rate_hz);
  }
  if (input.controller != "policy")
    return InvalidError("rollout: controller \"" + input.controller + "\", needs policy or mpc");
  RG_ASSIGN_OR_RETURN(policy::Policy policy, policy::ParsePolicy(input.policy_bytes, "policy"));
  RG_ASSIGN_OR_RETURN(auto controller,
                      PolicyController::Create(std::move(policy), model.plant.joint_names(), plan.spec.goal));
  return std::unique_ptr<Controller>(std::move(controller));
}

RolloutTaskOutput OutputOf(const RolloutResult& result) {
  const json rollout = json::parse(result.rollout_json);
  const json jitter = rollout.value("jitter", json::object());
  const json none = json::object();
  RolloutTaskOutput output;
  output.metadata_json = rollout.dump();
  output.summary_json = json{{"end_reason", EndReasonName(result.reason)},
                             {"detail", result.detail},
                             {"rows", result.rows},
                             {"ended_after_s", rollout.value("ended_after_s", 0.0)},
                             {"goal_joint_norm", result.goal_error.joint_norm},
                             {"goal_tip_m", result.goal_error.tip_distance},
                             {"missed_deadlines", jitter.value("missed_deadlines", 0)},
                             {"cycle_p99_us", jitter.value("cycle_us", none).value("p99", 0.0)},
                             {"lateness_p99_us", jitter.value("lateness_us", none).value("p99", 0.0)}}
                            .dump();
  output.bundle = result.bundle;
  output.usable = result.usable();
  return output;
}

}  // namespace

Result<RolloutTaskOutput> RunRolloutTask(const AgentConfig& config, const std::string& spool_folder,
                                         const RolloutTaskInput& input, const ProgressFn& progress,
                                         const CancelToken& stop) {
  RG_ASSIGN_OR_RETURN(const auto spool, Spool::Open(spool_folder));
  SalvageRecordings(*spool);
  RG_ASSIGN_OR_RETURN(const sim::ModelFile model, sim::ModelFromJson(input.model_json, "model"));
  RG_ASSIGN_OR_RETURN(const RolloutPlan plan, PlanRollout(input.spec, config, model.plant));
  RG_ASSIGN_OR_RETURN(const auto controller, MakeController(input, model, plan));
  RG_ASSIGN_OR_RETURN(const auto driver, MakeDriver(config, plan.spec.robot_seed));
  const RolloutInput rollout{.plan = plan,
                             .config = config,
                             .plant = model.plant,
                             .values = model.values,
                             .controller = *controller,
                             .controller_name = input.controller,
                             .policy_sha256 = input.policy_bytes.empty() ? "" : Sha256Hex(input.policy_bytes),
                             .model_sha256 = Sha256Hex(input.model_json)};
  RG_ASSIGN_OR_RETURN(const RolloutResult result,
                      RunRollout(*driver, rollout, *spool, progress, stop, RealClock()));
  return OutputOf(result);
}

}  // namespace rg::robot_agent
