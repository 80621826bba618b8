#include "worker/worker.h"

#include <sys/eventfd.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <thread>

#include "common/base/ids.h"
#include "common/base/log.h"

namespace rg::worker {
namespace {

namespace pb = realitygrad::v1;

constexpr int64_t kSecond = 1'000'000'000;
constexpr int kTransferThreads = 2;

std::string HostName() {
  char name[256] = {};
  gethostname(name, sizeof(name) - 1);
  return name;
}

// What the kernel could give without swapping; 0: not known.
uint64_t FreeMemoryBytes() {
  std::ifstream file("/proc/meminfo");
  std::string word;
  uint64_t kib = 0;
  while (file >> word) {
    if (word == "MemAvailable:" && file >> kib) return kib << 10;
  }
  return 0;
}

std::string DefaultFolder() {
  if (const char* cache = std::getenv("XDG_CACHE_HOME")) return std::string(cache) + "/realitygrad/worker";
  if (const char* home = std::getenv("HOME")) return std::string(home) + "/.cache/realitygrad/worker";
  return "/tmp/realitygrad-worker";
}

}  // namespace

Result<std::unique_ptr<Worker>> Worker::Open(WorkerOptions options, const Clock* clock) {
  if (options.name.empty()) options.name = HostName() + "-" + std::to_string(getpid());
  if (options.slots == 0) options.slots = std::max(1u, std::thread::hardware_concurrency());
  if (options.folder.empty()) options.folder = DefaultFolder();
  RG_ASSIGN_OR_RETURN(auto cache, ArtifactCache::Open(options.folder + "/cache", options.cache_bytes));
  std::string instance = options.name + "-" + RandomHex(6);
  std::string scratch_name = instance;
  std::replace(scratch_name.begin(), scratch_name.end(), '/', '_');
  RG_ASSIGN_OR_RETURN(auto scratch, ScratchSpace::Open(options.folder + "/scratch", scratch_name));
  std::unique_ptr<Worker> worker(
      new Worker(std::move(options), clock, std::move(instance), std::move(cache), std::move(scratch)));
  RG_RETURN_IF_ERROR(worker->Connect());
  return worker;
}

Worker::Worker(WorkerOptions options, const Clock* clock, std::string instance, ArtifactCache cache,
               ScratchSpace scratch)
    : options_(std::move(options)),
      clock_(clock),
      cache_(std::move(cache)),
      scratch_(std::move(scratch)),
      instance_(std::move(instance)) {
  self_.id = instance_;
  self_.role = options_.is_agent ? pb::ROLE_AGENT : pb::ROLE_WORKER;
}

Worker::~Worker() {
  executors_.clear();  // before what they write to
  transfers_.reset();
  if (transfer_fd_ >= 0) close(transfer_fd_);
}

Status Worker::Connect() {
  context_ = std::make_unique<transport::Context>();
  transport::DealerOptions dealer;
  dealer.key = options_.key;
  dealer.server_public_key = options_.server_public_key;
  dealer.allow_plain_loopback = true;
  dealer.limits.max_message_bytes = 128u << 20;
  RG_ASSIGN_OR_RETURN(socket_, transport::ConnectDealer(*context_, options_.coordinator, dealer));
  transfer_fd_ = eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK);
  transfers_ = std::make_unique<Transfers>(
      kTransferThreads, [this](int thread) { return ConnectForTransfers(thread); }, cache_.folder(),
      transfer_fd_);
  last_word_ns_ = last_busy_ns_ = now();
  return Status::Ok();
}

Result<std::unique_ptr<transport::RequestClient>> Worker::ConnectForTransfers(int thread) {
  transport::DealerOptions dealer;
  dealer.key = options_.key;
  dealer.server_public_key = options_.server_public_key;
  dealer.allow_plain_loopback = true;
  RG_ASSIGN_OR_RETURN(auto socket, transport::ConnectDealer(*context_, options_.coordinator, dealer));
  transport::Sender sender = self_;
  sender.id += "-transfer" + std::to_string(thread);
  return std::make_unique<transport::RequestClient>(std::move(socket), sender,
                                                    "coordinator at " + options_.coordinator, *clock_);
}

