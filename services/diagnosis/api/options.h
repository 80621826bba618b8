// What a diagnosis is asked: limits, windows, and what it starts from.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>

#include "common/sim/model_file.h"

namespace rg::diagnosis {

class FitExecutor;
struct Candidate;

struct DiagnosisOptions {
  int threads = 0;            // 0: all
  double window_s = 1.0;      // of the judgement on held-out recordings
  double fit_window_s = 0.5;  // of the fits
  double step_s = 2.5e-3;     // of the simulator
  int max_effects = 4;        // rounds of adding
  uint64_t seed = 1;          // of simulated nulls and bootstraps
  // Of all fits together (Work in lifted_fit.h): a limit that is the same on every machine, two and a half to
  // six minutes of one core, which few sets take. What is found by then is weighed beyond it, up to twice.
  // Where a recording kept aside must be fitted too, or windows halved, the search begins again with what is
  // left of 1.6 times that, but 0.6 of it at least.
  double work_limit = 1.2e10;
  // No new fit starts later than this many seconds; 0: no such limit. What it cuts off depends on the
  // machine.
  double time_limit_s = 0;
  FitExecutor* fits = nullptr;  // who makes the fits (fit_requests.h); null: this process
  bool trust_effort = false;    // go on where an effort's sign or unit looks wrong
  // What to start from instead of the set's URDF (given_model.h): findings are what it lacks.
  std::optional<sim::ModelFile> model;
  // What a search of fewer of the recordings, or over longer windows, came to, which the next one weighs
  // first; null: none.
  std::shared_ptr<const Candidate> earlier;
};

}  // namespace rg::diagnosis
