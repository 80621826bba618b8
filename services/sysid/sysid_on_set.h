// `realitygrad sysid SET`: inertial parameters, damping, friction and rotor inertia of a robot that was
// never seen, from a folder of recordings, judged on recordings it was not fitted to.
//
//   1. noise of the sensors, from the manifest or estimated; on request only a few windows of the fit
//      recordings, chosen by what the model says they would tell (window_choice.h)
//   2. start: linear regression of the inverse dynamics (initial_regression.h), so that no friction
//      starts on its bound
//   3. multiple shooting over the fit recordings, short windows first, then long ones; the residuals'
//      scale per joint is re-estimated in between; Huber; priors from the URDF
//   4. candidates (nominal, inertial, friction and rotor inertia, both, direction-dependent friction)
//      compared on held-out recordings in restarted windows: a richer one must be better there by more than
//      chance. What each round of shooting made of a candidate is judged there too. So the held-out figures
//      are those of the best of about a dozen fits, not of one chosen blindly.
//   5. identifiability, covariance, warnings
#pragma once

#include <Eigen/Core>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

#include "common/base/progress.h"
#include "common/base/status.h"
#include "common/recordings/recording_set.h"
#include "common/sim/model_file.h"
#include "common/sim/plant.h"
#include "services/sysid/identifiability.h"
#include "services/sysid/stop_condition.h"
#include "services/sysid/window_choice.h"

namespace rg::sysid {

struct SysidOptions {
  double window_s = 1.0;      // of the judgement
  double fit_window_s = 1.0;  // of the last round of shooting, and of the windows chosen
  int fit_windows = 0;        // so many windows are fitted, chosen by `window_choice`; 0: all there is
  WindowChoice window_choice = WindowChoice::kInformation;
  uint64_t window_seed = 1;        // of WindowChoice::kRandom
  double residual_rate_hz = 25.0;  // rows used as residuals are thinned to about this rate
  double step_s = 0.0;             // of the simulator; 0: the longest that makes no difference
  double huber = 3.0;
  int max_iterations = 12;           // per round of shooting
  double relative_tolerance = 1e-3;  // of the cost, ends a round
  bool fit_inertial = true;
  bool consistent_inertias = true;  // only bodies that can exist (fit_space.h)
  bool fit_joints = true;           // viscous and Coulomb friction, rotor inertia
  int threads = 0;                  // 0: all
  // What to start from instead of the set's URDF, a diagnosis' model for example: its effects stay, its
  // values are where fits start and what priors stand around. Its joints must be the set's.
  std::optional<sim::ModelFile> model;
};

// A held-out recording as measured and as both models tell it, in windows restarted from measured states.
// `before` is empty where the model as given cannot be simulated (rotor_start.h).
struct HoldoutTrace {
  std::string recording;
  Eigen::VectorXd t;                        // K
  Eigen::MatrixXd measured, before, after;  // n × K
};

// Windows of (0, 3600] s; a simulator's step of 0 (chosen) or [1e-6, 0.1] s.
Status CheckTimes(double window_s, double step_s);

inline constexpr size_t kTraces = 3;

struct HoldoutScore {
  std::string recording;
  double before_rms = 0.0, after_rms = 0.0;
  double before_median = 0.0, after_median = 0.0;  // of the windows
  Eigen::VectorXd before_joint_rms, after_joint_rms;
};

struct CandidateScore {
  std::string name;  // "inertial", "inertial + viscous + coulomb", …
  int parameters = 0;
  double fit_rms = 0.0, holdout_rms = 0.0;
  double seconds = 0.0;
};

struct SysidReport {
  std::string robot;
  std::vector<std::string> joints;
  double window_s = 1.0;
  double step_s = 0.0;  // that the simulator took
  // All held-out recordings together. Everything `before` is NaN where the model as given cannot be
  // simulated.
  double before_rms = 0.0, after_rms = 0.0;
  double before_median = 0.0, after_median = 0.0;  // medians over windows
  double fit_before_rms = 0.0, fit_after_rms = 0.0;
  bool judged_on_fit = false;  // the set has no holdout: the figures are of the fitted recordings
  std::vector<HoldoutScore> holdout;
  std::vector<HoldoutTrace> traces;  // of the first kTraces of them
  WindowChoice window_choice = WindowChoice::kInformation;
  std::vector<FitWindow> windows;              // that were chosen; empty: the whole recordings were fitted
  std::vector<std::string> window_recordings;  // their recordings' names
  bool consistent_inertias = true;
  std::vector<CandidateScore> candidates;
  std::string chosen;
  // Of which model: the chosen one, unless that has no parameters. Both empty: stopped before anything was
  // known of them, or nothing to fit.
  IdentifiabilityReport identifiability;
  std::string identifiability_of;
  std::vector<std::string> warnings;
  double seconds = 0.0;
  bool stopped_early = false;

  std::optional<sim::Plant> plant;  // the model with its effects
  Eigen::VectorXd values;           // of plant->parameters()
};

// Errors are of the data (a URDF that does not load, no effort, too few rows); a poor fit is a report.
Result<SysidReport> SysidOnSet(const recordings::RecordingSet& set, const SysidOptions& options,
                               const Clock& clock, const ProgressFn& progress = {},
                               const CancelToken* cancel = nullptr);

// The nominal plant of a set: its URDF, gravity, joints and locked joints, no effects.
Result<sim::Plant> NominalPlant(const recordings::RecordingSet& set);

// Whether a model's joints are those of a set, by their plants.
Status CheckJoints(const sim::Plant& model, const sim::Plant& set);

std::string FormatSysid(const SysidReport& report);
// {"holdout": {"before_rms", "after_rms", "window_s", "recordings": […]}, "candidates", "parameters", …}
nlohmann::json SysidToJson(const SysidReport& report);

}  // namespace rg::sysid
