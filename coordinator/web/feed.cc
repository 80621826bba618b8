#include "coordinator/web/feed.h"

#include <nlohmann/json.hpp>

#include "coordinator/client/as_json.h"
#include "coordinator/web/feed_json.h"

namespace rg::coordinator::web {

using nlohmann::json;

namespace {

constexpr int64_t kMomentNs = 500'000'000;
constexpr int64_t kTasksNs = 1'000'000'000;       // listings of tasks, which cost more
constexpr int64_t kForeverNs = int64_t{1} << 60;  // what never changes
constexpr size_t kMaxKept = 600;
constexpr uint32_t kMaxTasks = 500, kJobsPerPage = 50, kLogLines = 500, kMaxVersions = 100,
                   kMaxArtifacts = 200, kMaxDiagnoses = 20;
constexpr int kMaxLineage = 300;
constexpr uint64_t kMaxDiagnosisBytes = 4u << 20, kMaxFileBytes = 64u << 20;

Result<pb::ListJobsRequest> ListRequest(const std::string& state, int64_t of, int64_t before) {
  pb::ListJobsRequest request;
  request.set_limit(kJobsPerPage);
  request.set_parent_job(of);
  request.set_before_id(before);
  if (state == "live") {
    for (const auto live : {pb::JOB_STATE_QUEUED, pb::JOB_STATE_RUNNING, pb::JOB_STATE_PAUSED})
      request.add_states(live);
  } else if (!state.empty()) {
    std::string name = "JOB_STATE_" + state;
    for (char& c : name) c = static_cast<char>(std::toupper(static_cast<unsigned char>(c)));
    pb::JobState parsed;
    if (!pb::JobState_Parse(name, &parsed)) return InvalidError("there is no state '" + state + "'");
    request.add_states(parsed);
  }
  return request;
}

}  // namespace

// A client of the pool for one answer; one whose call failed is not used again.
class Feed::Borrowed {
 public:
  Borrowed(Feed* feed, std::unique_ptr<Client> client) : feed_(feed), client_(std::move(client)) {}
  Borrowed(Borrowed&&) = default;
  ~Borrowed() {
    if (client_ == nullptr) return;
    const std::lock_guard lock(feed_->mutex_);
    feed_->idle_.push_back(std::move(client_));
  }
  Client& operator*() const { return *client_; }
  Client* operator->() const { return client_.get(); }

