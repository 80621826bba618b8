// Scratch space of one worker process, below a folder that several on a host may share. It goes with the process:
// what one left that was killed is removed by the next one that starts.
#pragma once

#include <string>

#include "common/base/status.h"

namespace rg::worker {

class ScratchSpace {
 public:
  // Removes what dead processes left in `folder`, and takes `folder`/`instance`, which is made by whoever writes
  // there. Error: the folder cannot be made or written to.
  static Result<ScratchSpace> Open(const std::string& folder, const std::string& instance);
  ScratchSpace(ScratchSpace&& other) noexcept;
  ScratchSpace& operator=(ScratchSpace&&) = delete;
  ~ScratchSpace();  // removes it

  const std::string& path() const { return path_; }

 private:
  ScratchSpace(std::string path, int lock) : path_(std::move(path)), lock_(lock) {}
  std::string path_;
  int lock_ = -1;  // of PATH.lock, which the kernel lets go of when the process ends, however it does
};

}  // namespace rg::worker
