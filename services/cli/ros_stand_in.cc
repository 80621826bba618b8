#include "services/cli/ros_stand_in.h"

#include <arpa/inet.h>
#include <stdlib.h>
#include <sys/socket.h>
#include <unistd.h>

#include <filesystem>
#include <thread>

#include "common/base/clock.h"
#include "services/cli/context.h"

namespace rg::cli {
namespace {

constexpr char kPython[] = "/usr/bin/python3";
constexpr char kRosMaster[] = "/usr/bin/rosmaster";
constexpr char kStandIn[] = "realitygrad-kinova-stand-in";
constexpr char kStateInterval[] = "0.04";  // s; 25 Hz
constexpr double kStartTimeout = 30.0;

sockaddr_in Loopback(int port) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  address.sin_port = htons(static_cast<uint16_t>(port));
  return address;
}

Result<int> FreePort() {
  const int file = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  sockaddr_in address = Loopback(0);
  socklen_t size = sizeof address;
  auto* const any = reinterpret_cast<sockaddr*>(&address);
  const bool found = file >= 0 && bind(file, any, size) == 0 && getsockname(file, any, &size) == 0;
  if (file >= 0) close(file);
  if (!found) return UnavailableError("no free port on loopback for the ROS master");
  return static_cast<int>(ntohs(address.sin_port));
}

bool Answers(int port) {
  const int file = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
  const sockaddr_in address = Loopback(port);
  const bool answers = connect(file, reinterpret_cast<const sockaddr*>(&address), sizeof address) == 0;
  close(file);
  return answers;
}

Status AwaitMaster(int port, ChildProcesses* children) {
  const double give_up = RealClock().SteadySeconds() + kStartTimeout;
  while (!Answers(port)) {
    RG_RETURN_IF_ERROR(children->Check());
    if (RealClock().SteadySeconds() > give_up)
      return UnavailableError("the ROS master did not answer within " +
                              std::to_string(static_cast<int>(kStartTimeout)) + " s");
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }
  return Status::Ok();
}

}  // namespace

Status CheckRosStandIn() {
  if (!std::filesystem::exists(kRosMaster))
    return FailedPreconditionError(std::string(kRosMaster) + " is missing: install python3-rosmaster");
  const std::string program = SiblingProgram(kStandIn);
  if (std::filesystem::exists(program)) return Status::Ok();
  return FailedPreconditionError(program +
                                 " is missing: `realitygrad doctor` says whether this build has ROS; "
                                 "build the target `programs`");
}

Status StartRosStandIn(const RosStandInOptions& options, ChildProcesses* children) {
  RG_RETURN_IF_ERROR(CheckRosStandIn());
  RG_ASSIGN_OR_RETURN(const int port, FreePort());
  const std::string home = std::filesystem::absolute(options.folder + "/ros").string();
  std::error_code error;
  std::filesystem::create_directories(home, error);
  if (error) return InvalidError(home + ": cannot create: " + error.message());
  setenv("ROS_MASTER_URI", ("http://127.0.0.1:" + std::to_string(port)).c_str(), 1);
  setenv("ROS_IP", "127.0.0.1", 1);
  setenv("ROS_HOME", home.c_str(), 1);
  setenv("ROS_LOG_DIR", home.c_str(), 1);
  RG_RETURN_IF_ERROR(children->Start("ROS master",
                                     {kPython, kRosMaster, "--core", "-p", std::to_string(port)},
                                     options.folder + "/logs/ros-master.log"));
  RG_RETURN_IF_ERROR(AwaitMaster(port, children));
  return children->Start("stand-in",
                         {SiblingProgram(kStandIn), "--config", options.config, "--seed",
                          std::to_string(options.seed), "--state-interval", kStateInterval},
                         options.folder + "/logs/stand-in.log");
}

}  // namespace rg::cli
