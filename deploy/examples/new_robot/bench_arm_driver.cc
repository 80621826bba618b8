#include "bench_arm_driver.h"

#include <arpa/inet.h>
#include <netinet/tcp.h>
#include <sys/socket.h>
#include <time.h>
#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <mutex>
#include <nlohmann/json.hpp>
#include <sstream>
#include <thread>

#include "common/base/clock.h"

namespace bench_arm {
namespace {

using namespace rg;               // Status, Result
using namespace rg::robot_agent;  // Driver and what it takes

constexpr int64_t kStale = 500'000'000;  // ns without a state: the arm is gone

class BenchArm final : public Driver {
 public:
  BenchArm(std::string address, int port, std::vector<std::string> joints, std::string robot)
      : address_(std::move(address)), port_(port) {
    info_.robot = std::move(robot);
    info_.driver = "bench_arm";
    info_.joints = std::move(joints);
    info_.adds_gravity_compensation = false;  // this arm wants whole torques
    info_.silence_timeout_s = 0.25;           // then its controller goes to position mode
    info_.state_rate_hz = 100.0;
  }
  ~BenchArm() override {
    ended_ = true;
    if (socket_ >= 0) shutdown(socket_, SHUT_RDWR);
    if (listener_.joinable()) listener_.join();
    if (socket_ >= 0) close(socket_);
  }

  Status Connect(double timeout_s) override {
    socket_ = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    sockaddr_in there{};
    there.sin_family = AF_INET;
    there.sin_port = htons(static_cast<uint16_t>(port_));
    if (inet_pton(AF_INET, address_.c_str(), &there.sin_addr) != 1)
      return InvalidError("bench_arm: address \"" + address_ + "\" is not of the form 127.0.0.1");
    if (connect(socket_, reinterpret_cast<sockaddr*>(&there), sizeof there) != 0)
      return UnavailableError("no arm answers at " + address_ + ":" + std::to_string(port_) + ": " +
                              std::strerror(errno));
    const int on = 1;
    setsockopt(socket_, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    listener_ = std::thread([this] { Listen(); });
    const int64_t give_up = NowNanos() + std::llround(1e9 * timeout_s);
    RobotState state;
    while (!ReadState(&state).ok()) {
      if (NowNanos() > give_up) return DeadlineExceededError("the arm sends no states");
      (void)SleepUntil(NowNanos() + 5'000'000).ok();
    }
    return Hold();  // whoever was here before may have left it under torque
  }

  const DriverInfo& info() const override { return info_; }
  DriverHealth health() const override {
    const std::lock_guard lock(mutex_);
    return health_;
  }
  int64_t NowNanos() const override { return RealClock().SteadyNanos(); }
  Status SleepUntil(int64_t deadline_ns) override {
    const timespec until{deadline_ns / 1'000'000'000, deadline_ns % 1'000'000'000};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, nullptr) == EINTR) {
    }
    return Status::Ok();
  }
  Status ReadState(RobotState* state) override {
    const std::lock_guard lock(mutex_);
    if (state_.sequence == 0 || NowNanos() - received_ns_ > kStale)
      return UnavailableError("the arm sends no states");
    *state = state_;
    return Status::Ok();
  }
  Status EnterTorqueMode(const double* first) override {
    RG_RETURN_IF_ERROR(Send("E", first));
    // The arm says its mode: wait for it, so that a refusal is known as one.
    RobotState state;
    for (int look = 0; look < 100; ++look) {
      (void)SleepUntil(NowNanos() + 5'000'000).ok();
      RG_RETURN_IF_ERROR(ReadState(&state));
      if (state.mode == Mode::kTorque) return Status::Ok();
      RG_RETURN_IF_ERROR(Send("T", first));
    }
    return FailedPreconditionError("the arm did not enter torque mode");
  }
  Status SendTorque(const double* tau) override { return Send("T", tau); }
  Status StartMove(const double* q) override {
    {
      const std::lock_guard lock(mutex_);
      state_.moving = true;  // until a state says otherwise
    }
    return Send("P", q);
  }
  Status Hold() override { return Send("H", nullptr); }

 private:
  // "T 0.5 -1.25\n"
  Status Send(const char* word, const double* values) {
    std::string line = word;
    for (int i = 0; values != nullptr && i < n(); ++i) {
      char text[40];
      std::snprintf(text, sizeof text, " %.9g", values[i]);
      line += text;
    }
    line += "\n";
    const std::lock_guard lock(sending_);
    if (send(socket_, line.data(), line.size(), MSG_NOSIGNAL) != static_cast<ssize_t>(line.size()))
      return UnavailableError("the arm's connection is gone");
    return Status::Ok();
  }

  void Listen() {
    std::string buffer;
    char bytes[4096];
    while (!ended_) {
      const ssize_t count = recv(socket_, bytes, sizeof bytes, 0);
      if (count <= 0) return;
      buffer.append(bytes, static_cast<size_t>(count));
      for (size_t end; (end = buffer.find('\n')) != std::string::npos; buffer.erase(0, end + 1))
        Take(buffer.substr(0, end));
    }
  }

  // "S microseconds mode moving q… v… effort…": stamps are of the arm's clock, which began when it was switched on.
  void Take(const std::string& line) {
    std::istringstream in(line);
    std::string word;
    int64_t micros = 0;
    int mode = 0, moving = 0;
    RobotState next;
    in >> word >> micros >> mode >> moving;
    for (JointArray* values : {&next.q, &next.v, &next.effort})
      for (int i = 0; i < n(); ++i) in >> (*values)[i];
    const int64_t now = NowNanos();
    const std::lock_guard lock(mutex_);
    if (!in || word != "S") {
      ++health_.malformed;
      return;
    }
    // The fastest message so far tells how the two clocks stand to each other.
    offset_ns_ = std::min(offset_ns_, now - 1000 * micros);
    next.stamp_ns = 1000 * micros + offset_ns_;
    next.sequence = state_.sequence + 1;
    next.mode = mode != 0 ? Mode::kTorque : Mode::kPosition;
    next.moving = moving != 0;
    state_ = next;
    received_ns_ = now;
    ++health_.states_received;
    health_.connected = true;
  }

  int n() const { return static_cast<int>(info_.joints.size()); }

  const std::string address_;
  const int port_;
  DriverInfo info_;
  int socket_ = -1;
  std::thread listener_;
  std::atomic<bool> ended_{false};
  mutable std::mutex mutex_;
  std::mutex sending_;
  RobotState state_;
  DriverHealth health_;
  int64_t received_ns_ = 0, offset_ns_ = INT64_MAX;
};

}  // namespace

Result<std::unique_ptr<Driver>> MakeBenchArm(const DriverRequest& request) {
  try {
    const auto options = nlohmann::json::parse(request.options);
    return std::unique_ptr<Driver>(std::make_unique<BenchArm>(
        options.value("address", "127.0.0.1"), options.at("port").get<int>(),
        options.at("joints").get<std::vector<std::string>>(), request.robot));
  } catch (const nlohmann::json::exception& error) {
    return InvalidError(std::string("bench_arm: ") + error.what());
  }
}

}  // namespace bench_arm
