// A job as a picture that is drawn again: stages as bars with a cell per shard, who works on what, the best
// residual so far, when it will be over.
#pragma once

#include <string>
#include <vector>

#include "common/base/status.h"
#include "realitygrad/v1/control.pb.h"

namespace rg::coordinator {
class Client;
}

namespace rg::cli {

// '#' done, '>' running, '!' failed, '.' to do; a cell per task where they fit into `width`, else by share.
std::string ShardBar(uint32_t total, uint32_t done, uint32_t running, uint32_t failed, int width);

// Lines of at most `width` cells, at most `height` of them.
std::vector<std::string> LiveView(const realitygrad::v1::GetJobReply& job, int width, int height);

// Redraws it on stderr, a terminal, until the job is over. timeout_s < 0: for ever; else kDeadlineExceeded.
Result<realitygrad::v1::GetJobReply> WatchLive(coordinator::Client& client, int64_t job, double timeout_s);

}  // namespace rg::cli
