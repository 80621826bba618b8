// `diagnose`: which physics the model leaves out, from a recording set.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <atomic>
#include <memory>
#include <nlohmann/json.hpp>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/printf.h"
#include "common/recordings/recording_set.h"
#include "coordinator/client/client.h"
#include "realitygrad/v1/artifact.pb.h"
#include "realitygrad/v1/control.pb.h"
#include "services/cli/commands.h"
#include "services/cli/context.h"
#include "services/cli/early_warnings.h"
#include "services/cli/interrupt.h"
#include "services/cli/model_source.h"
#include "services/cli/output.h"
#include "services/cli/packed_set.h"
#include "services/cli/progress_display.h"
#include "services/cli/set_arguments.h"
#include "services/diagnosis/diagnosis.h"
#include "services/diagnosis/reporting/told_in_tables.h"
#include "services/jobs/kinds.h"
#include "services/jobs/remote_fits.h"
#include "services/report/diagnosis_page.h"
#include "services/report/diagnosis_svg.h"

namespace rg::cli {
namespace {

namespace pb = ::realitygrad::v1;

constexpr size_t kJointsInASentence = 2;

struct DiagnoseArguments {
  SetArguments sets;
  std::string out, svg, model;
  diagnosis::DiagnosisOptions options;
};

std::string ListOfNames(const std::vector<std::string>& names) {
  std::string out;
  for (size_t i = 0; i < names.size(); ++i)
    out += (i == 0 ? "" : i + 1 == names.size() ? " and " : ", ") + names[i];
  return out;
}

// A column per parameter, for more joints than a sentence names; else empty.
std::string ValuesOfJoints(const diagnosis::DiagnosisResult& r) {
  const diagnosis::JointTable values = diagnosis::ParametersOfJoints(r);
  if (values.columns.empty() || values.joints.size() <= kJointsInASentence) return "";
  std::vector<std::string> columns = {"joint"};
  for (const std::string& column : values.columns) columns.push_back(">" + column);
  TextTable table(columns);
  for (size_t j = 0; j < values.joints.size(); ++j) {
    std::vector<std::string> row = {values.joints[j]};
    row.insert(row.end(), values.cells[j].begin(), values.cells[j].end());
    table.AddRow(row);
  }
  std::string text = table.ToString();
  while (!text.empty() && text.back() == '\n') text.pop_back();
  return "\n" + text;
}

// `said`: notes that were said before the search.
std::string Told(const diagnosis::DiagnosisResult& r, const std::vector<std::string>& said) {
  const std::string gap = diagnosis::GapInWords(r);
  std::string text = r.verdict + (gap.empty() ? "" : ": " + gap);
  for (const auto& f : r.findings) {
    text += "\n  " + f.effect + Printf(" (%.2f)", f.confidence) + ": " + f.statement;
    if (f.effect_class.size() > 1)
      text += "\n    cannot be told from " + ListOfNames({f.effect_class.begin() + 1, f.effect_class.end()}) +
              " in these recordings";
  }
  text += ValuesOfJoints(r);
  text += "\nheld-out RMS: " +
          (std::isnan(r.holdout.before_rms) ? "the model as given cannot run"
                                            : Printf("%.4g as given", r.holdout.before_rms)) +
          Printf(", %.4g calibrated, %.4g with the findings, floor %.4g (%.1f s)", r.holdout.calibrated_rms,
                 r.holdout.after_rms, r.holdout.noise_floor_rms, r.elapsed_s);
  if (r.motion)
    text +=
        "\nrecord next: " + r.motion->description + Printf(" (%.3g nats expected)", r.motion->expected_nats);
  for (const std::string& note : r.notes) {
    if (std::find(said.begin(), said.end(), note) == said.end()) text += "\nnote: " + note;
  }
  return text;
}

std::string Next(const diagnosis::DiagnosisResult& r, const DiagnoseArguments& arguments) {
  const std::string& out = arguments.out;
  if (out.empty())
    return std::string("next: the same with --out DIR keeps model and report") +
           (r.motion ? ", and the motion that tells the rivals apart" : "");
  if (!r.motion)
    return "next: open " + ShellWord(out + "/report.html") + "; realitygrad predict --model " +
           ShellWord(out + "/model.json") + " --recording REC.csv --out PRED.csv";
  std::string sets;
  for (const std::string& set : arguments.sets.sets) sets += ShellWord(set) + " ";
  return "next: realitygrad submit rollout --trajectory " + ShellWord(out + "/motion.csv") +
         " --out MORE; realitygrad diagnose " + sets + "MORE --out " + ShellWord(out + "2") + "   (tells " +
         ListOfNames(r.motion->effects) + " apart)";
}

// Fits as tasks of a coordinator's workers. Ctrl-C ends the process, and takes back what no worker has done yet.
class Workers {
 public:
  Status Connect(const Context& context) {
    RG_ASSIGN_OR_RETURN(client_, context.Connect());
    RG_ASSIGN_OR_RETURN(stopping_client_, context.Connect());
    ends_.emplace([this] { return Stop(); });
    return Status::Ok();
  }
  Result<jobs::RemoteFits*> Start(const DiagnoseArguments& arguments) {
    RG_ASSIGN_OR_RETURN(const std::string packed, PackedSet(arguments.sets));
    pb::ArtifactInfo info;
    info.set_kind(jobs::kArtifactRecordingSet);
    info.set_metadata_json(nlohmann::json{{"name", arguments.sets.name()}}.dump());
    RG_ASSIGN_OR_RETURN(std::string set, client_->PutArtifact(packed, info));
    jobs::FitInputs inputs;
    inputs.recordings = {std::move(set)};
    if (!arguments.model.empty()) {
      RG_ASSIGN_OR_RETURN(inputs.model, PutModelFile(*client_, arguments.model));
    }
    fits_ = std::make_unique<jobs::RemoteFits>(*client_, std::move(inputs), &CancelledByInterrupt());
    started_ = fits_.get();
    return fits_.get();
  }
  // From now on what there is may be written.
  void Done() { ends_.reset(); }

