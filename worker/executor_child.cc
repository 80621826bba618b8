#include "worker/executor_child.h"

#include <poll.h>
#include <unistd.h>

#include <cerrno>
#include <condition_variable>
#include <cstring>
#include <deque>
#include <exception>
#include <filesystem>
#include <mutex>
#include <new>
#include <thread>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/hash.h"
#include "common/base/memory.h"
#include "common/base/utf8.h"
#include "coordinator/client/client.h"
#include "realitygrad/v1/executor.pb.h"
#include "worker/frame_stream.h"

namespace rg::worker {
namespace {

namespace pb = realitygrad::v1;

constexpr int kProgressEveryMs = 200;
constexpr size_t kMaxCheckpointBytes = 64u << 20;
constexpr size_t kMaxTextBytes = 8u << 10;

// What the reading thread and the task share.
class Link {
 public:
  explicit Link(int fd) : fd_(fd) {}

  void Send(const pb::FromExecutor& message) {
    const std::lock_guard lock(write_mutex_);
    if (!WriteFrame(fd_, message).ok()) _exit(0);  // nobody is left to work for
  }

  // Reads until the worker is gone; hands tasks over, cancels the one that runs.
  void ReadForever() {
    FrameReader reader;
    while (true) {
      pollfd waiting{fd_, POLLIN, 0};
      const int ready = poll(&waiting, 1, kProgressEveryMs);
      FlushProgress();
      if (ready <= 0) continue;
      if (reader.ReadSome(fd_) == FrameReader::State::kClosed) break;
      std::string frame;
      while (reader.Next(&frame)) Take(frame);
    }
    const std::lock_guard lock(mutex_);
    closed_ = true;
    if (busy_) _exit(0);
    wake_.notify_all();
  }

  // Null: the worker is gone.
  std::unique_ptr<pb::RunTask> NextTask() {
    std::unique_lock lock(mutex_);
    busy_ = false;
    wake_.wait(lock, [this] { return closed_ || !tasks_.empty(); });
    if (tasks_.empty()) return nullptr;
    auto task = std::move(tasks_.front());
    tasks_.pop_front();
    busy_ = true;
    return task;
  }

  void Begin(uint64_t token, CancelToken* cancel) {
    const std::lock_guard lock(mutex_);
    token_ = token;
    cancel_ = cancel;
    if (cancelled_token_ == token) cancel->Cancel();
  }
  void End() {
    const std::lock_guard lock(mutex_);
    token_ = 0;
    cancel_ = nullptr;
    has_progress_ = false;
  }

  // The newest one goes out when it is due; the reading thread sends what is left over.
  void Report(const ProgressUpdate& update) {
    {
      const std::lock_guard lock(mutex_);
      progress_ = update;
      has_progress_ = true;
    }
    FlushProgress();
  }

 private:
  void Take(const std::string& frame) {
    pb::ToExecutor message;
    if (!message.ParseFromString(frame)) _exit(1);
    const std::lock_guard lock(mutex_);
    if (message.has_run()) {
      tasks_.push_back(std::make_unique<pb::RunTask>(std::move(*message.mutable_run())));
      wake_.notify_all();
    } else if (message.has_cancel()) {
      cancelled_token_ = message.cancel().token();
      if (cancel_ != nullptr && token_ == cancelled_token_) cancel_->Cancel();
    }
  }

  void FlushProgress() {
    pb::FromExecutor message;
    {
      const std::lock_guard lock(mutex_);
      const int64_t now = RealClock().SteadyNanos();
      if (!has_progress_ || now - last_progress_ns_ < int64_t{kProgressEveryMs} * 1'000'000) return;
      has_progress_ = false;
      last_progress_ns_ = now;
      auto* report = message.mutable_progress();
      report->set_token(token_);
      report->mutable_progress()->set_stage(CleanUtf8(progress_.stage, kMaxTextBytes));
      report->mutable_progress()->set_done(progress_.done);
      report->mutable_progress()->set_total(progress_.total);
      report->mutable_progress()->set_note(CleanUtf8(progress_.note, kMaxTextBytes));
    }
    Send(message);
  }

