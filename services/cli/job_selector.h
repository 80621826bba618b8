// Which jobs a command is about.
#pragma once

#include <cstdint>
#include <set>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "realitygrad/v1/job.pb.h"

namespace rg::coordinator {
class Client;
}

namespace rg::cli {

using WantedState = bool (*)(realitygrad::v1::JobState);

// "5", "1-10", "1,3", "all", "last" -> ids; 0 stands for the newest. "all" leaves out those in no `wanted`
// state.
Result<std::vector<int64_t>> ParseSelector(const std::string& text, coordinator::Client& client,
                                           WantedState wanted = nullptr);

// All in a `wanted` state, and whose those are that are not of whoever asks.
struct AllJobs {
  std::vector<int64_t> mine, others;
  std::set<std::string> names;  // of the others
};
Result<AllJobs> SelectAll(coordinator::Client& client, WantedState wanted);

bool IsOver(realitygrad::v1::JobState state);

}  // namespace rg::cli
