// A ROS master on a port of its own and the stand-in, as children of the test; everything on loopback, in a
// scratch folder.
#pragma once

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "common/base/file.h"
#include "common/base/ids.h"

namespace rg {

inline constexpr char kRosMaster[] = "/usr/bin/rosmaster";

inline std::string Environment(const char* name) {
  const char* value = std::getenv(name);
  return value != nullptr ? value : ".";
}

inline int FreePort() {
  const int file = socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  socklen_t size = sizeof address;
  int port = -1;
  if (bind(file, reinterpret_cast<sockaddr*>(&address), size) == 0 &&
      getsockname(file, reinterpret_cast<sockaddr*>(&address), &size) == 0)
    port = ntohs(address.sin_port);
  close(file);
  return port;
}

inline bool Answers(int port) {
  const int file = socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<uint16_t>(port));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  const bool answers = connect(file, reinterpret_cast<sockaddr*>(&address), sizeof address) == 0;
  close(file);
  return answers;
}

class Child {
 public:
  Child() = default;
  Child(const std::vector<std::string>& words, const std::string& log) {
    pid_ = fork();
    if (pid_ != 0) return;
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    if (std::freopen(log.c_str(), "w", stdout) == nullptr || dup2(1, 2) < 0) _exit(126);
    std::vector<char*> argv;
    for (const std::string& word : words) argv.push_back(const_cast<char*>(word.c_str()));
    argv.push_back(nullptr);
    execv(argv[0], argv.data());
    _exit(127);
  }
  Child(Child&& other) noexcept { std::swap(pid_, other.pid_); }
  Child& operator=(Child&& other) noexcept {
    std::swap(pid_, other.pid_);
    return *this;
  }
  ~Child() { Stop(); }
  void Stop() {
    if (pid_ <= 0) return;
    kill(pid_, SIGTERM);
    for (int i = 0; i < 300 && waitpid(pid_, nullptr, WNOHANG) == 0; ++i) usleep(10'000);
    if (kill(pid_, 0) == 0) {
      kill(pid_, SIGKILL);
      waitpid(pid_, nullptr, 0);
    }
    pid_ = -1;
  }
  void Signal(int number) const { kill(pid_, number); }

 private:
  pid_t pid_ = -1;
};

// One master for all tests of the program: a process has one ROS node.
class RosTest : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    if (!std::filesystem::exists(kRosMaster)) return;
    folder_ = new std::string(std::filesystem::temp_directory_path() / ("rg_ros_" + RandomHex(6)));
    std::filesystem::create_directories(*folder_);
    port_ = FreePort();
    setenv("ROS_MASTER_URI", ("http://127.0.0.1:" + std::to_string(port_)).c_str(), 1);
    setenv("ROS_IP", "127.0.0.1", 1);
    setenv("ROS_HOME", folder_->c_str(), 1);
    setenv("ROS_LOG_DIR", folder_->c_str(), 1);
    master_ = new Child;
    StartMaster();
  }
  // On the port of the one before it.
  static void StartMaster() {
    *master_ = Child({"/usr/bin/python3", kRosMaster, "--core", "-p", std::to_string(port_)},
                     *folder_ + "/master.log");
    for (int i = 0; i < 1000 && !Answers(port_); ++i) usleep(20'000);
  }
  static void TearDownTestSuite() {
    delete master_;
    master_ = nullptr;
    std::error_code error;
    if (folder_ != nullptr) std::filesystem::remove_all(*folder_, error);
  }
  void SetUp() override {
    if (master_ == nullptr) GTEST_SKIP() << "SKIPPED: no rosmaster here (python3-rosmaster)";
    ASSERT_TRUE(Answers(port_)) << ReadFile(*folder_ + "/master.log").value();
  }

  // The Mico²'s stand-in after `edit` of its configuration.
  static Child StartStandIn(const std::function<void(nlohmann::json&)>& edit,
                            double state_interval_s = 0.04) {
    const std::string robots = Environment("RG_SOURCE_DIR") + "/deploy/robots/";
    nlohmann::json config = nlohmann::json::parse(ReadFile(robots + "mico2_stand_in.json").value());
    config["truth"] = std::filesystem::absolute(robots + config["truth"].get<std::string>());
    edit(config);
    const std::string path = *folder_ + "/stand_in.json";
    EXPECT_TRUE(WriteFileAtomically(path, config.dump()).ok());
    return Child({Environment("RG_BIN_DIR") + "/realitygrad-kinova-stand-in", "--config", path,
                  "--state-interval", std::to_string(state_interval_s)},
                 *folder_ + "/stand_in.log");
  }

  static inline std::string* folder_ = nullptr;
  static inline Child* master_ = nullptr;
  static inline int port_ = -1;
};

}  // namespace rg
