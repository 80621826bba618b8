// Some MiB beside the database that nobody else takes. When the disk is full they are given up, for what ends work or
// frees space: a cancel or a garbage collection has to write too.
#pragma once

#include <cstdint>
#include <string>

#include "common/base/status.h"

namespace rg::coordinator {

class DiskReserve {
 public:
  // `path` empty: there is none, and it is always as if it were there.
  DiskReserve(std::string path, int64_t bytes) : path_(std::move(path)), bytes_(bytes) {}

  // Takes the space, unless it has it. kResourceExhausted: there is none.
  Status Keep();
  void GiveUp();

 private:
  const std::string path_;
  const int64_t bytes_;
};

}  // namespace rg::coordinator