// --- the loop ------------------------------------------------------------------------------------------

Status Worker::Run(int signal_fd) {
  Status outcome;
  while (!MustStop()) {
    outcome = WhyLeave();
    if (!outcome.ok() && !RunsAtMostOnce()) break;
    SendBeatIfDue();
    SendReportsIfDue();
    SayIfAway();
    WaitForSomething(signal_fd);
    ReadSignal(signal_fd);
    ReceiveMessages();
    TakeTransferResults();
    ReadExecutors();
    EnforceDeadlines();
    StartQueued();
    FlushLogs();
  }
  GiveBackEverything("its worker leaves");
  FlushLogs();
  pb::WorkerMessage bye;
  bye.mutable_bye();
  Send(bye);
  return outcome;
}

bool Worker::MustStop() {
  if (!held_.empty()) last_busy_ns_ = now();
  if (stop_now_) return true;
  if (draining_ && held_.empty()) return true;
  if (draining_ && options_.drain_timeout_s > 0.0 &&
      now() - drain_since_ns_ > static_cast<int64_t>(options_.drain_timeout_s * kSecond)) {
    return true;
  }
  return options_.idle_exit_s > 0.0 &&
         now() - last_busy_ns_ > static_cast<int64_t>(options_.idle_exit_s * kSecond);
}

// A rollout under way is broken off for none of these: its arm moves, and what it records stays beside it.
bool Worker::RunsAtMostOnce() const {
  return std::any_of(held_.begin(), held_.end(), [](const auto& entry) {
    return entry.second.assignment.at_most_once() && entry.second.stage == Stage::kRunning;
  });
}

Status Worker::WhyLeave() {
  constexpr int kMostInVain = 8;  // over two minutes
  if (!refused_.empty()) return PermissionDeniedError(refused_);
  if (starts_in_vain_ >= kMostInVain)
    return UnavailableError(unable_ + ", " + std::to_string(starts_in_vain_) + " times in a row");
  return CheckPatience();
}

Status Worker::CheckPatience() {
  if (options_.patience_s <= 0.0 ||
      now() - last_word_ns_ < static_cast<int64_t>(options_.patience_s * kSecond)) {
    return Status::Ok();
  }
  return UnavailableError("no word from the coordinator at " + options_.coordinator + " for " +
                          std::to_string(static_cast<int>(options_.patience_s)) + " s");
}

// Once, and then every minute: a wrong address or a key that is not let in shows in nothing else.
void Worker::SayIfAway() {
  constexpr int64_t kSoon = 5 * kSecond, kAgain = 60 * kSecond;
  const int64_t silent_ns = now() - last_word_ns_;
  if (silent_ns < kSoon || now() < next_complaint_ns_) return;
  next_complaint_ns_ = now() + kAgain;
  const std::string hint = socket_->LinkHint();
  spdlog::warn("no word from the coordinator at {} for {} s: {}", options_.coordinator, silent_ns / kSecond,
               hint.empty() ? "is the address right, and does it run?" : hint);
}

void Worker::WaitForSomething(int signal_fd) {
  int64_t until = std::min(next_beat_ns_, now() + kSecond);
  if (!logs_.empty()) until = std::min(until, logs_due_ns_);
  for (const auto& [token, held] : held_) {
    if (held.deadline_ns > 0) until = std::min(until, held.deadline_ns);
    if (held.kill_at_ns > 0) until = std::min(until, held.kill_at_ns);
    if (held.next_send_ns > 0) until = std::min(until, held.next_send_ns);
  }
  transport::Poller poller;
  poller.Add(socket_.get());
  poller.AddFd(transfer_fd_);
  if (signal_fd >= 0) poller.AddFd(signal_fd);
  for (const auto& executor : executors_) {
    poller.AddFd(executor->message_fd());
    poller.AddFd(executor->output_fd());
  }
  poller.Wait(std::max<int64_t>(0, (until - now()) / 1'000'000 + 1));
}

