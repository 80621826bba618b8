// The part of the server that takes what is over out of memory, and out of the way.
#include <algorithm>
#include <utility>

#include "common/base/log.h"
#include "coordinator/server/past_jobs.h"
#include "coordinator/server/server.h"

namespace rg::coordinator {
namespace {

constexpr int64_t kLookEveryNs = 10'000'000'000;
constexpr int kEventsAtOnce = 1'000;

}  // namespace

Result<Job*> Server::BringBack(JobId id, bool with_tasks) {
  Job* here = state_.FindJob(id);
  if (here != nullptr && (!here->tasks.empty() || !with_tasks)) return here;
  RG_ASSIGN_OR_RETURN(const JobRow row, jobs_->FindJob(id));
  if (with_tasks) {
    RG_ASSIGN_OR_RETURN(const uint32_t archived, jobs_->FirstUnarchived(id));
    if (archived > 0 || row.archived_ns > 0)
      return FailedPreconditionError("job " + std::to_string(id) +
                                     " is archived: what its tasks were asked is gone, submit it again");
  }
  if (here != nullptr) Retire(state_, id);  // it came without its tasks
  RG_ASSIGN_OR_RETURN(const StoredJob stored, jobs_->LoadJob(id, with_tasks));
  state_.ended.push_back(id);
  return &Recall(state_, stored);
}

// After the batch has been committed and sent: what is over is durable, and was told to those who watched.
void Server::RetireEnded() {
  for (const JobId id : std::exchange(state_.ended, {})) {
    Retire(state_, id);
    if (state_.FindJob(id) == nullptr) jobs_->ForgetLogCounts(id);
  }
}

// A part per tick, so that nobody waits for it.
void Server::ArchiveIfDue(int64_t steady_ns) {
  if (steady_ns < archive_due_ns_) return;
  const int64_t wall = clock_->WallNanos();
  const int64_t before = options_.archive_after_ns > 0 ? wall - options_.archive_after_ns : 0;
  const auto job = jobs_->NextToArchive(before, options_.archive_above_tasks);
  const auto event_ns = jobs_->OldestEvent();
  Status done = job.ok() ? event_ns.status() : job.status();
  if (done.ok() && *job != 0 && state_.FindJob(*job) == nullptr) {
    done = Apart([&] { return ArchivePart(*jobs_, *job, wall).status(); });
  } else if (done.ok() && *event_ns != 0 && *event_ns < before) {
    done = Apart([&] { return jobs_->DropOldEvents(before, kEventsAtOnce).status(); });
  } else {
    archive_due_ns_ = steady_ns + kLookEveryNs;
  }
  if (done.ok()) return;
  archive_due_ns_ = steady_ns + kLookEveryNs;
  spdlog::warn("nothing is archived for now: {}", done.ToString());
}

// In the batch's transaction, but a failure undoes this alone.
Status Server::Apart(const std::function<Status()>& body) {
  RG_RETURN_IF_ERROR(EnsureTransaction());
  const Status done = database_->InTransaction(body);
  space_was_freed_ = space_was_freed_ || done.ok();
  return done;
}

void Server::HandleArchive(const transport::Message& message) {
  auto body = transport::Unpack<pb::ArchiveJobsRequest>(message);
  if (!body.ok()) return Reply(transport::MakeErrorReply(self_, message, body.status()));
  pb::ArchiveJobsReply reply;
  const Status done = Apart([&]() -> Status {
    RG_ASSIGN_OR_RETURN(reply, ArchiveSome(*body));
    return Status::Ok();
  });
  promises_.push_back(done.ok() ? transport::MakeReply(self_, message, reply)
                                : transport::MakeErrorReply(self_, message, done));
}

Result<pb::ArchiveJobsReply> Server::ArchiveSome(const pb::ArchiveJobsRequest& request) {
  constexpr uint64_t kTasksAtOnce = 5'000;
  constexpr int kListed = 10'000, kJobsAtOnce = 200;
  const int64_t wall = clock_->WallNanos(), before = wall - std::max<int64_t>(0, request.older_than_ns()) + 1;
  pb::ArchiveJobsReply reply;
  if (request.dry_run()) {
    JobFilter filter;
    filter.phases = {JobPhase::kSucceeded, JobPhase::kFailed, JobPhase::kCancelled};
    filter.any_parent = true;
    RG_RETURN_IF_ERROR(jobs_->ListJobs(filter, [&](const JobRow& row) {
      if (row.archived_ns > 0 || row.record.finished_ns >= before) return true;
      if (reply.jobs_size() >= kListed) return reply.set_more(true), false;
      reply.add_jobs(row.job);
      reply.set_tasks(reply.tasks() + row.total);
      return true;
    }));
    return reply;
  }
  while (reply.tasks() < kTasksAtOnce && reply.jobs_size() < kJobsAtOnce) {
    RG_ASSIGN_OR_RETURN(const JobId job, jobs_->NextToArchive(before, 0));
    if (job == 0) return reply;
    if (state_.FindJob(job) != nullptr) break;  // somebody has just brought it back
    RG_ASSIGN_OR_RETURN(const ArchivedPart part, ArchivePart(*jobs_, job, wall));
    reply.set_tasks(reply.tasks() + part.tasks);
    if (part.done) reply.add_jobs(job);
  }
  reply.set_more(true);
  return reply;
}

}  // namespace rg::coordinator
