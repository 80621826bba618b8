// `sysid` and `predict`: work on files, without a service.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/printf.h"
#include "common/model/robot_model.h"
#include "common/model/urdf_loader.h"
#include "common/recordings/csv.h"
#include "common/recordings/manifest.h"
#include "common/recordings/recording_set.h"
#include "common/sim/model_file.h"
#include "services/cli/commands.h"
#include "services/cli/context.h"
#include "services/cli/early_warnings.h"
#include "services/cli/interrupt.h"
#include "services/cli/progress_display.h"
#include "services/cli/set_arguments.h"
#include "services/report/sysid_page.h"
#include "services/sysid/prediction.h"
#include "services/sysid/rotor_start.h"
#include "services/sysid/sysid_on_set.h"

namespace rg::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

// ---- sysid ----

struct SysidArguments {
  SetArguments set;
  std::string out, model;
  std::string parametrisation = "log-cholesky", window_choice = "information";
  bool trust_effort = false;
  sysid::SysidOptions options;
};

Status Sysid(Context& context, SysidArguments& arguments) {
  RG_ASSIGN_OR_RETURN(const recordings::RecordingSet set, arguments.set.Load());
  if (!arguments.model.empty()) {
    RG_ASSIGN_OR_RETURN(arguments.options.model, sim::LoadModelFile(arguments.model));
  }
  RG_RETURN_IF_ERROR(CheckWritable(arguments.out));
  RG_RETURN_IF_ERROR(SayWarnings(context, set, arguments.options.model, arguments.trust_effort).status());
  ProgressDisplay display(context.quiet());
  RG_ASSIGN_OR_RETURN(const sysid::SysidReport report,
                      sysid::SysidOnSet(
                          set, arguments.options, RealClock(),
                          [&](const ProgressUpdate& u) { display.Show(u); }, &CancelledByInterrupt()));
  display.Finish();
  if (!arguments.out.empty() && report.plant) {
    RG_RETURN_IF_ERROR(sim::SaveModelFile(arguments.out + "/model.json", *report.plant, report.values));
    RG_RETURN_IF_ERROR(
        WriteFileAtomically(arguments.out + "/sysid.json", sysid::SysidToJson(report).dump(2)));
    RG_RETURN_IF_ERROR(WriteFileAtomically(arguments.out + "/report.html", report::SysidPage(report)));
  }
  if (context.json()) {
    PrintJson("realitygrad.sysid/1", sysid::SysidToJson(report));
  } else if (!context.quiet()) {
    Print(sysid::FormatSysid(report));
    if (!arguments.out.empty()) {
      Print("next: open " + ShellWord(arguments.out + "/report.html") + "; realitygrad predict --model " +
            ShellWord(arguments.out + "/model.json") + " --recording REC.csv --out PRED.csv");
    } else {
      Print("next: the same with --out DIR keeps the model for `realitygrad predict`");
    }
  }
  return Status::Ok();
}

// ---- predict ----

struct PredictArguments {
  std::string model, recording, out;
  double window_s = 1.0;
  bool measured_restart = false;
  ReadArguments read;
};

// What the simulation needs to know besides the model.
struct PredictionModel {
  sim::ModelFile file;
  std::optional<recordings::EffortKind> drive;
  bool effort_excludes_gravity = false;
  // Joints that move as measured; nothing: those without an effort in the recording.
  std::optional<std::vector<std::string>> prescribed;
};

Result<PredictionModel> NominalOf(const recordings::RecordingSet& set) {
  RG_ASSIGN_OR_RETURN(const sim::Plant plant, sysid::NominalPlant(set));
  return PredictionModel{
      {plant, plant.parameters().Nominal(), 0}, set.drive, set.effort_excludes_gravity, set.prescribed};
}

// A model.json, a recording set's folder, or a URDF.
Result<PredictionModel> LoadModel(const std::string& path) {
  std::error_code error;
  if (fs::is_directory(path, error)) {
    RG_ASSIGN_OR_RETURN(const auto set, recordings::LoadSet(path));
    return NominalOf(set);
  }
  if (path.ends_with(".urdf") || path.ends_with(".xml")) {
    RG_ASSIGN_OR_RETURN(model::RobotModel robot, model::LoadUrdf(path));
    RG_ASSIGN_OR_RETURN(const sim::Plant plant,
                        sim::Plant::Create(std::make_shared<const model::RobotModel>(std::move(robot))));
    return PredictionModel{{plant, plant.parameters().Nominal(), 0}, std::nullopt, false, std::nullopt};
  }
  RG_ASSIGN_OR_RETURN(sim::ModelFile file, sim::LoadModelFile(path));
  const std::vector<std::string> told = file.plant.options().prescribed;
  PredictionModel model{std::move(file), std::nullopt, false, std::nullopt};
  if (!told.empty()) model.prescribed = told;
  return model;
}