void Worker::ReadSignal(int signal_fd) {
  uint64_t count = 0;
  if (signal_fd < 0 || read(signal_fd, &count, sizeof(count)) != sizeof(count)) return;
  signals_ += static_cast<int>(count);
  if (signals_ >= 2) stop_now_ = true;
  if (draining_) return;
  spdlog::info("draining: {} tasks to finish", held_.size());
  draining_ = true;
  drain_since_ns_ = now();
  next_beat_ns_ = 0;
}

// --- messages --------------------------------------------------------------------------------------------

void Worker::Send(pb::WorkerMessage& message) {
  message.set_database(database_);
  const Status sent = socket_->Send(transport::MakeEvent(self_, message));
  if (!sent.ok()) spdlog::debug("not sent: {}", sent.ToString());  // what matters is sent again
}

void Worker::SendHello() {
  pb::WorkerMessage message;
  auto* hello = message.mutable_hello();
  hello->set_name(options_.name);
  hello->set_instance(instance_);
  hello->set_slots(options_.slots);
  for (const std::string& tag : options_.tags) hello->add_tags(tag);
  for (const std::string& kind : options_.kinds) hello->add_kinds(kind);
  for (const auto& [token, held] : held_) hello->add_held_tokens(token);
  hello->set_host(HostName());
  hello->set_pid(getpid());
  hello->set_version(options_.version);
  hello->set_draining(draining_);
  LookAtNode();
  hello->set_unable(WhyUnable());
  Send(message);
}

// Twice per heartbeat interval, so that a lost one costs no lease.
void Worker::SendBeatIfDue() {
  if (now() < next_beat_ns_) return;
  constexpr int64_t kHelloAgainNs = 250'000'000;
  next_beat_ns_ = now() + (joined_ ? heartbeat_ns_ / 2 : std::min(heartbeat_ns_ / 2, kHelloAgainNs));
  if (!joined_) return SendHello();
  pb::WorkerMessage message;
  for (const auto& [token, held] : held_) {
    message.mutable_heartbeat()->add_held_tokens(token);
    const bool is_over = held.stage == Stage::kUploading || held.stage == Stage::kReporting;
    if (is_over) message.mutable_heartbeat()->add_finished_tokens(token);
  }
  message.mutable_heartbeat()->set_draining(draining_);
  const bool was_able = node_trouble_.empty();
  LookAtNode();
  message.mutable_heartbeat()->set_unable(WhyUnable());
  message.mutable_heartbeat()->set_cache_bytes(cache_.bytes());
  Describe(message.mutable_heartbeat());
  Send(message);
  if (was_able && !node_trouble_.empty()) GiveBackWhatHasNotBegun("its worker " + node_trouble_);  // not to come back here
}

// For people to read.
void Worker::Describe(pb::WorkerHeartbeat* beat) {
  std::error_code error;
  const auto disk = std::filesystem::space(options_.folder, error);
  if (!error) beat->set_disk_free_bytes(disk.available);
  beat->set_memory_free_bytes(FreeMemoryBytes());
  double load = 0.0;
  if (getloadavg(&load, 1) == 1) beat->set_load(load);
  if (options_.waits_for) beat->set_robot_state(node_trouble_.empty() ? "armed" : node_trouble_);
}

void Worker::LookAtNode() {
  const std::string before = node_trouble_;
  node_trouble_ = DiskTrouble();
  if (node_trouble_.empty() && options_.waits_for) node_trouble_ = options_.waits_for();
  if (node_trouble_ == before) return;
  if (node_trouble_.empty()) {
    spdlog::info("goes on: it no longer {}", before);
  } else {
    spdlog::warn("nothing begins here: it {}", node_trouble_);
  }
}

// What a task may need is not known: without the least of it each would fail. What only saves time goes first.
std::string Worker::DiskTrouble() {
  constexpr uint64_t kLeastBytes = 32u << 20, kLeastPart = 16;
  for (const bool last : {false, true}) {
    std::error_code error;
    const auto disk = std::filesystem::space(options_.folder, error);
    const uint64_t least = std::min<uint64_t>(kLeastBytes, disk.capacity / kLeastPart);
    if (error || disk.available >= least) break;
    if (last) return "has a full disk: " + std::to_string(disk.available >> 10) + " KiB are left in " + options_.folder;
    cache_.ShrinkBy(least - disk.available);
  }
  return "";
}

