// realitygrad-proof-generator: makes the cases of a blind examination (proof_case.h).
#include <CLI/CLI.hpp>
#include <algorithm>
#include <cstdio>

#include "common/base/rng.h"
#include "services/proof/generator/hypotheses.h"
#include "services/proof/generator/proof_case.h"
#include "services/proof/generator/robots.h"

namespace {

std::string Digits(int number) {
  char text[16];
  std::snprintf(text, sizeof text, "%03d", number);
  return text;
}

struct OrdinaryRun {
  std::string sets, labels, robots;
  uint64_t seed = 1;
  int first = 0, count = 1;
  std::vector<std::string> kinds;
  std::vector<double> rates;
  std::vector<std::string> extras;  // of which one is added; empty: as drawn
  bool declared = false;
  double no_velocity = 0;
};

// Kind, rate and physics of a case. False: what is to be added suits none of a hundred drawings.
bool DrawOrdinaryRobot(const OrdinaryRun& run, rg::Rng& rng, rg::proof::CaseRequest* request) {
  const std::string extra = run.extras.empty() ? "" : run.extras[rng.Index(run.extras.size())];
  for (uint64_t attempt = 0; attempt < 100; ++attempt) {
    request->kind = run.kinds[rng.Index(run.kinds.size())];
    request->rate_hz = run.rates[rng.Index(run.rates.size())];
    if (run.declared) {
      request->ordinary = rg::proof::DrawDeclared(rng.Split(attempt));
      return true;
    }
    request->ordinary = rg::proof::DrawOrdinary(request->kind, request->rate_hz, rng.Split(attempt));
    if (extra.empty()) return true;
    request->ordinary->extra = extra;
    const auto fitting = rg::proof::OrdinaryExtras(request->kind, request->rate_hz, *request->ordinary);
    if (std::find(fitting.begin(), fitting.end(), extra) != fitting.end()) return true;
  }
  return false;
}

// Failures of a case are told and the next one is made. Code of the process.
int MakeOrdinary(const OrdinaryRun& run) {
  int failures = 0;
  for (int i = run.first; i < run.first + run.count; ++i) {
    rg::Rng rng = rg::Rng(run.seed).Split(static_cast<uint64_t>(i));
    rg::proof::CaseRequest request;
    request.name = "case_" + Digits(i);
    request.seed = rng.Next();
    request.robots = run.robots;
    request.declared = run.declared;
    if (!DrawOrdinaryRobot(run, rng, &request)) {
      std::fprintf(stderr,
                   "realitygrad-proof-generator: %s (%s): on none of the robots at none of the rates\n",
                   request.name.c_str(), request.ordinary->extra.c_str());
      ++failures;
      continue;
    }
    request.with_velocity = rng.Uniform() >= run.no_velocity;
    const auto summary = rg::proof::MakeCase(request, run.sets, run.labels);
    std::string drawn;
    for (const std::string& id : rg::proof::GearEffects(*request.ordinary))
      drawn += (drawn.empty() ? "" : "+") + id;
    if (request.ordinary->wrong_bodies) drawn += "+parameters_only";
    if (!request.ordinary->extra.empty()) drawn += "+" + request.ordinary->extra;
    if (!summary.ok()) {
      std::fprintf(stderr, "realitygrad-proof-generator: %s on %s: %s\n", drawn.c_str(), request.kind.c_str(),
                   summary.status().message().c_str());
      ++failures;
      continue;
    }
    std::printf("%s  %-9s %4.0f Hz  %s  %s  nominal/oracle %.2f\n", request.name.c_str(),
                request.kind.c_str(), request.rate_hz, run.declared ? "declared" : "ordinary", drawn.c_str(),
                summary->ratio);
    std::fflush(stdout);
  }
  return failures == 0 ? 0 : 1;
}

}  // namespace