// What the manifest beside a recording says of its effort, joints and rate, if there is one.
void TakeManifestBeside(const std::string& recording, PredictionModel* model, recordings::CsvOptions* csv) {
  const fs::path folder = fs::path(recording).parent_path();
  const std::string path = ((folder.empty() ? fs::path(".") : folder) / "manifest.json").string();
  const auto text = ReadFile(path);
  if (!text.ok()) return;
  const auto manifest = recordings::ParseManifest(*text, path);
  if (!manifest.ok()) return;
  const recordings::RecordingSet& set = manifest->settings;
  if (!model->drive) model->drive = set.drive;
  model->effort_excludes_gravity = model->effort_excludes_gravity || set.effort_excludes_gravity;
  csv->sample_rate_hz = set.sample_rate_hz;
  // Of another robot's set, or of one with other columns, nothing is taken.
  std::vector<std::string> joints = manifest->joints, own = model->file.plant.joint_names();
  std::sort(joints.begin(), joints.end());
  std::sort(own.begin(), own.end());
  if (set.prescribed_listed && joints == own) model->prescribed = set.prescribed;
}

std::string MoveAsMeasured(const recordings::Recording& recording) {
  std::string names;
  for (const int j : recording.prescribed)
    names += (names.empty() ? "" : ", ") + recording.joints[static_cast<size_t>(j)];
  return names + (recording.prescribed.size() == 1 ? " moves" : " move") +
         " as measured (prescribed), no error counts " + (recording.prescribed.size() == 1 ? "it" : "them");
}

// The model's joints move as measured where the recording's do.
Status TakeRoles(const recordings::Recording& recording, PredictionModel* model) {
  const sim::Plant& plant = model->file.plant;
  if (recording.prescribed == plant.prescribed()) return Status::Ok();
  std::vector<std::string> prescribed, passive = plant.options().passive;
  for (const int j : recording.prescribed) prescribed.push_back(recording.joints[static_cast<size_t>(j)]);
  std::erase_if(passive, [&](const std::string& joint) {
    return std::count(prescribed.begin(), prescribed.end(), joint) > 0;
  });
  RG_ASSIGN_OR_RETURN(model->file.plant, plant.WithRoles(prescribed, passive));
  return Status::Ok();
}

Status CheckRuns(const std::string& path, const sim::ModelFile& model) {
  const std::vector<std::string> joints = sysid::JointsThatDoNotRun(model.plant, model.values);
  if (joints.empty()) return Status::Ok();
  return InvalidError(
      path + ": joint '" + joints[0] +
      "' moves a link without inertia about its axis, and the inertia of its drive's rotor is "
      "not known: `realitygrad sysid SET --out DIR` finds it, DIR/model.json can be predicted "
      "with");
}

// What was measured, and what a model says, are not written over.
Status CheckOut(const PredictArguments& arguments) {
  std::error_code ignored;
  for (const std::string* input : {&arguments.recording, &arguments.model}) {
    if (std::filesystem::equivalent(arguments.out, *input, ignored))
      return InvalidError("--out " + arguments.out + ": is what is read, it would be lost: choose another");
  }
  return Status::Ok();
}

Status Predict(Context& context, const PredictArguments& arguments) {
  if (!(arguments.window_s > 0)) return InvalidError("--window must be positive (s)");
  RG_RETURN_IF_ERROR(CheckOut(arguments));
  RG_ASSIGN_OR_RETURN(const recordings::ReadOptions read, arguments.read.Options());
  RG_ASSIGN_OR_RETURN(PredictionModel model, LoadModel(arguments.model));
  recordings::CsvOptions csv = recordings::CsvOptionsFor(model.file.plant.model(), read);
  TakeManifestBeside(arguments.recording, &model, &csv);
  csv.prescribed = model.prescribed;
  RG_ASSIGN_OR_RETURN(recordings::Recording recording, recordings::LoadCsv(arguments.recording, csv));
  for (const std::string& note : recording.notes)
    PrintNote("realitygrad: " + arguments.recording + ": " + note);
  RG_RETURN_IF_ERROR(TakeRoles(recording, &model));
  RG_RETURN_IF_ERROR(CheckRuns(arguments.model, model.file));
  if (model.drive && *model.drive == recordings::EffortKind::kMeasured && recording.has_effort_measured()) {
    recording.drive = recordings::EffortKind::kMeasured;
  }
  sysid::PredictionOptions options;
  options.window_s = arguments.window_s;
  options.effort_excludes_gravity = model.effort_excludes_gravity;
  options.held_before = model.file.held_before;
  if (arguments.measured_restart) options.restart = sysid::RestartState::kMeasured;
  const sysid::Prediction prediction =
      sysid::PredictRecording(model.file.plant, model.file.values, recording, options);
  RG_RETURN_IF_ERROR(WriteFileAtomically(arguments.out, sysid::FormatPredictionCsv(prediction, recording)));
  const sysid::PredictionError error = sysid::ErrorOf(prediction, recording);
  if (!recording.prescribed.empty()) PrintNote("realitygrad: " + MoveAsMeasured(recording));
  for (const std::string& failure : prediction.failures) PrintNote("realitygrad: " + failure);
  if (context.json()) {
    std::vector<double> joints(error.joint_rms.data(), error.joint_rms.data() + error.joint_rms.size());
    PrintJson("realitygrad.prediction/1", {{"out", arguments.out},
                                           {"window_s", arguments.window_s},
                                           {"rms", error.rms},
                                           {"median_window_rms", error.median_window},
                                           {"joint_rms", joints},
                                           {"windows", error.windows.size()},
                                           {"failed_windows", prediction.failures.size()}});
  } else if (!context.quiet()) {
    const std::string text = Printf("%zu windows of %.3g s: RMS %.4g, median window %.4g (rad or m)",
                                    error.windows.size(), arguments.window_s, error.rms, error.median_window);
    Print(text);
  }
  return Status::Ok();
}

}  // namespace

