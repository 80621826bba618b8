#include "worker/transfers.h"

#include <gtest/gtest.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <atomic>
#include <filesystem>
#include <thread>

#include "common/base/file.h"
#include "common/base/hash.h"
#include "common/base/ids.h"
#include "common/transport/zmq_socket.h"
#include "worker/artifact_cache.h"

namespace rg::worker {
namespace {

namespace pb = realitygrad::v1;

// Serves one artefact, piece by piece.
class OneArtifact {
 public:
  OneArtifact(transport::Context& context, std::string bytes) : bytes_(std::move(bytes)) {
    router_ = *transport::BindRouter(context, "inproc://artefact", {.self = self_});
    thread_ = std::thread([this] { Serve(); });
  }
  ~OneArtifact() {
    stop_ = true;
    thread_.join();
  }

 private:
  void Serve() {
    transport::Message message;
    while (!stop_) {
      router_->Wait(10);
      while (router_->Receive(&message)) {
        const auto request = *transport::Unpack<pb::GetArtifactRequest>(message);
        pb::GetArtifactReply reply;
        reply.set_offset(request.offset());
        reply.set_size_bytes(bytes_.size());
        transport::Message answer = transport::MakeReply(self_, message, reply);
        answer.attachment = bytes_.substr(request.offset(), request.limit_bytes());
        EXPECT_TRUE(router_->Send(answer).ok());
      }
    }
  }

  const transport::Sender self_{"c", pb::ROLE_COORDINATOR};
  const std::string bytes_;
  std::unique_ptr<transport::ZmqSocket> router_;
  std::atomic<bool> stop_ = false;
  std::thread thread_;
};

// The worker's loop only notes what a transfer brings: hash, write and sync are done by then, so that a large
// input costs no heartbeat.
TEST(Transfers, AFetchedArtifactIsInTheCacheBeforeTheLoopHearsOfIt) {
  const std::string folder = "/tmp/rg-transfers-" + RandomHex(6);
  std::string bytes(5'000'000, 'x');
  bytes[4'999'999] = 'y';
  const std::string sha256 = Sha256Hex(bytes);
  {
    transport::Context context;
    const OneArtifact server(context, bytes);
    ArtifactCache cache = *ArtifactCache::Open(folder, 1u << 30);
    const int wake_fd = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
    Transfers transfers(
        1,
        [&](int) -> Result<std::unique_ptr<transport::RequestClient>> {
          const transport::Sender self{"w", pb::ROLE_WORKER};
          RG_ASSIGN_OR_RETURN(auto socket,
                              transport::ConnectDealer(context, "inproc://artefact", {.self = self}));
          return std::make_unique<transport::RequestClient>(std::move(socket), self, "test", RealClock());
        },
        cache.folder(), wake_fd);
    transfers.Add({Transfer::Kind::kFetch, 7, sha256, "", {}});
    pollfd woken{wake_fd, POLLIN, 0};
    ASSERT_EQ(poll(&woken, 1, 20'000), 1);
    const auto results = transfers.TakeResults();
    ASSERT_EQ(results.size(), 1u);
    ASSERT_TRUE(results[0].status.ok()) << results[0].status.ToString();
    EXPECT_EQ(results[0].bytes, bytes.size());
    std::string path;
    ASSERT_TRUE(cache.Find(sha256, &path)) << "there before it is taken";
    cache.Took(sha256, results[0].bytes);
    EXPECT_EQ(*ReadFile(path), bytes);
    EXPECT_EQ(cache.bytes(), bytes.size());
    close(wake_fd);
  }
  std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace rg::worker
