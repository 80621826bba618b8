#include "services/sysid/sysid_on_set.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <utility>

#include "common/base/parallel.h"
#include "common/base/printf.h"
#include "common/base/rng.h"
#include "common/effects/effect.h"
#include "common/effects/effect_catalog.h"
#include "common/effects/inference.h"
#include "common/model/robot_model.h"
#include "common/model/urdf_loader.h"
#include "common/recordings/noise.h"
#include "services/sysid/drive_signal.h"
#include "services/sysid/fit_space.h"
#include "services/sysid/initial_regression.h"
#include "services/sysid/joint_roles.h"
#include "services/sysid/prediction.h"
#include "services/sysid/rotor_start.h"
#include "services/sysid/shooting_fit.h"

namespace rg::sysid {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

constexpr double kMinError = 1e-6;     // rad or m: windows better than this are equally good
constexpr double kSimpler = 1.01;      // a start, which has no covariance, must be better than a fit by this
constexpr double kSignificance = 2.0;  // standard errors by which a richer model must be better
constexpr double kResampleShare = 0.975;
constexpr int kResamples = 1000;
constexpr uint64_t kResampleSeed = 1;      // fixed: the same data give the same choice
constexpr int kRefinements = 4;            // where little is fitted
constexpr double kInformationStep = 2e-3;  // s, of simulations that say what a window would tell
constexpr double kMuchWorse = 2.0;         // torque residual against the best model's

struct Candidate {
  std::string name;
  std::vector<std::string> effects;
  bool inertial = false;
};

struct Fitted {
  sim::Plant plant;
  FitSpace space;
  ShootingFit fit = {};
  VectorXd torque_stddev = {};  // of the regression's residual; empty when nothing was fitted
  CandidateScore score = {};
  std::vector<PredictionError> holdout = {};
};

// Where the model as given cannot be simulated (`runs`), the simplest one has what that needs.
std::vector<Candidate> Candidates(const SysidOptions& options, bool runs) {
  // What every drive has, and the same with dry friction that differs by direction.
  std::vector<std::string> coulomb, asymmetric;
  for (const effects::EffectInfo& effect : effects::Catalog()) {
    if (effects::InferenceOf(effect.id).of_every_drive) coulomb.push_back(effect.id);
  }
  for (const std::string& id : coulomb) {
    const bool dry = effects::IsIn(effects::Slot::kDryFriction, id);
    asymmetric.push_back(dry ? effects::LawOf(effects::Regressor::kForwards).id : id);
  }
  std::vector<Candidate> out{{runs ? "nominal" : "nominal + rotors that the URDF lacks", {}, false}};
  if (options.fit_inertial) out.push_back({"inertial", {}, true});
  if (options.fit_joints) out.push_back({"viscous + coulomb + rotor", coulomb, false});
  if (options.fit_joints && options.fit_inertial) {
    out.push_back({"inertial + viscous + coulomb + rotor", coulomb, true});
    out.push_back({"inertial + viscous + asymmetric + rotor", asymmetric, true});
  }
  return out;
}

class Identification {
 public:
  Identification(const recordings::RecordingSet& set, const SysidOptions& options, const Clock& clock,
                 const ProgressFn& progress, const CancelToken* cancel)
      : set_(set), options_(options), clock_(clock), progress_(progress), stop_(cancel) {
    threads_ = ChooseThreads(options.threads);
  }

  Result<SysidReport> Run() {
    const double start = clock_.SteadySeconds();
    RG_RETURN_IF_ERROR(Prepare());
    std::vector<Fitted> fitted;
    for (const Candidate& candidate : Candidates(options_, runs_)) {
      if (!fitted.empty() && stop_.ShouldStop()) break;
      RG_ASSIGN_OR_RETURN(Fitted f, Start(candidate));
      fitted.push_back(std::move(f));
    }
    KeepPromising(&fitted);
    ChooseStepFor(fitted.back());
    for (size_t i = 0; i < fitted.size(); ++i) {
      position_ = {static_cast<double>(i), static_cast<double>(fitted.size())};
      Tell(0.0, fitted[i].score.name);
      Finish(&fitted[i]);
      if (stop_.ShouldStop()) fitted.erase(fitted.begin() + static_cast<long>(i) + 1, fitted.end());
    }
    SysidReport report = Report(fitted);
    report.seconds = clock_.SteadySeconds() - start;
    report.stopped_early = stop_.ShouldStop();
    Tell(1.0, report.chosen);
    return report;
  }

