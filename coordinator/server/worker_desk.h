// Between the wire messages of workers and the core's events and actions: resolves inputs, stores
// outputs, assembles assignments.
#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "common/base/status.h"
#include "common/store/artifact_store.h"
#include "common/store/parameter_store.h"
#include "coordinator/core/events.h"
#include "coordinator/core/state.h"
#include "coordinator/store/job_store.h"
#include "realitygrad/v1/job.pb.h"
#include "realitygrad/v1/worker.pb.h"

namespace rg::coordinator {

namespace pb = realitygrad::v1;

class WorkerDesk {
 public:
  WorkerDesk(store::Database* database, store::ArtifactStore* artifacts, store::ParameterStore* parameters,
             JobStore* jobs)
      : database_(database), artifacts_(artifacts), parameters_(parameters), jobs_(jobs) {}

  // The core's event for a worker's message, or nothing where it has none (logs, checkpoints), or wants its outputs
  // stored first (ToFinished).
  static std::optional<Event> ToEvent(const pb::WorkerMessage& message, const std::string& instance);
  static Finished ToFinished(const pb::TaskFinished& finished, const std::string& instance);

  // What a finished task brought, ready to be committed: artefacts and parameter versions are written
  // into the open transaction. An error means the result cannot be accepted: the task has failed.
  Result<ResultRow> StoreOutputs(const State& state, const Lease& lease, const pb::TaskFinished& finished);
  // Hashes of outputs that were neither sent along nor uploaded.
  std::vector<std::string> MissingOutputs(const pb::TaskFinished& finished);

  // An error means the task cannot run at all (a parent lacks the output it names).
  Result<pb::TaskAssignment> Assemble(const State& state, const Assign& assign);
  // Every artefact that the job names must be here. kNotFound names task, input and hash.
  Status CheckArtifactsExist(const pb::JobSpec& spec);

 private:
  Status ResolveInput(const Job& job, uint32_t index, const pb::InputSpec& input,
                      std::vector<pb::ResolvedInput>* resolved);
  Status ResolveArtifact(const pb::InputSpec& input, std::vector<pb::ResolvedInput>* resolved);
  Status ResolveTaskOutputs(const Job& job, uint32_t parent, const std::string& output, bool all_outputs,
                            const pb::InputSpec& input, std::vector<pb::ResolvedInput>* resolved);
  Result<std::vector<pb::ResolvedInput>> ResolveInputs(const Job& job, uint32_t index,
                                                       const pb::TaskSpec& spec);
  Result<OutputRow> StoreOutput(TaskId task, const std::vector<std::string>& parents,
                                const pb::TaskOutput& output);
  Status AddParameters(TaskId task, const pb::TaskOutput& output);

  store::Database* database_;
  store::ArtifactStore* artifacts_;
  store::ParameterStore* parameters_;
  JobStore* jobs_;
};

}  // namespace rg::coordinator