void AddModelCommands(CLI::App& app, Context& context) {
  auto sysid_arguments = std::make_shared<SysidArguments>();
  CLI::App* sysid_command =
      app.add_subcommand("sysid", "Identify a robot from a recording set, judged on held-out recordings");
  auto& o = sysid_arguments->options;
  sysid_arguments->set.AddTo(sysid_command);
  sysid_command->add_option("--out", sysid_arguments->out,
                            "Folder for model.json, sysid.json and report.html");
  sysid_command->add_option("--model", sysid_arguments->model,
                            "model.json to start from, of a diagnosis for example; default: the set's URDF");
  sysid_command->add_option("--window", o.window_s, "Length of the judged predictions [s]")
      ->capture_default_str();
  sysid_command
      ->add_option("--parametrisation,--parametrization", sysid_arguments->parametrisation,
                   "Of a link's ten inertial parameters: log-cholesky (only bodies that can exist) or raw")
      ->check(CLI::IsMember({"log-cholesky", "raw"}))
      ->capture_default_str();
  sysid_command->add_option("--fit-window", o.fit_window_s, "Length of the fitted windows [s]")
      ->capture_default_str();
  sysid_command
      ->add_option("--fit-windows", o.fit_windows, "Fit only so many windows, see --window-choice; 0: all")
      ->check(CLI::Range(0, 100000))
      ->capture_default_str();
  sysid_command
      ->add_option("--window-choice", sysid_arguments->window_choice,
                   "With --fit-windows: the ones that tell most by the model (information), random, or first")
      ->check(CLI::IsMember({"information", "random", "first"}))
      ->capture_default_str();
  sysid_command->add_option("--seed", o.window_seed, "Of --window-choice random")->capture_default_str();
  sysid_command->add_option("--step", o.step_s, "Of the simulator [s]")->capture_default_str();
  sysid_command->add_option("--threads", o.threads, "0: all cores")->check(CLI::Range(0, 1024))->capture_default_str();
  sysid_command->add_flag(
      "--trust-effort", sysid_arguments->trust_effort,
      "Go on where the sign or the unit of an effort looks wrong, or gravity is not in it");
  sysid_command->add_flag_callback(
      "--no-friction", [&o] { o.fit_joints = false; }, "Inertial parameters only");
  sysid_command->add_flag_callback(
      "--no-inertial", [&o] { o.fit_inertial = false; }, "Joint friction and rotor inertia only");
  sysid_command->callback([&context, sysid_arguments] {
    // Both were checked against their names when they were read.
    sysid_arguments->options.consistent_inertias =
        *sysid::ParseParametrisation(sysid_arguments->parametrisation);
    sysid_arguments->options.window_choice = *sysid::ParseWindowChoice(sysid_arguments->window_choice);
    context.Failed(Sysid(context, *sysid_arguments));
  });

  auto predict_arguments = std::make_shared<PredictArguments>();
  CLI::App* predict =
      app.add_subcommand("predict", "Predict a recording in windows restarted from what was measured");
  predict->add_option("--model", predict_arguments->model, "model.json, a recording set's folder, or a URDF")
      ->required();
  predict->add_option("--recording", predict_arguments->recording, "CSV")->required();
  predict->add_option("--window", predict_arguments->window_s, "Seconds")->capture_default_str();
  predict->add_option("--out", predict_arguments->out, "CSV of predictions")->required();
  predict_arguments->read.AddTo(predict);
  predict->add_flag("--measured-restart", predict_arguments->measured_restart,
                    "Restart from the measured row itself, not from a filtered state");
  predict->callback([&context, predict_arguments] { context.Failed(Predict(context, *predict_arguments)); });
}

}  // namespace rg::cli