void Worker::SendReportsIfDue() {
  for (auto& [token, held] : held_) {
    if (held.next_send_ns == 0 || now() < held.next_send_ns) continue;
    held.next_send_ns = now() + std::max<int64_t>(heartbeat_ns_, kSecond / 2);
    if (held.stage == Stage::kAwaitingGrant) {
      pb::WorkerMessage message;
      message.mutable_start_request()->set_token(token);
      Send(message);
    } else if (held.stage == Stage::kReporting) {
      Send(held.report);
    }
  }
}

void Worker::FlushLogs() {
  if (logs_.empty() || now() < logs_due_ns_) return;
  for (auto& [token, lines] : logs_) {
    pb::WorkerMessage message;
    message.mutable_log()->set_token(token);
    for (pb::TaskLogLine& line : lines) *message.mutable_log()->add_lines() = std::move(line);
    Send(message);
  }
  logs_.clear();
}

void Worker::AddLog(uint64_t token, const std::string& text, int64_t wall_ns) {
  constexpr size_t kMaxPending = 2'000;
  constexpr int64_t kLogDelayNs = 100'000'000;
  const auto held = held_.find(token);
  if (held == held_.end()) return;
  if (logs_.empty()) logs_due_ns_ = now() + kLogDelayNs;
  auto& lines = logs_[token];
  if (lines.size() >= kMaxPending) return;
  pb::TaskLogLine& line = lines.emplace_back();
  line.set_text(lines.size() == kMaxPending ? "(lines left out: too many at once)" : text);
  line.set_wall_ns(wall_ns);
  line.set_attempt(held->second.assignment.attempt());
}

void Worker::ReceiveMessages() {
  transport::Message message;
  while (socket_->Receive(&message)) {
    auto body = transport::Unpack<pb::CoordinatorMessage>(message);
    if (!body.ok()) continue;
    last_word_ns_ = now();
    next_complaint_ns_ = 0;
    Handle(*body);
  }
}

void Worker::Handle(const pb::CoordinatorMessage& message) {
  switch (message.message_case()) {
    case pb::CoordinatorMessage::kWelcome:
      if (!joined_)
        spdlog::info("joined {} as {} with {} slots", options_.coordinator, options_.name, options_.slots);
      joined_ = true;
      database_ = message.welcome().database();
      refused_.clear();
      heartbeat_ns_ = std::max<int64_t>(1, message.welcome().heartbeat_ms()) * 1'000'000;
      inline_limit_ = message.welcome().inline_limit();
      next_beat_ns_ = WhyUnable().empty() ? std::min(next_beat_ns_, now() + heartbeat_ns_ / 2) : 0;
      break;
    case pb::CoordinatorMessage::kAssign:
      Take(message.assign());
      break;
    case pb::CoordinatorMessage::kStartGranted: {
      const auto held = held_.find(message.start_granted().token());
      if (held != held_.end() && held->second.stage == Stage::kAwaitingGrant && !held->second.revoked) {
        held->second.stage = Stage::kQueued;
        held->second.next_send_ns = 0;
      }
      break;
    }
    case pb::CoordinatorMessage::kRevoke:
      Revoke(message.revoke().token(), message.revoke().reason());
      break;
    case pb::CoordinatorMessage::kResultReply:
      HandleReply(message.result_reply());
      break;
    case pb::CoordinatorMessage::kHeartbeatReply:
      NoteTrouble(message.heartbeat_reply().trouble());
      if (message.heartbeat_reply().known()) break;
      joined_ = false;
      next_beat_ns_ = 0;
      break;
    case pb::CoordinatorMessage::kDrain:
      if (!draining_) drain_since_ns_ = now();
      draining_ = true;
      break;
    case pb::CoordinatorMessage::kAnotherDatabase:
      MoveTo(message.another_database());
      break;
    case pb::CoordinatorMessage::kRefused:
      refused_ = message.refused();
      break;
    default:
      break;
  }
}

