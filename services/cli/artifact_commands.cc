#include <CLI/CLI.hpp>
#include <nlohmann/json.hpp>

#include "common/base/clock.h"
#include "coordinator/client/client.h"
#include "services/cli/commands.h"
#include "services/cli/context.h"
#include "services/cli/job_view.h"

namespace rg::cli {
namespace {

namespace pb = ::realitygrad::v1;
using nlohmann::json;

std::string Bytes(uint64_t n) {
  char text[32];
  const char* units[] = {"B", "KiB", "MiB", "GiB"};
  int unit = 0;
  double size = static_cast<double>(n);
  while (size >= 1024 && unit < 3) size /= 1024, ++unit;
  std::snprintf(text, sizeof text, unit == 0 ? "%.0f %s" : "%.1f %s", size, units[unit]);
  return text;
}

struct ArtifactArguments {
  std::string hash, kind, out;
  int64_t job = 0;
  uint32_t limit = 0;
  bool descendants = false, yes = false, dry_run = false;
  double older_than_days = 30, forget_days = 0;
  std::string owner = "user";
};

template <class Body>
void WithClient(Context& context, const Body& body) {
  auto client = context.Connect();
  if (context.Failed(client.status())) return;
  context.Failed(body(**client));
}

Status List(Context& context, const ArtifactArguments& arguments, coordinator::Client& client) {
  RG_ASSIGN_OR_RETURN(const auto artifacts,
                      client.ListArtifacts(arguments.kind, arguments.job, arguments.limit));
  if (context.json()) {
    json list = json::array();
    for (const auto& a : artifacts) list.push_back(coordinator::ArtifactJson(a));
    PrintJson("realitygrad.artifacts/1", {{"artifacts", list}});
    return Status::Ok();
  }
  TextTable table({"SHA256", "KIND", ">SIZE", "CREATED", "JOB", "TASK"});
  for (const auto& a : artifacts) {
    if (context.quiet()) Print(a.sha256());
    table.AddRow({a.sha256().substr(0, 12), a.kind(), Bytes(a.size_bytes()), TimeText(a.created_ns()),
                  a.job_id(), a.task_id()});
  }
  if (!context.quiet()) Print(table.ToString());
  return Status::Ok();
}

Status Show(Context& context, const ArtifactArguments& arguments, coordinator::Client& client) {
  RG_ASSIGN_OR_RETURN(const auto info, client.ShowArtifact(arguments.hash));
  if (context.json()) {
    PrintJson("realitygrad.artifact/1", coordinator::ArtifactJson(info));
  } else {
    Print(coordinator::ArtifactJson(info).dump(2));
  }
  return Status::Ok();
}

Status Get(Context& context, const ArtifactArguments& arguments, coordinator::Client& client) {
  RG_ASSIGN_OR_RETURN(const auto info, client.ShowArtifact(arguments.hash));
  if (arguments.out == "-") {
    RG_ASSIGN_OR_RETURN(const std::string bytes, client.GetArtifact(info.sha256()));
    std::fwrite(bytes.data(), 1, bytes.size(), stdout);
    return Status::Ok();
  }
  const std::string path =
      arguments.out.empty() ? info.kind() + "-" + info.sha256().substr(0, 12) : arguments.out;
  RG_ASSIGN_OR_RETURN(const uint64_t size, client.GetArtifactFile(info.sha256(), path));
  if (context.json()) {
    json written = coordinator::ArtifactJson(info);
    written["out"] = path;
    PrintJson("realitygrad.artifact/1", written);
  } else if (!context.quiet())
    PrintNote("wrote " + path + " (" + Bytes(size) + ", " + info.kind() + ")");
  return Status::Ok();
}

Status Lineage(Context& context, const ArtifactArguments& arguments, coordinator::Client& client) {
  RG_ASSIGN_OR_RETURN(const auto info, client.ShowArtifact(arguments.hash));
  RG_ASSIGN_OR_RETURN(const auto lineage,
                      client.Lineage(info.sha256(), !arguments.descendants, arguments.descendants));
  if (context.json()) {
    json nodes = json::array(), edges = json::array();
    for (const auto& node : lineage.nodes()) nodes.push_back(coordinator::ArtifactJson(node));
    for (const auto& edge : lineage.edges())
      edges.push_back({{"parent", edge.parent()}, {"child", edge.child()}});
    PrintJson("realitygrad.lineage/1", {{"nodes", nodes}, {"edges", edges}});
    return Status::Ok();
  }
  std::map<std::string, const pb::ArtifactInfo*> by_hash;
  std::map<std::string, std::vector<std::string>> next;
  for (const auto& node : lineage.nodes()) by_hash[node.sha256()] = &node;
  for (const auto& edge : lineage.edges()) {
    (arguments.descendants ? next[edge.parent()] : next[edge.child()])
        .push_back(arguments.descendants ? edge.child() : edge.parent());
  }
  std::set<std::string> seen;
  const std::function<void(const std::string&, int)> print = [&](const std::string& hash, int depth) {
    const auto* node = by_hash.count(hash) ? by_hash.at(hash) : nullptr;
    const bool again = !seen.insert(hash).second;
    Print(std::string(static_cast<size_t>(2 * depth), ' ') + hash.substr(0, 12) + "  " +
          (node ? node->kind() : "?") + (node && !node->job_id().empty() ? "  job " + node->job_id() : "") +
          (again ? "  (above)" : ""));
    if (again) return;
    for (const std::string& other : next[hash]) print(other, depth + 1);
  };
  print(info.sha256(), 0);
  return Status::Ok();
}

Status Verify(Context& context, const ArtifactArguments& arguments, coordinator::Client& client) {
  std::vector<std::string> hashes;
  if (!arguments.hash.empty()) {
    RG_ASSIGN_OR_RETURN(const auto info, client.ShowArtifact(arguments.hash));
    hashes.push_back(info.sha256());
  }
  RG_ASSIGN_OR_RETURN(const auto report, client.VerifyArtifacts(hashes));
  if (context.json()) {
    json damaged = json::array();
    for (const auto& d : report.damaged())
      damaged.push_back({{"sha256", d.sha256()}, {"kind", d.kind()}, {"what", d.what()}});
    PrintJson("realitygrad.verify/1",
              {{"checked", report.checked()}, {"bytes", report.bytes()}, {"damaged", damaged}});
  } else {
    Print("checked " + std::to_string(report.checked()) + " artefacts, " + Bytes(report.bytes()) + ", " +
          std::to_string(report.damaged_size()) + " damaged");
    for (const auto& d : report.damaged())
      Print("  " + d.sha256().substr(0, 12) + "  " + d.kind() + "  " + d.what());
  }
  return report.damaged_size()
             ? DataLossError(std::to_string(report.damaged_size()) + " artefacts are damaged")
             : Status::Ok();
}

Status Gc(Context& context, const ArtifactArguments& arguments, coordinator::Client& client) {
  const bool dry_run = arguments.dry_run || !arguments.yes;
  RG_ASSIGN_OR_RETURN(const auto report,
                      client.CollectGarbage(static_cast<int64_t>(arguments.older_than_days * 86400e9),
                                            dry_run, static_cast<int64_t>(arguments.forget_days * 86400e9)));
  if (context.json()) {
    json removed = json::array();
    for (const auto& a : report.removed()) removed.push_back(coordinator::ArtifactJson(a));
    PrintJson("realitygrad.gc/1", {{"dry_run", dry_run},
                                   {"bytes", report.bytes()},
                                   {"complete", !report.more()},
                                   {"removed", removed}});
    return Status::Ok();
  }
  if (context.quiet()) {
    for (const auto& a : report.removed()) Print(a.sha256());
    return Status::Ok();
  }
  Print(std::string(dry_run ? "would remove " : "removed ") + std::to_string(report.removed_size()) +
        (report.more() ? " artefacts and more, " : " artefacts, ") + Bytes(report.bytes()) +
        (dry_run ? "; say --yes to do it" : ""));
  return Status::Ok();
}

Status PinOrUnpin(Context& context, const ArtifactArguments& arguments, coordinator::Client& client,
                  bool unpin) {
  RG_ASSIGN_OR_RETURN(const auto info, client.ShowArtifact(arguments.hash));
  RG_RETURN_IF_ERROR(client.Pin(info.sha256(), arguments.owner, unpin));
  RG_ASSIGN_OR_RETURN(const auto now, client.ShowArtifact(info.sha256()));
  if (context.json()) {
    PrintJson("realitygrad.artifact/1", coordinator::ArtifactJson(now));
  } else if (!context.quiet()) {
    PrintNote(now.sha256().substr(0, 12) +
              (unpin ? " is no longer kept for " : " and what it was made from are kept for ") +
              arguments.owner);
  }
  return Status::Ok();
}
Status Pin(Context& context, const ArtifactArguments& arguments, coordinator::Client& client) {
  return PinOrUnpin(context, arguments, client, false);
}
Status Unpin(Context& context, const ArtifactArguments& arguments, coordinator::Client& client) {
  return PinOrUnpin(context, arguments, client, true);
}

}  // namespace

void AddArtifactCommands(CLI::App& app, Context& context) {
  CLI::App* artifacts =
      app.add_subcommand("artifacts", "Everything that is versioned")->require_subcommand(1);
  const auto add = [&](const char* name, const char* help,
                       Status (*function)(Context&, const ArtifactArguments&, coordinator::Client&)) {
    auto arguments = std::make_shared<ArtifactArguments>();
    CLI::App* command = artifacts->add_subcommand(name, help);
    command->callback([&context, arguments, function] {
      WithClient(context, [&](coordinator::Client& client) { return function(context, *arguments, client); });
    });
    return std::pair{command, arguments};
  };
  const char* hash_help = "SHA-256, or a unique beginning of at least 6 digits";
  auto [list, list_arguments] = add("list", "Newest first", List);
  list->add_option("--kind", list_arguments->kind, "model, trajectories, policy, recording, parameters, …");
  list->add_option("--job", list_arguments->job, "Made by this job");
  list->add_option("--limit", list_arguments->limit, "At most so many");
  auto [show, show_arguments] = add("show", "Kind, size, metadata, parents", Show);
  show->add_option("HASH", show_arguments->hash, hash_help)->required();
  auto [get, get_arguments] = add("get", "Write its bytes to a file", Get);
  get->add_option("HASH", get_arguments->hash, hash_help)->required();
  get->add_option("--out", get_arguments->out, "File, or - for stdout");
  auto [lineage, lineage_arguments] = add("lineage", "What it was made from", Lineage);
  lineage->add_option("HASH", lineage_arguments->hash, hash_help)->required();
  lineage->add_flag("--descendants", lineage_arguments->descendants, "What was made from it instead");
  auto [verify, verify_arguments] = add("verify", "Check bytes against hashes", Verify);
  verify->add_option("HASH", verify_arguments->hash, hash_help);
  for (const auto& [name, help, function] :
       {std::tuple{"pin", "Keep it, and what it was made from, whatever is collected", &Pin},
        std::tuple{"unpin", "No longer", &Unpin}}) {
    auto [pin, pin_arguments] = add(name, help, function);
    pin->add_option("HASH", pin_arguments->hash, hash_help)->required();
    pin->add_option("--owner", pin_arguments->owner, "Who wants it kept")->capture_default_str();
  }
  auto [gc, gc_arguments] =
      add("gc", "Remove what no job, parameter version or pin refers to, and nothing kept descends from", Gc);
  gc->add_option("--older-than-days", gc_arguments->older_than_days, "Only older ones")
      ->check(CLI::Range(0.0, 100000.0))
      ->capture_default_str();
  gc->add_option("--forget-jobs-days", gc_arguments->forget_days,
                 "Jobs that ended longer ago no longer keep what they refer to (0: every job does)")
      ->check(CLI::Range(0.0, 100000.0));
  CLI::Option* yes =
      gc->add_flag("--yes", gc_arguments->yes, "Really remove; otherwise it only says what it would");
  gc->add_flag("--dry-run", gc_arguments->dry_run, "Only say what it would remove (as without --yes)")
      ->excludes(yes);
}

}  // namespace rg::cli
