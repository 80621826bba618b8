#include "services/diagnosis/likelihood/lifted_fit.h"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/QR>
#include <algorithm>
#include <cmath>
#include <limits>
#include <memory>
#include <numeric>
#include <utility>

#include "common/base/check.h"
#include "common/base/parallel.h"
#include "services/diagnosis/likelihood/lineariser.h"
#include "services/diagnosis/likelihood/move_states.h"
#include "services/diagnosis/likelihood/some_windows.h"
#include "services/sysid/boxed_newton_step.h"
#include "services/sysid/fit_space.h"

namespace rg::diagnosis {

namespace {

constexpr double kParts[] = {1.0, 0.3, 0.1, 0.03, 0.0};  // of the trust region, tried one after another
constexpr double kAsExpected = 1.3;    // times what the linear model says, which a step may cost
constexpr double kMostOfGain = 0.25;   // of what that says it gains, which does as well
constexpr double kLeastTaken = 0.1;    // of a trust region, for the next one
constexpr double kSettled = 0.02;      // what a step gains that is the last
constexpr size_t kStalled = 3;         // iterations, over which a fit stalls that gains less than
constexpr double kFarFromNoise = 2.0;  // times what noise leaves
constexpr double kStalledGain = 0.1;   // of what its cost is above noise
constexpr int kPatience = 3;           // iterations before windows are taken for lost

// A step is short enough if its error moves what is simulated, beside what parameters take up, by no more
// than so many nats, or by this share of what the fit leaves.
constexpr double kStepNats = 2.0, kStepShare = 0.1;
constexpr double kRichardson = 4.0 / 3.0;
// For values, moved by less than their stddev or by this share of themselves or of their priors' stddev.
constexpr double kValueShare = 0.01;
// Windows, evenly spread, on which each iteration asks whether the step has become too long.
constexpr size_t kStepWindows = kTogether;

// Seconds of one thread, fitted to 1,176 fits of seven sets (two to seven joints, 50 to 500 Hz); those of
// rows, columns and pairs lowered since to what they take with the kernels of row_products.h (two sets of
// seven joints).
constexpr double kPerSimulatedStep = 2.4e-7;   // and pair of states, a position and its rate
constexpr double kPerLinearisedStep = 1.9e-8;  // and pair of these
constexpr double kPerNode = 1.1e-6, kPerNodeColumn = 2.3e-7;
constexpr double kPerRowColumn = 1.2e-9;    // and state
constexpr double kPerScreenedPair = 8e-11;  // row or node and pair of columns

double StepsOf(const FitData& data, const LiftedOptions& options) { return data.Seconds() / options.step_s; }

double NodesOf(const FitData& data) {
  double count = 0;
  for (const NodeWindow& w : data.windows) count += static_cast<double>(w.t.size());
  return count;
}

// What the free starts of hidden states cost: they follow noise, each by up to a nat, where the data know
// them better than their own spread over the windows says.
double HiddenCost(const std::vector<Linear>& linear, const NodeStates& states, int n, double inverse_scale) {
  const int nx = static_cast<int>(states[0].rows()), nz = nx - 2 * n;
  if (nz == 0) return 0;
  VectorXd mean = VectorXd::Zero(nz), square = VectorXd::Zero(nz);
  for (const MatrixXd& s : states) mean += s.col(0).tail(nz) / static_cast<double>(states.size());
  for (const MatrixXd& s : states)
    square += (s.col(0).tail(nz) - mean).cwiseAbs2() / static_cast<double>(states.size());
  const VectorXd spread = square.cwiseSqrt();
  double cost = 0;
  for (const Linear& l : linear) {
    if (!l.ok) continue;
    const Eigen::ColPivHouseholderQR<MatrixXd> qr(l.rows.leftCols(2 * n));
    MatrixXd hidden = l.J_e().rightCols(nz) * spread.asDiagonal();
    hidden.applyOnTheLeft(qr.householderQ().adjoint());
    const auto own = hidden.bottomRows(hidden.rows() - qr.rank());
    const MatrixXd information = own.transpose() * own * inverse_scale;
    const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(information, Eigen::EigenvaluesOnly);
    for (const double x : eigen.eigenvalues()) cost += std::min(1.0, 0.5 * std::log1p(std::max(0.0, x)));
  }
  return cost;
}

// Whether a fit whose least cost after each iteration was `costs` goes no further, far from a noise of
// `rows`: something else is missing, and a minimum found more closely says nothing more.
bool Stalls(const std::vector<double>& costs, double rows) {
  const size_t done = costs.size();
  return done > kStalled && costs.back() > kFarFromNoise * rows &&
         costs[done - 1 - kStalled] - costs.back() < kStalledGain * (costs.back() - rows);
}

// Whether a fit whose cost after each iteration was `costs` would not come to what it has to.
bool Hopeless(const std::vector<double>& costs, const LiftedOptions& options) {
  const size_t done = costs.size();
  if (!(options.to_beat > 0) || done <= kPatience) return false;
  const double pace = std::sqrt(costs[done - 1] / costs[done - 3]);
  const double left = options.iterations + options.more_iterations + 1.0 - static_cast<double>(done);
  return costs.back() * std::pow(pace, left) > options.to_beat;
}

double Sum(const std::vector<double>& of) { return std::accumulate(of.begin(), of.end(), 0.0); }

// Parameters, the plant's values with them, states, and χ² of the windows simulated from these.
struct Point {
  VectorXd theta, values;
  NodeStates states;
  std::vector<double> chi2;
};

// One fit, step by step from where it starts; the result holds the point of least cost so far.
class LiftedFit {
 public:
  LiftedFit(const FitData& data, const FitModel& model, const LiftedOptions& options, const NodeStates* from)
      : data_(data), model_(model), options_(options), given_(from != nullptr) {
    at_.theta = space_.From(model.values);
    at_.values = sysid::WithFitted(model.parameters, model.values, at_.theta);
    lin_.SetValues(model, at_.values);
    at_.states = given_ ? *from : InitialStates(data, {model.plant, at_.values, model.parameters}, options);
    loose_ = ArrivalCosts(model.plant, at_.states);
    if (lin_.has_gaps()) FollowSimulations(data, lin_, options.threads, &at_.states);
    if (hidden_ && !given_) result_.work += (1 + (lin_.has_gaps() ? kFaces : 0)) * simulation_;
  }

