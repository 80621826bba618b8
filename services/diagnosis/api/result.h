// What a diagnosis answers.
#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "common/effects/effect.h"
#include "common/sim/plant.h"

namespace rg::diagnosis {

struct Region {
  std::string variable;  // "velocity.joint_2", "position.joint_3", "time", "effort.joint_1"
  double low = 0, high = 0;
};
struct TimeWindow {
  std::string recording;
  double start = 0, end = 0;
};
struct ParameterEstimate {
  std::string owner;  // joint, link or "*"
  std::string name, unit;
  double value = 0, stddev = 0;
};
struct Alternative {
  std::string effect;
  std::vector<std::string> joints;
  double evidence =
      0;  // nats: log predictive density of held-out recordings minus that of the chosen effect (held_out.h)
  bool separable = true;
  std::string experiment;
  bool by_motion = true;  // some motion could separate the two
};
struct Finding {
  std::string effect;
  std::vector<std::string> joints;
  double confidence = 0;
  bool modelled = true;  // false: something is missing, and no model of it was found
  std::string summary;
  double share_of_mismatch = 0;
  std::vector<Region> regions;
  std::vector<TimeWindow> windows;
  std::string statement, equation;
  effects::Variable shows_over = effects::Variable::kPosition;
  std::vector<std::string> effect_class;
  std::vector<ParameterEstimate> parameters;
  std::vector<Alternative> alternatives;
};

// A motion expected to separate effects that these recordings cannot (separating_motion.h). Written as
// motion.csv, which `realitygrad submit rollout --trajectory` plays.
struct ProposedMotion {
  std::vector<std::string> effects;  // the rivals, ids
  std::string description;
  double expected_nats = 0;  // expected log evidence against the wrong one
  std::vector<double> t;     // K, s
  Eigen::MatrixXd q, v;      // n × K
};

// A base parameter: as given, calibrated without the found effects, and with them.
struct LedgerRow {
  std::string name, unit;
  double nominal = 0, calibrated = 0, final = 0, prior_stddev = 1;
};

// A candidate that was fitted in the simulator.
struct CandidateRow {
  std::string name;
  bool calibrated = false;  // base parameters free
  double evidence = 0;      // log evidence minus that of the model without effects
  double chi2_per_row = 0;
  int round = 0;
  bool chosen = false;
};

// Missing force over time along one fitted recording. n × S.
struct ForcePlot {
  std::string recording;
  std::vector<double> t;
  Eigen::MatrixXd force, stddev, explained;  // explained: by the findings
  Eigen::MatrixXd q, v, u;
};

// One held-out recording by itself: RMS over rows, and the median over windows.
struct HoldoutRecording {
  std::string name;
  double before_rms = 0, calibrated_rms = 0, after_rms = 0;
  double before_median = 0, calibrated_median = 0, after_median = 0;
};

// Where the model as given cannot be simulated, its figures and the improvement are NaN, its plots empty.
struct HoldoutFit {
  double before_rms = 0, calibrated_rms = 0, after_rms = 0, noise_floor_rms = 0;
  double improvement_low = 0, improvement_high = 0;
  double worse_than_calibrated = 0;  // share of bootstrap draws over windows in which after_rms is the larger
  bool judged_on_fit = false;
  std::vector<double> before_windows, after_windows;
  std::vector<HoldoutRecording> recordings;
};
struct HoldoutPlot {
  std::string recording;
  std::vector<double> t;
  Eigen::MatrixXd measured, before, after;  // n × K
};

struct DiagnosisResult {
  std::string verdict;  // no_mismatch, parameters_only, unmodelled_physics, unexplained
  std::vector<Finding> findings;
  HoldoutFit holdout;
  double window_s = 1.0;
  double elapsed_s = 0;
  std::vector<std::string> notes;
  std::optional<ProposedMotion> motion;  // where some class has more than one effect

  std::string robot;
  std::vector<std::string> joints, units;
  bool effort_measured = false;  // the likelihood was the balance of torques
  double noise_scale = 1;        // residual variance in units of the sensors' noise
  double mismatch = 0;           // χ² per row of the calibrated model, 1 at the noise
  double remaining = 0;          // of the augmented model
  double null_threshold = 0;     // nats: 98 % quantile of the null distribution
  Eigen::VectorXd joint_share;   // n, of the missing force's energy above its noise
  std::vector<CandidateRow> candidates;
  std::vector<LedgerRow> ledger;
  std::vector<ForcePlot> force_plots;
  std::vector<HoldoutPlot> holdout_plots;

  std::optional<sim::Plant> plant;  // augmented
  Eigen::VectorXd values;
  bool held_before = true;  // sim::ModelFile
};

}  // namespace rg::diagnosis
