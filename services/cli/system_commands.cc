#include <CLI/CLI.hpp>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <thread>

#include "common/base/file.h"
#include "common/base/printf.h"
#include "common/transport/keys.h"
#include "coordinator/client/client.h"
#include "realitygrad/v1/control.pb.h"
#include "services/cli/commands.h"
#include "services/cli/context.h"
#include "services/cli/proof_generator.h"
#include "services/cli/robot_profile.h"

namespace rg::cli {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;

// ---- config ----

void ShowConfig(Context& context, bool origin) {
  const auto settings = context.Resolve();
  if (context.Failed(settings.status())) return;
  const std::vector<std::pair<std::string, Setting>> rows = {
      {"coordinator", settings->coordinator},
      {"key", settings->key},
      {"server_key", settings->server_key},
      {"robots", {RobotsFolder(*settings), settings->robots.origin}}};
  if (context.json()) {
    json out = json::object();
    for (const auto& [name, setting] : rows)
      out[name] = {{"value", setting.value}, {"origin", setting.origin}};
    return PrintJson("realitygrad.config/1", out);
  }
  TextTable table(origin ? std::vector<std::string>{"SETTING", "VALUE", "ORIGIN"}
                         : std::vector<std::string>{"SETTING", "VALUE"});
  for (const auto& [name, setting] : rows) {
    std::vector<std::string> row = {name, setting.value.empty() ? "–" : setting.value};
    if (origin) row.push_back(setting.origin);
    table.AddRow(row);
  }
  Print(table.ToString());
}

// ---- doctor ----

struct Finding {
  std::string what, detail;
  bool ok = true, fatal = true;
};

Finding CheckProgram(const std::string& name) {
  const std::string path = SiblingProgram(name);
  const bool there = fs::exists(path);
  return {"program " + name, there ? path : path + " is missing: build it, or install it beside realitygrad",
          there, true};
}

Finding CheckProofGenerator() {
  const std::string path = SiblingProgram(kProofGenerator);
  const bool there = fs::exists(path);
  return {std::string("program ") + kProofGenerator,
          there ? path : "only `prove` needs it; this makes it: " + HowToGetProofGenerator(), there, false};
}

// RG_ROS_MISSING: the packages that were missing when this was built.
Finding CheckKinovaDriver() {
  const std::string missing = RG_ROS_MISSING;
  if (!missing.empty())
    return {"driver kinova", "not built; it needs: " + missing + " (then cmake and build again)", false,
            false};
  const bool master = fs::exists("/usr/bin/rosmaster");
  return {"driver kinova",
          master ? "built in; its stand-in needs /usr/bin/rosmaster, which is there"
                 : "built in; its stand-in needs /usr/bin/rosmaster: install python3-rosmaster",
          true, false};
}

Finding CheckRobots(const Settings& settings) {
  const std::string folder = RobotsFolder(settings);
  const auto profiles = ListRobotProfiles(folder);
  if (!profiles.ok()) return {"robots", profiles.status().message(), false, true};
  std::string names;
  for (const std::string& name : *profiles) {
    const auto robot = LoadRobotProfile(folder, name);
    if (!robot.ok()) return {"robots", robot.status().message(), false, true};
    names += (names.empty() ? "" : ", ") + name;
  }
  return {"robots", names.empty() ? folder + " holds no robot profile" : names + " (" + folder + ")",
          !names.empty(), true};
}

Finding CheckScratch() {
  std::error_code error;
  const fs::space_info space = fs::space(fs::temp_directory_path(error), error);
  if (error) return {"temporary folder", error.message(), false, true};
  const double gib = static_cast<double>(space.available) / (1 << 30);
  const std::string text = Printf("%.1f GiB free in %s", gib, fs::temp_directory_path(error).c_str());
  return {"temporary folder", text, gib > 0.5, true};
}

Finding CheckProcessor() {
  const char* best = __builtin_cpu_supports("avx512f") ? "AVX-512"
                     : __builtin_cpu_supports("avx2")  ? "AVX2"
                                                       : "baseline x86-64";
  return {"processor", std::to_string(std::thread::hardware_concurrency()) + " cores, kernels for " + best,
          true, false};
}

Finding CheckCoordinator(const Context& context, const Settings& settings) {
  auto client = context.Connect();
  if (!client.ok()) return {"coordinator", client.status().message(), false, false};
  const auto status = (*client)->CoordinatorStatus();
  if (!status.ok())
    return {"coordinator", settings.coordinator.value + ": " + status.status().message(), false, false};
  if (!status->trouble().empty()) return {"coordinator", settings.coordinator.value + ": " + status->trouble(), false, true};
  return {"coordinator",
          settings.coordinator.value + ", version " + status->version() + ", " +
              std::to_string(status->workers()) + " workers",
          true, false};
}

void Doctor(Context& context) {
  const auto settings = context.Resolve();
  if (context.Failed(settings.status())) return;
  const std::vector<Finding> findings = {CheckProgram("realitygrad-coordinator"),
                                         CheckProgram("realitygrad-worker"),
                                         CheckProgram("realitygrad-agent"),
                                         CheckProgram("realitygrad-guard"),
                                         CheckProgram("realitygrad-simulated-robot"),
                                         CheckProgram("realitygrad-lab"),
                                         CheckProofGenerator(),
                                         CheckKinovaDriver(),
                                         CheckRobots(*settings),
                                         CheckScratch(),
                                         CheckProcessor(),
                                         CheckCoordinator(context, *settings)};
  json list = json::array();
  TextTable table({"CHECK", "RESULT", "DETAIL"});
  for (const Finding& f : findings) {
    if (!f.ok && f.fatal) context.exit_code = kExitError;
    list.push_back({{"check", f.what}, {"ok", f.ok}, {"required", f.fatal}, {"detail", f.detail}});
    table.AddRow({f.what, f.ok ? "ok" : f.fatal ? "FAILED" : "not there", f.detail});
  }
  if (context.json()) return PrintJson("realitygrad.doctor/1", {{"checks", list}});
  Print(table.ToString());
}

// ---- keys ----

struct KeyArguments {
  std::string name, role, folder;  // role empty: the coordinator's of that name, else operator
  bool overwrite = false, robots = false;
};

std::string FolderOf(const KeyArguments& a) {
  return a.folder.empty() ? transport::DefaultKeyFolder() : a.folder;
}

// A coordinator's own key is on no list: what it is for is said instead.
std::string AdviceFor(const KeyArguments& a, const std::string& role) {
  const std::string file = FolderOf(a) + "/" + a.name;
  if (role != "coordinator") return "let it in with: realitygrad keys allow " + a.name;
  return "start it with: realitygrad coordinator --key " + file + ".key --allowed-keys " + FolderOf(a) +
         "/allowed_keys; others reach it with --server-key " + file + ".pub";
}

Status GenerateKey(Context& context, const KeyArguments& a) {
  const std::string role_name = !a.role.empty() ? a.role : a.name == "coordinator" ? "coordinator" : "operator";
  RG_ASSIGN_OR_RETURN(const auto role, transport::ParseRole(role_name));
  RG_ASSIGN_OR_RETURN(const auto key, transport::GenerateKeyFiles(FolderOf(a), a.name, role, a.overwrite));
  if (context.json()) {
    PrintJson(
        "realitygrad.key/1",
        {{"name", key.name}, {"role", role_name}, {"public_key", key.keys.public_key}, {"folder", FolderOf(a)}});
  } else {
    Print(key.keys.public_key);
    PrintNote("wrote " + FolderOf(a) + "/" + a.name +
              ".key and .pub; " + AdviceFor(a, role_name));
  }
  return Status::Ok();
}

Status ListKeys(Context& context, const KeyArguments& a) {
  RG_ASSIGN_OR_RETURN(const auto keys, transport::ListKeys(FolderOf(a)));
  RG_ASSIGN_OR_RETURN(const auto allowed, transport::LoadAllowList(FolderOf(a) + "/allowed_keys"));
  json list = json::array();
  TextTable table({"NAME", "ROLE", "ALLOWED", "ROBOTS", "PUBLIC KEY"});
  const auto add = [&](const std::string& name, const std::string& role, bool is_allowed,
                       const std::string& key) {
    const auto* entry = allowed.Find(key);
    const bool robots = entry != nullptr && entry->robots;
    list.push_back(
        {{"name", name}, {"role", role}, {"allowed", is_allowed}, {"robots", robots}, {"public_key", key}});
    table.AddRow({name, role, is_allowed ? "yes" : "no", robots ? "yes" : "–", key});
  };
  for (const auto& key : keys) {
    add(key.name, std::string(transport::RoleName(key.role)), allowed.Find(key.keys.public_key) != nullptr,
        key.keys.public_key);
  }
  for (const auto& row : allowed.Rows()) {
    const bool listed = std::any_of(keys.begin(), keys.end(),
                                    [&](const auto& k) { return k.keys.public_key == row.public_key; });
    if (!listed) add(row.entry.name, std::string(transport::RoleName(row.entry.role)), true, row.public_key);
  }
  if (context.json()) {
    PrintJson("realitygrad.keys/1", {{"folder", FolderOf(a)}, {"keys", list}});
  } else {
    Print(table.ToString());
  }
  return Status::Ok();
}

Status AllowKey(Context&, const KeyArguments& a) {
  RG_ASSIGN_OR_RETURN(const auto key, transport::LoadPublicKeyFile(FolderOf(a) + "/" + a.name + ".pub"));
  return transport::AllowKey(FolderOf(a) + "/allowed_keys", key.keys.public_key, key.role, key.name,
                             a.robots);
}

Status RevokeKey(Context&, const KeyArguments& a) {
  return transport::RevokeKey(FolderOf(a) + "/allowed_keys", a.name);
}

void AddKeyCommands(CLI::App& app, Context& context) {
  CLI::App* keys = app.add_subcommand("keys", "Keys for encrypted connections")->require_subcommand(1);
  const auto add = [&](const char* name, const char* help, bool named,
                       Status (*function)(Context&, const KeyArguments&)) {
    auto arguments = std::make_shared<KeyArguments>();
    CLI::App* command = keys->add_subcommand(name, help);
    if (named) command->add_option("NAME", arguments->name)->required();
    command->add_option("--folder", arguments->folder, "Default: " + transport::DefaultKeyFolder());
    command->callback([&context, arguments, function] { context.Failed(function(context, *arguments)); });
    return std::pair{command, arguments};
  };
  auto [generate, arguments] = add("generate", "Make a pair", true, GenerateKey);
  generate->add_option("--role", arguments->role,
                       "coordinator, worker, agent, operator or viewer (default: operator; of the name coordinator: that)");
  generate->add_flag("--overwrite", arguments->overwrite, "Replace an existing pair");
  add("list", "Pairs of the folder and who is let in", false, ListKeys);
  auto [allow, allow_arguments] = add("allow", "Let the holder of a key in", true, AllowKey);
  allow->add_flag("--robots", allow_arguments->robots,
                  "An operator may have robots moved: submit rollouts and retry them");
  add("revoke", "Never again, at once", true, RevokeKey);
}

}  // namespace

void AddSystemCommands(CLI::App& app, Context& context) {
  app.add_subcommand("doctor", "Check this installation")->callback([&context] { Doctor(context); });
  auto origin = std::make_shared<bool>(false);
  CLI::App* config = app.add_subcommand("config", "Settings in force")->require_subcommand(1);
  CLI::App* show = config->add_subcommand("show", "Each setting");
  show->add_flag("--origin", *origin, "And where it comes from");
  show->callback([&context, origin] { ShowConfig(context, *origin); });
  AddKeyCommands(app, context);
}

}  // namespace rg::cli