void Worker::Take(const pb::TaskAssignment& assignment) {
  const uint64_t token = assignment.token();
  if (assignment.database() != database_) return;
  if (held_.count(token) > 0 || done_tokens_.count(token) > 0) return;
  Held& held = held_[token];
  held.assignment = assignment;
  held.scratch = scratch_.path() + "/" + std::to_string(token);
  spdlog::debug("task {} of job {}, attempt {}", assignment.name(), assignment.job(), assignment.attempt());
  if (draining_) return ReportFailure(held, pb::ATTEMPT_OUTCOME_LOST, "given back: its worker is draining", true);
  held.input_paths.resize(static_cast<size_t>(assignment.inputs_size()));
  std::set<std::string> missing;
  for (int i = 0; i < assignment.inputs_size(); ++i) {
    const std::string& sha256 = assignment.inputs(i).sha256();
    cache_.Hold(sha256);
    if (!cache_.Find(sha256, &held.input_paths[static_cast<size_t>(i)])) missing.insert(sha256);
  }
  for (const std::string& sha256 : missing) {
    transfers_->Add({Transfer::Kind::kFetch, token, sha256, "", {}, database_});
    ++held.open_transfers;
  }
  if (missing.empty()) InputsAreHere(token, held);
}

void Worker::HandleReply(const pb::TaskResultReply& reply) {
  const auto found = held_.find(reply.token());
  if (found == held_.end()) return;
  Held& held = found->second;
  if (reply.missing_sha256_size() > 0) {
    if (held.stage == Stage::kReporting && held.report.has_finished()) {
      Upload(reply.token(), held, {reply.missing_sha256().begin(), reply.missing_sha256().end()});
    }
    return;
  }
  if (reply.try_again()) return NoteTrouble(reply.reason());  // it is sent again when it is due
  if (!reply.accepted() && !held.revoked)
    spdlog::warn("result of {} was refused: {}", held.assignment.name(), reply.reason());
  if (held.stage == Stage::kReporting) return Forget(reply.token());
  held.revoked = true;  // refused before it was sent: an answer to an older message
  Interrupt(held);
}

void Worker::Revoke(uint64_t token, const std::string& why) {
  const auto found = held_.find(token);
  if (found == held_.end()) return;
  Held& held = found->second;
  if (held.revoked) return;
  spdlog::info("task {} is taken back: {}", held.assignment.name(), why);
  held.revoked = true;
  if (held.stage != Stage::kRunning) return Forget(token);
  Interrupt(held);
}

// There its tokens are those of other tasks, or of none. It says hello as before until what runs has ended, and joins
// with an empty memory.
void Worker::MoveTo(const std::string& database) {
  joined_ = false;
  std::vector<uint64_t> tokens;
  for (const auto& [token, held] : held_) tokens.push_back(token);
  for (const uint64_t token : tokens) Revoke(token, "the coordinator has another database now");
  if (!held_.empty()) return;
  spdlog::warn("the coordinator at {} has another database than before", options_.coordinator);
  done_tokens_.clear();
  done_order_.clear();
  database_ = database;
  next_beat_ns_ = 0;
}

void Worker::NoteTrouble(const std::string& trouble) {
  if (trouble.empty() == trouble_.empty()) return;
  trouble_ = trouble;
  if (trouble.empty()) {
    spdlog::info("the coordinator takes results again");
  } else {
    spdlog::warn("the coordinator takes nothing new, results wait here: {}", trouble);
  }
}

void Worker::Forget(uint64_t token) {
  const auto found = held_.find(token);
  if (found == held_.end()) return;
  transfers_->Drop(token);
  if (found->second.revoked) next_beat_ns_ = 0;  // tells that the slot is free
  for (const auto& input : found->second.assignment.inputs()) cache_.Release(input.sha256());
  std::error_code ignored;
  std::filesystem::remove_all(found->second.scratch, ignored);
  held_.erase(found);
  logs_.erase(token);
  constexpr size_t kRemembered = 10'000;
  if (done_tokens_.insert(token).second) done_order_.push_back(token);
  while (done_order_.size() > kRemembered) {
    done_tokens_.erase(done_order_.front());
    done_order_.pop_front();
  }
}

}  // namespace rg::worker
