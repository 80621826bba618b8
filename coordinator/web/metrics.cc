#include "coordinator/web/metrics.h"

#include <prometheus/collectable.h>
#include <prometheus/metric_family.h>
#include <prometheus/text_serializer.h>

#include <limits>
#include <nlohmann/json.hpp>
#include <sstream>

namespace rg::coordinator::web {
namespace {

namespace pb = realitygrad::v1;

prometheus::MetricFamily Family(const std::string& name, const std::string& help,
                                prometheus::MetricType type) {
  prometheus::MetricFamily family;
  family.name = "realitygrad_" + name;
  family.help = help;
  family.type = type;
  return family;
}

prometheus::MetricFamily Gauge(const std::string& name, const std::string& help, double value) {
  prometheus::MetricFamily family = Family(name, help, prometheus::MetricType::Gauge);
  family.metric.emplace_back().gauge.value = value;
  return family;
}

std::string Joined(const google::protobuf::RepeatedPtrField<std::string>& words) {
  std::string text;
  for (const std::string& word : words) text += (text.empty() ? "" : ",") + word;
  return text;
}

// By kind of task and by the tags that it asks of its worker.
void AddDemand(const pb::StatusReply& status, std::vector<prometheus::MetricFamily>* families) {
  auto ready = Family("demand_tasks_ready", "Tasks that wait for a worker, by kind and required tags",
                      prometheus::MetricType::Gauge);
  auto running = Family("demand_tasks_running", "Tasks that run, by kind and required tags",
                        prometheus::MetricType::Gauge);
  for (const pb::ClassDemand& demand : status.demand()) {
    for (auto* family : {&ready, &running}) {
      prometheus::ClientMetric& metric = family->metric.emplace_back();
      metric.label = {{"kind", demand.kind()}, {"tags", Joined(demand.tags())}};
      metric.gauge.value = static_cast<double>(family == &ready ? demand.ready() : demand.running());
    }
  }
  families->push_back(std::move(ready));
  families->push_back(std::move(running));
}

void AddSeconds(const pb::StatusReply& status, std::vector<prometheus::MetricFamily>* families) {
  auto family = Family("task_seconds", "How long tasks ran, by kind", prometheus::MetricType::Histogram);
  for (const pb::TaskSeconds& seconds : status.seconds()) {
    prometheus::ClientMetric& metric = family.metric.emplace_back();
    metric.label = {{"kind", seconds.kind()}};
    for (int i = 0; i < seconds.count_size(); ++i) {
      const double bound = i < seconds.at_most_size() ? seconds.at_most(i) : std::numeric_limits<double>::infinity();
      metric.histogram.bucket.push_back({seconds.count(i), bound});
      metric.histogram.sample_count = seconds.count(i);
    }
    metric.histogram.sample_sum = seconds.sum();
  }
  families->push_back(std::move(family));
}

// 0 or 1 each: what an alert looks at.
void AddWorkers(const pb::StatusReply& status, const std::vector<pb::WorkerInfo>& workers,
                std::vector<prometheus::MetricFamily>* families) {
  const auto of = [](const char* name, const char* help, prometheus::MetricType type) { return Family(name, help, type); };
  auto failed = of("worker_tasks_failed_total", "Attempts that failed, by worker", prometheus::MetricType::Counter);
  auto unable = of("worker_unable", "1 where a worker is given nothing for now", prometheus::MetricType::Gauge);
  auto armed = of("robot_armed", "1 where the agent's arm is armed", prometheus::MetricType::Gauge);
  auto latched = of("robot_latched", "1 where the agent's arm waits for a person to look at it", prometheus::MetricType::Gauge);
  auto held = of("robot_held", "1 for each robot that is held", prometheus::MetricType::Gauge);
  const auto add = [](prometheus::MetricFamily& family, const char* label, const std::string& name, double value) {
    prometheus::ClientMetric& metric = family.metric.emplace_back();
    metric.label = {{label, name}};
    (family.type == prometheus::MetricType::Counter ? metric.counter.value : metric.gauge.value) = value;
  };
  for (const pb::WorkerInfo& worker : workers) {
    add(failed, "worker", worker.name(), static_cast<double>(worker.tasks_failed()));
    add(unable, "worker", worker.name(), worker.connected() && !worker.unable().empty());
    if (worker.robot_state().empty() || !worker.connected()) continue;
    add(armed, "worker", worker.name(), worker.robot_state() == "armed");
    add(latched, "worker", worker.name(), worker.robot_state().find("latched") != std::string::npos);
  }
  for (const pb::RobotHold& hold : status.holds()) add(held, "robot", hold.robot(), 1.0);
  for (auto* family : {&failed, &unable, &armed, &latched, &held}) families->push_back(std::move(*family));
}

void AddAllocations(const std::string& more_status, std::vector<prometheus::MetricFamily>* families) {
  const auto more = nlohmann::json::parse(more_status, nullptr, false);
  if (!more.is_object() || !more.contains("autoscale")) return;
  const auto& scale = more["autoscale"];
  families->push_back(
      Gauge("allocations_running", "Allocations of the cluster that run", scale.value("running", 0.0)));
  families->push_back(
      Gauge("allocations_pending", "Allocations that were asked for", scale.value("pending", 0.0)));
  families->push_back(Gauge("allocations_in_vain",
                            "Allocations in a row whose worker did nothing or never came",
                            scale.value("in_vain", 0.0)));
}

}  // namespace

uint64_t SlotsWanted(const pb::StatusReply& status) {
  uint64_t wanted = 0;
  for (const pb::ClassDemand& demand : status.demand()) {
    if (!demand.robot() && demand.tags().empty()) wanted += demand.ready() + demand.running();
  }
  return wanted;
}

std::string MetricsText(const pb::StatusReply& status, double uptime_s, const std::string& more_status,
                        const std::vector<pb::WorkerInfo>& workers) {
  std::vector<prometheus::MetricFamily> families;
  auto info = Family("info", "Version of the coordinator", prometheus::MetricType::Gauge);
  info.metric.emplace_back().label = {{"version", status.version()}};
  info.metric.back().gauge.value = 1.0;
  families.push_back(std::move(info));
  families.push_back(Gauge("uptime_seconds", "Since the coordinator started", uptime_s));
  families.push_back(
      Gauge("writable", "1, or 0 while nothing new is taken (a full disk)", status.trouble().empty()));
  families.push_back(Gauge("workers", "Connected workers", status.workers()));
  families.push_back(Gauge("slots", "Slots of connected workers", status.slots()));
  families.push_back(Gauge("slots_busy", "Slots that run a task", status.slots_busy()));
  const auto number = [](uint64_t n) { return static_cast<double>(n); };
  families.push_back(
      Gauge("tasks_waiting", "Tasks that wait for other tasks", number(status.tasks_waiting())));
  families.push_back(Gauge("tasks_ready", "Tasks that wait for a worker", number(status.tasks_ready())));
  families.push_back(Gauge("tasks_running", "Tasks under a lease", number(status.tasks_leased())));
  families.push_back(
      Gauge("worker_slots_wanted",
            "Slots that tasks fill or would fill, without those that need a robot or a tag: scale "
            "workers by this",
            number(SlotsWanted(status))));
  families.push_back(Gauge("oldest_ready_seconds", "Since the submission of the oldest job with a task that waits for a worker",
                           status.oldest_ready_s()));
  families.push_back(Gauge("database_bytes", "Size of the database", number(status.database_bytes())));
  families.push_back(Gauge("disk_free_bytes", "Left on the database's disk", number(status.disk_free_bytes())));
  AddDemand(status, &families);
  AddSeconds(status, &families);
  AddWorkers(status, workers, &families);
  for (const auto& [name, value] :
       std::map<std::string, double>(status.counters().begin(), status.counters().end())) {
    auto counter = Family(name, "Since the coordinator started", prometheus::MetricType::Counter);
    counter.metric.emplace_back().counter.value = value;
    families.push_back(std::move(counter));
  }
  AddAllocations(more_status, &families);
  std::ostringstream out;
  prometheus::TextSerializer().Serialize(out, families);
  return out.str();
}

}  // namespace rg::coordinator::web
