// The worker's side of an executor child: started when a task needs it, reused for the next task,
// replaced after a crash. What a task writes to stdout and stderr becomes lines of its log.
#pragma once

#include <sys/types.h>

#include <deque>
#include <memory>
#include <string>
#include <vector>

#include "common/base/status.h"
#include "realitygrad/v1/executor.pb.h"
#include "worker/frame_stream.h"

namespace rg::worker {

class Executor {
 public:
  // Starts this program again with `arguments` plus "--executor-fd N". Call from the main thread: the
  // child dies with the thread that started it.
  static Result<std::unique_ptr<Executor>> Start(const std::vector<std::string>& arguments);
  // Kills the child if it is alive.
  ~Executor();
  Executor(const Executor&) = delete;

  Status Run(const realitygrad::v1::RunTask& task);
  void Cancel();  // asks the running task to stop
  void Kill();

  // Messages that have arrived, and lines the child has printed. False: the child is gone (see
  // HowItEnded) and everything it had sent has been handed out.
  bool Read(std::vector<realitygrad::v1::FromExecutor>* messages, std::vector<std::string>* lines);

  uint64_t token() const { return token_; }  // of the task it runs; 0: idle
  void SetIdle() { token_ = 0; }
  int message_fd() const { return message_fd_; }
  int output_fd() const { return output_fd_; }
  pid_t pid() const { return pid_; }
  // It has said so: it can run tasks. One that ends before it has run nothing.
  bool is_ready() const { return ready_; }
  // "killed by signal 11 (Segmentation fault); last lines: …"
  std::string HowItEnded();

 private:
  Executor(pid_t pid, int message_fd, int output_fd)
      : pid_(pid), message_fd_(message_fd), output_fd_(output_fd) {}
  void ReadOutput(std::vector<std::string>* lines);

  pid_t pid_;
  int message_fd_;
  int output_fd_;
  uint64_t token_ = 0;
  FrameReader reader_;
  std::string partial_line_;
  std::deque<std::string> last_lines_;
  bool ready_ = false;
  bool reaped_ = false;
  int wait_status_ = 0;
};

}  // namespace rg::worker
