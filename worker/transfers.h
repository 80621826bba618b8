// Fetching inputs and uploading outputs beside the worker's loop, so that heartbeats never wait for
// bytes: not for their way, nor for their hash, nor for the disk. Each thread has a connection of its own.
#pragma once

#include <atomic>
#include <condition_variable>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "common/base/status.h"
#include "common/transport/request_client.h"
#include "realitygrad/v1/artifact.pb.h"

namespace rg::worker {

struct Transfer {
  enum class Kind { kFetch, kUpload } kind = Kind::kFetch;
  uint64_t token = 0;
  std::string sha256;
  std::string path;                    // upload: where the bytes are
  realitygrad::v1::ArtifactInfo info;  // upload
  std::string database;                // identity of the one whose token it is
};
struct TransferResult {
  Transfer transfer;
  Status status;
  uint64_t bytes = 0;  // of a fetched artefact, which is in the cache's folder by now, checked and synced
};

class Transfers {
 public:
  using Connect = std::function<Result<std::unique_ptr<transport::RequestClient>>(int thread)>;
  // `wake_fd` is an eventfd that becomes readable when a result is there.
  Transfers(int threads, Connect connect, std::string cache_folder, int wake_fd);
  ~Transfers();  // breaks off what is under way

  void Add(Transfer transfer);
  // Forgets what has not begun for this token.
  void Drop(uint64_t token);
  std::vector<TransferResult> TakeResults();

 private:
  void Work(int thread);
  TransferResult RunOne(Transfer transfer, transport::RequestClient& client);

  Connect connect_;
  const std::string cache_folder_;
  int wake_fd_;
  std::mutex mutex_;
  std::condition_variable wake_;
  std::deque<Transfer> queue_;
  std::vector<TransferResult> results_;
  std::vector<transport::RequestClient*> clients_;
  bool stop_ = false;
  std::vector<std::thread> threads_;
};

}  // namespace rg::worker