 private:
  std::string Stop() {
    const jobs::RemoteFits* fits = started_;
    if (fits == nullptr) return ": the diagnosis had not begun";
    for (const int64_t job : fits->open_jobs()) {
      const auto cancelled = stopping_client_->Act(job, pb::JOB_ACTION_CANCEL, "the diagnosis was stopped");
      if (cancelled.status().code() == StatusCode::kUnavailable) return "";
    }
    return ": nothing was written, and the fits that workers had not done are cancelled";
  }

  std::unique_ptr<coordinator::Client> client_, stopping_client_;
  std::unique_ptr<jobs::RemoteFits> fits_;
  std::atomic<const jobs::RemoteFits*> started_{nullptr};
  std::optional<EndsOnInterrupt> ends_;
};

Status DiagnoseSet(Context& context, const DiagnoseArguments& arguments) {
  std::optional<Workers> workers;
  if (!context.flags.coordinator.value.empty()) RG_RETURN_IF_ERROR(workers.emplace().Connect(context));
  RG_ASSIGN_OR_RETURN(const recordings::RecordingSet set, arguments.sets.Load());
  RG_RETURN_IF_ERROR(CheckWritable(arguments.out));
  diagnosis::DiagnosisOptions options = arguments.options;
  if (!arguments.model.empty()) {
    RG_ASSIGN_OR_RETURN(options.model, sim::LoadModelFile(arguments.model));
  }
  RG_ASSIGN_OR_RETURN(const auto said, SayWarnings(context, set, options.model, options.trust_effort));
  const jobs::RemoteFits* fits = nullptr;
  if (workers) {
    RG_ASSIGN_OR_RETURN(jobs::RemoteFits* const started, workers->Start(arguments));
    options.fits = started, fits = started;
  }
  ProgressDisplay display(context.quiet());
  RG_ASSIGN_OR_RETURN(const diagnosis::DiagnosisResult result,
                      diagnosis::Diagnose(
                          set, options, RealClock(), [&](const ProgressUpdate& u) { display.Show(u); },
                          &CancelledByInterrupt()));
  if (workers) workers->Done();
  display.Finish();
  if (fits != nullptr && !context.quiet())
    PrintNote(std::to_string(fits->by_workers()) + " fits by workers, " + std::to_string(fits->here()) + " here");
  if (!arguments.out.empty()) {
    RG_RETURN_IF_ERROR(diagnosis::WriteDiagnosis(arguments.out, result, report::DiagnosisPage(result)));
  }
  if (!arguments.svg.empty())
    RG_RETURN_IF_ERROR(WriteFileAtomically(arguments.svg, report::DiagnosisSvg(result)));
  if (context.json()) {
    PrintJson("realitygrad.diagnosis/1", nlohmann::json::parse(diagnosis::DiagnosisJson(result)));
  } else if (!context.quiet()) {
    Print(Told(result, said));
    Print(Next(result, arguments));
  }
  return Status::Ok();
}

}  // namespace

void AddDiagnoseCommand(CLI::App& app, Context& context) {
  auto arguments = std::make_shared<DiagnoseArguments>();
  CLI::App* command =
      app.add_subcommand("diagnose", "Say which physics the model leaves out, from a recording set");
  auto& o = arguments->options;
  arguments->sets.AddTo(command);
  command->add_option(
      "--model", arguments->model,
      "A model.json to start from, identified or diagnosed before, instead of the set's URDF");
  command->add_option("--out", arguments->out, "Folder for diagnosis.json, model.json and report.html");
  command->add_option("--svg", arguments->svg, "File for a small picture of the missing force");
  command->add_option("--threads", o.threads, "0: all cores")
      ->check(CLI::Range(0, 1024))
      ->capture_default_str();
  command->add_option("--window", o.window_s, "Length of the judged predictions [s]")->capture_default_str();
  command->add_option("--step", o.step_s, "Of the simulator, at most [s]; halved where its error counts")
      ->capture_default_str();
  command->add_flag("--trust-effort", o.trust_effort,
                    "Go on where the sign or the unit of an effort looks wrong");
  command->add_option("--seed", o.seed, "Of simulated nulls and bootstraps")->capture_default_str();
  command->callback([&context, arguments] { context.Failed(DiagnoseSet(context, *arguments)); });
}

}  // namespace rg::cli
