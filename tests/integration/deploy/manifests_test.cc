// What deploy/ hands to systemd, Docker, Kubernetes and Slurm fits together, and fits the programs: every
// flag that it gives them is one they have, every name that it refers to is there.
#include <gtest/gtest.h>
#include <unistd.h>
#include <yaml-cpp/yaml.h>

#include <cstdlib>
#include <filesystem>
#include <map>
#include <regex>
#include <set>
#include <sstream>
#include <string>
#include <vector>

#include "common/base/file.h"

namespace rg {
namespace {

namespace fs = std::filesystem;

std::string Deploy() {
  const char* source = std::getenv("RG_SOURCE_DIR");
  return std::string(source ? source : ".") + "/deploy";
}

std::string OutputOf(const std::string& command) {
  FILE* pipe = popen((command + " 2>&1").c_str(), "r");
  std::string text;
  char piece[4096];
  for (size_t n; (n = fread(piece, 1, sizeof piece, pipe)) > 0;) text.append(piece, n);
  pclose(pipe);
  return text;
}

// The long flags of a program of this build, from its --help.
std::set<std::string> FlagsOf(const std::string& program) {
  const char* bin = std::getenv("RG_BIN_DIR");
  const std::string help = OutputOf(std::string(bin ? bin : ".") + "/realitygrad-" + program + " --help");
  std::set<std::string> flags;
  const std::regex flag("--[a-z][a-z0-9-]*");
  for (std::sregex_iterator it(help.begin(), help.end(), flag), end; it != end; ++it) flags.insert(it->str());
  return flags;
}

// Every word that begins with -- is a flag of the program that the first word names.
void ExpectItsFlags(const std::vector<std::string>& words, const std::string& where) {
  ASSERT_FALSE(words.empty()) << where;
  ASSERT_TRUE(words[0] == "coordinator" || words[0] == "worker" || words[0] == "agent")
      << where << ": " << words[0];
  const std::set<std::string> flags = FlagsOf(words[0]);
  ASSERT_GT(flags.size(), 5u) << words[0];
  for (size_t i = 1; i < words.size(); ++i) {
    if (words[i].rfind("--", 0) == 0) {
      EXPECT_EQ(flags.count(words[i]), 1u) << where << ": " << words[i];
    }
  }
}

std::vector<std::string> Words(const YAML::Node& list) {
  std::vector<std::string> words;
  for (const auto& word : list) words.push_back(word.as<std::string>());
  return words;
}

// By "Kind/name".
std::map<std::string, YAML::Node> Manifests() {
  std::map<std::string, YAML::Node> all;
  const YAML::Node kustomization = YAML::LoadFile(Deploy() + "/kubernetes/kustomization.yaml");
  std::vector<std::string> files = Words(kustomization["resources"]);
  files.push_back("secret.example.yaml");
  for (const std::string& file : files) {
    for (const YAML::Node& document : YAML::LoadAllFromFile(Deploy() + "/kubernetes/" + file)) {
      EXPECT_TRUE(document["apiVersion"] && document["kind"] && document["metadata"]["name"]) << file;
      all[document["kind"].as<std::string>() + "/" + document["metadata"]["name"].as<std::string>()] =
          document;
    }
  }
  return all;
}

void ExpectSamePods(const YAML::Node& selector, const YAML::Node& labels, const std::string& where) {
  ASSERT_TRUE(selector.IsMap() && selector.size() > 0) << where;
  for (const auto& wanted : selector)
    EXPECT_EQ(labels[wanted.first.as<std::string>()].as<std::string>(""), wanted.second.as<std::string>())
        << where;
}

// Mounts name volumes, probes name ports, arguments are the program's; nothing runs as root or writes to its
// image.
void ExpectASoundPod(const YAML::Node& owner, const std::string& name) {
  const YAML::Node pod = owner["spec"]["template"]["spec"];
  EXPECT_TRUE(pod["securityContext"]["runAsNonRoot"].as<bool>(false)) << name;
  std::set<std::string> volumes, ports;
  for (const auto& volume : pod["volumes"]) volumes.insert(volume["name"].as<std::string>());
  for (const auto& claim : owner["spec"]["volumeClaimTemplates"])
    volumes.insert(claim["metadata"]["name"].as<std::string>());
  for (const char* kind : {"initContainers", "containers"}) {
    for (const auto& container : pod[kind]) {
      for (const auto& mount : container["volumeMounts"])
        EXPECT_EQ(volumes.count(mount["name"].as<std::string>()), 1u) << name << ": " << mount["name"];
      for (const auto& port : container["ports"]) ports.insert(port["name"].as<std::string>());
      const YAML::Node security = container["securityContext"];
      EXPECT_TRUE(security["readOnlyRootFilesystem"].as<bool>(false)) << name;
      EXPECT_FALSE(security["allowPrivilegeEscalation"].as<bool>(true)) << name;
      EXPECT_TRUE(container["resources"]["limits"]["memory"]) << name;
      if (container["args"]) ExpectItsFlags(Words(container["args"]), name);
      for (const char* probe : {"startupProbe", "readinessProbe", "livenessProbe"}) {
        for (const char* how : {"httpGet", "tcpSocket"}) {
          if (container[probe] && container[probe][how]) {
            EXPECT_EQ(ports.count(container[probe][how]["port"].as<std::string>()), 1u) << name;
          }
        }
      }
    }
  }
}

TEST(Kubernetes, ManifestsFitTogetherAndFitThePrograms) {
  const auto all = Manifests();
  for (const char* name :
       {"Namespace/realitygrad", "StatefulSet/realitygrad-coordinator", "Service/realitygrad-coordinator",
        "Deployment/realitygrad-worker", "ScaledObject/realitygrad-worker", "Secret/realitygrad-keys"})
    ASSERT_EQ(all.count(name), 1u) << name;
  for (const char* name : {"StatefulSet/realitygrad-coordinator", "Deployment/realitygrad-worker"}) {
    const YAML::Node& owner = all.at(name);
    ExpectSamePods(owner["spec"]["selector"]["matchLabels"], owner["spec"]["template"]["metadata"]["labels"],
                   name);
    ExpectASoundPod(owner, name);
  }
  const YAML::Node& coordinator = all.at("StatefulSet/realitygrad-coordinator");
  EXPECT_EQ(coordinator["spec"]["replicas"].as<int>(), 1);
  EXPECT_EQ(all.count("Service/" + coordinator["spec"]["serviceName"].as<std::string>()), 1u);
  ExpectSamePods(all.at("Service/realitygrad-coordinator")["spec"]["selector"],
                 coordinator["spec"]["template"]["metadata"]["labels"], "Service");
}

TEST(Kubernetes, KedaScalesTheWorkersByTheDemand) {
  const auto all = Manifests();
  const YAML::Node scaled = all.at("ScaledObject/realitygrad-worker")["spec"];
  EXPECT_EQ(all.count("Deployment/" + scaled["scaleTargetRef"]["name"].as<std::string>()), 1u);
  EXPECT_FALSE(all.at("Deployment/realitygrad-worker")["spec"]["replicas"]) << "two would set them";
  const YAML::Node trigger = scaled["triggers"][0];
  EXPECT_EQ(trigger["type"].as<std::string>(), "metrics-api");
  const YAML::Node metadata = trigger["metadata"];
  EXPECT_EQ(metadata["url"].as<std::string>(),
            "http://realitygrad-coordinator.realitygrad.svc:7342/api/demand");
  EXPECT_EQ(metadata["valueLocation"].as<std::string>(), "slots_wanted");
  // As many slots as a worker has.
  const auto words =
      Words(all.at("Deployment/realitygrad-worker")["spec"]["template"]["spec"]["containers"][0]["args"]);
  for (size_t i = 0; i + 1 < words.size(); ++i) {
    if (words[i] == "--slots") {
      EXPECT_EQ(metadata["targetValue"].as<std::string>(), words[i + 1]);
    }
  }
  const YAML::Node token =
      all.at("TriggerAuthentication/" +
             trigger["authenticationRef"]["name"].as<std::string>())["spec"]["secretTargetRef"][0];
  EXPECT_TRUE(
      all.at("Secret/" + token["name"].as<std::string>())["stringData"][token["key"].as<std::string>()]);
}

TEST(Compose, ServicesAreThePrograms) {
  const YAML::Node compose = YAML::LoadFile(Deploy() + "/docker/compose.yaml");
  std::set<std::string> volumes;
  for (const auto& volume : compose["volumes"]) volumes.insert(volume.first.as<std::string>());
  for (const char* name : {"coordinator", "worker"}) {
    const YAML::Node service = compose["services"][name];
    ExpectItsFlags(Words(service["command"]), name);
    for (const auto& mount : service["volumes"]) {
      const std::string source = mount.as<std::string>().substr(0, mount.as<std::string>().find(':'));
      if (source[0] != '.') {
        EXPECT_EQ(volumes.count(source), 1u) << source;
      }
    }
  }
}

TEST(Systemd, UnitsAreSoundAndLocked) {
  for (const auto& entry : fs::directory_iterator(Deploy() + "/systemd")) {
    const std::string unit = *ReadFile(entry.path().string()), name = entry.path().stem().string();
    for (const char* line : {"NoNewPrivileges=yes", "ProtectSystem=strict", "PrivateTmp=yes",
                             "CapabilityBoundingSet=\n", "SystemCallFilter=@system-service", "UMask=0077"})
      EXPECT_NE(unit.find(line), std::string::npos) << name << ": " << line;
    std::istringstream lines(unit);
    for (std::string line; std::getline(lines, line);) {
      if (line.rfind("ExecStart=/usr/bin/realitygrad-", 0) != 0) continue;
      std::istringstream split(line.substr(std::string("ExecStart=/usr/bin/realitygrad-").size()));
      std::vector<std::string> words;
      for (std::string word; split >> word;) words.push_back(word);
      ExpectItsFlags(words, name);
    }
  }
}

TEST(Systemd, VerifiesTheUnits) {
  if (access("/usr/bin/systemd-analyze", X_OK) != 0) GTEST_SKIP() << "systemd-analyze is not installed";
  const fs::path folder = fs::temp_directory_path() / ("rg_units_" + std::to_string(getpid()));
  fs::create_directories(folder);
  const char* bin = std::getenv("RG_BIN_DIR");
  for (const auto& entry : fs::directory_iterator(Deploy() + "/systemd")) {
    // The programs of this build instead of installed ones; users that a package makes.
    std::string unit = *ReadFile(entry.path().string());
    unit = std::regex_replace(unit, std::regex("/usr/bin/"), std::string(bin ? bin : ".") + "/");
    unit = std::regex_replace(unit, std::regex("\n(User|Group)=[^\n]*"), "");
    ASSERT_TRUE(WriteFileAtomically((folder / entry.path().filename()).string(), unit).ok());
    const std::string said =
        OutputOf("systemd-analyze verify --man=no " + (folder / entry.path().filename()).string());
    std::istringstream lines(said);
    for (std::string line; std::getline(lines, line);)
      EXPECT_EQ(line.find(entry.path().filename().string() + ":"), std::string::npos) << line;
  }
  fs::remove_all(folder);
}

TEST(Slurm, ScriptsAreShellAndGiveTheWorkersFlags) {
  const std::set<std::string> worker = FlagsOf("worker"), coordinator = FlagsOf("coordinator");
  for (const auto& entry : fs::directory_iterator(Deploy() + "/slurm")) {
    EXPECT_EQ(OutputOf("bash -n " + entry.path().string()), "");
    const std::string script = *ReadFile(entry.path().string());
    EXPECT_NE(script.find("#SBATCH --no-requeue"), std::string::npos) << entry.path();
    EXPECT_NE(script.find("#SBATCH --signal=B:TERM@"), std::string::npos) << entry.path();
  }
  const std::string script = *ReadFile(Deploy() + "/slurm/worker.sbatch");
  for (const char* flag : {"--name", "--slots", "--idle-exit", "--patience", "--folder"}) {
    EXPECT_NE(script.find(flag), std::string::npos) << flag;
    EXPECT_EQ(worker.count(flag), 1u) << flag;
  }
}

}  // namespace
}  // namespace rg
