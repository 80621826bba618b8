#include "coordinator/server/read_desk.h"

#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <utility>

#include "common/base/utf8.h"
#include "common/store/artifact_store.h"
#include "common/store/database.h"
#include "common/store/parameter_store.h"
#include "coordinator/server/artifact_desk.h"
#include "coordinator/server/history.h"
#include "coordinator/server/past_jobs.h"
#include "coordinator/store/schema.h"
#include "realitygrad/v1/control.pb.h"

namespace rg::coordinator {
namespace {

namespace pb = realitygrad::v1;
using transport::Is;

constexpr size_t kPageBytes = 8u << 20;
constexpr size_t kMaxWaiting = 1024;
constexpr size_t kMaxAnswerBytes = 64u << 20;  // made and not taken yet: then it pauses

// A connection with the stores on it.
struct Reader {
  std::unique_ptr<store::Database> database;
  std::unique_ptr<store::ArtifactStore> artifacts;
  std::unique_ptr<store::ParameterStore> parameters;
  std::unique_ptr<JobStore> jobs;
  std::unique_ptr<ArtifactDesk> desk;

  Status Open(const std::string& path, const Clock* clock, std::function<bool()> stop) {
    if (desk != nullptr) return Status::Ok();
    store::DatabaseOptions options;
    options.path = path;
    options.read_only = true;
    RG_ASSIGN_OR_RETURN(
        database, store::Database::Open(options, {store::ArtifactStore::Schema(),
                                                  store::ParameterStore::Schema(), CoordinatorSchema()}));
    RG_ASSIGN_OR_RETURN(artifacts, store::ArtifactStore::Open(database.get(), clock));
    parameters = std::make_unique<store::ParameterStore>(database.get(), clock);
    jobs = std::make_unique<JobStore>(database.get());
    desk = std::make_unique<ArtifactDesk>(artifacts.get(), parameters.get(), clock);
    desk->set_stop(std::move(stop));
    return Status::Ok();
  }
};

// Beside the database, under a name that is not taken.
Result<pb::BackupReply> BackUp(store::Database& database, const pb::BackupRequest& request) {
  const std::string& name = request.name();
  if (name.empty() || name.front() == '.' || name.find('/') != std::string::npos || !IsPlainText(name))
    return InvalidError("the name of a backup is that of a file without a folder, not '" + VisibleText(name) +
                        "'");
  std::error_code error;
  const auto path = std::filesystem::absolute(database.path(), error).parent_path() / name;
  const Status done = database.BackupTo(path.string());
  if (!done.ok()) {
    if (done.code() != StatusCode::kAlreadyExists) std::filesystem::remove(path, error);
    return done;
  }
  pb::BackupReply reply;
  reply.set_path(path.string());
  reply.set_bytes(std::filesystem::file_size(path, error));
  return reply;
}

template <class Reply>
transport::Message Pack(const transport::Sender& self, const transport::Message& request,
                        const Result<Reply>& reply) {
  return reply.ok() ? transport::MakeReply(self, request, *reply)
                    : transport::MakeErrorReply(self, request, reply.status());
}

std::optional<transport::Message> Answer(Reader& reader, const transport::Sender& self,
                                         const transport::Message& request) {
  if (const auto body = transport::Unpack<pb::BackupRequest>(request); body.ok())
    return Pack(self, request, BackUp(*reader.database, *body));
  if (const auto body = transport::Unpack<pb::GetLogsRequest>(request); body.ok())
    return Pack(self, request, ReadLogs(*reader.jobs, *body, kPageBytes));
  if (const auto body = transport::Unpack<pb::ListEventsRequest>(request); body.ok())
    return Pack(self, request, ReadEvents(*reader.jobs, *body, kPageBytes));
  if (const auto body = transport::Unpack<pb::GetJobRequest>(request); body.ok())
    return Pack(self, request, DescribePastJob(*reader.jobs, *body, kPageBytes));
  if (const auto body = transport::Unpack<pb::ExplainRequest>(request); body.ok())
    return Pack(self, request, ExplainPastTask(*reader.jobs, *body));
  return reader.desk->Answer(self, request);
}

}  // namespace

ReadDesk::ReadDesk(std::string database_path, transport::Sender self, const Clock* clock,
                   std::function<void()> wake)
    : path_(std::move(database_path)), self_(std::move(self)), clock_(clock), wake_(std::move(wake)) {
  thread_ = std::thread([this] { Work(); });
}

ReadDesk::~ReadDesk() {
  {
    const std::lock_guard lock(mutex_);
    stop_ = true;
  }
  more_.notify_all();
  thread_.join();
}

bool ReadDesk::IsLong(const transport::Message& request) {
  return Is<pb::VerifyArtifactsRequest>(request) || Is<pb::ArtifactLineageRequest>(request) ||
         Is<pb::BackupRequest>(request);
}

bool ReadDesk::IsShort(const transport::Message& request) {
  return Is<pb::GetArtifactRequest>(request) || Is<pb::ShowArtifactRequest>(request) ||
         Is<pb::ListArtifactsRequest>(request) || Is<pb::ListRobotsRequest>(request) ||
         Is<pb::ParameterHistoryRequest>(request) || Is<pb::ShowParametersRequest>(request) ||
         Is<pb::DiffParametersRequest>(request) || Is<pb::GetLogsRequest>(request) ||
         Is<pb::ListEventsRequest>(request);
}

Status ReadDesk::Add(transport::Message request) {
  {
    const std::lock_guard lock(mutex_);
    if (waiting_.size() >= kMaxWaiting)
      return ResourceExhaustedError("too many requests wait for the database: try again later");
    waiting_.push_back(std::move(request));
  }
  more_.notify_one();
  return Status::Ok();
}

std::vector<transport::Message> ReadDesk::TakeAnswers() {
  std::vector<transport::Message> taken;
  {
    const std::lock_guard lock(mutex_);
    taken.swap(answers_);
    answer_bytes_ = 0;
  }
  if (!taken.empty()) more_.notify_one();
  return taken;
}

void ReadDesk::Work() {
  Reader reader;
  while (true) {
    transport::Message request;
    {
      std::unique_lock lock(mutex_);
      more_.wait(lock, [this] { return stop_ || (!waiting_.empty() && answer_bytes_ < kMaxAnswerBytes); });
      if (stop_) return;
      request = std::move(waiting_.front());
      waiting_.pop_front();
    }
    const Status opened = reader.Open(path_, clock_, [this] { return stop_.load(); });
    std::optional<transport::Message> answer =
        opened.ok() ? Answer(reader, self_, request) : transport::MakeErrorReply(self_, request, opened);
    {
      const std::lock_guard lock(mutex_);
      if (!answer) continue;
      answer_bytes_ += answer->envelope.payload().size() + answer->attachment.size();
      answers_.push_back(*std::move(answer));
    }
    wake_();
  }
}

}  // namespace rg::coordinator
