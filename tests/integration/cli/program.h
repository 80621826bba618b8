// Runs the programs of this build and keeps what they said.
#pragma once

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>

#include "common/base/file.h"
#include "common/base/ids.h"

namespace rg {

inline std::string BinDir() {
  const char* dir = std::getenv("RG_BIN_DIR");
  return dir ? dir : ".";
}

class ScratchFolder {
 public:
  ScratchFolder() : path_(std::filesystem::temp_directory_path() / ("rg_cli_" + RandomHex(6))) {
    std::filesystem::create_directories(path_);
  }
  ~ScratchFolder() {
    std::error_code error;
    std::filesystem::remove_all(path_, error);
  }
  const std::string& path() const { return path_; }
  std::string operator/(const std::string& name) const { return path_ + "/" + name; }

 private:
  std::string path_;
};

struct Said {
  int code = -1;
  std::string out, err;
};

// `arguments` are words for a shell.
inline Said RunProgram(const ScratchFolder& scratch, const std::string& arguments) {
  const std::string out = scratch / "out", err = scratch / "err";
  const std::string command =
      "cd " + scratch.path() + " && " + BinDir() + "/realitygrad " + arguments + " >" + out + " 2>" + err;
  const int how = std::system(command.c_str());
  return {WIFEXITED(how) ? WEXITSTATUS(how) : 128 + WTERMSIG(how), ReadFile(out).value(),
          ReadFile(err).value()};
}

// A program started in the background and ended with the test; its log is NAME.log.
class Background {
 public:
  Background(const ScratchFolder& scratch, const std::string& name, const std::string& arguments) {
    const std::string pid_file = scratch / (name + ".pid");
    const std::string command = "cd " + scratch.path() + " && { " + BinDir() + "/" + name + " " + arguments +
                                " > " + name + ".log 2>&1 & echo $! > " + pid_file + "; }";
    if (std::system(command.c_str()) == 0) std::ifstream(pid_file) >> pid_;
  }
  ~Background() {
    if (pid_ > 0) kill(pid_, SIGTERM);
  }
  void Signal(int number) {
    if (pid_ > 0) kill(pid_, number);
  }
  void KillNow() {
    if (pid_ > 0) kill(pid_, SIGKILL);
    pid_ = -1;
  }

 private:
  pid_t pid_ = -1;
};

}  // namespace rg