  int fd_;
  std::mutex write_mutex_;
  std::mutex mutex_;
  std::condition_variable wake_;
  std::deque<std::unique_ptr<pb::RunTask>> tasks_;
  bool busy_ = false, closed_ = false;
  uint64_t token_ = 0, cancelled_token_ = 0;
  CancelToken* cancel_ = nullptr;
  ProgressUpdate progress_;
  bool has_progress_ = false;
  int64_t last_progress_ns_ = 0;
};

// Only where it is wanted: on a busy disk a folder made and removed costs more than a short task. What cannot
// be made shows when something is written there.
void MakeFolder(const std::string& path) {
  std::error_code ignored;
  std::filesystem::create_directories(path, ignored);
}

class ChildContext final : public TaskContext {
 public:
  ChildContext(Link& link, const pb::RunTask& run) : link_(link), run_(run) {}
  void Progress(const ProgressUpdate& update) override { link_.Report(update); }
  const CancelToken& cancel_token() const override { return cancel_; }
  CancelToken& mutable_cancel_token() { return cancel_; }
  std::string LoadCheckpoint() override {
    const std::lock_guard lock(mutex_);
    return has_own_ ? own_ : run_.assignment().checkpoint();
  }
  Status SaveCheckpoint(std::string bytes) override {
    if (bytes.size() > kMaxCheckpointBytes) {
      return ResourceExhaustedError("checkpoint of " + std::to_string(bytes.size()) +
                                    " bytes is above the limit of " + std::to_string(kMaxCheckpointBytes));
    }
    pb::FromExecutor message;
    const std::lock_guard lock(mutex_);
    own_ = std::move(bytes);
    has_own_ = true;
    message.mutable_checkpoint()->set_token(run_.assignment().token());
    message.mutable_checkpoint()->set_sequence(++sequence_);
    message.mutable_checkpoint()->set_bytes(own_);
    link_.Send(message);
    return Status::Ok();
  }
  void Log(std::string_view line) override {
    pb::FromExecutor message;
    message.mutable_log()->set_token(run_.assignment().token());
    pb::TaskLogLine* out = message.mutable_log()->add_lines();
    out->set_wall_ns(RealClock().WallNanos());
    out->set_attempt(run_.assignment().attempt());
    out->set_text(CleanUtf8(line, kMaxTextBytes));
    link_.Send(message);
  }
  const std::string& scratch_folder() const override {
    MakeFolder(run_.scratch_folder());
    return run_.scratch_folder();
  }
  Result<std::shared_ptr<coordinator::Client>> Coordinator() override {
    const pb::Access& access = run_.access();
    coordinator::ClientOptions options;
    options.address = access.coordinator();
    options.role = static_cast<pb::Role>(access.role());
    options.name = "task";
    options.lease = run_.assignment().token();
    if (!access.public_key().empty())
      options.key = transport::KeyPair{access.public_key(), access.secret_key()};
    options.server_public_key = access.server_public_key();
    RG_ASSIGN_OR_RETURN(auto client, coordinator::Client::Connect(options));
    return std::shared_ptr<coordinator::Client>(std::move(client));
  }

