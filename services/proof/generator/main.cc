// realitygrad-proof-generator: makes the cases of a blind examination (proof_case.h).
#include <CLI/CLI.hpp>
#include <cstdio>

#include "common/base/rng.h"
#include "services/proof/generator/hypotheses.h"
#include "services/proof/generator/proof_case.h"

namespace {

std::string Digits(int number) {
  char text[16];
  std::snprintf(text, sizeof text, "%03d", number);
  return text;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{
      "Makes recording sets with concealed physics, by an engine that shares no code with the simulator"};
  std::string sets = "proof/sets", labels = "proof/labels", robots = "deploy/robots";
  uint64_t seed = 1;
  int first = 0, count = 1;
  std::vector<std::string> effects, robot_names = {"mico2", "arm2", "pendulum"};
  std::vector<double> rates = {25, 50, 100, 250, 500};
  double weak = 0.15, pairs = 0.15, controls = 0.25, wrong_parameters = 0.2, no_velocity = 0.1;
  app.add_option("--sets", sets, "Folder for the recording sets");
  app.add_option("--labels", labels, "Folder for labels and concealed recordings");
  app.add_option("--robots", robots, "Folder of <robot>.urdf");
  app.add_option("--robot", robot_names, "Robots to draw from");
  app.add_option("--rate", rates, "Sample rates to draw from, Hz");
  app.add_option("--seed", seed, "Seed of the whole examination");
  app.add_option("--first", first, "Number of the first case");
  app.add_option("--count", count, "Cases to make")->check(CLI::PositiveNumber);
  app.add_option("--effect", effects, "Effects to draw from (default: all); given with '+' act together");
  app.add_option("--weak", weak, "Share of weak cases")->check(CLI::Range(0.0, 1.0));
  app.add_option("--pairs", pairs, "Share of cases with two effects")->check(CLI::Range(0.0, 1.0));
  app.add_option("--controls", controls, "Share of cases with nothing missing")->check(CLI::Range(0.0, 1.0));
  app.add_option("--wrong-parameters", wrong_parameters, "Share of cases whose URDF is off as well")
      ->check(CLI::Range(0.0, 1.0));
  app.add_option("--no-velocity", no_velocity, "Share of cases with positions only")
      ->check(CLI::Range(0.0, 1.0));
  CLI11_PARSE(app, argc, argv);

  int failures = 0;
  for (int i = first; i < first + count; ++i) {
    rg::Rng rng = rg::Rng(seed).Split(static_cast<uint64_t>(i));
    rg::proof::CaseRequest request;
    request.name = "case_" + Digits(i);
    request.seed = rng.Next();
    const bool control = effects.empty() && rng.Uniform() < controls;
    const auto& pool = effects.empty() ? rg::proof::KnownEffects() : effects;
    const size_t skip = effects.empty() ? 2 : 0;  // none and parameters_only are controls
    const auto draw = [&] { return pool[skip + rng.Index(pool.size() - skip)]; };
    std::string drawn = control ? (rng.Uniform() < 0.5 ? "none" : "parameters_only") : draw();
    if (!control && effects.empty() && rng.Uniform() < pairs) drawn += "+" + draw();
    for (size_t at = 0; at <= drawn.size();) {
      const size_t plus = std::min(drawn.find('+', at), drawn.size());
      const std::string id = drawn.substr(at, plus - at);
      if (std::find(request.effects.begin(), request.effects.end(), id) == request.effects.end())
        request.effects.push_back(id);
      at = plus + 1;
    }
    request.robot = robot_names[rng.Index(robot_names.size())];
    if (drawn.find("joint_coupling") != std::string::npos && request.robot == "pendulum")
      request.robot = "arm2";
    request.urdf = robots + "/" + request.robot + ".urdf";
    request.rate_hz = rates[rng.Index(rates.size())];
    const bool fast =
        drawn.find("backlash") != std::string::npos || drawn.find("elasticity") != std::string::npos;
    if (fast && request.rate_hz < 100) request.rate_hz = 250;
    request.weak = !control && rng.Uniform() < weak;
    request.wrong_parameters = !control && rng.Uniform() < wrong_parameters;
    request.with_velocity = rng.Uniform() >= no_velocity;
    const auto summary = rg::proof::MakeCase(request, sets, labels);
    if (!summary.ok()) {
      std::fprintf(stderr, "realitygrad-proof-generator: %s (%s on %s): %s\n", request.name.c_str(),
                   drawn.c_str(), request.robot.c_str(), summary.status().message().c_str());
      ++failures;
      continue;
    }
    std::printf("%s  %-28s %-9s %4.0f Hz  nominal/oracle %.2f%s%s\n", request.name.c_str(), drawn.c_str(),
                request.robot.c_str(), request.rate_hz, summary->ratio, request.weak ? "  weak" : "",
                summary->warning.empty() ? "" : ("  (" + summary->warning + ")").c_str());
    std::fflush(stdout);
  }
  return failures == 0 ? 0 : 1;
}
