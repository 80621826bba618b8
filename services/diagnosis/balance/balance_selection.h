// Selection of effects and joints on the balance of torques: steps 1 to 5 of balance_search.h.
#pragma once

#include <functional>
#include <initializer_list>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "common/base/progress.h"
#include "common/effects/effect.h"
#include "common/effects/inference.h"
#include "services/diagnosis/balance/balance_fit.h"

namespace rg::diagnosis {

inline constexpr double kErrors = 2.0;  // standard errors over blocks, that common effects must gain

// Plain laws, and terms that refine dry friction. A constant force comes after the plain laws, named an
// offset of the effort: with Coulomb friction it equals friction that depends on the direction.
extern const std::vector<effects::Regressor> kPlainLaws, kFinerLaws;

// Delay or lag of the motion behind the effort on one joint; kDelay with 0 s: none.
struct JointTiming {
  EffortTiming kind = EffortTiming::kDelay;
  double seconds = 0;
  double stddev = 0;
};

class BalanceSelection {
 public:
  using TraceFn = std::function<void(const std::string&)>;
  BalanceSelection(const FitSetting& setting, int max_effects, TraceFn trace);

  // Estimates delay or lag per joint with all losses free, which would else bias it.
  void FindTiming();
  void Select(const CancelToken* cancel);

  const TorqueBalance& balance() const { return balance_; }
  BalanceFit& fit() { return fit_; }
  const BalanceFit& fit() const { return fit_; }
  const BalanceModel& model() const { return model_; }
  // The chosen model with separate friction and rotors in the place of a coupled drive.
  BalanceModel Uncoupled() const;
  double timing_gain() const { return timing_gain_; }              // nats
  double other_timing_gain() const { return other_timing_gain_; }  // of lags for delays and the reverse
  const std::vector<int>& early() const { return early_; }         // joints whose effort lags their motion

  // Columns of a law on a joint; whether a model has any; the sum of their coefficients in SI.
  std::vector<int> ColumnsOf(effects::Regressor law, int joint) const;
  void Insert(std::initializer_list<effects::Regressor> laws, int joint, BalanceModel* m) const;
  void Erase(effects::Regressor law, int joint, BalanceModel* m) const;
  bool Has(const BalanceModel& m, effects::Regressor law, int joint) const;
  double Scale(const BalanceSolution& s, int joint) const;
  double Coefficient(const BalanceSolution& s, effects::Regressor law, int joint) const;
  std::vector<double> Coefficients(const BalanceSolution& s, const effects::Inference& effect,
                                   int joint) const;
  bool Admissible(const BalanceModel& m, int joint) const;
  // The effects of a model for the simulator, timing included.
  std::vector<EffectSpec> SpecsOf(const BalanceModel& m) const;
  EffectSpec SpecOf(effects::Regressor law, const BalanceModel& m, const BalanceSolution& s, int joint) const;
  std::vector<EffectSpec> SpecsOfJoint(const BalanceModel& m, const BalanceSolution& s, int joint) const;
  std::optional<EffectSpec> PayloadOf(const BalanceModel& m) const;
  std::set<std::string> KindsOf(const BalanceModel& m) const;
  // Jackknife stddev of the effects' parameters, by their names.
  std::map<std::string, double> Spread() const;
  double LogHypotheses() const;

 private:
  struct Trial;
  void FindDrive();
  BalanceModel PlainOnAll() const;
  BalanceModel WithDrive(BalanceModel m) const;
  double DrivePays(const BalanceModel& rival, std::string* line) const;
  double FittedGain(const BalanceModel& rival) const;
  void RefineRatio(const BalanceModel& rival);
  bool PruneDrive();
  void Pass(int joint, const JointTiming& timing);
  BalanceModel Flexible(BalanceModel m) const;
  std::vector<BalanceModel> With(const BalanceModel& m, effects::Regressor law, int joint) const;
  bool Pays(effects::Regressor law, const BlockCosts& before, const BlockCosts& after, int joint,
            Gain* gain) const;
  Trial TryTilt(const BlockCosts& before) const;
  Trial TryLaw(effects::Regressor law, const BlockCosts& before) const;
  void BeginWithLosses();
  void RepairSigns(BalanceModel* m) const;
  bool PaysTogether(const BlockCosts& before, const BlockCosts& after) const;
  void TryPayload();
  void TryRipple(int joint);
  bool AddKind();
  bool DropNegative(int joint);
  bool Refined(int joint) const;
  bool AddRefinement();
  void Prune();
  std::string StateOf(const BalanceModel& m) const;

  const FitSetting setting_;
  const FitData& data_ = setting_.data;
  const sim::Plant& nominal_ = setting_.nominal;
  const MotionScales& scales_ = setting_.scales;
  int max_effects_;
  TraceFn trace_;
  TorqueBalance balance_ = MakeTorqueBalance(setting_);
  BalanceFit fit_{balance_};
  BalanceModel model_{.features = std::vector<std::set<int>>(data_.n)};
  std::vector<std::set<int>>
      losses_;  // per joint, columns of the losses accepted on all joints together; empty: none
  std::vector<JointTiming> timing_ = std::vector<JointTiming>(data_.n);
  std::vector<int> early_;
  double timing_gain_ = 0, other_timing_gain_ = 0;
  double ratio_stddev_ = 0;  // of the coupled drive's κ
};

}  // namespace rg::diagnosis
