#include "services/lab/simulated_workers.h"

#include <unistd.h>

#include <charconv>
#include <map>
#include <memory>
#include <queue>
#include <vector>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/hash.h"
#include "common/transport/envelope.h"
#include "common/transport/keys.h"
#include "common/transport/zmq_socket.h"
#include "realitygrad/v1/worker.pb.h"

namespace rg::lab {
namespace {

namespace pb = ::realitygrad::v1;

constexpr int64_t kBeatNs = 500'000'000;
constexpr int64_t kSendAgainNs = 2'000'000'000;  // a result that nobody has answered

int64_t SteadyNow() { return RealClock().SteadyNanos(); }

class SimulatedWorker {
 public:
  SimulatedWorker(std::string name, std::unique_ptr<transport::ZmqSocket> socket,
                  const SimulatedWorkersOptions& options)
      : name_(std::move(name)), socket_(std::move(socket)), options_(options) {
    self_ = {name_ + "-" + std::to_string(getpid()), pb::ROLE_WORKER};
  }

  transport::ZmqSocket* socket() { return socket_.get(); }
  int64_t next_ns() const { return due_.empty() ? next_beat_ns_ : std::min(next_beat_ns_, due_.top().first); }

  void Work(std::vector<double>* delays_ms) {
    transport::Message message;
    while (socket_->Receive(&message)) {
      const auto body = transport::Unpack<pb::CoordinatorMessage>(message);
      if (body.ok()) Handle(*body, delays_ms);
    }
    const int64_t now = SteadyNow();
    while (!due_.empty() && due_.top().first <= now) {
      const uint64_t token = due_.top().second;
      due_.pop();
      Finish(token, now);
    }
    if (now >= next_beat_ns_) Beat(now);
  }
  void Leave() {
    pb::WorkerMessage bye;
    bye.mutable_bye();
    Send(bye);
  }

 private:
  void Send(const pb::WorkerMessage& message) {
    const Status sent = socket_->Send(transport::MakeEvent(self_, message));
    (void)sent;  // it is sent again
  }

  void Beat(int64_t now) {
    next_beat_ns_ = now + (joined_ ? kBeatNs : kBeatNs / 2);
    pb::WorkerMessage message;
    if (!joined_) {
      auto* hello = message.mutable_hello();
      hello->set_name(name_);
      hello->set_slots(static_cast<uint32_t>(options_.slots));
      hello->add_kinds(kSimulatedKind);
      hello->set_host("simulated");
      hello->set_pid(getpid());
      for (const auto& [token, task] : held_) hello->add_held_tokens(token);
    } else {
      message.mutable_heartbeat();
      for (const auto& [token, task] : held_) message.mutable_heartbeat()->add_held_tokens(token);
    }
    Send(message);
  }

  void Handle(const pb::CoordinatorMessage& message, std::vector<double>* delays_ms) {
    if (message.has_welcome()) joined_ = true;
    if (message.has_heartbeat_reply() && !message.heartbeat_reply().known())
      joined_ = false, next_beat_ns_ = 0;
    if (message.has_revoke()) held_.erase(message.revoke().token());
    if (message.has_result_reply() && !message.result_reply().try_again())
      held_.erase(message.result_reply().token());
    if (!message.has_assign()) return;
    const pb::TaskAssignment& task = message.assign();
    if (!held_.emplace(task.token(), task.task()).second) return;
    const int64_t now = SteadyNow();
    int64_t offered_ns = 0;
    const char* end = task.payload().data() + task.payload().size();
    if (std::from_chars(task.payload().data(), end, offered_ns).ptr == end && offered_ns > 0)
      delays_ms->push_back(1e-6 * static_cast<double>(now - offered_ns));
    due_.push({now + static_cast<int64_t>(1e9 * options_.seconds), task.token()});
  }

  void Finish(uint64_t token, int64_t now) {
    const auto held = held_.find(token);
    if (held == held_.end()) return;
    pb::WorkerMessage message;
    auto* finished = message.mutable_finished();
    finished->set_token(token);
    finished->set_task(held->second);
    finished->set_seconds(options_.seconds);
    if (options_.summary_bytes > 0)
      finished->set_summary_json("{\"result\":\"" +
                                 std::string(static_cast<size_t>(options_.summary_bytes), 'r') + "\"}");
    if (options_.output_bytes > 0) {
      std::string bytes = std::to_string(held->second);
      bytes.resize(static_cast<size_t>(options_.output_bytes), '.');
      auto* output = finished->add_outputs();
      output->set_name("out");
      output->set_kind("text");
      output->set_size(bytes.size());
      output->set_sha256(Sha256Hex(bytes));
      output->set_metadata_json("{}");
      output->set_inline_bytes(std::move(bytes));
    }
    Send(message);
    due_.push({now + kSendAgainNs, token});
  }

  const std::string name_;
  std::unique_ptr<transport::ZmqSocket> socket_;
  const SimulatedWorkersOptions& options_;
  transport::Sender self_;
  bool joined_ = false;
  int64_t next_beat_ns_ = 0;
  std::map<uint64_t, int64_t> held_;  // tasks by token, until their result is acknowledged
  using Due = std::pair<int64_t, uint64_t>;
  std::priority_queue<Due, std::vector<Due>, std::greater<>> due_;
};

Result<transport::DealerOptions> DealerOf(const SimulatedWorkersOptions& options) {
  transport::DealerOptions dealer;
  dealer.allow_plain_loopback = true;
  if (options.key_file.empty()) return dealer;
  RG_ASSIGN_OR_RETURN(const auto own, transport::LoadKeyFile(options.key_file));
  RG_ASSIGN_OR_RETURN(const auto server, transport::LoadPublicKeyFile(options.server_key_file));
  dealer.key = own.keys;
  dealer.server_public_key = server.keys.public_key;
  return dealer;
}

}  // namespace

Status RunSimulatedWorkers(const SimulatedWorkersOptions& options, const CancelToken& stop) {
  RG_ASSIGN_OR_RETURN(const auto dealer, DealerOf(options));
  transport::Context context;
  std::vector<std::unique_ptr<SimulatedWorker>> workers;
  transport::Poller poller;
  for (int w = 1; w <= options.count; ++w) {
    RG_ASSIGN_OR_RETURN(auto socket, transport::ConnectDealer(context, options.coordinator, dealer));
    workers.push_back(std::make_unique<SimulatedWorker>(options.prefix + "-" + std::to_string(w),
                                                        std::move(socket), options));
    poller.Add(workers.back()->socket());
  }
  std::vector<double> delays_ms;
  while (!stop.cancelled()) {
    int64_t until = SteadyNow() + 200'000'000;
    for (const auto& worker : workers) until = std::min(until, worker->next_ns());
    poller.Wait(std::max<int64_t>(0, (until - SteadyNow() + 999'999) / 1'000'000));
    for (const auto& worker : workers) worker->Work(&delays_ms);
  }
  for (const auto& worker : workers) worker->Leave();
  usleep(100'000);
  if (options.delays_file.empty()) return Status::Ok();
  std::string text;
  for (const double ms : delays_ms) text += std::to_string(ms) + "\n";
  return WriteFileAtomically(options.delays_file, text);
}

}  // namespace rg::lab