 private:
  Status Prepare() {
    RG_ASSIGN_OR_RETURN(sim::Plant nominal, NominalPlant(set_));
    given_ = nominal.parameters().Nominal();
    if (options_.model) {
      RG_RETURN_IF_ERROR(CheckJoints(options_.model->plant, nominal));
      const sim::PlantOptions& roles = nominal.options();
      RG_ASSIGN_OR_RETURN(nominal, options_.model->plant.WithRoles(roles.prescribed, roles.passive));
      given_ = options_.model->values;
    }
    runs_ = Runs(nominal, given_);
    RG_ASSIGN_OR_RETURN(nominal, WithRotors(set_, nominal, given_));
    for (const int i : nominal.parameters().OfKind(sim::ParameterKind::kArmature))
      given_[i] = nominal.parameters()[i].nominal;
    nominal_.emplace(std::move(nominal));
    const VectorXd& values = given_;
    for (const recordings::Recording* rec : set_.Fit()) {
      if (rec->drive_effort().size() == 0) return InvalidError(rec->name + ": no effort drives the model");
      if (rec->rows() < 10) return InvalidError(rec->name + ": fewer than 10 rows, too little to fit");
      fit_.push_back({rec, set_.effort_excludes_gravity ? DriveSignalWithGravity(*rec, *nominal_, values)
                                                        : DriveSignal(*rec)});
    }
    if (fit_.empty()) return InvalidError("no recording of the split \"fit\"");
    judged_ = set_.Holdout();
    judged_on_fit_ = judged_.empty();
    if (judged_on_fit_) judged_ = set_.Fit();
    noise_ = FlooredNoise(recordings::EstimateSensorNoise(set_));
    return options_.fit_windows > 0 ? ChooseWindows() : Status::Ok();
  }

  // Leaves of the fit recordings what is to be fitted.
  Status ChooseWindows() {
    const std::vector<FitWindow> candidates = CandidateWindows(fit_, options_.fit_window_s);
    switch (options_.window_choice) {
      case WindowChoice::kFirst:
        windows_ = TakeFirst(candidates, options_.fit_windows);
        break;
      case WindowChoice::kRandom:
        windows_ = TakeAtRandom(candidates, options_.window_seed, options_.fit_windows);
        break;
      case WindowChoice::kInformation: {
        RG_ASSIGN_OR_RETURN(windows_, MostInformative(candidates));
        break;
      }
    }
    if (windows_.empty())
      return InvalidError(Printf("no fit recording holds a window of %g s", options_.fit_window_s));
    std::vector<FitRecording> whole = std::move(fit_);
    fit_.clear();
    slices_.reserve(windows_.size());
    for (const FitWindow& w : windows_) {
      const recordings::Recording& rec = *whole[w.recording].recording;
      window_recordings_.push_back(rec.name);
      slices_.push_back(recordings::Slice(rec, w.first, w.last - w.first + 1));
      fit_.push_back({&slices_.back(), whole[w.recording].command});
    }
    return Status::Ok();
  }

  // By what they would tell the richest candidate of its parameters.
  Result<std::vector<FitWindow>> MostInformative(const std::vector<FitWindow>& candidates) const {
    const Candidate richest = Candidates(options_, runs_).back();
    RG_ASSIGN_OR_RETURN(const sim::Plant plant, PlantOf(richest));
    const FitSpace space(ParametersOf(plant, richest), options_.consistent_inertias);
    WindowInformationOptions information;
    information.threads = threads_;
    information.simulator.step_s = options_.step_s > 0.0 ? options_.step_s : kInformationStep;
    return ChooseByInformation(plant, plant.ValuesFrom(nominal_->parameters(), given_), space, fit_,
                               candidates, noise_, options_.fit_windows, information);
  }

