// realitygrad-simulated-robot: a robot with physics that the model lacks, as a process of its own.
#include <CLI/CLI.hpp>
#include <iostream>

#include "common/base/log.h"
#include "robot_agent/drivers/packet_socket.h"
#include "robot_agent/simulated_robot/robot_server.h"

namespace rg::robot_agent {
namespace {

struct Flags {
  std::string truth, socket_path;
  uint64_t seed = 1;
  int socket_fd = -1;
  bool allow_faults = false;
};

// A robot on a path outlives its drivers: the next one finds it where the last one left it.
Status ServeForEver(RobotWorld& world, const Flags& flags) {
  RG_ASSIGN_OR_RETURN(const PacketSocket listener, PacketSocket::Listen(flags.socket_path));
  spdlog::info("waiting for a driver at {}", flags.socket_path);
  while (true) {
    RG_ASSIGN_OR_RETURN(const PacketSocket socket, listener.Accept());
    RG_RETURN_IF_ERROR(ServeRobot(world, socket, flags.allow_faults));
    world.Hold();
  }
}

Status Run(const Flags& flags) {
  RG_ASSIGN_OR_RETURN(const RobotTruth truth, LoadRobotTruth(flags.truth));
  RobotWorld world(truth, flags.seed);
  if (flags.socket_fd >= 0) return ServeRobot(world, PacketSocket(flags.socket_fd), flags.allow_faults);
  return ServeForEver(world, flags);
}

}  // namespace
}  // namespace rg::robot_agent

int main(int argc, char** argv) {
  rg::robot_agent::Flags flags;
  CLI::App app("A robot arm with physics that the model lacks, for the agent's driver `simulated`.",
               "realitygrad-simulated-robot");
  app.add_option("--truth", flags.truth, "realitygrad.robot_truth/1, e.g. deploy/robots/mico2_truth.json")
      ->required()
      ->check(CLI::ExistingFile);
  app.add_option("--seed", flags.seed, "seed of the sensor noise");
  auto* path = app.add_option("--socket", flags.socket_path, "listen at this path");
  auto* fd = app.add_option("--socket-fd", flags.socket_fd, "serve the driver on this open socket");
  path->excludes(fd);
  app.add_flag("--allow-faults", flags.allow_faults, "let the driver ask for faults (tests)");
  CLI11_PARSE(app, argc, argv);
  if (flags.socket_path.empty() && flags.socket_fd < 0) {
    std::cerr << "realitygrad-simulated-robot: needs --socket or --socket-fd\n";
    return 2;
  }
  rg::InitLogging("simulated-robot");
  const rg::Status status = rg::robot_agent::Run(flags);
  if (status.ok()) return 0;
  spdlog::error("{}", status.ToString());
  return 1;
}
