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
  // Budget of one search: about its seconds on one thread (lifted_fit.h), the same on any machine. Beyond it
  // nothing new is tried (what comes after a search of drives gets half of it at least); comparing what was
  // found ends at twice that. A restart (with a held-out recording fitted too) gets what is left of 1.6 times
  // this budget, 0.6 of it at least.
  double work_limit = 110;
  // No new fit starts later than this many seconds; 0: no limit. Makes results depend on the machine.
  double time_limit_s = 0;
  FitExecutor* fits = nullptr;  // makes the fits (fit_requests.h); null: this process
  bool trust_effort = false;    // diagnose even if an effort's sign or unit looks wrong
  // The model to start from instead of the set's URDF (given_model.h): findings are what it lacks.
  std::optional<sim::ModelFile> model;
  // Result of an earlier search (of fewer recordings), tried first: where these are consistent with it, the losses of
  // drives are not searched for anew; null: none.
  std::shared_ptr<const Candidate> earlier;
};

}  // namespace rg::diagnosis
