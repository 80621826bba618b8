// Keeps everything that a reader hands out, and folders that go away.
#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "common/base/ids.h"
#include "services/importing/log.h"

namespace rg::test {

class CollectedLog final : public importing::LogSink {
 public:
  struct Kept {
    size_t topic;
    int64_t log_ns;
    std::string bytes;
  };
  std::vector<importing::Topic> topics;
  std::vector<Kept> messages;
  std::vector<std::string> notes;

  Status OnTopic(const importing::Topic& topic) override {
    topics.push_back(topic);
    return Status::Ok();
  }
  Status OnMessage(const importing::Message& message) override {
    messages.push_back({message.topic, message.log_ns, std::string(message.bytes)});
    return Status::Ok();
  }
  void OnNote(const std::string& note) override { notes.push_back(note); }
};

class TemporaryFolder {
 public:
  TemporaryFolder() : path_(std::filesystem::temp_directory_path() / ("rg_importing_" + RandomHex(6))) {
    std::filesystem::create_directories(path_);
  }
  ~TemporaryFolder() {
    std::error_code error;
    std::filesystem::remove_all(path_, error);
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  std::string operator/(const std::string& name) const { return (path_ / name).string(); }

 private:
  std::filesystem::path path_;
};

}  // namespace rg::test
