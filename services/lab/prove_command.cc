// `prove`: the blind examination of the diagnosis, on sets that an engine of its own makes.

#include <CLI/CLI.hpp>
#include <algorithm>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <thread>

#include "common/base/file.h"
#include "common/base/hash.h"
#include "common/base/rng.h"
#include "services/cli/child_processes.h"
#include "services/cli/context.h"
#include "services/cli/interrupt.h"
#include "services/cli/progress_display.h"
#include "services/cli/proof_generator.h"
#include "services/cli/robot_profile.h"
#include "services/lab/lab_commands.h"
#include "services/lab/process_pool.h"
#include "services/lab/proof_runs.h"
#include "services/lab/prove_battery.h"
#include "services/proof/battery.h"
#include "services/proof/concealed.h"
#include "services/proof/examination.h"
#include "services/proof/proof_text.h"

namespace rg::lab {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

// Controls, effects outside the catalogue, ordinary robots and controls that declare what these have are
// numbered from here, so that each count may grow.
constexpr int kFirstControl = 500, kFirstOutside = 800, kFirstOrdinary = 1000, kFirstDeclared = 1500,
              kLast = 2000;
constexpr int kCasesPerMaker = 4;
constexpr int kNoExit = 126;  // and above: a program that was not started or was killed

const std::vector<std::string> kRobots = {"mico2", "arm7", "arm4", "scara", "arm2", "pendulum", "slide"};

const std::vector<std::string> kDrawable = {"mico2", "arm7", "arm6",     "arm4",
                                            "scara", "arm2", "pendulum", "slide"};

struct ProveArguments {
  std::string out = "proof", markdown;
  std::vector<std::string> sets, compare, reliability;
  std::string svg;
  std::vector<std::string> robots = kRobots;
  uint64_t seed = 1;
  int cases = 100, controls = 60, outside = 20, ordinary = 100, declared = 60, jobs = 0, limit_s = 0;
  double weak = 0.15, pairs = 0.2, wrong_parameters = 0.2, tuned = 0.15;
  bool quick = false, make_only = false, mark_only = false;

  std::string Sets() const { return out + "/sets"; }
  std::string Labels() const { return out + "/sealed"; }
  std::string Answers() const { return out + "/answers"; }
  std::string Command() const {
    std::string text = "realitygrad prove --seed " + std::to_string(seed) + " --cases " +
                       std::to_string(cases) + " --controls " + std::to_string(controls) + " --outside " +
                       std::to_string(outside) + " --ordinary " + std::to_string(ordinary) + " --declared " +
                       std::to_string(declared);
    std::string names;
    for (const std::string& robot : robots) names += (names.empty() ? "" : ",") + robot;
    return robots == kRobots ? text : text + " --robots " + names;
  }
};

class Examiner {
 public:
  Examiner(const cli::Context& context, const ProveArguments& arguments, std::string robots_folder)
      : a_(arguments), robots_folder_(std::move(robots_folder)), quiet_(context.quiet()), display_(quiet_) {}

  Result<proof::ProofRecord> Run() {
    std::error_code error;
    for (const std::string& folder : {a_.Sets(), a_.Labels(), a_.Answers(), a_.out + "/logs"}) {
      fs::create_directories(folder, error);
      if (error) return InvalidError(folder + ": cannot create: " + error.message());
    }
    RG_RETURN_IF_ERROR(MakeSets());
    proof::ProofRecord record;
    record.command = a_.Command();
    RG_ASSIGN_OR_RETURN(record.seal, Seal());
    if (!quiet_)
      cli::PrintNote("sealed: SHA-256 of " + std::to_string(names_.size()) + " labels " + record.seal);
    if (a_.make_only) return record;
    RG_RETURN_IF_ERROR(DiagnoseAll());
    RG_ASSIGN_OR_RETURN(const std::string opened, Seal());
    if (opened != record.seal) return DataLossError(a_.Labels() + ": labels changed during the examination");
    RG_RETURN_IF_ERROR(MarkAll(&record));
    return record;
  }

