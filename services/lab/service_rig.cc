#include "services/lab/service_rig.h"

#include <stdlib.h>
#include <unistd.h>

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/transport/keys.h"
#include "coordinator/client/client.h"
#include "services/cli/context.h"

namespace rg::lab {
namespace {

namespace fs = std::filesystem;
namespace pb = ::realitygrad::v1;

constexpr int kPatienceS = 60;

// A line "Name:   123 kB" of /proc/PID/status, in MiB.
double StatusMiB(int pid, const std::string& name) {
  std::ifstream file("/proc/" + std::to_string(pid) + "/status");
  for (std::string line; std::getline(file, line);) {
    if (line.rfind(name + ":", 0) == 0) return std::stod(line.substr(name.size() + 1)) / 1024.0;
  }
  return 0.0;
}

}  // namespace

Result<std::unique_ptr<ServiceRig>> ServiceRig::Make(const CancelToken* cancel) {
  char folder[] = "/var/tmp/realitygrad-bench-XXXXXX";
  if (mkdtemp(folder) == nullptr) return InternalError("/var/tmp: cannot make a folder");
  std::unique_ptr<ServiceRig> rig(new ServiceRig(folder, cancel));
  RG_RETURN_IF_ERROR(rig->MakeKeys());
  return rig;
}

ServiceRig::~ServiceRig() {
  client_.reset();
  workers_.StopAll(3.0);
  coordinator_.StopAll(10.0);
  std::error_code error;
  fs::remove_all(folder_, error);
}

Status ServiceRig::MakeKeys() {
  const std::string keys = folder_ + "/keys";
  const std::pair<const char*, pb::Role> owners[] = {
      {"coordinator", pb::ROLE_COORDINATOR}, {"worker", pb::ROLE_WORKER}, {"operator", pb::ROLE_OPERATOR}};
  for (const auto& [name, role] : owners) {
    RG_ASSIGN_OR_RETURN(const auto key, transport::GenerateKeyFiles(keys, name, role));
    if (role == pb::ROLE_COORDINATOR) continue;
    RG_RETURN_IF_ERROR(transport::AllowKey(keys + "/allowed_keys", key.keys.public_key, role, name));
  }
  return Status::Ok();
}

Result<double> ServiceRig::StartCoordinator() {
  const std::string address_file = folder_ + "/address";
  std::error_code error;
  fs::remove(address_file, error);
  const double begin = RealClock().SteadySeconds();
  RG_RETURN_IF_ERROR(coordinator_.Start(
      "coordinator",
      {cli::SiblingProgram("realitygrad-coordinator"), "--listen", "tcp://127.0.0.1:0", "--address-file",
       address_file, "--db", database(), "--key", folder_ + "/keys/coordinator.key", "--allowed-keys",
       folder_ + "/keys/allowed_keys"},
      folder_ + "/coordinator.log"));
  while (!fs::exists(address_file)) {
    RG_RETURN_IF_ERROR(Check());
    if (RealClock().SteadySeconds() > begin + kPatienceS)
      return UnavailableError("the coordinator does not listen after a minute");
    usleep(2'000);
  }
  RG_ASSIGN_OR_RETURN(address_, ReadFile(address_file));
  while (!address_.empty() && address_.back() == '\n') address_.pop_back();
  RG_ASSIGN_OR_RETURN(client_, NewClient());
  RG_RETURN_IF_ERROR(client_->CoordinatorStatus().status());
  return RealClock().SteadySeconds() - begin;
}

void ServiceRig::StopCoordinator() {
  client_.reset();
  coordinator_.StopAll(20.0);
}

Result<std::unique_ptr<coordinator::Client>> ServiceRig::NewClient() const {
  RG_ASSIGN_OR_RETURN(const auto own, transport::LoadKeyFile(folder_ + "/keys/operator.key"));
  RG_ASSIGN_OR_RETURN(const auto server, transport::LoadPublicKeyFile(folder_ + "/keys/coordinator.pub"));
  coordinator::ClientOptions options;
  options.address = address_;
  options.key = own.keys;
  options.server_public_key = server.keys.public_key;
  options.attempt_timeout_ms = 60'000;
  options.name = "bench";
  return coordinator::Client::Connect(options);
}

Status ServiceRig::StartSimulatedWorkers(const std::string& prefix, const std::vector<std::string>& flags) {
  std::vector<std::string> command({cli::SiblingProgram("realitygrad-lab"), "bench", "simulated-workers",
                                    "--coordinator", address_, "--key", folder_ + "/keys/worker.key",
                                    "--server-key", folder_ + "/keys/coordinator.pub", "--prefix", prefix});
  command.insert(command.end(), flags.begin(), flags.end());
  return workers_.Start(prefix, command, folder_ + "/" + prefix + ".log");
}

Status ServiceRig::StartWorker(const std::string& name, int slots) {
  return workers_.Start(name,
                        {cli::SiblingProgram("realitygrad-worker"), "--coordinator", address_, "--name", name,
                         "--slots", std::to_string(slots), "--folder", folder_ + "/" + name, "--key",
                         folder_ + "/keys/worker.key", "--server-key", folder_ + "/keys/coordinator.pub"},
                        folder_ + "/" + name + ".log");
}

void ServiceRig::StopWorkers(double grace_s) { workers_.StopAll(grace_s); }

Status ServiceRig::AwaitWorkers(size_t count) {
  const double deadline = RealClock().SteadySeconds() + kPatienceS;
  size_t seen = 0;
  while (RealClock().SteadySeconds() < deadline) {
    RG_RETURN_IF_ERROR(Check());
    RG_ASSIGN_OR_RETURN(const auto status, client_->CoordinatorStatus());
    seen = status.workers();
    if (seen >= count) return Status::Ok();
    usleep(20'000);
  }
  return UnavailableError("only " + std::to_string(seen) + " of " + std::to_string(count) +
                          " workers joined within a minute");
}

Status ServiceRig::Check() {
  if (cancel_ != nullptr && cancel_->cancelled()) return CancelledError("interrupted");
  RG_RETURN_IF_ERROR(coordinator_.Check());
  return workers_.Check();
}

double ServiceRig::CoordinatorCpuSeconds() const {
  std::ifstream file("/proc/" + std::to_string(coordinator_.first_pid()) + "/stat");
  std::stringstream text;
  text << file.rdbuf();
  const std::string line = text.str();
  const size_t paren = line.rfind(')');
  if (paren == std::string::npos) return 0.0;
  std::istringstream fields(line.substr(paren + 1));
  std::string skipped;
  for (int i = 0; i < 11; ++i) fields >> skipped;  // state and ten more
  double user = 0.0, system = 0.0;
  fields >> user >> system;
  return (user + system) / static_cast<double>(sysconf(_SC_CLK_TCK));
}

double ServiceRig::CoordinatorMiB(bool peak) const {
  return StatusMiB(coordinator_.first_pid(), peak ? "VmHWM" : "VmRSS");
}

}  // namespace rg::lab
