// What the page asks the coordinator, as a viewer among others, over the same socket and messages as
// everybody. An answer is kept for a moment and given to all who ask the same meanwhile: however many look at
// the page, and however often, the coordinator is asked about twice a second for each thing that somebody
// looks at. What never changes (the values of a version, the contents of an artefact) is kept longer.
//
// Thread-safe; a call blocks its thread until the answer is there, for a few seconds at the most.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "common/base/clock.h"
#include "common/base/status.h"
#include "coordinator/client/client.h"

namespace rg::coordinator::web {

class Feed {
 public:
  // `more_status`: what else the status shows ("autoscale"), a JSON object; may be empty.
  Feed(ClientOptions coordinator, const Clock* clock, std::function<std::string()> more_status = {});
  ~Feed();

  // A JSON object each; for the page's view of the same name.
  Result<std::string> Status();
  // `state`: of one state, "live" for those that are not over, empty for all; `of`: those that tasks of this
  // job submitted; `before`: only older ones than this.
  Result<std::string> Jobs(const std::string& state, int64_t of, int64_t before);
  Result<std::string> Job(int64_t id);
  Result<std::string> Logs(int64_t job, uint64_t after);
  Result<std::string> Events(int64_t job);
  Result<std::string> Workers();
  Result<std::string> Robots();
  Result<std::string> History(const std::string& robot);
  Result<std::string> Values(const std::string& robot);  // of the newest versions
  Result<std::string> Diagnoses();
  Result<std::string> Artifacts(const std::string& kind);
  Result<std::string> Artifact(const std::string& sha256);  // with its lineage both ways

  Result<pb::StatusReply> CoordinatorStatus();
  Result<std::vector<pb::WorkerInfo>> WorkerInfos();
  std::string MoreStatus() const { return more_status_ ? more_status_() : std::string(); }
  struct File {
    std::string kind, bytes;
  };
  Result<File> Bytes(const std::string& sha256);

 private:
  class Borrowed;
  struct Kept {
    std::mutex mutex;  // held while it is asked for: others wait for that answer
    int64_t until_ns = 0;
    Result<std::string> answer = std::string();  // an error too is everybody's for a moment
  };
  // `ask` is called with a client and gives the text; OnceJson's gives a JSON value.
  template <class Ask>
  Result<std::string> Once(const std::string& key, int64_t for_ns, const Ask& ask);
  template <class Ask>
  Result<std::string> OnceJson(const std::string& key, int64_t for_ns, const Ask& ask);
  Result<Borrowed> Borrow();
  Result<nlohmann::json> DiagnosisOf(Client& client, const pb::ArtifactInfo& info);

  const ClientOptions options_;
  const Clock* clock_;
  const std::function<std::string()> more_status_;
  std::mutex mutex_;  // guards what follows
  std::vector<std::unique_ptr<Client>> idle_;
  std::map<std::string, std::shared_ptr<Kept>> kept_;
};

}  // namespace rg::coordinator::web
