// The programs that `run` starts: each a child whose output goes to a log file and who does not outlive
// this process.
#pragma once

#include <sys/types.h>

#include <string>
#include <vector>

#include "common/base/status.h"

namespace rg::cli {

// The last line of a text file that says something; empty where there is none.
std::string LastLine(const std::string& file);

class ChildProcesses {
 public:
  ChildProcesses() = default;
  ~ChildProcesses() { StopAll(3.0); }
  ChildProcesses(const ChildProcesses&) = delete;
  ChildProcesses& operator=(const ChildProcesses&) = delete;

  // `name` is for people and for the log's name. The child gets SIGTERM if this process dies, and
  // does not see the terminal's Ctrl-C.
  Status Start(const std::string& name, const std::vector<std::string>& command, const std::string& log_file);
  // Ok while all are running, or what ended was said before; else the first that ended, with the last line of its log
  // where it ended by itself. `ended`: its name.
  Status Check(std::string* ended = nullptr);
  // One that has ended, as it was started.
  Status StartAgain(const std::string& name);
  // SIGTERM to all but the first, which the others may still need, and to it when they have ended;
  // SIGKILL to those still there after `grace_s`.
  void StopAll(double grace_s);
  // Of the first that was started; -1: there is none, or it has ended.
  pid_t first_pid() const { return children_.empty() ? -1 : children_.front().pid; }

 private:
  struct Child {
    std::string name;
    std::vector<std::string> command;
    std::string log_file;
    pid_t pid = -1;
  };
  static Status Begin(Child* child);
  static void Terminate(const Child& child);
  static void AwaitEnd(Child* child, double deadline);  // steady seconds; SIGKILL then
  std::vector<Child> children_;
};

}  // namespace rg::cli
