// Requests about artefacts and the parameter history, answered from common/store. Writes join the
// server's open transaction; the reply may leave only after it committed.
#pragma once

#include <functional>
#include <map>
#include <optional>
#include <string>

#include "common/base/clock.h"
#include "common/base/status.h"
#include "common/store/artifact_store.h"
#include "common/store/parameter_store.h"
#include "common/transport/envelope.h"
#include "realitygrad/v1/artifact.pb.h"
#include "realitygrad/v1/parameters.pb.h"

namespace rg::coordinator {

class ArtifactDesk {
 public:
  ArtifactDesk(store::ArtifactStore* artifacts, store::ParameterStore* parameters, const Clock* clock)
      : artifacts_(artifacts), parameters_(parameters), clock_(clock) {}

  static bool Writes(const transport::Message& request);
  // The reply, or nothing if the request is not one of this desk's.
  std::optional<transport::Message> Answer(const transport::Sender& self, const transport::Message& request);

  // Long checks ask it whether to break off.
  void set_stop(std::function<bool()> stop) { stop_ = std::move(stop); }
  // After a rollback: what uploads had written may be gone.
  void ForgetUploads() { uploads_.clear(); }
  // Uploads that nobody has continued for a while.
  void DropIdleUploads();

 private:
  struct Upload {
    store::ArtifactWriter writer;
    int64_t last_ns;
  };
  Result<transport::Message> Put(const transport::Sender& self, const transport::Message& request);
  Result<transport::Message> Get(const transport::Sender& self, const transport::Message& request);

  store::ArtifactStore* artifacts_;
  store::ParameterStore* parameters_;
  const Clock* clock_;
  std::function<bool()> stop_;
  std::map<std::string, Upload> uploads_;  // by peer and upload id
};

realitygrad::v1::ArtifactInfo ToProto(const store::ArtifactInfo& info);
realitygrad::v1::ParameterVersion ToProto(const store::ParameterVersion& version);
// From the metadata of an artefact of kind "parameters" (worker/task_registry.h).
Result<store::ParameterVersion> ParseParameterMetadata(const std::string& metadata_json);

}  // namespace rg::coordinator