  // The candidate's plant, and where its fit starts.
  Result<Fitted> Start(const Candidate& candidate) {
    const double start = clock_.SteadySeconds();
    RG_ASSIGN_OR_RETURN(sim::Plant plant, PlantOf(candidate));
    Fitted f{plant, FitSpace(ParametersOf(plant, candidate), options_.consistent_inertias)};
    f.score.name = candidate.name;
    f.fit.theta = f.space.nominal();
    f.fit.values = plant.ValuesFrom(nominal_->parameters(), given_);
    f.score.parameters = f.space.size();
    if (f.space.size() > 0) Regress(&f);
    f.score.seconds = clock_.SteadySeconds() - start;
    return f;
  }

  // Judges the start and what each round of shooting made of it, and keeps the best on held-out data: long
  // windows can fit the peculiarities of few recordings.
  void Finish(Fitted* f) {
    const double start = clock_.SteadySeconds();
    Judge(f);
    if (f->space.size() > 0) Shoot(f);
    f->score.seconds += clock_.SteadySeconds() - start;
  }

  void Judge(Fitted* f) const {
    f->score.fit_rms = Score(*f, set_.Fit(), nullptr);
    f->score.holdout_rms = Score(*f, judged_, &f->holdout);
  }

  // A model whose inverse dynamics already explains the torques much worse than another's is not shot.
  static void KeepPromising(std::vector<Fitted>* fitted) {
    double best = std::numeric_limits<double>::infinity();
    for (const Fitted& f : *fitted) {
      if (f.torque_stddev.size() > 0) best = std::min(best, LogTorqueError(f));
    }
    std::erase_if(*fitted, [&](const Fitted& f) {
      return f.torque_stddev.size() > 0 && LogTorqueError(f) > best + std::log(kMuchWorse);
    });
  }

  // Mean over the joints that have an equation of their own.
  static double LogTorqueError(const Fitted& f) {
    double sum = 0.0;
    for (int j = 0; j < f.torque_stddev.size(); ++j) {
      if (!f.plant.IsPrescribed(j)) sum += std::log(f.torque_stddev[j]);
    }
    return sum / std::max<double>(1.0, static_cast<double>(f.torque_stddev.size()) -
                                           static_cast<double>(f.plant.prescribed().size()));
  }

  void ChooseStepFor(const Fitted& f) {
    simulator_.step_s = options_.step_s > 0.0 ? options_.step_s
                                              : ChooseStep(f.plant, f.fit.values, f.space, f.fit.theta, fit_,
                                                           noise_, 0.5 * options_.fit_window_s);
  }

  Result<sim::Plant> PlantOf(const Candidate& candidate) const {
    std::vector<effects::EffectSpec> specs = nominal_->effects();
    for (const std::string& id : candidate.effects) {
      const std::vector<std::string> joints = JointsWithout(id);
      if (!joints.empty()) specs.push_back(effects::MakeSpec(id, joints));
    }
    return sim::Plant::Create(nominal_->shared_model(), nominal_->options(), std::move(specs));
  }

  // Joints on which the model that was given has neither this effect nor, for dry friction, another law of
  // it.
  std::vector<std::string> JointsWithout(const std::string& id) const {
    const auto dry = [](const std::string& of) { return effects::IsIn(effects::Slot::kDryFriction, of); };
    std::vector<std::string> joints;
    for (int j = 0; j < nominal_->num_joints(); ++j) {
      if (nominal_->Takes(id, j)) joints.push_back(nominal_->joint_names()[static_cast<size_t>(j)]);
    }
    for (const effects::EffectSpec& spec : nominal_->effects()) {
      if (spec.id != id && !(dry(spec.id) && dry(id))) continue;
      for (const std::string& joint : spec.joints) std::erase(joints, joint);
    }
    return joints;
  }

