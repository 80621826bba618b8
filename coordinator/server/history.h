// What was said and what happened, from the store alone: logs and events, a page at a time. For whichever
// thread owns the store.
#pragma once

#include <cstddef>

#include "common/base/status.h"
#include "coordinator/store/job_store.h"
#include "realitygrad/v1/control.pb.h"

namespace rg::coordinator {

// The next page begins after the last line's sequence (event's id). About `page_bytes` in one reply.
// kNotFound: no such job, or no such task of it. A job 0 must have been resolved by the caller.
Result<realitygrad::v1::GetLogsReply> ReadLogs(JobStore& store,
                                               const realitygrad::v1::GetLogsRequest& request,
                                               size_t page_bytes);
// Of job 0: all.
Result<realitygrad::v1::ListEventsReply> ReadEvents(JobStore& store,
                                                    const realitygrad::v1::ListEventsRequest& request,
                                                    size_t page_bytes);

}  // namespace rg::coordinator
