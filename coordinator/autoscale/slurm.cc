#include "coordinator/autoscale/slurm.h"

#include <unistd.h>

#include <algorithm>
#include <filesystem>
#include <set>
#include <sstream>

#include "common/base/utf8.h"
#include "coordinator/autoscale/command.h"

namespace rg::coordinator::autoscale {
namespace {

std::string FirstLine(const CommandResult& said) {
  const std::string& text = said.err.empty() ? said.out : said.err;
  return VisibleText(text.substr(0, text.find('\n')));
}

// Of what sbatch says, these mean that it is the controller's trouble and not the request's.
bool IsNoAnswer(const std::string& text) {
  for (const char* words : {"Unable to contact", "Connection refused", "Socket timed out", "timed out",
                            "Zero Bytes", "Transport endpoint", "temporarily unavailable", "Communication"}) {
    if (text.find(words) != std::string::npos) return true;
  }
  return false;
}

bool IsNumber(const std::string& text) {
  return !text.empty() && std::all_of(text.begin(), text.end(), [](char c) { return c >= '0' && c <= '9'; });
}

}  // namespace

std::vector<std::string> Slurm::SbatchWords(const std::string& tag) const {
  std::vector<std::string> words = {"sbatch",
                                    "--parsable",
                                    "--job-name=" + tag,
                                    "--no-requeue",
                                    "--signal=B:TERM@60",
                                    "--ntasks=1",
                                    "--cpus-per-task=" + std::to_string(options_.slots),
                                    "--export=ALL",
                                    "--output=" + options_.log_folder + "/" + tag + ".log"};
  words.insert(words.end(), options_.sbatch.begin(), options_.sbatch.end());
  return words;
}

// The worker takes the place of the shell, so that Slurm's signal reaches it: it drains.
std::string Slurm::Script(const std::string& tag) const {
  std::string script =
      "#!/bin/sh\n"
      "unset REALITYGRAD_KEY REALITYGRAD_SERVER_KEY REALITYGRAD_ALLOWED_KEYS REALITYGRAD_COORDINATOR "
      "REALITYGRAD_DB\n"
      "exec";
  for (const std::string& word : options_.worker) script += " " + ShellQuoted(word);
  return script + " --name " + ShellQuoted(tag) + " --slots " + std::to_string(options_.slots) + "\n";
}

Status Slurm::TryOut() const {
  auto words = SbatchWords("realitygrad-dry-run");
  words.insert(words.begin() + 1, "--test-only");
  RG_ASSIGN_OR_RETURN(const CommandResult said,
                      RunCommand(words, Script("realitygrad-dry-run"), options_.timeout_s));
  if (said.code == 0) return Status::Ok();
  if (IsNoAnswer(said.err)) return UnavailableError(FirstLine(said));
  return InvalidError(FirstLine(said));
}

Result<std::string> Slurm::Ask(const std::string& tag) const {
  RG_ASSIGN_OR_RETURN(const CommandResult said,
                      RunCommand(SbatchWords(tag), Script(tag), options_.timeout_s));
  if (said.code != 0) {
    return IsNoAnswer(said.err) ? UnavailableError(FirstLine(said)) : InvalidError(FirstLine(said));
  }
  // "17", or "17;cluster"
  std::string id = said.out.substr(0, said.out.find_first_of(";\n"));
  if (!IsNumber(id)) return UnavailableError("sbatch said '" + FirstLine(said) + "' instead of a number");
  return id;
}

size_t PruneLogs(const std::string& folder, const std::vector<std::string>& kept, size_t most, double age_s) {
  namespace fs = std::filesystem;
  std::vector<std::pair<fs::file_time_type, fs::path>> logs;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder, error)) {
    const bool is_log = entry.path().extension() == ".log" && entry.is_regular_file(error);
    const std::string tag = entry.path().stem().string();
    if (is_log && std::find(kept.begin(), kept.end(), tag) == kept.end())
      logs.emplace_back(entry.last_write_time(error), entry.path());
  }
  std::sort(logs.rbegin(), logs.rend());
  const auto oldest = fs::file_time_type::clock::now() - std::chrono::seconds(static_cast<int64_t>(age_s));
  size_t removed = 0;
  for (size_t i = 0; i < logs.size(); ++i) {
    if (i >= most || logs[i].first < oldest) removed += fs::remove(logs[i].second, error);
  }
  return removed;
}

Result<std::vector<Listed>> ParseQueue(const std::string& text) {
  static const std::set<std::string> ended = {"COMPLETED", "FAILED",    "CANCELLED", "TIMEOUT",
                                              "NODE_FAIL", "PREEMPTED", "BOOT_FAIL", "OUT_OF_MEMORY",
                                              "DEADLINE",  "REVOKED"};
  static const std::set<std::string> pending = {"PENDING",     "REQUEUED",     "REQUEUE_HOLD",
                                                "REQUEUE_FED", "SPECIAL_EXIT", "SUSPENDED"};
  std::vector<Listed> all;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    if (line.empty()) continue;
    const size_t first = line.find('|'), last = line.rfind('|');
    if (first == std::string::npos || last == first)
      return UnavailableError("squeue said '" + VisibleText(line) + "'");
    Listed one;
    one.id = line.substr(0, first);
    one.tag = line.substr(first + 1, last - first - 1);
    const std::string state = line.substr(last + 1);
    one.ended = ended.count(state) > 0;
    one.pending = pending.count(state) > 0;
    all.push_back(one);
  }
  return all;
}

Result<std::vector<Listed>> Slurm::List() const {
  RG_ASSIGN_OR_RETURN(const CommandResult said,
                      RunCommand({"squeue", "--noheader", "--user=" + std::to_string(geteuid()),
                                  "--states=all", "--format=%i|%j|%T"},
                                 "", options_.timeout_s));
  if (said.code != 0) return UnavailableError(FirstLine(said));
  return ParseQueue(said.out);
}

Status Slurm::GiveBack(const std::string& id) const {
  RG_ASSIGN_OR_RETURN(const CommandResult said, RunCommand({"scancel", id}, "", options_.timeout_s));
  const bool gone = said.err.find("Invalid job id") != std::string::npos;
  return said.code == 0 || gone ? Status::Ok() : UnavailableError(FirstLine(said));
}

}  // namespace rg::coordinator::autoscale