  // Rotor inertia is believed in units of what the joint carries, which its catalogue row cannot know.
  std::vector<FitParameter> ParametersOf(const sim::Plant& plant, const Candidate& candidate) const {
    std::vector<FitParameter> out;
    if (candidate.inertial) out = InertialFitParameters(plant);
    if (candidate.inertial || !candidate.effects.empty() || !runs_) {
      for (FitParameter& p : RotorFitParameters(plant)) out.push_back(std::move(p));
    }
    if (candidate.inertial || !candidate.effects.empty()) {
      for (FitParameter& p : DeclaredJointFitParameters(plant)) {
        if (p.nominal != 0.0) out.push_back(std::move(p));
      }
    }
    dynamics::Workspace workspace;
    const int n = plant.num_joints();
    MatrixXd M(n, n);
    dynamics::Crba(MechanismOf(plant, plant.parameters().Nominal()), workspace,
                   fit_.front().recording->q.col(0), M);
    for (FitParameter& p : EffectFitParameters(plant)) {
      if (std::find(candidate.effects.begin(), candidate.effects.end(), plant.parameters()[p.index].effect) ==
          candidate.effects.end())
        continue;
      const sim::Parameter& row = plant.parameters()[p.index];
      const int joint = plant.model().FindJoint(row.owner);
      // Where the URDF declares the same force, that parameter is the one that moves.
      using enum effects::Regressor;
      if (row.effect == effects::LawOf(kVelocity).id && plant.model().joint(joint).damping != 0.0) continue;
      if (row.effect == effects::LawOf(kDirection).id && plant.model().joint(joint).friction != 0.0) continue;
      if (row.effect == effects::LawOf(kAcceleration).id)
        p.prior_stddev = std::max(p.prior_stddev, M(joint, joint));
      if (!std::isfinite(p.prior_stddev)) p.prior_stddev = 0.1 * LargestEffort(joint);
      out.push_back(std::move(p));
    }
    if (options_.model) StandAround(plant.ValuesFrom(nominal_->parameters(), given_), &out);
    return out;
  }

  static void StandAround(const VectorXd& values, std::vector<FitParameter>* parameters) {
    for (FitParameter& p : *parameters) {
      p.nominal = values[p.index];
      p.lower = std::min(p.lower, p.nominal);
      p.upper = std::max(p.upper, p.nominal);
    }
  }

  // What stands for the effort limit of a joint whose URDF has none.
  double LargestEffort(int joint) const {
    double largest = 1e-3;
    for (const FitRecording& fit : fit_) {
      largest = std::max(largest, fit.recording->drive_effort().row(joint).cwiseAbs().maxCoeff());
    }
    return largest;
  }

  void Regress(Fitted* f) const {
    const RegressionResult start =
        RegressInverseDynamics(f->plant, f->fit.values, f->space, f->fit.theta, fit_);
    f->fit.theta = start.theta;
    if (start.rows > 0) f->torque_stddev = start.torque_stddev;
    f->fit.values = f->space.Values(f->fit.theta, f->fit.values);
  }

  ShootingFitOptions Shooting() const {
    ShootingFitOptions shooting;
    shooting.first_window_s = 0.25 * options_.fit_window_s;
    shooting.window_s = options_.fit_window_s;
    shooting.residual_rate_hz = options_.residual_rate_hz;
    shooting.huber = options_.huber;
    shooting.max_iterations = options_.max_iterations;
    shooting.relative_tolerance = options_.relative_tolerance;
    shooting.threads = threads_;
    shooting.simulator = simulator_;
    if (!windows_.empty()) shooting.refinements = kRefinements;
    return shooting;
  }

