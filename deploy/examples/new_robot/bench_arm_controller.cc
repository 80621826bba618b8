// Plays the arm and its controller: two joints with friction that its URDF knows nothing of, lines of text over TCP, so
// that the example can be tried without an arm. bench_arm_controller TRUTH.json PORT
#include <arpa/inet.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <sstream>

#include "common/base/clock.h"
#include "robot_agent/simulated_robot/robot_world.h"
#include "robot_agent/simulated_robot/truth.h"

namespace {

using namespace rg;
using namespace rg::robot_agent;

void Obey(const std::string& line, int n, RobotWorld* world) {
  std::istringstream in(line);
  std::string word;
  JointArray values{};
  in >> word;
  for (int i = 0; i < n; ++i) in >> values[i];
  if (word == "H") return world->Hold();
  if (!in) return;
  if (word == "E") world->EnterTorque(values.data());
  if (word == "T" && world->mode() == Mode::kTorque) world->Torque(values.data());
  if (word == "P") world->MoveTo(values.data());
}

std::string Line(const RobotState& state, int n) {
  std::ostringstream out;
  out.precision(9);
  out << "S " << state.stamp_ns / 1000 << ' ' << (state.mode == Mode::kTorque) << ' ' << state.moving;
  for (const JointArray* values : {&state.q, &state.v, &state.effort})
    for (int i = 0; i < n; ++i) out << ' ' << (*values)[i];
  return out.str() + "\n";
}

// Until the connection ends; time goes on meanwhile.
void Serve(int connection, int n, int64_t epoch_ns, RobotWorld* world) {
  std::string buffer;
  while (true) {
    pollfd waiting{connection, POLLIN, 0};
    poll(&waiting, 1, 2);
    world->AdvanceTo(RealClock().SteadyNanos() - epoch_ns);
    if (waiting.revents != 0) {
      char bytes[4096];
      const ssize_t count = recv(connection, bytes, sizeof bytes, 0);
      if (count <= 0) return world->Hold();
      buffer.append(bytes, static_cast<size_t>(count));
      for (size_t end; (end = buffer.find('\n')) != std::string::npos; buffer.erase(0, end + 1))
        Obey(buffer.substr(0, end), n, world);
    }
    RobotState state;
    if (!world->TakeState(&state)) continue;
    const std::string line = Line(state, n);
    if (send(connection, line.data(), line.size(), MSG_NOSIGNAL) < 0) return world->Hold();
  }
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 3) return std::cerr << "bench_arm_controller TRUTH.json PORT\n", 2;
  auto truth = LoadRobotTruth(argv[1]);
  if (!truth.ok()) return std::cerr << truth.status().message() << "\n", 1;
  RobotWorld world(*truth, 1);
  const int listening = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0), on = 1;
  setsockopt(listening, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
  sockaddr_in here{};
  here.sin_family = AF_INET;
  here.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  here.sin_port = htons(static_cast<uint16_t>(std::atoi(argv[2])));
  if (bind(listening, reinterpret_cast<sockaddr*>(&here), sizeof here) != 0 || listen(listening, 1) != 0)
    return std::perror("bench_arm_controller"), 1;
  const int64_t epoch = RealClock().SteadyNanos();
  while (true) {
    const int connection = accept(listening, nullptr, nullptr);
    if (connection < 0) continue;
    setsockopt(connection, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    Serve(connection, truth->n(), epoch, &world);
    close(connection);
  }
}