 private:
  // `pool` empty: any effect, with the shares that were asked for.
  std::vector<std::string> Plain(const std::vector<std::string>& pool) const {
    std::vector<std::string> flags;
    const auto with = [&](const char* flag, double value) {
      flags.insert(flags.end(), {flag, std::to_string(value)});
    };
    with("--controls", 0);
    with("--weak", pool.empty() ? a_.weak : 0);
    with("--pairs", pool.empty() ? a_.pairs : 0);
    with("--wrong-parameters", pool.empty() ? a_.wrong_parameters : 0);
    with("--tuned", pool.empty() ? a_.tuned : 0);
    for (const std::string& effect : pool) flags.insert(flags.end(), {"--effect", effect});
    for (const std::string& robot : a_.robots) flags.insert(flags.end(), {"--robot", robot});
    return flags;
  }

  // Of the generator's own mixture of robots, if none were asked for.
  std::vector<std::string> OfOrdinary(const std::string& kind) const {
    std::vector<std::string> flags = {kind};
    if (a_.robots == kRobots) return flags;
    for (const std::string& robot : a_.robots) flags.insert(flags.end(), {"--robot", robot});
    return flags;
  }

  // One process of the generator per few cases: a case depends on seed and number alone. Runs that were
  // interrupted go on where they were.
  Status MakeSets() {
    const std::string maker = cli::SiblingProgram(cli::kProofGenerator);
    std::vector<PooledProcess> makers;
    // `own`: flags of this kind of cases, beside where they go and which they are.
    const auto add = [&](int first, int count, const std::vector<std::string>& own) {
      for (int i = first; i < first + count; i += kCasesPerMaker) {
        const int n = std::min(kCasesPerMaker, first + count - i);
        const std::string done = a_.out + "/logs/made-" + std::to_string(i) + "-" + std::to_string(n);
        if (fs::exists(done)) continue;
        std::vector<std::string> command({maker, "--sets", a_.Sets(), "--labels", a_.Labels(), "--robots",
                                          robots_folder_, "--seed", std::to_string(a_.seed), "--first",
                                          std::to_string(i), "--count", std::to_string(n)});
        command.insert(command.end(), own.begin(), own.end());
        makers.push_back({command, a_.out + "/logs/make-" + std::to_string(i) + ".log"});
        marks_.push_back(done);
      }
    };
    add(0, a_.cases, Plain({}));
    add(kFirstControl, a_.controls, Plain({"none", "parameters_only"}));
    add(kFirstOutside, a_.outside, Plain({"unknown_field"}));
    add(kFirstOrdinary, a_.ordinary, OfOrdinary("--ordinary"));
    add(kFirstDeclared, a_.declared, OfOrdinary("--declared"));
    size_t made = 0;
    RG_RETURN_IF_ERROR(RunPool(
        makers, a_.jobs,
        [&](size_t i, const PooledEnd& end) {
          // A case whose true robot cannot be simulated is dropped by the generator and said in its log.
          if (end.code < kNoExit) (void)WriteFileAtomically(marks_[i], "");
          display_.Show({"making sets", static_cast<double>(++made), static_cast<double>(makers.size()), ""});
        },
        &cli::CancelledByInterrupt()));
    for (const auto& entry : fs::directory_iterator(a_.Labels())) {
      if (fs::exists(entry.path() / "label.json")) names_.push_back(entry.path().filename());
    }
    std::sort(names_.begin(), names_.end());
    return names_.empty() ? InternalError(a_.out + "/logs: no set could be made") : Status::Ok();
  }

  Result<std::string> Seal() const {
    Sha256 hash;
    for (const std::string& name : names_) {
      for (const char* file : {"/label.json", "/oracle.json"}) {
        RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(a_.Labels() + "/" + name + file));
        hash.Update(name + file + "\n");
        hash.Update(text);
      }
    }
    return hash.FinishHex();
  }

  Status DiagnoseAll() {
    std::vector<SetToDiagnose> sets;
    for (const std::string& name : names_) sets.push_back({name, a_.Sets() + "/" + name});
    return DiagnoseSets(sets, {a_.Answers(), a_.out + "/logs", a_.limit_s, a_.jobs}, &display_);
  }

