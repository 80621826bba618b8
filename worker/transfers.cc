#include "worker/transfers.h"

#include <unistd.h>

#include "coordinator/client/transfer.h"
#include "worker/artifact_cache.h"

namespace rg::worker {

Transfers::Transfers(int threads, Connect connect, std::string cache_folder, int wake_fd)
    : connect_(std::move(connect)), cache_folder_(std::move(cache_folder)), wake_fd_(wake_fd) {
  clients_.resize(static_cast<size_t>(threads), nullptr);
  for (int i = 0; i < threads; ++i) threads_.emplace_back([this, i] { Work(i); });
}

Transfers::~Transfers() {
  {
    const std::lock_guard lock(mutex_);
    stop_ = true;
    for (transport::RequestClient* client : clients_) {
      if (client != nullptr) client->Cancel();
    }
  }
  wake_.notify_all();
  for (std::thread& thread : threads_) thread.join();
}

void Transfers::Add(Transfer transfer) {
  {
    const std::lock_guard lock(mutex_);
    queue_.push_back(std::move(transfer));
  }
  wake_.notify_one();
}

void Transfers::Drop(uint64_t token) {
  const std::lock_guard lock(mutex_);
  std::erase_if(queue_, [token](const Transfer& transfer) { return transfer.token == token; });
}

std::vector<TransferResult> Transfers::TakeResults() {
  const std::lock_guard lock(mutex_);
  return std::exchange(results_, {});
}

void Transfers::Work(int thread) {
  auto client = connect_(thread);
  while (true) {
    Transfer transfer;
    {
      std::unique_lock lock(mutex_);
      clients_[static_cast<size_t>(thread)] = client.ok() && !stop_ ? client->get() : nullptr;
      wake_.wait(lock, [this] { return stop_ || !queue_.empty(); });
      if (stop_) {
        clients_[static_cast<size_t>(thread)] = nullptr;
        return;
      }
      transfer = std::move(queue_.front());
      queue_.pop_front();
    }
    TransferResult result =
        client.ok() ? RunOne(std::move(transfer), **client) : TransferResult{transfer, client.status(), 0};
    {
      const std::lock_guard lock(mutex_);
      results_.push_back(std::move(result));
    }
    const uint64_t one = 1;
    [[maybe_unused]] const ssize_t written = write(wake_fd_, &one, sizeof(one));
  }
}

TransferResult Transfers::RunOne(Transfer transfer, transport::RequestClient& client) {
  TransferResult result;
  if (transfer.kind == Transfer::Kind::kFetch) {
    const auto size = coordinator::FetchArtifactToFile(client, transfer.sha256,
                                                       ArtifactCache::PathIn(cache_folder_, transfer.sha256));
    result.status = size.status();
    if (size.ok()) result.bytes = *size;
  } else {
    result.status = coordinator::UploadArtifactFile(client, transfer.path, transfer.info);
  }
  result.transfer = std::move(transfer);
  return result;
}

}  // namespace rg::worker
