// Answers requests that only read artefacts, parameters, logs or events, on a thread of its own with a
// connection of its own: a check of the whole store, or a long lineage, keeps nobody else waiting. It sees
// what is committed.
#pragma once

#include <atomic>
#include <condition_variable>
#include <deque>
#include <functional>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "common/base/clock.h"
#include "common/base/status.h"
#include "common/transport/envelope.h"

namespace rg::coordinator {

class ReadDesk {
 public:
  // `wake` is called from the thread when an answer is there.
  ReadDesk(std::string database_path, transport::Sender self, const Clock* clock, std::function<void()> wake);
  ~ReadDesk();  // breaks off what is under way

  static bool IsLong(const transport::Message& request);   // may take seconds or minutes
  static bool IsShort(const transport::Message& request);  // a page or a piece, but there are many

  // In order. kResourceExhausted: too many wait already.
  Status Add(transport::Message request);
  std::vector<transport::Message> TakeAnswers();

 private:
  void Work();

  const std::string path_;
  const transport::Sender self_;
  const Clock* clock_;
  const std::function<void()> wake_;
  mutable std::mutex mutex_;  // guards all below
  std::condition_variable more_;
  std::deque<transport::Message> waiting_;
  std::vector<transport::Message> answers_;
  size_t answer_bytes_ = 0;
  std::atomic<bool> stop_ = false;  // written under the mutex
  std::thread thread_;
};

}  // namespace rg::coordinator
