#include "coordinator/web/feed_json.h"

#include <cmath>
#include <nlohmann/json.hpp>

#include "coordinator/client/as_json.h"
#include "coordinator/web/metrics.h"

namespace rg::coordinator::web {

namespace pb = realitygrad::v1;
using nlohmann::json;

namespace {

json Parsed(const std::string& text) { return json::parse(text.empty() ? "null" : text, nullptr, false); }

json NumberOrNull(const json& value, const char* key) {
  const auto found = value.is_object() ? value.find(key) : value.end();
  return value.is_object() && found != value.end() && found->is_number() ? *found : json(nullptr);
}

std::string TextOf(const json& value, const char* key) {
  const auto found = value.is_object() ? value.find(key) : value.end();
  return value.is_object() && found != value.end() && found->is_string() ? found->get<std::string>() : "";
}

}  // namespace

json StatusJson(const pb::StatusReply& status, int64_t wall_ns) {
  json counters = json::object();
  for (const auto& [name, value] : status.counters()) counters[name] = value;
  return {{"instance", status.instance()},
          {"version", status.version()},
          {"database", status.database()},
          {"uptime_s", SecondsJson(status.started_ns(), 0, wall_ns)},
          {"workers", status.workers()},
          {"slots", status.slots()},
          {"slots_busy", status.slots_busy()},
          {"slots_wanted", SlotsWanted(status)},
          {"tasks_waiting", status.tasks_waiting()},
          {"tasks_ready", status.tasks_ready()},
          {"tasks_running", status.tasks_leased()},
          {"trouble", status.trouble()},
          {"counters", counters}};
}

json SeenWorkerJson(const pb::WorkerInfo& worker) {
  json out = WorkerJson(worker);
  out["last_seen_s"] = worker.connected() ? 0.0 : std::floor(worker.last_seen_s());
  out["disk_free_gib"] = std::floor(10.0 * static_cast<double>(worker.disk_free_bytes()) / (1 << 30)) / 10.0;
  for (const char* moves : {"disk_free_bytes", "memory_free_bytes", "load"}) out.erase(moves);
  return out;
}

json DiagnosisJson(const std::string& bytes, const pb::ArtifactInfo& info) {
  const json file = Parsed(bytes);
  json findings = json::array();
  const json none = json::object();
  const json& list = file.is_object() && file.contains("findings") ? file["findings"] : none;
  for (const json& finding : list.is_array() ? list : json::array()) {
    json joints = json::array();
    if (finding.is_object() && finding.contains("joints") && finding["joints"].is_array()) {
      for (const json& joint : finding["joints"])
        if (joint.is_string()) joints.push_back(joint);
    }
    findings.push_back({{"effect", TextOf(finding, "effect")},
                        {"statement", TextOf(finding, "statement")},
                        {"joints", joints},
                        {"confidence", NumberOrNull(finding, "confidence")}});
  }
  const json& fit = file.is_object() && file.contains("fit") ? file["fit"] : none;
  const json& holdout = fit.is_object() && fit.contains("holdout") ? fit["holdout"] : none;
  return {{"sha256", info.sha256()},
          {"job", info.job_id()},
          {"created", FormatWallTime(info.created_ns())},
          {"verdict", TextOf(file, "verdict")},
          {"findings", findings},
          {"before", NumberOrNull(holdout, "before_rms")},
          {"after", NumberOrNull(holdout, "after_rms")}};
}

}  // namespace rg::coordinator::web
