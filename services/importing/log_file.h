// Opens whatever a person calls a log: a .bag, .mcap or .db3 file, or the folder of a ROS 2 bag.
#pragma once

#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.h"
#include "services/importing/log.h"

namespace rg::importing {

enum class Container { kRos1Bag, kMcap, kDb3, kCsv };

// Told by the first bytes; a CSV is text that is none of the others.
Result<Container> ContainerOf(const std::string& path);

// A file mapped into memory, read once from front to back.
class MappedFile {
 public:
  static Result<MappedFile> Open(const std::string& path);
  MappedFile(MappedFile&& other) noexcept;
  MappedFile& operator=(MappedFile&&) = delete;
  ~MappedFile();
  std::string_view bytes() const { return {data_, size_}; }
  // Bytes before `end` are not needed any more: their memory is given back (they can still be read).
  void Forget(uint64_t end);

 private:
  MappedFile(const char* data, size_t size) : data_(data), size_(size) {}
  const char* data_;
  size_t size_;
  uint64_t forgotten_ = 0;
};

struct LogFile {
  std::string name;  // as the user gave it, for messages
  std::vector<std::string> parts;
  std::vector<Container> containers;  // of each part
  bool compressed_messages = false;   // of a ROS 2 bag
};

// A folder is a ROS 2 bag: the files that its metadata.yaml names, or all that are there.
Result<LogFile> OpenLog(const std::string& path);

// All parts, one after another, as one log: equal topics of two parts are one topic.
Status ReadLog(const LogFile& file, LogSink& sink);

}  // namespace rg::importing