  void Run() {
    for (iteration_ = 0; iteration_ <= last_; ++iteration_) {
      Linearise();
      FormNormalEquations();
      if (iteration_ == 0 && (hidden_ || given_)) CountStart();
      double taken = 1.0;
      Point next = BestStep(&taken);
      double gain = Adopt(next);
      AdaptTrust(taken, gain);
      ReturnStrayed(lin_, data_, at_.states, &next.states);
      at_ = std::move(next);
      if (lin_.has_gaps() && iteration_ < last_) gain = FollowFaces(gain);
      result_.iterations = iteration_ + 1;
      const bool ends = Ends(gain) || iteration_ == last_;
      if (ends || HalvingsNeeded(few_) > 0) halvings_ = HalvingsNeeded(all_);
      if (ends || halvings_ > 0) break;
    }
    result_.rows = data_.Rows(), result_.step_s = options_.step_s;
    if (result_.ok) Weigh();
  }
  FitResult result() && { return std::move(result_); }

  // How often the step has to be halved before the fit goes on.
  int halvings() const { return halvings_; }

 private:
  // What the error of the step does to the fit: away from the solution is a rule of second order 4/3 of what
  // halving its step changes (Richardson).
  struct StepError {
    double nats = 0;  // by which it moves what is simulated, beside what starts and parameters take up
    VectorXd shift;   // P: by which parameters take it up
  };

