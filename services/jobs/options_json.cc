#include "services/jobs/options_json.h"

#include <nlohmann/json.hpp>

namespace rg::jobs {

using nlohmann::json;

json OptionsToJson(const IterationOptions& o) {
  return {{"seed", o.seed},
          {"trajectories",
           {{"count", o.trajectories.count},
            {"shard_size", o.trajectories.shard_size},
            {"duration_s", o.trajectories.duration_s},
            {"reach", o.trajectories.reach},
            {"spread", o.trajectories.spread}}},
          {"train",
           {{"epochs", o.train.epochs},
            {"batch", o.train.batch},
            {"learning_rate", o.train.learning_rate},
            {"hidden", o.train.hidden},
            {"aggregations", o.train.aggregations},
            {"examination_pairs", o.train.examination_pairs}}},
          {"curriculum",
           {{"on", o.curriculum.on}, {"first", o.curriculum.first}, {"growth", o.curriculum.growth}}},
          {"diagnosis",
           {{"on", o.diagnosis.on},
            {"work_limit", o.diagnosis.work_limit},
            {"window_s", o.diagnosis.window_s},
            {"threads", o.diagnosis.threads}}},
          {"rollout",
           {{"duration_s", o.rollout.duration_s},
            {"rate_hz", o.rollout.rate_hz},
            {"goal_q", o.rollout.goal_q},
            {"goal_position", o.rollout.goal_position},
            {"reach_s", o.rollout.reach_s},
            {"controller", o.rollout.controller},
            {"excitation", o.rollout.excitation},
            {"slower_attempts", o.rollout.slower_attempts},
            {"accept_partial", o.rollout.accept_partial}}},
          {"identify",
           {{"chains", o.identify.chains},
            {"rounds", o.identify.rounds},
            {"budget_s", o.identify.budget_s},
            {"hops", o.identify.hops},
            {"whole_recording", o.identify.whole_recording},
            {"window_s", o.identify.window_s},
            {"window_start_s", o.identify.window_start_s},
            {"solver", o.identify.solver},
            {"bounds", o.identify.bounds},
            {"parametrisation", o.identify.parametrisation},
            {"friction", o.identify.friction},
            {"alpha", o.identify.alpha}}}};
}

IterationOptions OptionsFromJson(const json& j) {
  IterationOptions o;
  j.at("seed").get_to(o.seed);
  const json &t = j.at("trajectories"), &p = j.at("train"), &r = j.at("rollout"), &i = j.at("identify");
  t.at("count").get_to(o.trajectories.count), t.at("shard_size").get_to(o.trajectories.shard_size);
  t.at("duration_s").get_to(o.trajectories.duration_s), t.at("reach").get_to(o.trajectories.reach),
      t.at("spread").get_to(o.trajectories.spread);
  p.at("epochs").get_to(o.train.epochs), p.at("batch").get_to(o.train.batch);
  p.at("learning_rate").get_to(o.train.learning_rate), p.at("hidden").get_to(o.train.hidden);
  p.at("aggregations").get_to(o.train.aggregations);
  p.at("examination_pairs").get_to(o.train.examination_pairs);
  const json& c = j.at("curriculum");
  c.at("on").get_to(o.curriculum.on), c.at("first").get_to(o.curriculum.first),
      c.at("growth").get_to(o.curriculum.growth);
  // Runs that were begun before there was a diagnosis have none.
  const json d = j.value("diagnosis", json::object());
  o.diagnosis.on = d.value("on", o.diagnosis.on),
  o.diagnosis.work_limit = d.value("work_limit", o.diagnosis.work_limit);
  o.diagnosis.window_s = d.value("window_s", o.diagnosis.window_s),
  o.diagnosis.threads = d.value("threads", o.diagnosis.threads);
  r.at("duration_s").get_to(o.rollout.duration_s), r.at("rate_hz").get_to(o.rollout.rate_hz),
      r.at("goal_q").get_to(o.rollout.goal_q);
  r.at("goal_position").get_to(o.rollout.goal_position), r.at("reach_s").get_to(o.rollout.reach_s),
      r.at("controller").get_to(o.rollout.controller);
  // Runs that were begun before there were such have none.
  o.rollout.excitation = r.value("excitation", o.rollout.excitation);
  o.rollout.slower_attempts = r.value("slower_attempts", o.rollout.slower_attempts);
  o.rollout.accept_partial = r.value("accept_partial", o.rollout.accept_partial);
  i.at("chains").get_to(o.identify.chains), i.at("rounds").get_to(o.identify.rounds),
      i.at("budget_s").get_to(o.identify.budget_s);
  i.at("hops").get_to(o.identify.hops), i.at("whole_recording").get_to(o.identify.whole_recording),
      i.at("window_s").get_to(o.identify.window_s);
  i.at("window_start_s").get_to(o.identify.window_start_s), i.at("solver").get_to(o.identify.solver),
      i.at("bounds").get_to(o.identify.bounds);
  // Runs that were begun before there was a choice go on as they began.
  o.identify.parametrisation = i.value("parametrisation", "raw");
  i.at("alpha").get_to(o.identify.alpha), i.at("friction").get_to(o.identify.friction);
  return o;
}

}  // namespace rg::jobs
