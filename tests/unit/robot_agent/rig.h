// What the tests of whole rollouts share: the Mico² as believed, its agent, a spool of their own, and a
// controller that goes to the goal without a policy.
#pragma once

#include <cstdlib>
#include <filesystem>
#include <memory>
#include <string>

#include "common/base/file.h"
#include "common/base/ids.h"
#include "common/model/urdf_loader.h"
#include "common/sim/plant.h"
#include "robot_agent/arm_model.h"
#include "robot_agent/rollout/rollout_runner.h"
#include "robot_agent/spool.h"

namespace rg::robot_agent {

inline std::string SourceDir() { return std::getenv("RG_SOURCE_DIR"); }

struct Rig {
  explicit Rig(bool lock_step)
      : config(LoadAgentConfig(SourceDir() + "/deploy/robots/mico2_agent.json").value()),
        plant(MakePlant()),
        values(plant.parameters().Nominal()),
        folder((std::filesystem::temp_directory_path() / ("rg-rig-" + RandomHex(6))).string()),
        spool(Spool::Open(folder).value()) {
    config.simulated.lock_step = lock_step;
    config.simulated.allow_faults = true;
    config.simulated.reply_timeout_s = 0.5;
    config.stop.attempt_s = 0.6;  // for an arm that is gone for good
    spec.id = "rollout-1";
    spec.duration_s = 2.0;
    spec.goal_seed = 4;
  }
  ~Rig() { std::filesystem::remove_all(folder); }

  static sim::Plant MakePlant() {
    const std::vector<std::string> joints{"joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6"};
    auto model = model::LoadUrdf(SourceDir() + "/deploy/robots/mico2.urdf",
                                 {.joints = joints, .locked = {}, .end_effector = ""});
    return sim::Plant::Create(std::make_shared<const model::RobotModel>(std::move(model).value())).value();
  }

  RolloutPlan Plan() const { return PlanRollout(spec, config, plant).value(); }

  std::unique_ptr<SimulatedDriver> Driver(uint64_t seed = 1) const {
    SimulatedDriverOptions options = config.simulated;
    options.seed = seed;
    return std::make_unique<SimulatedDriver>(options);
  }

  // Gravity of the believed arm and a spring to the goal; `on_cycle` is called first, with the time.
  FunctionController ToGoal(const RolloutPlan& plan, std::function<void(double)> on_cycle = {}) const {
    auto arm = std::make_shared<PlantArmModel>(plant, values);
    const Eigen::VectorXd goal = plan.spec.goal;
    return FunctionController([=](double t, const double* q, const double* v, double* tau) {
      if (on_cycle) on_cycle(t);
      arm->GravityTorque(q, tau);
      for (int i = 0; i < 6; ++i) {
        const bool large = i < 3;
        tau[i] += (large ? 40.0 : 8.0) * (goal[i] - q[i]) - (large ? 2.0 : 0.2) * v[i];
      }
    });
  }

  Result<RolloutResult> Run(robot_agent::Driver& driver, const RolloutPlan& plan, Controller& controller,
                            const ProgressFn& on_progress = {}, const CancelToken* own_stop = nullptr) {
    const RolloutInput input{.plan = plan,
                             .config = config,
                             .plant = plant,
                             .controller = controller,
                             .observer = nullptr,
                             .guard = nullptr,
                             .controller_name = "spring",
                             .policy_sha256 = "",
                             .model_sha256 = "",
                             .job_id = "",
                             .task_id = ""};
    return RunRollout(driver, input, *spool, on_progress, own_stop ? *own_stop : stop, RealClock());
  }

  AgentConfig config;
  sim::Plant plant;
  Eigen::VectorXd values;
  rollouts::RolloutSpec spec;
  std::string folder;
  std::unique_ptr<Spool> spool;
  CancelToken stop;
};

}  // namespace rg::robot_agent