  // As these windows tell: until the error is small (kStepNats), which falls with the square of the step and
  // in nats with the fourth power.
  int HalvingsNeeded(const std::vector<int>& windows) {
    const double most = std::floor(std::log2(options_.step_s / options_.shortest_step_s) + 1e-6);
    if (most < 1 || last_ == 0 || !result_.ok) return 0;
    const StepError error = ErrorOfStep(windows);
    // Without it no less than this would be left.
    const double least = std::sqrt(best_) - std::sqrt(2 * error.nats);
    if (options_.to_beat > 0 && least > std::sqrt(options_.to_beat)) return 0;
    const double left = 0.5 * (result_.chi2 * inverse_scale_ - data_.Rows());
    double needed = 0.25 * std::log2(error.nats / std::max(kStepNats, kStepShare * left));
    if (options_.for_values) needed = std::max(needed, 0.5 * std::log2(LargestShift(error.shift)));
    return static_cast<int>(std::clamp(std::ceil(needed), 0.0, most));
  }

  // Relative to what a parameter may be off.
  double LargestShift(const VectorXd& shift) const {
    if (P_ == 0) return 0;
    const VectorXd known = Eigen::LLT<MatrixXd>(H_).solve(MatrixXd::Identity(P_, P_)).diagonal().cwiseSqrt();
    const VectorXd may = known.cwiseMax(kValueShare * result_.theta.cwiseAbs().cwiseMax(sigma_));
    return shift.cwiseAbs().cwiseQuotient(may).maxCoeff();
  }

  // Of all windows, as far as these tell.
  StepError ErrorOfStep(const std::vector<int>& windows) {
    if (finer_ == nullptr) {
      LiftedOptions half = options_;
      half.step_s *= 0.5;
      finer_ = std::make_unique<Lineariser>(data_, model_, false, half);
    }
    finer_->SetValues(model_, result_.values), lin_.SetValues(model_, result_.values);
    const auto own = ResidualsFrom(result_.states, windows, options_.threads, lin_);
    const auto other = ResidualsFrom(result_.states, windows, options_.threads, *finer_);
    lin_.SetValues(model_, at_.values);  // at which the next iteration linearises
    const double share = static_cast<double>(windows.size()) / W_;
    result_.work += 3 * simulation_ * share;
    double squares = 0;
    VectorXd along = VectorXd::Zero(P_);
    for (size_t i = 0; i < windows.size(); ++i) {
      const Linear& l = linear_[windows[i]];
      if (!l.ok || !other[i].allFinite()) continue;
      if (!own[i].allFinite()) {
        squares += kSoft * kSoft * static_cast<double>(own[i].size());
        continue;
      }
      RowMatrixXd moved = (own[i] - other[i]).cwiseMin(kSoft).cwiseMax(-kSoft);
      ProjectOut(l.J_e(), &moved);
      squares += moved.squaredNorm();
      along += l.J().transpose() * moved.col(0);
    }
    const double scale = inverse_scale_ / share;
    VectorXd taken_up = along * scale;
    if (P_ > 0) Eigen::LLT<MatrixXd>(H_).solveInPlace(taken_up);
    const double left = std::max(0.0, scale * (squares - along.dot(taken_up)));
    return {0.5 * kRichardson * kRichardson * left, kRichardson * taken_up};
  }

  void Linearise() {
    std::vector<RowMatrixXd> grams(W_);
    ParallelFor(options_.threads, W_, [&](int worker, int w) {
      Linear& l = linear_[w];
      lin_.Run(worker, w, at_.states[w], nullptr, nullptr, true, &l);
      if (!l.ok) return;
      RobustWeights(loose_[w], at_.states[w].col(0), &l);
      starts_[w] = BestStart(l, loose_[w]);
      RowMatrixXd rest = l.rows.rightCols(P_ + 1);
      ProjectOut(l.J_e(), &rest);
      grams[w].setZero(P_ + 1, P_ + 1);
      AddGram(rest, inverse_scale_, grams[w]);
    });
    result_.work += LinearisationWork(data_, options_, lin_.nx(), lin_.nx() + P_) *
                    (1 + W_ * lin_.Memory() / data_.Seconds());
    gram_ = MatrixXd::Zero(P_ + 1, P_ + 1);
    for (int w = 0; w < W_; ++w) {
      if (linear_[w].ok) gram_ += grams[w];
    }
    gram_ = MatrixXd(gram_.selfadjointView<Eigen::Lower>());
  }

  void FormNormalEquations() {
    H_ = gram_.topLeftCorner(P_, P_);
    H_.diagonal() += prior_;
    gradient_ = -gram_.col(P_).head(P_) + prior_.cwiseProduct(at_.theta - theta0_);
  }

