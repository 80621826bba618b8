// The agent's own door: a Unix socket in the spool's folder, for this user only, one line in, one JSON object
// out. It needs no coordinator.
#pragma once

#include <functional>
#include <string>

#include "common/base/status.h"

namespace rg::robot_agent {

// FOLDER/agent.sock, whatever the length of the path.
class LocalSocket {
 public:
  static Result<LocalSocket> Listen(const std::string& folder);
  LocalSocket(LocalSocket&& other) noexcept : file_(other.file_), path_(std::move(other.path_)) {
    other.file_ = -1;
  }
  ~LocalSocket();  // removes the file

  int file() const { return file_; }
  // Takes one caller that waits, if there is one, and answers. A caller that says nothing for half a second
  // is left.
  void Serve(const std::function<std::string(const std::string& line)>& answer) const;

 private:
  LocalSocket(int file, std::string path) : file_(file), path_(std::move(path)) {}
  int file_;
  std::string path_;
};

// kUnavailable: no agent runs on this spool.
Result<std::string> AskLocally(const std::string& folder, const std::string& line);

}  // namespace rg::robot_agent
