#include "services/lab/proof_runs.h"

#include <filesystem>

#include "common/base/file.h"
#include "common/base/hash.h"
#include "services/cli/context.h"
#include "services/cli/interrupt.h"
#include "services/cli/output.h"
#include "services/lab/process_pool.h"
#include "services/proof/run_record.h"

namespace rg::lab {

namespace fs = std::filesystem;
using proof::RunRecord;

namespace {

bool Answered(const std::string& answer) { return fs::exists(answer + "/diagnosis.json"); }

// Answers of programs that kept no record are taken as they are.
bool Settled(const std::string& answer, const std::string& set, int limit_s) {
  const auto record = proof::ReadRunRecord(answer);
  if (!record) return Answered(answer);
  return record->Settles(set, limit_s) &&
         (record->outcome == RunRecord::Outcome::kOutOfTime || Answered(answer));
}

// As it is seen from the answer, so that both may be moved together.
std::string Origin(const SetToDiagnose& set, const std::string& answer) {
  return fs::weakly_canonical(set.folder).lexically_relative(fs::weakly_canonical(answer)).string();
}

std::vector<std::string> Command(const SetToDiagnose& set, const std::string& answer) {
  std::vector<std::string> command({cli::SiblingProgram("realitygrad"), "diagnose", set.folder, "--out",
                                    answer, "--threads", "1", "--output", "quiet"});
  const std::string model = set.folder + "/model.json";
  if (fs::exists(model)) command.insert(command.end(), {"--model", model});
  return command;
}

RunRecord::Outcome OutcomeOf(const PooledEnd& end, const std::string& answer) {
  if (end.out_of_time) return RunRecord::Outcome::kOutOfTime;
  return end.code == 0 && Answered(answer) ? RunRecord::Outcome::kAnswered : RunRecord::Outcome::kFailed;
}

std::string NoteOf(const std::string& name, const PooledEnd& end, int limit_s) {
  if (end.out_of_time) return name + ": no answer in " + std::to_string(limit_s) + " s of CPU time";
  return end.code == 0 ? "" : name + " ended with code " + std::to_string(end.code);
}

}  // namespace

Status DiagnoseSets(const std::vector<SetToDiagnose>& sets, const ProofRuns& runs,
                    cli::ProgressDisplay* display) {
  RG_ASSIGN_OR_RETURN(const std::string bytes, ReadFile(cli::SiblingProgram("realitygrad")));
  const std::string program = Sha256Hex(bytes).substr(0, 12);
  std::error_code error;
  fs::create_directories(runs.logs, error);
  if (error) return InvalidError(runs.logs + ": cannot create: " + error.message());
  std::vector<PooledProcess> processes;
  std::vector<const SetToDiagnose*> which;
  for (const SetToDiagnose& set : sets) {
    const std::string answer = runs.answers + "/" + set.name;
    if (Settled(answer, Origin(set, answer), runs.limit_s)) continue;
    fs::remove(answer + "/diagnosis.json", error);  // of another set: it is no answer to this one
    which.push_back(&set);
    processes.push_back({Command(set, answer), runs.logs + "/" + set.name + ".log", runs.limit_s});
  }
  size_t done = sets.size() - processes.size();
  Status written;
  RG_RETURN_IF_ERROR(RunPool(
      processes, runs.jobs,
      [&](size_t i, const PooledEnd& end) {
        const SetToDiagnose& set = *which[i];
        const std::string answer = runs.answers + "/" + set.name;
        const Status status =
            proof::WriteRunRecord(answer, {Origin(set, answer), program, OutcomeOf(end, answer), end.cpu_s,
                                           static_cast<double>(runs.limit_s)});
        if (written.ok()) written = status;
        display->Show({"diagnosing", static_cast<double>(++done), static_cast<double>(sets.size()),
                       NoteOf(set.name, end, runs.limit_s)});
      },
      &cli::CancelledByInterrupt()));
  return written;
}

}  // namespace rg::lab