  // The start itself counts; what is not free starts as the parameters say.
  void CountStart() {
    at_.chi2.resize(W_);
    ParallelFor(options_.threads, groups_, [&](int worker, int g) {
      std::vector<int> windows;
      std::vector<VectorXd> starts;
      for (int w = g * W_ / groups_; w < (g + 1) * W_ / groups_; ++w) {
        if (linear_[w].ok) {
          auto tied = linear_[w].Node(0).rightCols<1>();
          at_.states[w].col(0) += tied;
          tied.setZero();
        }
        windows.push_back(w), starts.push_back(at_.states[w].col(0));
      }
      const std::vector<double> own = lin_.Simulated(worker, windows, starts);
      std::copy(own.begin(), own.end(), at_.chi2.begin() + windows.front());
    });
    Adopt(at_);
  }

  VectorXd StepWithin(double radius) const {
    if (P_ == 0 || radius == 0) return VectorXd::Zero(P_);
    const VectorXd& theta = at_.theta;
    const VectorXd limit = (radius * sigma_).cwiseMax(radius * 0.5 * theta.cwiseAbs());
    const VectorXd step =
        sysid::BoxedNewtonStep(H_, gradient_, (lower_ - theta).cwiseMax(-limit).cwiseMin(0.0),
                               (upper_ - theta).cwiseMin(limit).cwiseMax(0.0));
    return step.allFinite() ? step : VectorXd::Zero(P_);
  }

  Point After(const VectorXd& step) {
    Point to{(at_.theta + step).cwiseMax(lower_).cwiseMin(upper_), {}, at_.states, std::vector<double>(W_)};
    to.values = sysid::WithFitted(model_.parameters, model_.values, to.theta);
    lin_.SetValues(model_, to.values);
    const std::vector<double> adopted = hidden_ || iteration_ > 0 ? at_.chi2 : std::vector<double>{};
    std::vector<size_t> simulated(groups_);
    ParallelFor(options_.threads, groups_, [&](int worker, int g) {
      simulated[g] = MoveStates(lin_, worker, g * W_ / groups_, (g + 1) * W_ / groups_, linear_, starts_,
                                step, adopted, &to.states, &to.chi2);
    });
    const size_t windows = std::accumulate(simulated.begin(), simulated.end(), size_t{0});
    const size_t again =
        iteration_ < kPatience ? 0 : TryRecordedStarts(lin_, data_, options_.threads, &to.states, &to.chi2);
    result_.work += simulation_ * static_cast<double>(windows + (hidden_ ? 3 : 2) * again) / W_;
    return to;
  }

  // Whether a step costs about what the linear model says.
  bool IsAsExpected(double cost, const VectorXd& step) const {
    if (P_ == 0) return true;
    const double expected =
        gram_(P_, P_) + PriorCost(at_.theta) + 2 * gradient_.dot(step) + step.dot(H_ * step);
    return cost <= kAsExpected * expected || best_ - cost > kMostOfGain * (best_ - expected);
  }

  // States follow. Where the cost is not what the linear model says, smaller steps are tried beside the first
  // while they are better: at last none, for states alone come to where the model holds.
  Point BestStep(double* taken) {
    Point nearest;
    double least = std::numeric_limits<double>::infinity();
    for (const double part : kParts) {
      const VectorXd step = StepWithin(part * trust_);
      Point tried = After(step);
      const double cost = CostOf(tried);
      const bool better = cost < least, known = least < best_;
      if (better) least = cost, *taken = part, nearest = std::move(tried);
      if (part == 1.0 && IsAsExpected(cost, step)) break;
      if (!better && known) break;
    }
    RG_CHECK(std::isfinite(least)) << "a fit's cost is not finite after any step";
    lin_.SetValues(model_, nearest.values);
    return nearest;
  }

  // Where a smaller step was better, the next one is kept that small.
  void AdaptTrust(double taken, double gain) {
    trust_ *= taken < 1.0 ? std::max(kLeastTaken, taken) : gain > 0 ? 2.0 : 0.5;
    trust_ = std::min(1.0, trust_);
  }

