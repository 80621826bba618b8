#include "services/cli/context.h"

#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "common/base/file.h"
#include "common/transport/keys.h"
#include "coordinator/client/client.h"
#include "services/cli/child_processes.h"

namespace rg::cli {
namespace {

namespace fs = std::filesystem;

struct Key {
  const char* name;
  const char* environment;
  Setting Settings::*member;
};
const Key kKeys[] = {{"coordinator", "REALITYGRAD_COORDINATOR", &Settings::coordinator},
                     {"key", "REALITYGRAD_KEY", &Settings::key},
                     {"server_key", "REALITYGRAD_SERVER_KEY", &Settings::server_key},
                     {"robots", "REALITYGRAD_ROBOTS", &Settings::robots}};

Status ReadSettingsFile(const std::string& path, const std::string& origin, Settings* settings) {
  RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  const nlohmann::json file = nlohmann::json::parse(text, nullptr, false);
  if (!file.is_object()) return InvalidError(path + ": not a JSON object");
  for (const auto& [name, value] : file.items()) {
    bool known = false;
    for (const Key& key : kKeys) {
      if (name != key.name) continue;
      known = true;
      if (!value.is_string()) return InvalidError(path + ": '" + name + "' must be a string");
      if ((settings->*key.member).origin == "default")
        settings->*key.member = {value, origin + " (" + path + ")"};
    }
    if (!known)
      return InvalidError(path + ": unknown key '" + name + "' (coordinator, key, server_key, robots)");
  }
  return Status::Ok();
}

std::string FindProjectFile() {
  std::error_code error;
  for (fs::path folder = fs::current_path(error); !folder.empty(); folder = folder.parent_path()) {
    if (fs::exists(folder / kProjectFile, error)) return folder / kProjectFile;
    if (folder == folder.parent_path()) break;
  }
  return {};
}

std::string UserFile() {
  const char* xdg = std::getenv("XDG_CONFIG_HOME");
  const char* home = std::getenv("HOME");
  if (xdg && *xdg) return std::string(xdg) + "/realitygrad/config.json";
  return home ? std::string(home) + "/.config/realitygrad/config.json" : std::string();
}

}  // namespace

Result<Settings> Context::Resolve() const {
  Settings settings;
  for (const Key& key : kKeys) {
    Setting& setting = settings.*key.member;
    const char* environment = std::getenv(key.environment);
    if (!(flags.*key.member).value.empty()) {
      setting = {(flags.*key.member).value, "flag"};
    } else if (environment && *environment) {
      setting = {environment, std::string("environment (") + key.environment + ")"};
    } else {
      setting.origin = "default";
    }
  }
  if (const std::string project = FindProjectFile(); !project.empty()) {
    RG_RETURN_IF_ERROR(ReadSettingsFile(project, "project file", &settings));
  }
  if (const std::string user = UserFile(); !user.empty() && fs::exists(user)) {
    RG_RETURN_IF_ERROR(ReadSettingsFile(user, "user file", &settings));
  }
  if (settings.coordinator.value.empty()) settings.coordinator.value = kDefaultCoordinator;
  return settings;
}

namespace {

// Whether a process has the socket of this ipc:// address open. Other addresses: true.
bool SomebodyListens(const std::string& address) {
  constexpr std::string_view kIpc = "ipc://";
  sockaddr_un to{};
  to.sun_family = AF_UNIX;
  if (!address.starts_with(kIpc) || address.size() - kIpc.size() >= sizeof to.sun_path) return true;
  address.copy(to.sun_path, sizeof to.sun_path - 1, kIpc.size());
  const int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
  if (fd < 0) return true;
  const bool listens = connect(fd, reinterpret_cast<const sockaddr*>(&to), sizeof to) == 0;
  close(fd);
  return listens;
}

}  // namespace

Context::Context() = default;
Context::~Context() {
  children_.reset();
  std::error_code error;
  if (!socket_folder_.empty()) fs::remove_all(socket_folder_, error);
}

Result<std::string> Context::AddressOfRun(const std::string& folder) const {
  // A run that was killed leaves its address behind.
  if (const auto running = ReadFile(folder + "/address"); running.ok() && SomebodyListens(*running))
    return *running;
  const std::string database = folder + "/realitygrad.db";
  if (!fs::exists(database))
    return NotFoundError(folder + ": not the folder of a run (realitygrad.db is not there)");
  char socket_folder[] = "/tmp/realitygrad-XXXXXX";
  if (mkdtemp(socket_folder) == nullptr) return InternalError("/tmp: cannot make a folder for the socket");
  socket_folder_ = socket_folder;
  const std::string address = "ipc://" + socket_folder_ + "/coordinator.sock";
  std::error_code error;
  fs::create_directories(folder + "/logs", error);  // if that fails, Start says so
  children_ = std::make_unique<ChildProcesses>();
  RG_RETURN_IF_ERROR(children_->Start(
      "coordinator", {SiblingProgram("realitygrad-coordinator"), "--listen", address, "--db", database},
      folder + "/logs/coordinator.log"));
  return address;
}

Result<std::unique_ptr<coordinator::Client>> Context::Connect() const {
  RG_ASSIGN_OR_RETURN(const Settings settings, Resolve());
  coordinator::ClientOptions options;
  options.address = settings.coordinator.value;
  if (fs::is_directory(options.address)) {
    RG_ASSIGN_OR_RETURN(options.address, AddressOfRun(options.address));
  }
  if (!settings.server_key.value.empty()) {
    RG_ASSIGN_OR_RETURN(const transport::NamedKey server,
                        transport::LoadPublicKeyFile(settings.server_key.value));
    options.server_public_key = server.keys.public_key;
  }
  if (!settings.key.value.empty()) {
    RG_ASSIGN_OR_RETURN(const transport::NamedKey key, transport::LoadKeyFile(settings.key.value));
    options.key = key.keys;
    options.role = key.role;
  }
  options.remark = UserAtHost();
  return coordinator::Client::Connect(options);
}

std::string UserAtHost() {
  char host[256] = "?";
  gethostname(host, sizeof host - 1);
  const char* user = getenv("USER");
  return std::string(user ? user : "user") + "@" + host;
}

bool Context::Failed(const Status& status) {
  if (status.ok()) return false;
  // A coordinator of our own that did not come up says better why nobody answers.
  const Status own =
      children_ && status.code() == StatusCode::kUnavailable ? children_->Check() : Status::Ok();
  const Status& why = own.ok() ? status : own;
  exit_code = Fail(why);
  if (error.ok()) error = why;
  if (misused_) exit_code = kExitUsage;
  return true;
}

Status Context::Usage(Status status) const {
  misused_ = misused_ || !status.ok();
  return status;
}

std::string RobotsFolder(const Settings& settings) {
  if (!settings.robots.value.empty()) return settings.robots.value;
  // Of an installed program: ../share beside its bin/.
  std::error_code error;
  const fs::path self = fs::read_symlink("/proc/self/exe", error);
  const fs::path installed = self.parent_path().parent_path() / "share" / "realitygrad" / "robots";
  return !error && fs::is_directory(installed, error) ? installed.string() : std::string(RG_ROBOTS_FOLDER);
}

std::string SiblingProgram(const std::string& name) {
  std::error_code error;
  const fs::path self = fs::read_symlink("/proc/self/exe", error);
  return (error ? fs::path(".") : self.parent_path()) / name;
}

Status BecomeProgram(const std::string& name, char** argv) {
  const std::string program = SiblingProgram(name);
  execv(program.c_str(), argv);
  return NotFoundError(program + ": cannot start: " + std::strerror(errno));
}

Status CheckWritable(const std::string& folder) {
  if (folder.empty()) return Status::Ok();
  std::vector<fs::path> missing;  // the folder itself first
  for (fs::path at = fs::absolute(folder).lexically_normal(); !fs::exists(at); at = at.parent_path()) {
    if (at.has_filename()) missing.push_back(at);
  }
  std::error_code error;
  fs::create_directories(folder, error);
  if (!error && access(folder.c_str(), W_OK) != 0) error = std::error_code(errno, std::generic_category());
  const std::string reason = error.message();
  const bool failed = static_cast<bool>(error);
  for (const fs::path& made : missing) fs::remove(made, error);
  return failed ? InvalidError(folder + ": cannot write there: " + reason) : Status::Ok();
}

}  // namespace rg::cli
