// What every command needs: how to print, where the coordinator is, how it ends.
#pragma once

#include <memory>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "services/cli/output.h"

namespace rg::coordinator {
class Client;
}

namespace rg::cli {

// A setting and where it came from: flag > environment > project file > user file > default.
struct Setting {
  std::string value;
  std::string origin;
};

// Settings known to the command line: "coordinator", "key", "server_key" (files), "robots".
struct Settings {
  Setting coordinator, key, server_key, robots;
};

inline constexpr char kDefaultCoordinator[] = "tcp://127.0.0.1:7341";
inline constexpr char kProjectFile[] = ".realitygrad.json";

class ChildProcesses;

class Context {
 public:
  Context();
  ~Context();
  OutputFormat output = OutputFormat::kTable;
  Settings flags;  // values given by flags, empty where none was
  int exit_code = kExitOk;
  Status error;  // the first that made a command fail
  char** argv = nullptr;  // of this process

  // The project file is looked for in this folder and above it. Error: an unreadable file or an
  // unknown key in it.
  Result<Settings> Resolve() const;
  // To the coordinator of the settings. Where that is the folder of a run on this machine, to the
  // coordinator of the run, or, when it is over, to one that is started for as long as this lives.
  Result<std::unique_ptr<coordinator::Client>> Connect() const;
  // Prints `status` and sets the exit code; true if it was an error.
  bool Failed(const Status& status);
  // `status` as it is; if it is an error, one of usage: Failed will exit with 2.
  Status Usage(Status status) const;
  bool json() const { return output == OutputFormat::kJson; }
  bool quiet() const { return output == OutputFormat::kQuiet; }

 private:
  Result<std::string> AddressOfRun(const std::string& folder) const;
  mutable std::unique_ptr<ChildProcesses> children_;
  mutable std::string socket_folder_;
  mutable bool misused_ = false;
};

// The user of this process and its host.
std::string UserAtHost();
// Folder of robot profiles and URDFs: the setting, or what was there when the program was built.
std::string RobotsFolder(const Settings& settings);
// A program of this build, beside the running one.
std::string SiblingProgram(const std::string& name);
// Such a program in place of this one. Returns only where it cannot be started.
Status BecomeProgram(const std::string& name, char** argv);
// Whether `folder` can be written, or made if it is not there; asked before long work. Leaves nothing.
// An empty name: no folder is wanted.
Status CheckWritable(const std::string& folder);

}  // namespace rg::cli