  void Shoot(Fitted* best) const {
    const Fitted start = *best;
    double rounds = 0.0;  // of two
    FitByShooting(
        start.plant, start.fit.values, start.space, start.fit.theta, fit_, noise_, Shooting(), stop_,
        [&](const ShootingFit& fit) {
          Fitted trial = start;
          trial.fit = fit;
          KeepBetter(std::move(trial), best);
          rounds += 1.0;
        },
        [&](const ProgressUpdate& u) {
          Tell(0.5 * (rounds + u.done / u.total), start.score.name + ", " + u.note);
        });
  }

  void KeepBetter(Fitted trial, Fitted* best) const {
    Judge(&trial);
    const bool first = best->fit.solution.information.size() == 0;  // a start has no covariance to report
    if (first ? trial.score.holdout_rms < kSimpler * best->score.holdout_rms
              : trial.score.holdout_rms < best->score.holdout_rms) {
      *best = std::move(trial);
    }
  }

  Prediction Predict(const Fitted& f, const recordings::Recording& rec) const {
    PredictionOptions prediction;
    prediction.window_s = options_.window_s;
    prediction.simulator = simulator_;
    prediction.noise = noise_;
    prediction.effort_excludes_gravity = set_.effort_excludes_gravity;
    return PredictRecording(f.plant, f.fit.values, rec, prediction);
  }

  // RMS over all recordings together; `each` (or null) gets one entry per recording.
  double Score(const Fitted& f, const std::vector<const recordings::Recording*>& recs,
               std::vector<PredictionError>* each) const {
    std::vector<PredictionError> errors(recs.size());
    ParallelFor(threads_, static_cast<int>(recs.size()),
                [&](int, int i) { errors[i] = ErrorOf(Predict(f, *recs[i]), *recs[i]); });
    double squares = 0.0, rows = 0.0;
    for (size_t i = 0; i < recs.size(); ++i) {
      squares += errors[i].rms * errors[i].rms * recs[i]->rows();
      rows += recs[i]->rows();
    }
    if (each != nullptr) *each = std::move(errors);
    return std::sqrt(squares / std::max(1.0, rows));
  }

  // From the simplest to the richest: a model replaces the one before when its held-out error is smaller,
  // and by more than chance on a window by window comparison: in nearly all resamples of the windows, or in
  // the mean of the logarithms, where one window does not decide.
  static size_t Choose(const std::vector<Fitted>& fitted) {
    size_t best = 0;
    for (size_t i = 1; i < fitted.size(); ++i) {
      if (fitted[i].score.holdout_rms >= fitted[best].score.holdout_rms) continue;
      const auto pairs = PairedWindows(fitted[best].holdout, fitted[i].holdout);
      if (pairs.empty() || LogGain(pairs) > kSignificance || ShareOfResamples(pairs) > kResampleShare)
        best = i;
    }
    return best;
  }

  static std::vector<std::pair<double, double>> PairedWindows(const std::vector<PredictionError>& before,
                                                              const std::vector<PredictionError>& after) {
    std::vector<std::pair<double, double>> pairs;
    for (size_t r = 0; r < before.size(); ++r) {
      for (size_t w = 0; w < before[r].windows.size(); ++w) {
        pairs.emplace_back(before[r].windows[w] + kMinError, after[r].windows[w] + kMinError);
      }
    }
    return pairs;
  }

  // Mean of log(before/after) in standard errors.
  static double LogGain(const std::vector<std::pair<double, double>>& pairs) {
    const double count = static_cast<double>(pairs.size());
    double sum = 0.0, squares = 0.0;
    for (const auto& [before, after] : pairs) {
      const double gain = std::log(before / after);
      sum += gain;
      squares += gain * gain;
    }
    const double mean = sum / count;
    const double variance =
        std::max(1e-12, squares / count - mean * mean) * count / std::max(1.0, count - 1.0);
    return mean / std::sqrt(variance / count);
  }

