#include "services/jobs/remote_fits.h"

#include <map>
#include <optional>

#include "coordinator/client/client.h"
#include "services/jobs/fit_messages.h"
#include "services/jobs/kinds.h"

namespace rg::jobs {

namespace pb = ::realitygrad::v1;
using diagnosis::FitRequest;
using diagnosis::FitResult;
using diagnosis::FitSetting;

namespace {

constexpr uint32_t kWaitMs = 500;

std::string TaskName(size_t i) { return "fit-" + std::to_string(i); }

void AddInput(const char* name, const std::string& sha256, pb::TaskSpec* task) {
  pb::InputSpec* input = task->add_inputs();
  input->set_name(name);
  input->set_artifact(sha256);
}

}  // namespace

class RemoteFits::Batch final : public diagnosis::FitBatch {
 public:
  Batch(RemoteFits& owner, const FitSetting& setting, std::vector<FitRequest> requests, int64_t job)
      : owner_(owner), setting_(setting), requests_(std::move(requests)), open_(job), job_(job) {
    const std::lock_guard lock(owner_.mutex_);
    if (open_ != 0) owner_.open_.insert(open_);
  }
  ~Batch() override {
    {
      const std::lock_guard lock(owner_.mutex_);
      owner_.open_.erase(open_);
    }
    if (job_ == 0) return;
    const auto now = owner_.client_.GetJob(job_, false);
    // What is not needed any more; an error leaves it to run to its end.
    if (now.ok() && now->job().finished_ns() == 0)
      (void)owner_.client_.Act(job_, pb::JOB_ACTION_CANCEL, "the search needs no more of these fits");
  }

  FitResult Take(size_t i) override {
    if (auto fit = FromWorker(i)) {
      ++owner_.by_workers_;
      return *std::move(fit);
    }
    ++owner_.here_;
    return diagnosis::MakeFit(setting_, requests_[i]);
  }

 private:
  // Waits for a fit that a worker has; nothing where none has it, or it failed there.
  std::optional<FitResult> FromWorker(size_t i) {
    uint64_t revision = 0;
    while (job_ != 0 && !(owner_.cancel_ != nullptr && owner_.cancel_->cancelled())) {
      const auto now = owner_.client_.WatchJob(job_, revision, revision == 0 ? 0 : kWaitMs, true);
      if (!now.ok()) {
        job_ = 0;  // the coordinator is gone: the rest is made here
        break;
      }
      revision = now->job().revision();
      const pb::TaskInfo* task = nullptr;
      for (const pb::TaskInfo& each : now->tasks()) {
        if (each.name() == TaskName(i)) task = &each;
      }
      if (task != nullptr && task->state() == pb::TASK_STATE_LEASED) continue;
      if (task == nullptr || task->state() != pb::TASK_STATE_SUCCEEDED || task->outputs_size() != 1) break;
      const auto bytes = owner_.client_.GetArtifact(task->outputs(0).sha256());
      pb::FitReply reply;
      if (!bytes.ok() || !reply.ParseFromString(*bytes)) break;
      return FitOf(reply);
    }
    return {};
  }

  RemoteFits& owner_;
  FitSetting setting_;
  std::vector<FitRequest> requests_;
  const int64_t open_;
  int64_t job_;  // 0: there is none, or no coordinator any more
};

std::vector<int64_t> RemoteFits::open_jobs() const {
  const std::lock_guard lock(mutex_);
  return {open_.begin(), open_.end()};
}

int64_t RemoteFits::Submit(const std::vector<FitRequest>& requests, const diagnosis::FitData& data) {
  pb::ArtifactInfo info;
  info.set_kind(kArtifactFitBatch);
  info.set_metadata_json("{}");
  const auto batch = client_.PutArtifact(BatchOf(requests, data).SerializeAsString(), info);
  if (!batch.ok()) return 0;
  pb::JobSpec job;
  job.set_kind("fits");
  job.set_name("fits of a diagnosis");
  job.set_spec_json("{}");
  // Workers begin at the end, this process at the beginning.
  for (size_t i = requests.size(); i-- > 0;) {
    pb::TaskSpec* task = job.add_tasks();
    task->set_name(TaskName(i));
    task->set_stage("fits");
    task->set_kind(kKindFit);
    pb::FitPayload payload;
    payload.set_index(static_cast<uint32_t>(i));
    payload.set_rollouts(inputs_.rollouts);
    payload.SerializeToString(task->mutable_payload());
    for (const std::string& recording : inputs_.recordings) AddInput(kInputRecording, recording, task);
    if (!inputs_.model.empty()) AddInput(kInputModel, inputs_.model, task);
    AddInput(kInputFitBatch, *batch, task);
  }
  const auto id = client_.Submit(job, inputs_.of_a_task ? "fits " + *batch : "");
  return id.ok() ? *id : 0;
}

std::unique_ptr<diagnosis::FitBatch> RemoteFits::Start(const FitSetting& setting,
                                                       std::vector<FitRequest> requests) {
  // One alone is not worth the way.
  const bool stopped = cancel_ != nullptr && cancel_->cancelled();
  const int64_t job = requests.size() > 1 && !stopped ? Submit(requests, setting.data) : 0;
  return std::make_unique<Batch>(*this, setting, std::move(requests), job);
}

}  // namespace rg::jobs