  Status MarkAll(proof::ProofRecord* record) {
    for (size_t i = 0; i < names_.size(); ++i) {
      const std::string answer = a_.Answers() + "/" + names_[i], label = a_.Labels() + "/" + names_[i];
      RG_ASSIGN_OR_RETURN(const proof::Concealed concealed,
                          proof::PredictConcealed(label, a_.Sets() + "/" + names_[i], answer + "/model.json",
                                                  Rng(a_.seed).Split(i)));
      RG_ASSIGN_OR_RETURN(proof::CaseMarks marks,
                          proof::MarkAnswer({names_[i], a_.Sets() + "/" + names_[i], label + "/label.json"},
                                            answer, concealed.marks));
      marks.plot = concealed.plot;
      if (!marks.diagnosed) {
        if (marks.reason.empty())
          marks.reason = concealed.refused.empty() ? cli::LastLine(a_.out + "/logs/" + names_[i] + ".log")
                                                   : concealed.refused;
        if (!quiet_) cli::PrintNote(names_[i] + ": no diagnosis: " + marks.reason);
      }
      record->cases.push_back(std::move(marks));
      display_.Show({"marking", static_cast<double>(i + 1), static_cast<double>(names_.size()), names_[i]});
    }
    display_.Finish();
    return Status::Ok();
  }

  const ProveArguments& a_;
  std::string robots_folder_;
  bool quiet_;
  cli::ProgressDisplay display_;
  std::vector<std::string> names_, marks_;
};

Status Examine(cli::Context& context, ProveArguments& arguments) {
  if (arguments.quick) {
    arguments.cases = 3, arguments.controls = 2, arguments.outside = 1;
    arguments.ordinary = arguments.declared = 1;
    arguments.robots = {"pendulum"};
  }
  if (const std::string maker = cli::SiblingProgram(cli::kProofGenerator); !fs::exists(maker))
    return FailedPreconditionError(
        maker + " is not there: it needs DART. This makes it: " + cli::HowToGetProofGenerator());
  RG_ASSIGN_OR_RETURN(const cli::Settings settings, context.Resolve());
  Examiner examiner(context, arguments, cli::RobotsFolder(settings));
  RG_ASSIGN_OR_RETURN(const proof::ProofRecord record, examiner.Run());
  if (arguments.make_only) {
    const json made = {{"command", record.command},
                       {"seal", record.seal},
                       {"sets", arguments.Sets()},
                       {"labels", arguments.Labels()}};
    if (context.json()) {
      cli::PrintJson("realitygrad.proof_sets/1", made);
    } else {
      cli::Print("sets: " + arguments.Sets() + "\nlabels: " + arguments.Labels());
    }
    return Status::Ok();
  }
  const std::string markdown = proof::Markdown(record), page = arguments.out + "/proof.html";
  json all = {{"command", record.command}, {"seal", record.seal}, {"cases", json::array()}};
  for (const proof::CaseMarks& c : record.cases) all["cases"].push_back(proof::ToJson(c));
  all["summary"] = proof::ToJson(proof::Summarise(record.cases));
  all["effects"] = proof::PerEffect(record.cases);
  RG_RETURN_IF_ERROR(WriteFileAtomically(page, proof::ProofPage(record)));
  RG_RETURN_IF_ERROR(WriteFileAtomically(arguments.out + "/proof.json", all.dump(1)));
  if (!arguments.markdown.empty()) RG_RETURN_IF_ERROR(WriteFileAtomically(arguments.markdown, markdown));
  if (context.json()) {
    cli::PrintJson("realitygrad.proof/1", all);
  } else {
    cli::Print(context.quiet() ? page : markdown);
    if (!context.quiet()) cli::Print("page: " + page);
  }
  return Status::Ok();
}

Status Prove(cli::Context& context, ProveArguments& arguments) {
  if (arguments.jobs <= 0)
    arguments.jobs = std::max(1, static_cast<int>(std::thread::hardware_concurrency()));
  const BatteryArguments battery = {arguments.sets, arguments.compare,  arguments.reliability,
                                    arguments.svg,  arguments.out,      arguments.limit_s,
                                    arguments.jobs, arguments.mark_only};
  if (!battery.compare.empty()) return CompareAnswers(context, battery);
  if (!battery.reliability.empty()) return TellReliability(context, battery);
  if (!battery.sets.empty()) return RunBattery(context, battery);
  return Examine(context, arguments);
}

}  // namespace

