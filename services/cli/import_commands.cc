// `import` and `export`: recording sets from and to the files that other programs have.
#include <CLI/CLI.hpp>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>

#include "common/base/file.h"
#include "common/base/printf.h"
#include "services/cli/commands.h"
#include "services/cli/context.h"
#include "services/cli/progress_display.h"
#include "services/importing/exact_set.h"
#include "services/importing/import.h"
#include "services/importing/set_bag.h"

namespace rg::cli {
namespace {

namespace fs = std::filesystem;
using importing::ImportedFile;
using importing::ImportReport;
using importing::TakenColumn;
using nlohmann::json;

class ImportProgress {
 public:
  explicit ImportProgress(const Context& context) : display_(context.quiet()) {}
  ProgressFn Fn() {
    return [this](const ProgressUpdate& update) { display_.Show(update); };
  }
  void Finish() { display_.Finish(); }

 private:
  ProgressDisplay display_;
};

// ---- import ----

struct ImportArguments {
  importing::ImportOptions options;
};

json TakenJson(const TakenColumn& c) {
  return {{"topic", c.topic}, {"field", c.field},     {"column", c.column},  {"unit", c.unit},
          {"clock", c.clock}, {"rate_hz", c.rate_hz}, {"samples", c.samples}};
}

json ReportJson(const ImportReport& report) {
  json files = json::array(), not_taken = json::array();
  for (const ImportedFile& file : report.files) {
    json taken = json::array();
    for (const TakenColumn& column : file.taken) taken.push_back(TakenJson(column));
    files.push_back({{"path", file.path},
                     {"recording", file.recording},
                     {"split", file.holdout ? "holdout" : "fit"},
                     {"rows", file.rows},
                     {"duration_s", file.duration_s},
                     {"start_ns", file.start_ns},
                     {"time_base", file.base},
                     {"taken", taken}});
  }
  for (const auto& left : report.not_taken)
    not_taken.push_back({{"topic", left.topic}, {"type", left.type}, {"why", left.why}});
  return {{"set", report.out},
          {"files", files},
          {"not_taken", not_taken},
          {"guessed", report.guessed},
          {"reasons", report.reasons},
          {"notes", report.notes},
          {"map", report.map_json.empty() ? json() : json::parse(report.map_json)}};
}

void PrintTaken(const ImportReport& report) {
  TextTable table({"TOPIC", "FIELD", "COLUMN", "UNIT", "CLOCK", ">HZ", ">SAMPLES"});
  const auto dash = [](const std::string& text) { return text.empty() ? std::string("–") : text; };
  for (const TakenColumn& c : report.files.front().taken) {
    table.AddRow({dash(c.topic), c.field, c.column, dash(c.unit), dash(c.clock), Printf("%.1f", c.rate_hz),
                  std::to_string(c.samples)});
  }
  if (table.empty()) return;  // a bag that an export wrote: all of it
  Print(table.ToString());
}

void PrintFiles(const ImportReport& report) {
  TextTable table({"FILE", "RECORDING", ">ROWS", ">SECONDS", "SPLIT", "TIME BASE"});
  for (const ImportedFile& file : report.files) {
    table.AddRow({file.path, file.recording, std::to_string(file.rows), Printf("%.2f", file.duration_s),
                  file.holdout ? "holdout" : "fit", file.base.empty() ? "as exported" : file.base});
  }
  Print(table.ToString());
}

void PrintNotTaken(const ImportReport& report) {
  if (report.not_taken.empty()) return;
  TextTable table({"NOT TAKEN", "TYPE", "WHAT"});
  for (const auto& left : report.not_taken) table.AddRow({left.topic, left.type, left.why});
  Print(table.ToString());
}

void PrintReport(const Context& context, const ImportReport& report) {
  if (context.json()) return PrintJson("realitygrad.import/1", ReportJson(report));
  if (context.quiet()) return Print(report.out);
  PrintTaken(report);
  PrintNotTaken(report);
  PrintFiles(report);
  for (const std::string& reason : report.reasons) Print("guessed: " + reason);
  for (const std::string& note : report.notes) Print("note: " + note);
  Print("next: realitygrad diagnose " + ShellWord(report.out) + " --out " +
        ShellWord(report.out + "_diagnosed"));
}

Status PrintGuess(Context& context, const ImportArguments& arguments) {
  ImportProgress progress(context);
  RG_ASSIGN_OR_RETURN(const importing::GuessReport guess, importing::Guess(arguments.options, progress.Fn()));
  progress.Finish();
  const std::string& out = arguments.options.out;
  if (!out.empty()) RG_RETURN_IF_ERROR(WriteFileAtomically(out, guess.map_json));
  if (context.json()) {
    PrintJson(
        "realitygrad.import_guess/1",
        {{"map", json::parse(guess.map_json)}, {"reasons", guess.reasons}, {"questions", guess.questions}});
    return Status::Ok();
  }
  // The mapping alone, so that it can go to a file.
  if (out.empty()) {
    Print(guess.map_json.substr(0, guess.map_json.size() - 1));
  } else {
    Print(out);
  }
  if (context.quiet()) return Status::Ok();
  for (const std::string& reason : guess.reasons) PrintNote("guessed: " + reason);
  for (const std::string& question : guess.questions) PrintNote("check: " + question);
  const std::string map = out.empty() ? "MAP.json" : out;
  std::string files;
  for (const std::string& file : arguments.options.files) files += ShellWord(file) + " ";
  PrintNote("next: " + std::string(out.empty() ? "put this into MAP.json, look at it; " : "look at it; ") +
            "realitygrad import " + files + "--urdf " + ShellWord(arguments.options.urdf) + " --map " +
            ShellWord(map) + " --out SET");
  return Status::Ok();
}

Status RunImport(Context& context, const ImportArguments& arguments) {
  if (arguments.options.map == "guess") return PrintGuess(context, arguments);
  if (arguments.options.out.empty())
    return context.Usage(InvalidError("--out is missing: the folder of the new set"));
  RG_RETURN_IF_ERROR(CheckWritable(arguments.options.out));
  ImportProgress progress(context);
  RG_ASSIGN_OR_RETURN(const ImportReport report, importing::Import(arguments.options, progress.Fn()));
  progress.Finish();
  PrintReport(context, report);
  return Status::Ok();
}

// ---- export ----

struct SetExportArguments {
  std::string set, format, out;
};

Result<std::vector<std::string>> ExportFiles(const SetExportArguments& arguments,
                                             const importing::ExactSet& exact, const std::string& out,
                                             const ProgressFn& progress) {
  if (arguments.format == "bag")
    return importing::WriteSetBags(out, exact.set, exact.manifest_json, progress);
  RG_RETURN_IF_ERROR(importing::WriteExactSet(out, exact.set, exact.manifest_json));
  std::vector<std::string> paths;
  for (const auto& recording : exact.set.recordings)
    paths.push_back((fs::path(out) / recording.name).string());
  return paths;
}

Status RunExport(Context& context, const SetExportArguments& arguments) {
  if (arguments.format != "csv" && arguments.format != "bag")
    return context.Usage(InvalidError("--format: '" + arguments.format + "', must be csv or bag"));
  std::string set = arguments.set;
  while (set.size() > 1 && set.back() == '/') set.pop_back();
  const std::string out = arguments.out.empty() ? set + "_" + arguments.format : arguments.out;
  std::error_code error;
  if (fs::exists(out, error) && !(fs::is_directory(out, error) && fs::is_empty(out, error)))
    return AlreadyExistsError(out + ": is there already, and not empty: choose another with --out");
  RG_ASSIGN_OR_RETURN(const importing::ExactSet exact, importing::LoadExactSet(set));
  RG_RETURN_IF_ERROR(CheckWritable(out));
  ImportProgress progress(context);
  RG_ASSIGN_OR_RETURN(const std::vector<std::string> paths,
                      ExportFiles(arguments, exact, out, progress.Fn()));
  progress.Finish();
  if (context.json()) {
    PrintJson("realitygrad.set_export/1",
              {{"out", out}, {"export_format", arguments.format}, {"files", paths}, {"notes", exact.notes}});
    return Status::Ok();
  }
  for (const std::string& path : paths) Print(path);
  if (context.quiet()) return Status::Ok();
  for (const std::string& note : exact.notes) PrintNote("note: " + note);
  if (arguments.format == "bag")
    PrintNote("next: realitygrad import " + ShellWord(out) +
              "/*.bag --out SET   (reads them back, value by value)");
  return Status::Ok();
}

}  // namespace

void AddImportCommands(CLI::App& app, Context& context) {
  auto import_arguments = std::make_shared<ImportArguments>();
  CLI::App* import = app.add_subcommand(
      "import", "Make a recording set from ROS bags, MCAP files or CSV files, one recording each");
  auto& o = import_arguments->options;
  import->add_option("FILE", o.files, ".bag, .mcap, .db3, a ROS 2 bag's folder, or .csv")->required();
  import->add_option("--out", o.out, "Folder of the new set; with --map guess, a file for the mapping");
  import->add_option("--urdf", o.urdf, "The robot's URDF; bags that `export` wrote bring their own");
  import->add_option("--map", o.map,
                     "Mapping of topics and fields to columns (JSON), or `guess` to see what would be taken; "
                     "default: the guess, refused where it is ambiguous");
  import->callback([&context, import_arguments] { context.Failed(RunImport(context, *import_arguments));
});

auto export_arguments = std::make_shared<SetExportArguments>();
CLI::App* exporting =
    app.add_subcommand("export", "Write a recording set as plain CSV files or as ROS 1 bags");
exporting->add_option("SET", export_arguments->set, "Folder of a recording set")->required();
exporting->add_option("--format", export_arguments->format, "csv or bag")->required();
exporting->add_option("--out", export_arguments->out, "Folder; default: SET_csv or SET_bag");
exporting->callback([&context, export_arguments] { context.Failed(RunExport(context, *export_arguments)); });
}  // namespace rg::cli

}  // namespace rg::cli
