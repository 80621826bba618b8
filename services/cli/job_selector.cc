#include "services/cli/job_selector.h"

#include <CLI/CLI.hpp>

#include "coordinator/client/client.h"
#include "services/cli/context.h"
#include "services/cli/job_view.h"

namespace rg::cli {

namespace pb = ::realitygrad::v1;

Result<std::vector<int64_t>> ParseSelector(const std::string& text, coordinator::Client& client,
                                           WantedState wanted) {
  std::vector<int64_t> ids;
  if (text == "last") return std::vector<int64_t>{0};
  if (text == "all") {
    RG_ASSIGN_OR_RETURN(const auto jobs, client.ListAllJobs());
    for (const auto& job : jobs) {
      if (wanted == nullptr || wanted(job.state())) ids.push_back(job.id());
    }
    return ids;
  }
  for (const std::string& part : CLI::detail::split(text, ',')) {
    long low = 0, high = 0;
    char dash = 0, rest = 0;
    const int fields = std::sscanf(part.c_str(), "%ld%c%ld%c", &low, &dash, &high, &rest);
    if (fields == 1) high = low;
    constexpr long kMost = 1'000'000'000'000, kMostAtOnce = 100'000;
    const bool is_range = fields == 3 && dash == '-';
    if ((fields != 1 && !is_range) || low < 1 || high < low || high > kMost || high - low > kMostAtOnce) {
      return InvalidError("job selector '" + text + "': must be a number, 1-10, 1,3, all or last");
    }
    for (long id = low; id <= high; ++id) ids.push_back(id);
  }
  return ids;
}

Result<AllJobs> SelectAll(coordinator::Client& client, WantedState wanted) {
  AllJobs all;
  pb::ListJobsRequest request;
  request.set_limit(10'000);
  while (true) {
    RG_ASSIGN_OR_RETURN(const auto reply, client.ListJobsReply(request));
    const std::string& me = reply.you().empty() ? UserAtHost() : reply.you();
    for (const auto& job : reply.jobs()) {
      if (!wanted(job.state())) continue;
      const std::string name = WhoOf(job.submitted_by()).name;
      const bool is_mine = name == me || name.empty();
      (is_mine ? all.mine : all.others).push_back(job.id());
      if (!is_mine) all.names.insert(name);
    }
    if (!reply.more() || reply.jobs().empty()) return all;
    request.set_before_id(reply.jobs().rbegin()->id());
  }
}

bool IsOver(pb::JobState state) {
  return state == pb::JOB_STATE_SUCCEEDED || state == pb::JOB_STATE_FAILED ||
         state == pb::JOB_STATE_CANCELLED;
}

}  // namespace rg::cli