  // Of a gear with play: from faces that are nearer to the record, on to the simulations. Returns what it
  // gains with the step's `gain`.
  double FollowFaces(double gain) {
    if (options_.free_hidden) {
      ChooseFaces(data_, lin_, options_.threads, options_.noise_scale, &at_.chi2, &at_.states);
      result_.work += kFaces * simulation_;
      const double more = Adopt(at_);
      if (more > 0) gain = std::max(gain, 0.0) + more;
    }
    FollowSimulations(data_, lin_, options_.threads, &at_.states);
    result_.work += simulation_;
    return gain;
  }

  // Returns what the cost falls by against the best so far, which the point takes the place of if it does.
  double Adopt(const Point& p) {
    const double cost = CostOf(p), gain = best_ - cost;
    if (!(gain > 0)) return gain;
    best_ = cost;
    result_.values = p.values, result_.theta = p.theta, result_.states = p.states;
    result_.chi2 = Sum(p.chi2), result_.window_chi2 = p.chi2, result_.prior_cost = PriorCost(p.theta);
    result_.information = gram_.topLeftCorner(P_, P_);
    result_.ok = true;
    return gain;
  }

  bool Ends(double gain) {
    if (iteration_ > 0 && std::abs(gain) < kSettled) return true;
    if (iteration_ >= options_.iterations && !(gain > options_.still_falling * best_)) return true;
    costs_.push_back(best_);
    return (!may_stall_ && Stalls(costs_, data_.Rows())) || Hopeless(costs_, options_);
  }

  // The posterior about the result's point, and its evidence.
  void Weigh() {
    const Posterior posterior = PosteriorOf(result_.information, sigma_);
    result_.stddev = posterior.stddev;
    result_.evidence = -0.5 * result_.chi2 * inverse_scale_ - 0.5 * result_.prior_cost -
                       posterior.half_log_det - HiddenCost(linear_, result_.states, data_.n, inverse_scale_);
  }

  std::vector<int> Spread(size_t count) const {
    const std::vector<uint32_t> places = EvenlySpread(static_cast<size_t>(W_), count);
    return {places.begin(), places.end()};
  }
  double PriorCost(const VectorXd& theta) const { return prior_.dot((theta - theta0_).cwiseAbs2()); }
  double CostOf(const Point& p) const { return Sum(p.chi2) * inverse_scale_ + PriorCost(p.theta); }

  const FitData& data_;
  const FitModel& model_;
  const LiftedOptions& options_;
  const bool given_;  // whether the start is
  const int P_ = static_cast<int>(model_.parameters.size()), W_ = static_cast<int>(data_.windows.size());
  const int groups_ = (W_ + kTogether - 1) / kTogether;
  const int last_ = options_.iterations + options_.more_iterations;
  const double inverse_scale_ = 1.0 / options_.noise_scale;
  Lineariser lin_{data_, model_, false, options_};
  const double simulation_ = SimulationWork(data_, options_, lin_.nx());
  // A mass that has to find its swing, or a motor its face, may stall for a while and then come near.
  const bool hidden_ = lin_.nx() > 2 * data_.n, may_stall_ = HasFreeStates(model_.plant);
  const sysid::FitSpace space_{model_.parameters, false};
  const VectorXd &theta0_ = space_.nominal(), &lower_ = space_.lower(), &upper_ = space_.upper(),
                 &sigma_ = space_.prior_stddev();
  const VectorXd prior_ = sigma_.cwiseAbs2().cwiseInverse();
  std::vector<ArrivalCost> loose_;