int main(int argc, char** argv) {
  CLI::App app{
      "Makes recording sets with concealed physics, by an engine that shares no code with the simulator"};
  std::string sets = "proof/sets", labels = "proof/labels", robots = "deploy/robots";
  uint64_t seed = 1;
  int first = 0, count = 1;
  bool ordinary = false, declared = false;
  std::vector<std::string> effects, robot_names = rg::proof::KnownRobots();
  std::vector<double> rates = {25, 50, 100, 250, 500};
  double weak = 0.15, pairs = 0.15, controls = 0.25, wrong_parameters = 0.2, no_velocity = 0.1, tuned = 0.15;
  app.add_option("--sets", sets, "Folder for the recording sets");
  app.add_option("--labels", labels, "Folder for labels and concealed recordings");
  app.add_option("--robots", robots, "Folder of mico2.urdf");
  auto* robot_option = app.add_option("--robot", robot_names, "Robots to draw from");
  auto* rate_option = app.add_option("--rate", rates, "Sample rates to draw from, Hz");
  app.add_option("--seed", seed, "Seed of the whole examination");
  app.add_option("--first", first, "Number of the first case");
  app.add_option("--count", count, "Cases to make")->check(CLI::PositiveNumber);
  app.add_option("--effect", effects,
                 "Effects to draw from (default: all); given with '+' act together. Of ordinary robots: the "
                 "one thing more");
  app.add_option("--weak", weak, "Share of weak cases")->check(CLI::Range(0.0, 1.0));
  app.add_option("--pairs", pairs, "Share of cases with two effects")->check(CLI::Range(0.0, 1.0));
  app.add_option("--controls", controls, "Share of cases with nothing missing")->check(CLI::Range(0.0, 1.0));
  app.add_option("--wrong-parameters", wrong_parameters, "Share of cases whose URDF is off as well")
      ->check(CLI::Range(0.0, 1.0));
  app.add_option("--tuned", tuned, "Share of effects whose URDF was tuned and hides part of them")
      ->check(CLI::Range(0.0, 1.0));
  auto* ordinary_flag =
      app.add_flag("--ordinary", ordinary, "Ordinary robots: friction, damping and rotors on every joint");
  app.add_flag("--declared", declared, "Ordinary robots whose set declares all of it: controls")
      ->excludes(ordinary_flag);
  app.add_option("--no-velocity", no_velocity, "Share of cases with positions only")
      ->check(CLI::Range(0.0, 1.0));
  CLI11_PARSE(app, argc, argv);
  if (ordinary || declared) {
    if (robot_option->empty()) robot_names = rg::proof::OrdinaryRobots();
    if (rate_option->empty()) rates = rg::proof::OrdinaryRates();
    return MakeOrdinary(
        {sets, labels, robots, seed, first, count, robot_names, rates, effects, declared, no_velocity});
  }

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
    const std::string first = control ? (rng.Uniform() < 0.5 ? "none" : "parameters_only") : draw();
    for (size_t at = 0; at <= first.size();) {
      const size_t plus = std::min(first.find('+', at), first.size());
      request.effects.push_back(first.substr(at, plus - at));
      at = plus + 1;
    }
    const auto suits = [&](const std::string& kind) {
      return std::all_of(request.effects.begin(), request.effects.end(),
                         [&](const std::string& e) { return rg::proof::Applies(e, kind); });
    };
    for (int attempt = 0; attempt < 100; ++attempt) {
      request.kind = robot_names[rng.Index(robot_names.size())];
      if (suits(request.kind)) break;
    }
    if (!suits(request.kind)) {
      std::fprintf(stderr, "realitygrad-proof-generator: %s (%s): on none of the robots\n",
                   request.name.c_str(), first.c_str());
      ++failures;
      continue;
    }
    if (!control && effects.empty() && rng.Uniform() < pairs) {
      for (int attempt = 0; attempt < 100 && request.effects.size() < 2; ++attempt) {
        const std::string second = draw();
        if (rg::proof::Applies(second, request.kind) && rg::proof::CanPair(first, second, request.kind))
          request.effects.push_back(second);
      }
    }
    std::string drawn;
    for (const std::string& e : request.effects) drawn += (drawn.empty() ? "" : "+") + e;
    request.robots = robots;
    request.rate_hz = rates[rng.Index(rates.size())];
    const bool fast =
        drawn.find("backlash") != std::string::npos || drawn.find("elasticity") != std::string::npos;
    if (fast && request.rate_hz < 100) request.rate_hz = 250;
    // The two that nothing is concealed in have no strength and no other URDF.
    const bool nothing = first == "none" || first == "parameters_only";
    request.weak = !nothing && rng.Uniform() < weak;
    request.wrong_parameters = !nothing && rng.Uniform() < wrong_parameters;
    // Damping that absorbs viscous friction hides all of it: that is no case.
    const bool hideable = !nothing && first != "viscous_friction";
    request.tuned = hideable && !request.weak && !request.wrong_parameters &&
                    rng.Uniform() < tuned / std::max(1e-9, (1 - weak) * (1 - wrong_parameters));
    request.with_velocity = rng.Uniform() >= no_velocity;
    auto summary = rg::proof::MakeCase(request, sets, labels);
    if (!summary.ok() && (request.weak || request.tuned || request.wrong_parameters)) {
      // What cannot be weak, hidden or beside wrong bodies there may still be plain.
      request.weak = request.tuned = request.wrong_parameters = false;
      summary = rg::proof::MakeCase(request, sets, labels);
    }
    if (!summary.ok()) {
      std::fprintf(stderr, "realitygrad-proof-generator: %s on %s: %s\n", drawn.c_str(), request.kind.c_str(),
                   summary.status().message().c_str());
      ++failures;
      continue;
    }
    std::printf("%s  %-28s %-9s %4.0f Hz  nominal/oracle %.2f%s%s\n", request.name.c_str(), drawn.c_str(),
                request.kind.c_str(), request.rate_hz, summary->ratio,
                request.weak    ? "  weak"
                : request.tuned ? "  tuned"
                                : "",
                summary->warning.empty() ? "" : ("  (" + summary->warning + ")").c_str());
    std::fflush(stdout);
  }
  return failures == 0 ? 0 : 1;
}
