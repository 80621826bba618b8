// `check`: what a recording set holds, in seconds and without any search.
#include <CLI/CLI.hpp>
#include <cmath>
#include <memory>
#include <nlohmann/json.hpp>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/model/robot_model.h"
#include "common/recordings/recording_set.h"
#include "services/cli/commands.h"
#include "services/cli/context.h"
#include "services/cli/set_arguments.h"
#include "services/diagnosis/data/words.h"
#include "services/diagnosis/reporting/set_check.h"
#include "services/report/check_page.h"
#include "services/sysid/sysid_on_set.h"

namespace rg::cli {
namespace {

using diagnosis::FileFigures;
using diagnosis::JointFigures;
using diagnosis::Listed;
using diagnosis::Number;
using diagnosis::SetCheck;

struct CheckArguments {
  SetArguments set;
  std::string html;
};

std::string OrDash(double x) { return std::isfinite(x) ? Number(x) : "–"; }

std::string Limits(const model::Joint& joint) {
  return std::isfinite(joint.lower) || std::isfinite(joint.upper)
             ? OrDash(joint.lower) + " to " + OrDash(joint.upper)
             : "–";
}

std::string RobotLine(const recordings::RecordingSet& set, const sim::Plant& plant) {
  std::string text = plant.model().name() + " (" + set.urdf_path + "), gravity " + Number(set.gravity.x()) +
                     " " + Number(set.gravity.y()) + " " + Number(set.gravity.z()) + " m/s²";
  std::vector<std::string> locked;
  for (const auto& [joint, q] : diagnosis::LockedJoints(set)) locked.push_back(joint + " at " + Number(q));
  return locked.empty() ? text : text + "; locked: " + Listed(locked);
}

std::string RecordingsTable(const SetCheck& check) {
  TextTable table({"RECORDING", "SPLIT", ">SECONDS", ">ROWS", ">HZ", ">GAPS", ">MISSING", "COLUMNS"});
  for (const FileFigures& f : check.survey.files) {
    std::string columns;
    for (const std::string& kind : f.columns) columns += (columns.empty() ? "" : ", ") + kind;
    table.AddRow({f.name, f.split == recordings::Split::kFit ? "fit" : "holdout", Number(f.duration),
                  std::to_string(f.rows), Number(1 / f.period), std::to_string(f.gaps.size()),
                  Number(f.missing), columns});
  }
  return table.ToString();
}

std::string JointsTable(const sim::Plant& plant, const SetCheck& check) {
  TextTable table({"JOINT", "MOVED", ">FROM", ">TO", "LIMITS", ">SPEED", ">LIMIT", ">EFFORT RMS", ">PEAK",
                   ">LIMIT", ">NOISE", ">STEP"});
  for (int j = 0; j < check.survey.n; ++j) {
    const model::Joint& joint = plant.model().joint(j);
    const JointFigures& f = check.survey.joints[static_cast<size_t>(j)];
    table.AddRow({joint.name, f.moved ? "yes" : "no", Number(f.low), Number(f.high), Limits(joint),
                  Number(f.peak_speed), OrDash(joint.velocity), Number(f.effort_rms), Number(f.peak_effort),
                  OrDash(joint.effort), Number(check.survey.estimated.position_stddev[j]),
                  Number(check.survey.estimated.position_resolution[j])});
  }
  return table.ToString();
}

std::string EffectsTable(const std::vector<diagnosis::EffectShows>& effects, int joints) {
  TextTable table({"EFFECT", "COULD SHOW ON", "WITHIN", "NOT ON"});
  for (const diagnosis::EffectShows& e : effects) table.AddRow(diagnosis::InWords(e, joints));
  return table.ToString();
}

Status Check(Context& context, const CheckArguments& arguments) {
  const double start = RealClock().SteadySeconds();
  RG_ASSIGN_OR_RETURN(const recordings::RecordingSet set, arguments.set.Load());
  RG_ASSIGN_OR_RETURN(const sim::Plant plant, sysid::NominalPlant(set));
  RG_ASSIGN_OR_RETURN(const SetCheck check, diagnosis::CheckSet(set, plant, false));
  const std::vector<diagnosis::EffectShows> effects = diagnosis::WhatShows(check.survey, plant);
  if (!arguments.html.empty())
    RG_RETURN_IF_ERROR(WriteFileAtomically(arguments.html, report::CheckPage(set, plant, check, effects)));
  if (context.json()) {
    nlohmann::json json = diagnosis::CheckJson(set, plant, check, effects);
    json["elapsed_s"] = RealClock().SteadySeconds() - start;
    PrintJson("realitygrad.check/1", std::move(json));
    return check.refusal;
  }
  if (!context.quiet())
    Print(RobotLine(set, plant) + "\n\n" + RecordingsTable(check) + "\n" + JointsTable(plant, check) + "\n" +
          EffectsTable(effects, check.survey.n));
  for (const std::string& warning : check.warnings) Print("note: " + warning);
  return check.refusal;
}

}  // namespace

void AddCheckCommand(CLI::App& app, Context& context) {
  auto arguments = std::make_shared<CheckArguments>();
  CLI::App* command = app.add_subcommand(
      "check", "Say what a recording set holds, what it could show, and what is odd, without any search");
  arguments->set.AddTo(command);
  command->add_option("--html", arguments->html, "File for a page with everything that was measured");
  command->callback([&context, arguments] { context.Failed(Check(context, *arguments)); });
}

}  // namespace rg::cli
