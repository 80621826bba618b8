#include "services/cli/job_terms.h"

#include <CLI/CLI.hpp>

#include "coordinator/client/client.h"
#include "services/cli/job_selector.h"

namespace rg::cli {

void JobTerms::AddTo(CLI::App* command) {
  command->add_option("--name", name_, "For people");
  command->add_option("--label", labels_, "NAME=VALUE, to find it by; several");
  command->add_option("--priority", priority_, "Higher first; `job priority` changes it later")
      ->capture_default_str();
  command->add_option("--after", after_,
                      "5, 1-10, 1,3 or last: nothing of it starts before these jobs have succeeded");
  command
      ->add_option("--time-limit", time_limit_s_,
                   "Seconds from its start, pauses included; then it fails (0: none)")
      ->check(CLI::Range(0.0, 1e9))
      ->capture_default_str();
}

Status JobTerms::Apply(coordinator::Client& client, realitygrad::v1::JobSpec* job) const {
  if (!name_.empty()) job->set_name(name_);
  job->set_priority(priority_);
  job->set_time_limit_s(time_limit_s_);
  for (const std::string& label : labels_) {
    const size_t equals = label.find('=');
    if (equals == 0 || equals == std::string::npos)
      return InvalidError("--label '" + label + "': must be NAME=VALUE");
    (*job->mutable_labels())[label.substr(0, equals)] = label.substr(equals + 1);
  }
  if (after_.empty()) return Status::Ok();
  RG_ASSIGN_OR_RETURN(const auto ids, ParseSelector(after_, client, [](auto state) { return !IsOver(state); }));
  for (int64_t id : ids) {
    if (id == 0) {
      RG_ASSIGN_OR_RETURN(const auto newest, client.GetJob(0));
      id = newest.job().id();
    }
    job->add_after_jobs(id);
  }
  return Status::Ok();
}

}  // namespace rg::cli
