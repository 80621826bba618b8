// Hosts on one machine: network namespaces on a bridge.
#pragma once

#include <unistd.h>

#include <cstdlib>
#include <string>
#include <utility>
#include <vector>

#include "common/base/ids.h"

namespace rg::testing {

inline bool Shell(const std::string& command) { return std::system((command + " >/dev/null 2>&1").c_str()) == 0; }

// Three namespaces h1..h3 (network + 1..3), and a fourth that holds the bridge between them.
class Hosts {
 public:
  // Why there can be none here; empty: there can.
  static std::string WhyNot() {
    if (geteuid() != 0) return "needs root to make network namespaces";
    return Shell("ip -V") ? "" : "the program ip (iproute2) is missing";
  }
  // `network`: "10.0.0."
  explicit Hosts(std::string network) : prefix_("rg" + RandomHex(3)), network_(std::move(network)) {
    ok_ = Shell("ip netns add " + Name(0)) && Shell("ip -n " + Name(0) + " link add br0 type bridge") &&
          Shell("ip -n " + Name(0) + " link set br0 up");
    for (int i = 1; i <= 3 && ok_; ++i) ok_ = AddHost(i);
  }
  ~Hosts() {
    for (int i = 0; i <= 3; ++i) Shell("ip netns del " + Name(i));
  }
  bool ok() const { return ok_; }
  std::string Name(int host) const { return prefix_ + "h" + std::to_string(host); }
  // Pulls the host's cable, or puts it back.
  void Plug(int host, bool in) const {
    Shell("ip -n " + Name(0) + " link set port" + std::to_string(host) + (in ? " up" : " down"));
  }
  std::vector<std::string> On(int host, std::vector<std::string> arguments) const {
    std::vector<std::string> all = {"ip", "netns", "exec", Name(host)};
    all.insert(all.end(), arguments.begin(), arguments.end());
    return all;
  }

 private:
  bool AddHost(int host) {
    const std::string name = Name(host), number = std::to_string(host);
    return Shell("ip netns add " + name) &&
           Shell("ip -n " + name + " link add eth0 type veth peer name port" + number + " netns " +
                 Name(0)) &&
           Shell("ip -n " + Name(0) + " link set port" + number + " master br0 up") &&
           Shell("ip -n " + name + " addr add " + network_ + number + "/24 dev eth0") &&
           Shell("ip -n " + name + " link set eth0 up") && Shell("ip -n " + name + " link set lo up");
  }
  std::string prefix_, network_;
  bool ok_ = false;
};

}  // namespace rg::testing
