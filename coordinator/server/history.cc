#include "coordinator/server/history.h"

#include <algorithm>

namespace rg::coordinator {
namespace {

namespace pb = realitygrad::v1;

int LimitOf(uint32_t asked) {
  constexpr uint32_t kNormally = 1'000, kAtMost = 100'000;
  return static_cast<int>(asked == 0 ? kNormally : std::min(asked, kAtMost));
}

}  // namespace

Result<pb::GetLogsReply> ReadLogs(JobStore& store, const pb::GetLogsRequest& request, size_t page_bytes) {
  constexpr size_t kRowBytes = 32;
  TaskId first = MakeTaskId(request.job(), 0), last = MakeTaskId(request.job(), kMaxTasksPerJob - 1);
  if (!request.task().empty()) {
    RG_ASSIGN_OR_RETURN(first, store.FindTask(request.job(), request.task()));
    last = first;
  }
  RG_ASSIGN_OR_RETURN(const auto lines,
                      store.Logs(first, last, request.after_sequence(), LimitOf(request.limit())));
  pb::GetLogsReply reply;
  size_t bytes = 0;
  for (const LogRow& line : lines) {
    if (bytes > page_bytes) break;
    bytes += line.text.size() + line.name.size() + kRowBytes;
    pb::TaskLogLine* out = reply.add_lines();
    out->set_wall_ns(line.wall_ns);
    out->set_attempt(line.attempt);
    out->set_text(line.text);
    out->set_sequence(line.sequence);
    out->set_task(line.name);
  }
  return reply;
}

Result<pb::ListEventsReply> ReadEvents(JobStore& store, const pb::ListEventsRequest& request,
                                       size_t page_bytes) {
  constexpr size_t kRowBytes = 64;
  RG_ASSIGN_OR_RETURN(const auto rows,
                      store.Events(request.job(), request.after_id(), LimitOf(request.limit())));
  pb::ListEventsReply reply;
  size_t bytes = 0;
  for (const EventRow& row : rows) {
    if (bytes > page_bytes) break;
    bytes += row.event.detail.size() + row.event.task.size() + row.event.worker.size() + kRowBytes;
    pb::EventRecord* out = reply.add_events();
    out->set_id(row.id);
    out->set_wall_ns(row.event.wall_ns);
    out->set_job(row.event.job);
    out->set_task(row.event.task);
    out->set_worker(row.event.worker);
    out->set_kind(row.event.kind);
    out->set_detail(row.event.detail);
  }
  return reply;
}

}  // namespace rg::coordinator