 private:
  Link& link_;
  const pb::RunTask& run_;
  CancelToken cancel_;
  std::mutex mutex_;
  std::string own_;
  bool has_own_ = false;
  uint64_t sequence_ = 0;
};

// Loads the inputs from the cache and checks them; those that are wrong or gone are named in `damaged`.
Result<TaskInput> LoadInput(const pb::RunTask& run, std::vector<std::string>* damaged) {
  const pb::TaskAssignment& assignment = run.assignment();
  TaskInput input;
  input.kind = assignment.kind();
  input.task_name = assignment.name();
  input.job_name = assignment.job_name();
  input.job = assignment.job();
  input.task = assignment.task();
  input.attempt = assignment.attempt();
  input.database = assignment.database();
  input.payload = assignment.payload();
  for (int i = 0; i < assignment.inputs_size(); ++i) {
    const pb::ResolvedInput& from = assignment.inputs(i);
    InputArtifact& to = input.inputs.emplace_back();
    to.name = from.name();
    to.sha256 = from.sha256();
    to.kind = from.kind();
    to.metadata_json = from.metadata_json();
    to.from_task = from.from_task();
    to.from_output = from.from_output();
    auto bytes = ReadFile(run.input_paths(i));
    if (!bytes.ok() || Sha256Hex(*bytes) != from.sha256()) {
      damaged->push_back(from.sha256());
      continue;
    }
    to.bytes = *std::move(bytes);
  }
  if (damaged->empty()) return input;
  return DataLossError(std::to_string(damaged->size()) + " inputs in the cache are damaged or gone");
}

Result<TaskOutputs> CallFunction(const TaskRegistry& registry, const TaskInput& input, TaskContext& context) {
  const TaskFunction* function = registry.Find(input.kind);
  if (function == nullptr) return InvalidError("this worker does not know the kind '" + input.kind + "'");
  try {
    return (*function)(input, context);
  } catch (const std::bad_alloc&) {
    return ResourceExhaustedError("kind '" + input.kind + "': " + std::strerror(ENOMEM));
  } catch (const std::exception& e) {
    return InternalError("kind '" + input.kind + "' threw: " + e.what());
  }
}

// Another machine may have the room that this one has not; a size limit is the same everywhere.
bool IsOfNode(const Status& outcome) {
  const auto says = [&](int error) { return outcome.message().find(std::strerror(error)) != std::string::npos; };
  return outcome.code() == StatusCode::kResourceExhausted && (says(ENOSPC) || says(EDQUOT) || says(ENOMEM));
}

// Messages carry UTF-8; what a task names or describes wrongly is its error, not a lost message.
Status CheckText(const TaskOutputs& outputs) {
  if (!IsUtf8(outputs.summary_json) || !IsUtf8(outputs.remark))
    return InvalidError("the summary or the remark is not UTF-8");
  for (const OutputArtifact& output : outputs.artifacts) {
    bool good = IsUtf8(output.name) && IsUtf8(output.kind) && IsUtf8(output.metadata_json);
    for (const std::string& parent : output.extra_parents) good = good && IsUtf8(parent);
    if (!good)
      return InvalidError("output '" + output.name + "': name, kind, metadata or parents are not UTF-8");
  }
  return Status::Ok();
}

Status PackOutputs(const pb::RunTask& run, TaskOutputs outputs, pb::ExecutorFinished* finished) {
  RG_RETURN_IF_ERROR(CheckText(outputs));
  uint64_t inline_left = run.inline_limit();
  for (size_t i = 0; i < outputs.artifacts.size(); ++i) {
    OutputArtifact& from = outputs.artifacts[i];
    pb::ExecutorOutput* to = finished->add_outputs();
    to->mutable_output()->set_name(from.name);
    to->mutable_output()->set_kind(from.kind);
    to->mutable_output()->set_metadata_json(from.metadata_json);
    to->mutable_output()->set_sha256(Sha256Hex(from.bytes));
    to->mutable_output()->set_size(from.bytes.size());
    for (const std::string& parent : from.extra_parents) to->mutable_output()->add_extra_parents(parent);
    if (from.bytes.size() <= inline_left) {
      inline_left -= from.bytes.size();
      to->mutable_output()->set_inline_bytes(std::move(from.bytes));
      continue;
    }
    MakeFolder(run.scratch_folder());
    to->set_path(run.scratch_folder() + "/.output-" + std::to_string(i));
    RG_RETURN_IF_ERROR(WriteFileAtomically(to->path(), from.bytes));
  }
  finished->set_summary_json(outputs.summary_json);
  finished->set_remark(outputs.remark);
  return Status::Ok();
}

void RunOne(Link& link, const TaskRegistry& registry, const pb::RunTask& run) {
  const uint64_t token = run.assignment().token();
  ChildContext context(link, run);
  link.Begin(token, &context.mutable_cancel_token());
  const double begin = RealClock().SteadySeconds();
  pb::FromExecutor message;
  std::vector<std::string> damaged;
  Status outcome;
  if (auto input = LoadInput(run, &damaged); input.ok()) {
    auto outputs = CallFunction(registry, *input, context);
    outcome =
        outputs.ok() ? PackOutputs(run, *std::move(outputs), message.mutable_finished()) : outputs.status();
  } else {
    outcome = input.status();
  }
  link.End();
  if (outcome.ok()) {
    message.mutable_finished()->set_token(token);
    message.mutable_finished()->set_seconds(RealClock().SteadySeconds() - begin);
  } else {
    auto* failed = message.mutable_failed();
    failed->set_token(token);
    failed->set_code(static_cast<uint32_t>(outcome.code()));
    failed->set_error(CleanUtf8(outcome.ToString(), kMaxTextBytes));
    failed->set_retryable(TaskFailureIsRetryable(outcome.code()));
    failed->set_of_node(IsOfNode(outcome));
    for (std::string& sha256 : damaged) failed->add_damaged_inputs(std::move(sha256));
  }
  link.Send(message);
}

}  // namespace

int ServeAsExecutor(int fd, const TaskRegistry& registry) {
  KeepFreedMemory();
  Link link(fd);
  pb::FromExecutor ready;
  ready.mutable_ready();
  link.Send(ready);
  std::thread reader([&link] { link.ReadForever(); });
  while (const auto run = link.NextTask()) RunOne(link, registry, *run);
  reader.join();
  return 0;
}

}  // namespace rg::worker