  // Share of bootstrap resamples of the windows in which the sum of squares falls.
  static double ShareOfResamples(const std::vector<std::pair<double, double>>& pairs) {
    Rng rng(kResampleSeed);
    int better = 0;
    for (int k = 0; k < kResamples; ++k) {
      double gain = 0.0;
      for (size_t w = 0; w < pairs.size(); ++w) {
        const auto& [before, after] = pairs[rng.Index(pairs.size())];
        gain += before * before - after * after;
      }
      better += gain > 0.0 ? 1 : 0;
    }
    return static_cast<double>(better) / kResamples;
  }

  static double MedianOfWindows(const std::vector<PredictionError>& errors) {
    std::vector<double> all;
    for (const PredictionError& e : errors) all.insert(all.end(), e.windows.begin(), e.windows.end());
    if (all.empty()) return 0.0;
    std::nth_element(all.begin(), all.begin() + all.size() / 2, all.end());
    return all[all.size() / 2];
  }

  // Of the model as given, where it can be simulated.
  double Before(double x) const { return runs_ ? x : std::numeric_limits<double>::quiet_NaN(); }

  SysidReport Report(const std::vector<Fitted>& fitted) const {
    const Fitted& nominal = fitted.front();
    const Fitted& best = fitted[Choose(fitted)];
    SysidReport report;
    report.robot = nominal_->model().name();
    report.joints = nominal_->joint_names();
    report.window_s = options_.window_s;
    report.step_s = simulator_.step_s;
    report.judged_on_fit = judged_on_fit_;
    report.before_rms = Before(nominal.score.holdout_rms);
    report.after_rms = best.score.holdout_rms;
    report.before_median = Before(MedianOfWindows(nominal.holdout));
    report.after_median = MedianOfWindows(best.holdout);
    report.fit_before_rms = Before(nominal.score.fit_rms);
    report.fit_after_rms = best.score.fit_rms;
    report.chosen = best.score.name;
    for (const Fitted& f : fitted) report.candidates.push_back(f.score);
    for (size_t i = 0; i < judged_.size(); ++i) {
      const PredictionError &before = nominal.holdout[i], &after = best.holdout[i];
      report.holdout.push_back(
          {judged_[i]->name, Before(before.rms), after.rms, Before(before.median_window), after.median_window,
           VectorXd(before.joint_rms.unaryExpr([&](double x) { return Before(x); })), after.joint_rms});
    }
    for (size_t i = 0; i < std::min(kTraces, judged_.size()); ++i) {
      const recordings::Recording& rec = *judged_[i];
      const MatrixXd before = runs_ ? Predict(nominal, rec).q : MatrixXd();
      report.traces.push_back({rec.name, rec.t, rec.q, before, Predict(best, rec).q});
    }
    report.window_choice = options_.window_choice;
    report.windows = windows_;
    report.window_recordings = window_recordings_;
    report.consistent_inertias = options_.consistent_inertias;
    report.plant = best.plant;
    report.values = best.fit.values;
    // A model without parameters says nothing of what the recordings could tell: the richest one does.
    Fitted told = best.space.size() > 0 ? best : fitted.back();
    if (told.fit.solution.information.size() == 0) {
      told.fit.scales = ScalesOf(noise_);
      AddInformation(told.plant, told.space, fit_, noise_, Shooting(), stop_, &told.fit);
    }
    report.identifiability = IdentifiabilityOf(told.space, told.fit);
    if (!report.identifiability.parameters.empty()) report.identifiability_of = told.score.name;
    FillWarnings(best, &report);
    return report;
  }