void AddProveCommand(CLI::App& app, cli::Context& context) {
  auto arguments = std::make_shared<ProveArguments>();
  CLI::App* command = app.add_subcommand(
      "prove",
      "Examine the diagnosis blind: concealed physics by another engine, sealed labels, every miss told");
  command->add_option("--out", arguments->out, "Folder; a run that was interrupted goes on in it")
      ->capture_default_str();
  command->add_option("--seed", arguments->seed, "Of the whole examination")->capture_default_str();
  command->add_option("--cases", arguments->cases, "Sets with something concealed")
      ->capture_default_str()
      ->check(CLI::Range(0, kFirstControl));
  command
      ->add_option("--controls", arguments->controls, "Sets with nothing concealed, or wrong parameters only")
      ->capture_default_str()
      ->check(CLI::Range(0, kFirstOutside - kFirstControl));
  command->add_option("--outside", arguments->outside, "Further sets whose force is outside the catalogue")
      ->capture_default_str()
      ->check(CLI::Range(0, kFirstOrdinary - kFirstOutside));
  command
      ->add_option("--ordinary", arguments->ordinary,
                   "Ordinary robots: friction, damping and rotors on every joint, mostly one thing more")
      ->capture_default_str()
      ->check(CLI::Range(0, kFirstDeclared - kFirstOrdinary));
  command
      ->add_option("--declared", arguments->declared,
                   "Controls: ordinary robots whose set declares all of it")
      ->capture_default_str()
      ->check(CLI::Range(0, kLast - kFirstDeclared));
  command->add_option("--robots", arguments->robots, "To draw from")
      ->delimiter(',')
      ->capture_default_str()
      ->check(CLI::IsMember(kDrawable));
  command->add_option("--jobs", arguments->jobs, "Sets at a time, one thread each; default: one per core");
  command->add_option("--weak", arguments->weak, "Share of weak effects")->check(CLI::Range(0.0, 1.0));
  command->add_option("--pairs", arguments->pairs, "Share of pairs")->check(CLI::Range(0.0, 1.0));
  command->add_option("--wrong-parameters", arguments->wrong_parameters, "Share whose URDF is off as well")
      ->check(CLI::Range(0.0, 1.0));
  command->add_option("--tuned", arguments->tuned, "Share whose URDF was tuned and hides part of the effect")
      ->check(CLI::Range(0.0, 1.0));
  command
      ->add_option("--limit", arguments->limit_s,
                   "Most CPU time for each set [s]; one without an answer by then is a miss. 0: none")
      ->capture_default_str()
      ->check(CLI::Range(0, 1000000));
  command->add_option("--markdown", arguments->markdown, "Also write the tables to this file");
  command->add_flag("--quick", arguments->quick, "Eight sets of a pendulum");
  command->add_flag("--make-only", arguments->make_only,
                    "Write sets and labels, and diagnose nothing; the same command without it goes on");
  CLI::Option* sets =
      command
          ->add_option(
              "--sets", arguments->sets,
              "No examination: diagnose and mark these labelled sets (folders of them, or of sets/), "
              "answers in --out")
          ->type_name("DIR");
  command->add_flag("--mark-only", arguments->mark_only, "Mark the answers that are there, diagnose nothing")
      ->needs(sets);
  CLI::Option* compare = command
                             ->add_option("--compare", arguments->compare,
                                          "No examination: two answers folders, of two builds, set by set")
                             ->type_name("BEFORE AFTER")
                             ->expected(2);
  CLI::Option* reliability =
      command
          ->add_option(
              "--reliability", arguments->reliability,
              "No examination: answers folders, confidences said against what held, ordinary robots half")
          ->type_name("ANSWERS")
          ->excludes(sets)
          ->excludes(compare);
  command->add_option("--svg", arguments->svg, "Also write the reliability diagram to this file")
      ->needs(reliability);
  for (const char* of_examination :
       {"--seed", "--cases", "--controls", "--outside", "--ordinary", "--declared", "--robots", "--weak",
        "--pairs", "--wrong-parameters", "--tuned", "--markdown", "--quick", "--make-only"}) {
    sets->excludes(of_examination);
    compare->excludes(of_examination);
    reliability->excludes(of_examination);
  }
  command->callback([&context, arguments] { context.Failed(Prove(context, *arguments)); });
}

}  // namespace rg::lab