  Point at_;  // χ²: empty before the first step where the start does not count
  int iteration_ = 0;
  std::vector<Linear> linear_ = std::vector<Linear>(W_);
  std::vector<BestStart> starts_ = std::vector<BestStart>(W_);
  MatrixXd gram_;       // (P + 1)², of the rows alone: its last row and column belong to the residual
  MatrixXd H_;          // P × P, prior included
  VectorXd gradient_;   // P
  double trust_ = 1.0;  // of σ, or of half the value
  double best_ = std::numeric_limits<double>::infinity();
  std::vector<double> costs_;          // after each iteration
  std::unique_ptr<Lineariser> finer_;  // with half of the step
  const std::vector<int> few_ = Spread(kStepWindows), all_ = Spread(W_);
  int halvings_ = 0;
  FitResult result_;
};

}  // namespace

double SimulationWork(const FitData& data, const LiftedOptions& options, long states) {
  return kPerSimulatedStep * StepsOf(data, options) * 0.5 * static_cast<double>(states);
}

double LinearisationWork(const FitData& data, const LiftedOptions& options, long states, long columns) {
  const auto C = static_cast<double>(columns), moving = 0.5 * static_cast<double>(states);
  return kPerLinearisedStep * StepsOf(data, options) * moving * moving +
         NodesOf(data) * (kPerNode + kPerNodeColumn * C) +
         kPerRowColumn * data.Rows() * static_cast<double>(states) * C;
}

double ScreenWork(const FitData& data, const LiftedOptions& options, long states, long parameters,
                  long columns, int draws) {
  // Linearised in unit torques, of which half act before a node on average, and a third of all pairs; all
  // columns are made of these.
  const double nodes = NodesOf(data), P = static_cast<double>(parameters), D = static_cast<double>(columns);
  const double intervals = nodes / static_cast<double>(std::max<size_t>(1, data.windows.size())) - 1;
  const double units = columns > 0 ? data.n * intervals : 0, B = P + units;
  return LinearisationWork(data, options, states, states + std::lround(P + 0.5 * units)) +
         kPerScreenedPair * (data.Rows() * B * (B / 3 + 0.5 * draws) + nodes * D * (B + D));
}

double HalfLogDet(const Eigen::LLT<MatrixXd>& factor) {
  double sum = 0;
  for (const double x : factor.matrixLLT().diagonal()) sum += std::log(x);
  return sum;
}

Posterior PosteriorOf(const MatrixXd& information, const VectorXd& sigma) {
  const auto P = sigma.size();
  Posterior out{0, VectorXd(P)};
  if (P == 0) return out;
  const MatrixXd scaled = sigma.asDiagonal() * information * sigma.asDiagonal();
  const Eigen::LLT<MatrixXd> llt(MatrixXd::Identity(P, P) + scaled);
  out.half_log_det = HalfLogDet(llt);
  const MatrixXd covariance = llt.solve(MatrixXd::Identity(P, P));
  for (Eigen::Index i = 0; i < P; ++i) {
    out.stddev[i] = sigma[i] * std::sqrt(std::max(0.0, covariance(i, i)));
  }
  return out;
}

int MotorOf(const sim::Plant& plant, const std::string& joint) {
  const auto& names = plant.internal_state_names();
  const auto at = std::ranges::find(names, "motor_position." + joint);
  return at == names.end() ? -1 : static_cast<int>(at - names.begin());
}

bool HasStatesBut(std::initializer_list<std::string_view> kinds, const sim::Plant& plant) {
  const auto& names = plant.internal_state_names();
  return std::ranges::any_of(names, [&](const std::string& name) {
    return std::ranges::none_of(kinds, [&](auto kind) { return name.starts_with(kind); });
  });
}

FitResult Fit(const FitData& data, const FitModel& model, const LiftedOptions& options,
              const NodeStates* from) {
  FitResult found;
  int halvings = 0;
  {
    LiftedFit fit(data, model, options, from);
    fit.Run();
    halvings = fit.halvings();
    found = std::move(fit).result();
  }
  if (halvings == 0) return found;
  LiftedOptions finer = options;
  finer.step_s = std::ldexp(options.step_s, -halvings);
  FitResult refined = Fit(data, {model.plant, found.values, model.parameters}, finer, &found.states);
  refined.work += found.work, refined.iterations += found.iterations;
  return refined;
}

LiftedOptions KeepingStep(LiftedOptions options) {
  options.shortest_step_s = options.step_s;
  return options;
}

LiftedOptions AsFitted(LiftedOptions options, const FitResult& fit) {
  if (fit.step_s > 0) options.step_s = std::min(options.step_s, fit.step_s);
  return options;
}

}  // namespace rg::diagnosis