  void FillWarnings(const Fitted& f, SysidReport* report) const {
    report->warnings = set_.warnings;
    for (std::string& note : NotesOnRotors(f.plant, f.fit.values))
      report->warnings.push_back(std::move(note));
    for (std::string& note : NotesOnRoles(set_, *nominal_)) report->warnings.push_back(std::move(note));
    const std::string residual = Printf(
        "; the error of %.3g is no proof: the data leave this free, the consistent parametrisation does not",
        report->after_rms);
    for (const std::string& w : ImpossibleInertias(f.plant, f.fit.values))
      report->warnings.push_back(w + residual);
    for (const ParameterVerdict& p : report->identifiability.parameters) {
      if (report->identifiability_of != report->chosen) break;
      if (p.verdict == Verdict::kAtBound && p.value != 0.0) {
        report->warnings.push_back(p.name + " sits on its bound, " + std::to_string(p.value) + " " + p.unit);
      }
    }
    if (f.fit.solution.failed_windows > 0) {
      report->warnings.push_back(std::to_string(f.fit.solution.failed_windows) +
                                 " windows could not be simulated with the fitted parameters");
    }
    if (set_.holdout_was_chosen) report->warnings.push_back("the set has no holdout split: one was chosen");
    if (judged_on_fit_)
      report->warnings.push_back("the set has one recording: errors are of the fitted data");
  }

  // `share` of the current candidate is done.
  void Tell(double share, const std::string& note) const {
    if (progress_) progress_({"fit", position_.candidate + share, position_.candidates, note});
  }

  const recordings::RecordingSet& set_;
  const SysidOptions& options_;
  const Clock& clock_;
  const ProgressFn& progress_;
  StopCondition stop_;
  int threads_ = 1;
  sim::SimulatorOptions simulator_;
  std::optional<sim::Plant> nominal_;
  VectorXd given_;  // values of nominal_'s table
  std::vector<FitRecording> fit_;
  std::vector<FitWindow> windows_;  // where only some are fitted: these, as
  std::vector<recordings::Recording> slices_;
  std::vector<std::string> window_recordings_;
  std::vector<const recordings::Recording*> judged_;
  bool judged_on_fit_ = false;
  bool runs_ = true;  // the model as given can be simulated
  struct {
    double candidate = 0.0, candidates = 1.0;
  } position_;  // for progress
  recordings::SensorNoise noise_;
};

}  // namespace

Result<sim::Plant> NominalPlant(const recordings::RecordingSet& set) {
  model::LoadOptions load;
  load.joints = set.joints;
  load.locked = set.locked;
  RG_ASSIGN_OR_RETURN(model::RobotModel robot, model::ParseUrdf(set.urdf_text, set.urdf_path, load));
  sim::PlantOptions options;
  options.gravity = set.gravity;
  options.prescribed = set.prescribed;
  auto shared = std::make_shared<const model::RobotModel>(std::move(robot));
  RG_ASSIGN_OR_RETURN(const sim::Plant driven, sim::Plant::Create(shared, options));
  options.passive = PassiveJoints(set, driven);
  return sim::Plant::Create(std::move(shared), options);
}

Status CheckJoints(const sim::Plant& model, const sim::Plant& set) {
  if (model.joint_names() == set.joint_names()) return Status::Ok();
  std::string have, want;
  for (const std::string& joint : model.joint_names()) have += " " + joint;
  for (const std::string& joint : set.joint_names()) want += " " + joint;
  return InvalidError("the model has the joints" + have + ", the recordings" + want);
}

Status CheckTimes(double window_s, double step_s) {
  if (!(window_s > 0.0 && window_s <= 3600.0))
    return InvalidError(Printf("window is %g s, must be positive and at most 3600 s", window_s));
  if (step_s != 0.0 && !(step_s >= 1e-6 && step_s <= 0.1))
    return InvalidError(Printf("step is %g s, must be 0 (chosen) or between 1e-6 and 0.1 s", step_s));
  return Status::Ok();
}

Result<SysidReport> SysidOnSet(const recordings::RecordingSet& set, const SysidOptions& options,
                               const Clock& clock, const ProgressFn& progress, const CancelToken* cancel) {
  RG_RETURN_IF_ERROR(CheckTimes(options.window_s, options.step_s));
  RG_RETURN_IF_ERROR(CheckTimes(options.fit_window_s, options.step_s).WithPrefix("fit"));
  return Identification(set, options, clock, progress, cancel).Run();
}

}  // namespace rg::sysid
