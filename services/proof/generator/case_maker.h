// How a case is made, in four parts: the robot (case_robot.cc), its effects (case_effects.cc) or those of an
// ordinary robot (case_ordinary.cc), and its files (proof_case.cc).
#pragma once

#include <cmath>
#include <nlohmann/json.hpp>
#include <set>
#include <string>
#include <vector>

#include "common/base/rng.h"
#include "services/proof/generator/comparison.h"
#include "services/proof/generator/equivalents.h"
#include "services/proof/generator/hypotheses.h"
#include "services/proof/generator/proof_case.h"
#include "services/proof/generator/references.h"
#include "services/proof/generator/set_files.h"
#include "services/proof/generator/tuning.h"
#include "services/proof/generator/visibility.h"

namespace rg::proof {

// Everything a case is made from.
class CaseMaker {
 public:
  CaseMaker(const CaseRequest& request, uint64_t seed) : request_(request), rng_(seed) {}

  Result<CaseSummary> Run(const std::string& sets_folder, const std::string& labels_folder);

 private:
  Status LoadRobot();
  Eigen::VectorXd Gravity(const Eigen::VectorXd& q) const;  // and leaves the skeleton at rest in q
  Eigen::MatrixXd Select(const Eigen::MatrixXd& full) const;
  double GravityGrowth(const Eigen::VectorXd& q) const;
  Eigen::VectorXd CalmHome(Rng rng) const;
  void ChooseMotion();
  Truth Nominal() const { return Truth{std::vector<JointTruth>(joints_.size())}; }
  Track Record(const Truth& truth, const std::string& kind, double duration, uint64_t stream,
               bool regular) const;
  Status MeasureScales(const Truth& truth);
  // `without`: leaves out the effect of this index.
  Truth Draw(double strength, bool wrong_parameters, nlohmann::json* effects, int without = -1) const;
  Motion TuningMotion(const Truth& truth) const;
  Status TuneNominal(const Truth& truth, nlohmann::json* effects);
  double SensorNoise() const {  // of positions, rad or m
    return std::sqrt(noise_.position * noise_.position + noise_.resolution * noise_.resolution / 12);
  }
  Comparison Compared() const { return {skeleton_, joints_, dt_, request_.rate_hz}; }
  // The robot as it is recorded to fit, first or second: what does not show there is not there to be named.
  Track ToFit(const Truth& truth, size_t which) const {
    const PlannedRecording planned = DrawPlan(rng_.Split(4))[which];
    return Record(truth, planned.kind, planned.duration_s, which, true);
  }
  Visibility VisibilityOf(const Truth& truth) const;
  std::vector<bool> ToTellFromBodies(const Truth& truth, nlohmann::json effects) const;
  Status KeepVisible(Truth* truth, nlohmann::json* effects) const;
  double Ratio(const Truth& truth) const;
  Result<Truth> SearchStrength(nlohmann::json* effects, std::string* warning);
  std::set<std::string> JointsApart() const;
  RobotFacts Facts(const Truth& truth) const;
  Eigen::VectorXd Controller(const Eigen::VectorXd& q, const Eigen::VectorXd& v, const Eigen::VectorXd& q_ref,
                             const Eigen::VectorXd& v_ref) const;

  // One effect of an ordinary robot and the robot without it.
  struct Part {
    std::string id;
    Truth without;
  };
  Status MakeOrdinary(Truth* truth, nlohmann::json* effects);
  Status ShowGears(Truth* truth) const;
  Status AddOneThingMore(Truth* truth, nlohmann::json* effects);
  Status KeepOrdinaryVisible(const Truth& truth, nlohmann::json* effects) const;
  Status Declare(const Truth& truth);

  CaseRequest request_;
  Rng rng_;
  std::string original_urdf_, urdf_;                // of the robot without its effects; as handed out
  dart::dynamics::SkeletonPtr skeleton_, nominal_;  // the robot without its effects; as handed out
  std::vector<std::string> joints_, links_;
  std::vector<Eigen::Index> at_;  // skeleton index of joint i
  ReferenceLimits limits_;
  Eigen::VectorXd effort_;
  Truth servo_;              // what the controller knows of the gears; no joint: nothing
  double compensated_ = 0;   // share of their friction that it feeds forward
  std::vector<Part> parts_;  // of an ordinary robot
  Truth declared_;           // what the set declares beyond its URDF; no joint: nothing
  std::string model_;        // of the set's model.json
  Scales scales_;
  SetStyle style_;
  Noise noise_{};
  double dt_ = 2e-4, wn_ = 8, strength_ = 1;
};

}  // namespace rg::proof