 private:
  Feed* feed_;
  std::unique_ptr<Client> client_;
};

Feed::Feed(ClientOptions coordinator, const Clock* clock, std::function<std::string()> more_status)
    : options_(std::move(coordinator)), clock_(clock), more_status_(std::move(more_status)) {}

Feed::~Feed() = default;

Result<Feed::Borrowed> Feed::Borrow() {
  {
    const std::lock_guard lock(mutex_);
    if (!idle_.empty()) {
      auto client = std::move(idle_.back());
      idle_.pop_back();
      return Borrowed(this, std::move(client));
    }
  }
  RG_ASSIGN_OR_RETURN(auto client, Client::Connect(options_));
  return Borrowed(this, std::move(client));
}

template <class Ask>
Result<std::string> Feed::Once(const std::string& key, int64_t for_ns, const Ask& ask) {
  std::shared_ptr<Kept> kept;
  {
    const std::lock_guard lock(mutex_);
    if (kept_.size() >= kMaxKept && kept_.count(key) == 0) kept_.clear();
    auto& place = kept_[key];
    if (place == nullptr) place = std::make_shared<Kept>();
    kept = place;
  }
  const std::lock_guard lock(kept->mutex);
  if (clock_->SteadyNanos() < kept->until_ns) return kept->answer;
  const auto now = [&]() -> Result<std::string> {
    RG_ASSIGN_OR_RETURN(const auto client, Borrow());
    return ask(*client);
  };
  kept->answer = now();
  kept->until_ns = clock_->SteadyNanos() + (kept->answer.ok() ? for_ns : kMomentNs);
  return kept->answer;
}

template <class Ask>
Result<std::string> Feed::OnceJson(const std::string& key, int64_t for_ns, const Ask& ask) {
  return Once(key, for_ns, [&](Client& client) -> Result<std::string> {
    RG_ASSIGN_OR_RETURN(const json value, ask(client));
    return Dump(value);
  });
}

Result<pb::StatusReply> Feed::CoordinatorStatus() {
  RG_ASSIGN_OR_RETURN(const std::string bytes,
                      Once("status message", kMomentNs, [](Client& client) -> Result<std::string> {
                        RG_ASSIGN_OR_RETURN(const auto status, client.CoordinatorStatus());
                        return status.SerializeAsString();
                      }));
  pb::StatusReply status;
  status.ParseFromString(bytes);
  return status;
}

Result<std::vector<pb::WorkerInfo>> Feed::WorkerInfos() {
  RG_ASSIGN_OR_RETURN(const std::string bytes,
                      Once("workers message", kMomentNs, [](Client& client) -> Result<std::string> {
                        RG_ASSIGN_OR_RETURN(const auto workers, client.Workers());
                        pb::ListWorkersReply reply;
                        for (const pb::WorkerInfo& worker : workers) *reply.add_workers() = worker;
                        return reply.SerializeAsString();
                      }));
  pb::ListWorkersReply reply;
  reply.ParseFromString(bytes);
  return std::vector<pb::WorkerInfo>(reply.workers().begin(), reply.workers().end());
}

Result<std::string> Feed::Status() {
  return OnceJson("status", kMomentNs, [&](Client& client) -> Result<json> {
    RG_ASSIGN_OR_RETURN(const auto status, client.CoordinatorStatus());
    json out = StatusJson(status, clock_->WallNanos());
    if (more_status_) out.update(json::parse(more_status_()));
    return out;
  });
}

Result<std::string> Feed::Jobs(const std::string& state, int64_t of, int64_t before) {
  RG_ASSIGN_OR_RETURN(const auto request, ListRequest(state, of, before));
  const std::string key = "jobs " + state + " " + std::to_string(of) + " " + std::to_string(before);
  return OnceJson(key, kMomentNs, [&](Client& client) -> Result<json> {
    RG_ASSIGN_OR_RETURN(const auto jobs, client.ListJobs(request));
    json list = json::array();
    for (const auto& job : jobs) list.push_back(JobJson(job, clock_->WallNanos()));
    return json{{"jobs", list}, {"more", jobs.size() >= kJobsPerPage}};
  });
}

Result<std::string> Feed::Job(int64_t id) {
  return OnceJson("job " + std::to_string(id), kTasksNs, [&](Client& client) -> Result<json> {
    RG_ASSIGN_OR_RETURN(auto reply, client.WatchJob(id, 0, 0));
    if (reply.job().tasks_total() <= kMaxTasks) {
      RG_ASSIGN_OR_RETURN(reply, client.GetJob(id, true, true));
    }
    return JobDetailsJson(reply, false, clock_->WallNanos());
  });
}

Result<std::string> Feed::Logs(int64_t job, uint64_t after) {
  return OnceJson("logs " + std::to_string(job) + " " + std::to_string(after), kMomentNs,
                  [&](Client& client) -> Result<json> {
                    RG_ASSIGN_OR_RETURN(const auto reply, client.Logs(job, {}, after, kLogLines));
                    json lines = json::array();
                    for (const auto& line : reply.lines()) lines.push_back(LogLineJson(line));
                    return json{{"lines", lines}};
                  });
}

Result<std::string> Feed::Events(int64_t job) {
  return OnceJson("events " + std::to_string(job), kMomentNs, [&](Client& client) -> Result<json> {
    RG_ASSIGN_OR_RETURN(const auto events, client.Events(job, 0, 200));
    json list = json::array();
    for (const auto& event : events) list.push_back(EventJson(event));
    return json{{"events", list}};
  });
}

Result<std::string> Feed::Workers() {
  return OnceJson("workers", kMomentNs, [&](Client& client) -> Result<json> {
    RG_ASSIGN_OR_RETURN(const auto workers, client.Workers());
    json list = json::array();
    for (const auto& worker : workers) list.push_back(SeenWorkerJson(worker));
    return json{{"workers", list}};
  });
}

Result<std::string> Feed::Robots() {
  return OnceJson("robots", kMomentNs, [&](Client& client) -> Result<json> {
    RG_ASSIGN_OR_RETURN(const auto robots, client.Robots());
    return json{{"robots", robots}};
  });
}

Result<std::string> Feed::History(const std::string& robot) {
  return OnceJson("history " + robot, kMomentNs, [&](Client& client) -> Result<json> {
    RG_ASSIGN_OR_RETURN(const auto history, client.ParameterHistoryAndCurrent(robot, kMaxVersions));
    json list = json::array();
    for (const auto& version : history.versions()) list.push_back(VersionJson(version));
    return json{{"robot", robot}, {"versions", list}, {"current", history.current()}};
  });
}

// By parameter: its value and standard deviation in each of the versions, oldest first.
Result<std::string> Feed::Values(const std::string& robot) {
  return OnceJson("values " + robot, kMomentNs, [&](Client& client) -> Result<json> {
    RG_ASSIGN_OR_RETURN(const auto versions, client.ParameterHistory(robot, kMaxVersions));
    json numbers = json::array();
    std::vector<std::string> names;
    std::map<std::string, std::pair<json, json>> columns;
    for (auto version = versions.rbegin(); version != versions.rend(); ++version) {
      const size_t place = numbers.size();
      numbers.push_back(version->version());
      const std::string key = "version " + robot + " " + std::to_string(version->version());
      RG_ASSIGN_OR_RETURN(
          const std::string text, OnceJson(key, kForeverNs, [&](Client& other) -> Result<json> {
            RG_ASSIGN_OR_RETURN(const auto full, other.Parameters(robot, version->version()));
            json values = json::array();
            for (const auto& value : full.values())
              values.push_back(
                  {value.name(), value.value(), value.has_stddev() ? json(value.stddev()) : json(nullptr)});
            return values;
          }));
      for (const json& row : json::parse(text)) {
        const std::string& name = row[0].get_ref<const std::string&>();
        const auto [column, is_new] = columns.try_emplace(name);
        if (is_new) names.push_back(name);
        auto& [values, stddevs] = column->second;
        while (values.size() < place) values.push_back(nullptr), stddevs.push_back(nullptr);
        values.push_back(row[1]), stddevs.push_back(row[2]);
      }
    }
    json parameters = json::array();
    for (const std::string& name : names) {
      auto& [values, stddevs] = columns[name];
      while (values.size() < numbers.size()) values.push_back(nullptr), stddevs.push_back(nullptr);
      parameters.push_back({{"name", name}, {"values", values}, {"stddevs", stddevs}});
    }
    return json{{"robot", robot}, {"versions", numbers}, {"parameters", parameters}};
  });
}

Result<json> Feed::DiagnosisOf(Client& client, const pb::ArtifactInfo& info) {
  if (info.size_bytes() > kMaxDiagnosisBytes) return DiagnosisJson("", info);
  RG_ASSIGN_OR_RETURN(const std::string text,
                      OnceJson("diagnosis " + info.sha256(), kForeverNs, [&](Client&) -> Result<json> {
                        RG_ASSIGN_OR_RETURN(const std::string bytes, client.GetArtifact(info.sha256()));
                        return DiagnosisJson(bytes, info);
                      }));
  return json::parse(text);
}

Result<std::string> Feed::Diagnoses() {
  return OnceJson("diagnoses", 2 * kMomentNs, [&](Client& client) -> Result<json> {
    RG_ASSIGN_OR_RETURN(const auto infos, client.ListArtifacts("diagnosis", 0, kMaxDiagnoses));
    RG_ASSIGN_OR_RETURN(const auto reports, client.ListArtifacts("report", 0, kMaxArtifacts));
    json list = json::array(), pages = json::array();
    for (const auto& report : reports) pages.push_back(ArtifactJson(report));
    for (const auto& info : infos) {
      RG_ASSIGN_OR_RETURN(json diagnosis, DiagnosisOf(client, info));
      diagnosis["report"] = nullptr;
      for (const auto& report : reports) {  // that the same task wrote
        if (!info.task_id().empty() && report.task_id() == info.task_id())
          diagnosis["report"] = report.sha256();
      }
      list.push_back(std::move(diagnosis));
    }
    return json{{"diagnoses", list}, {"reports", pages}};
  });
}

Result<std::string> Feed::Artifacts(const std::string& kind) {
  return OnceJson("artifacts " + kind, kMomentNs, [&](Client& client) -> Result<json> {
    RG_ASSIGN_OR_RETURN(const auto infos, client.ListArtifacts(kind, 0, kMaxArtifacts));
    json list = json::array();
    for (const auto& info : infos) list.push_back(ArtifactJson(info));
    return json{{"artifacts", list}};
  });
}

Result<std::string> Feed::Artifact(const std::string& sha256) {
  return OnceJson("artifact " + sha256, 4 * kMomentNs, [&](Client& client) -> Result<json> {
    RG_ASSIGN_OR_RETURN(const auto info, client.ShowArtifact(sha256));
    RG_ASSIGN_OR_RETURN(const auto lineage, client.Lineage(info.sha256(), true, true));
    json nodes = json::array(), edges = json::array();
    for (const auto& node : lineage.nodes()) {
      if (static_cast<int>(nodes.size()) >= kMaxLineage) break;
      nodes.push_back({{"sha256", node.sha256()}, {"kind", node.kind()}, {"job", node.job_id()}});
    }
    for (const auto& edge : lineage.edges()) {
      if (static_cast<int>(edges.size()) >= 4 * kMaxLineage) break;
      edges.push_back({{"parent", edge.parent()}, {"child", edge.child()}});
    }
    return json{{"artifact", ArtifactJson(info)},
                {"nodes", nodes},
                {"edges", edges},
                {"cut", lineage.nodes_size() > kMaxLineage || lineage.edges_size() > 4 * kMaxLineage}};
  });
}

Result<Feed::File> Feed::Bytes(const std::string& sha256) {
  RG_ASSIGN_OR_RETURN(auto client, Borrow());
  RG_ASSIGN_OR_RETURN(const auto info, client->ShowArtifact(sha256));
  if (info.size_bytes() > kMaxFileBytes) {
    return ResourceExhaustedError("of " + std::to_string(info.size_bytes()) +
                                  " bytes: too large for the page; realitygrad artifacts get does it");
  }
  RG_ASSIGN_OR_RETURN(std::string bytes, client->GetArtifact(info.sha256()));
  return File{info.kind(), std::move(bytes)};
}

}  // namespace rg::coordinator::web
