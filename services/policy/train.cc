#include "services/policy/train.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>
#include <map>
#include <numbers>

namespace rg::policy {
namespace {

// Streams of the seed: the start, the split and the order of the points do not touch each other.
enum Stream : uint64_t { kStartStream = 0, kSplitStream = 1, kOrderStream = 2 };

constexpr int kLossBatch = 256;  // points at a time where only the loss is wanted

Status CheckOptions(const TrainOptions& o, const Dataset& d) {
  const auto error = [](const std::string& what) { return InvalidError("training options: " + what); };
  if (o.hidden.empty() || o.hidden.size() > 8) {
    return error("hidden: " + std::to_string(o.hidden.size()) + " layers, must be 1 to 8");
  }
  for (const int h : o.hidden) {
    if (h < 1 || h > kMaxHidden) {
      return error("hidden: " + std::to_string(h) + ", must be 1 to " + std::to_string(kMaxHidden));
    }
  }
  if (o.epochs < 1) return error("epochs: " + std::to_string(o.epochs) + ", must be at least 1");
  if (o.batch < 1) return error("batch: " + std::to_string(o.batch) + ", must be at least 1");
  const auto inside = [](double x, double low, double high) { return x >= low && x < high; };
  if (!(o.learning_rate > 0.0) || !std::isfinite(o.learning_rate))
    return error("learning_rate must be above 0");
  if (!(o.final_rate_share > 0.0 && o.final_rate_share <= 1.0))
    return error("final_rate_share must be in (0, 1]");
  if (!inside(o.beta1, 0.0, 1.0) || !inside(o.beta2, 0.0, 1.0))
    return error("beta1, beta2 must be in [0, 1)");
  if (!(o.epsilon > 0.0)) return error("epsilon must be above 0");
  if (!(o.weight_decay >= 0.0)) return error("weight_decay must be at least 0");
  if (!inside(o.validation_fraction, 0.0, 1.0)) return error("validation_fraction must be in [0, 1)");
  if (d.inputs.rows() > kMaxInputs || d.outputs.rows() > kMaxOutputs)
    return error("too many inputs or outputs");
  int last = -1;
  for (const int i : o.periodic_inputs) {
    if (i <= last || i >= d.inputs.rows()) return error("periodic_inputs must ascend and be inputs");
    last = i;
  }
  return Status::Ok();
}

struct Normalisation {
  std::vector<double> mean, scale;
};

// Mean and standard deviation of each row over `points`. A row that does not vary, to float's
// precision, gets scale 0.
template <class ValueAt>
Normalisation Normalise(int rows, const std::vector<int>& points, const ValueAt& value_at) {
  Normalisation n;
  const double count = static_cast<double>(points.size());
  for (int row = 0; row < rows; ++row) {
    double sum = 0.0, square = 0.0;
    for (const int p : points) sum += value_at(row, p);
    const double mean = sum / count;
    for (const int p : points) square += std::pow(value_at(row, p) - mean, 2);
    const double stddev = std::sqrt(square / count);
    n.mean.push_back(mean);
    n.scale.push_back(stddev > 1e-6 * std::abs(mean) ? stddev : 0.0);
  }
  return n;
}

// One row of `stride` floats per point: (value − mean) / scale, padded with zeros.
template <class ValueAt>
std::vector<float> NormalisedRows(int points, int stride, const Normalisation& n, const ValueAt& value_at) {
  std::vector<float> rows(static_cast<size_t>(points) * static_cast<size_t>(stride), 0.0f);
  for (int p = 0; p < points; ++p) {
    float* row = rows.data() + static_cast<size_t>(p) * static_cast<size_t>(stride);
    for (size_t i = 0; i < n.mean.size(); ++i) {
      if (n.scale[i] > 0.0) {
        row[i] = static_cast<float>((value_at(static_cast<int>(i), p) - n.mean[i]) / n.scale[i]);
      }
    }
  }
  return rows;
}

Eigen::MatrixXd EncodeAll(const InputEncoding& encoding, const Eigen::MatrixXf& inputs) {
  Eigen::MatrixXd features(encoding.features(), inputs.cols());
  for (Eigen::Index p = 0; p < inputs.cols(); ++p) {
    const Eigen::VectorXd x = inputs.col(p).cast<double>();
    encoding.Encode(x.data(), features.col(p).data());
  }
  return features;
}

std::vector<int> NetworkSizes(int features, const std::vector<int>& hidden, int outputs) {
  std::vector<int> sizes = {features};
  sizes.insert(sizes.end(), hidden.begin(), hidden.end());
  sizes.push_back(outputs);
  return sizes;
}

class Trainer {
 public:
  Trainer(const Dataset& dataset, const TrainOptions& options)
      : dataset_(dataset),
        options_(options),
        rng_(options.seed),
        encoding_{static_cast<int>(dataset.inputs.rows()), options.periodic_inputs},
        outputs_(static_cast<int>(dataset.outputs.rows())),
        split_(SplitByTrajectory(dataset.trajectory, options.validation_fraction, options.seed)),
        network_(NetworkSizes(encoding_.features(), options.hidden, outputs_)),
        workspace_(network_, std::max(options.batch, kLossBatch),
                   options.kernels ? *options.kernels : BestKernels()),
        order_(split_.train) {
    Prepare();
  }

  TrainResult Run(const ProgressFn& progress, const CancelToken* cancel) {
    Termination termination = Termination::kCompleted;
    int epoch = 0;
    for (; epoch < options_.epochs; ++epoch) {
      const double train = RunEpoch(epoch, cancel);
      if (cancelled_) {
        termination = Termination::kCancelled;
        break;
      }
      const double validation = MeanLoss(split_.validation);
      if (!std::isfinite(train) || std::isinf(validation) ||
          (std::isnan(validation) && !split_.validation.empty())) {
        termination = Termination::kDiverged;
        break;
      }
      curve_.push_back({train, validation});
      Keep(validation);
      Report(progress, epoch);
    }
    return Finish(termination, epoch);
  }

 private:
  void Prepare() {
    Rng start = rng_.Split(kStartStream);
    network_.StartHe(start);
    kept_ = network_.parameters();
    const Eigen::MatrixXd features = EncodeAll(encoding_, dataset_.inputs);
    const auto feature_at = [&](int row, int p) { return features(row, p); };
    const auto output_at = [&](int row, int p) { return static_cast<double>(dataset_.outputs(row, p)); };
    input_normalisation_ = Normalise(encoding_.features(), split_.train, feature_at);
    output_normalisation_ = Normalise(outputs_, split_.train, output_at);
    const int points = dataset_.size();
    inputs_ = NormalisedRows(points, workspace_.input_stride(), input_normalisation_, feature_at);
    targets_ = NormalisedRows(points, workspace_.target_stride(), output_normalisation_, output_at);
    moment1_.assign(network_.parameters().size(), 0.0f);
    moment2_ = moment1_;
  }

  double LearningRate(int epoch) const {
    if (options_.schedule == Schedule::kConstant || options_.epochs == 1) return options_.learning_rate;
    const double done = static_cast<double>(epoch) / (options_.epochs - 1);
    const double share = options_.final_rate_share +
                         (1.0 - options_.final_rate_share) * 0.5 * (1.0 + std::cos(std::numbers::pi * done));
    return options_.learning_rate * share;
  }

  void ShufflePoints(int epoch) {
    Rng rng = rng_.Split(kOrderStream).Split(static_cast<uint64_t>(epoch));
    for (size_t i = order_.size(); i > 1; --i) std::swap(order_[i - 1], order_[rng.Index(i)]);
  }

  // Mean loss over the epoch's batches.
  double RunEpoch(int epoch, const CancelToken* cancel) {
    ShufflePoints(epoch);
    const double rate = LearningRate(epoch);
    const int points = static_cast<int>(order_.size());
    double sum = 0.0;
    for (int first = 0; first < points; first += options_.batch) {
      if (cancel && cancel->cancelled()) {
        cancelled_ = true;
        return 0.0;
      }
      const int count = std::min(options_.batch, points - first);
      sum +=
          workspace_.LossAndGradient(network_, inputs_.data(), targets_.data(), order_.data() + first, count);
      StepAdam(rate);
    }
    return sum / (static_cast<double>(points) * outputs_);
  }

  void StepAdam(double rate) {
    ++step_;
    const double c1 = 1.0 - std::pow(options_.beta1, step_), c2 = 1.0 - std::pow(options_.beta2, step_);
    AdamStep step;
    step.beta1 = static_cast<float>(options_.beta1);
    step.beta2 = static_cast<float>(options_.beta2);
    step.rate = static_cast<float>(rate * std::sqrt(c2) / c1);
    step.epsilon = static_cast<float>(options_.epsilon * std::sqrt(c2));
    step.decay = static_cast<float>(1.0 - rate * options_.weight_decay);
    const Kernels& kernels = options_.kernels ? *options_.kernels : BestKernels();
    kernels.adam(network_.parameters().data(), moment1_.data(), moment2_.data(), workspace_.gradient().data(),
                 network_.parameters().size(), step);
  }

  // Mean square error of the network as it is; NaN without points.
  double MeanLoss(const std::vector<int>& points) {
    if (points.empty()) return std::numeric_limits<double>::quiet_NaN();
    double sum = 0.0;
    for (size_t first = 0; first < points.size(); first += kLossBatch) {
      const int count = static_cast<int>(std::min<size_t>(kLossBatch, points.size() - first));
      sum += workspace_.Loss(network_, inputs_.data(), targets_.data(), points.data() + first, count);
    }
    return sum / (static_cast<double>(points.size()) * outputs_);
  }

  // The weights that a later divergence or keep_best goes back to.
  void Keep(double validation) {
    const bool choosing = options_.keep_best && !split_.validation.empty();
    if (choosing && !(validation < best_validation_)) return;
    best_validation_ = validation;
    kept_ = network_.parameters();
  }

  void Report(const ProgressFn& progress, int epoch) const {
    if (!progress) return;
    char note[96];
    std::snprintf(note, sizeof note, "loss %.3g, validation %.3g", curve_.back().train,
                  curve_.back().validation);
    progress({"policy", static_cast<double>(epoch + 1), static_cast<double>(options_.epochs), note});
  }

  std::vector<double> Rms(const Policy& policy, const std::vector<int>& points) const {
    std::vector<double> square(static_cast<size_t>(outputs_), 0.0), out(square);
    for (const int p : points) {
      const Eigen::VectorXd x = dataset_.inputs.col(p).cast<double>();
      (void)policy.Evaluate({x.data(), static_cast<size_t>(x.size())}, out);
      for (int i = 0; i < outputs_; ++i) {
        square[static_cast<size_t>(i)] +=
            std::pow(out[static_cast<size_t>(i)] - static_cast<double>(dataset_.outputs(i, p)), 2);
      }
    }
    for (double& s : square) s = std::sqrt(s / static_cast<double>(points.size()));
    return points.empty() ? std::vector<double>() : square;
  }

  TrainResult Finish(Termination termination, int epoch) {
    // What a cancelled epoch did so far is kept too, unless the best is wanted.
    if (termination == Termination::kDiverged || (options_.keep_best && !curve_.empty())) {
      network_.parameters() = kept_;
    }
    Policy::Parts parts;
    parts.joints = options_.joints;
    parts.encoding = encoding_;
    parts.input_mean = input_normalisation_.mean;
    parts.input_scale = input_normalisation_.scale;
    parts.output_mean = output_normalisation_.mean;
    parts.output_scale = output_normalisation_.scale;
    parts.network = network_;
    parts.record = {options_.seed, static_cast<int>(curve_.size()), static_cast<int>(split_.train.size()),
                    static_cast<int>(split_.validation.size()), curve_};
    TrainResult result{Policy(std::move(parts))};
    result.termination = termination;
    result.diverged_epoch = termination == Termination::kDiverged ? epoch : -1;
    result.train_loss = MeanLoss(split_.train);
    result.validation_loss = MeanLoss(split_.validation);
    result.train_rms = Rms(result.policy, split_.train);
    result.validation_rms = Rms(result.policy, split_.validation);
    return result;
  }

  const Dataset& dataset_;
  const TrainOptions& options_;
  Rng rng_;
  InputEncoding encoding_;
  int outputs_;
  DataSplit split_;
  Network network_;
  BatchWorkspace workspace_;
  std::vector<int> order_;
  Normalisation input_normalisation_, output_normalisation_;
  std::vector<float> inputs_, targets_;  // normalised, one padded row per point
  std::vector<float> moment1_, moment2_;
  int64_t step_ = 0;
  bool cancelled_ = false;
  std::vector<EpochLoss> curve_;
  std::vector<float> kept_;
  double best_validation_ = std::numeric_limits<double>::infinity();
};

}  // namespace

std::vector<int> PeriodicInputs(const std::vector<bool>& joint_is_continuous) {
  const int n = static_cast<int>(joint_is_continuous.size());
  std::vector<int> periodic;
  for (const int block : {0, 2}) {
    for (int j = 0; j < n; ++j) {
      if (joint_is_continuous[static_cast<size_t>(j)]) periodic.push_back(block * n + j);
    }
  }
  return periodic;
}

DataSplit SplitByTrajectory(const std::vector<uint64_t>& trajectory, double validation_fraction,
                            uint64_t seed) {
  std::vector<uint64_t> ids(trajectory);
  std::sort(ids.begin(), ids.end());
  ids.erase(std::unique(ids.begin(), ids.end()), ids.end());
  Rng rng = Rng(seed).Split(kSplitStream);
  for (size_t i = ids.size(); i > 1; --i) std::swap(ids[i - 1], ids[rng.Index(i)]);
  size_t held = 0;
  if (validation_fraction > 0.0 && ids.size() > 1) {
    const auto wanted =
        static_cast<size_t>(std::lround(validation_fraction * static_cast<double>(ids.size())));
    held = std::clamp<size_t>(wanted, 1, ids.size() - 1);
  }
  std::map<uint64_t, bool> is_held;
  for (size_t i = 0; i < ids.size(); ++i) is_held[ids[i]] = i < held;
  DataSplit split;
  for (size_t p = 0; p < trajectory.size(); ++p) {
    (is_held[trajectory[p]] ? split.validation : split.train).push_back(static_cast<int>(p));
  }
  return split;
}

std::string TrainResult::Message() const {
  char text[160];
  const char* how = termination == Termination::kCompleted   ? "completed"
                    : termination == Termination::kCancelled ? "cancelled"
                                                             : "diverged";
  std::snprintf(text, sizeof text, "%s after %d epochs, loss %.3g, validation %.3g", how,
                policy.record().epochs, train_loss, validation_loss);
  return text;
}

Result<TrainResult> Train(const Dataset& dataset, const TrainOptions& options, const ProgressFn& progress,
                          const CancelToken* cancel) {
  RG_RETURN_IF_ERROR(CheckDataset(dataset));
  RG_RETURN_IF_ERROR(CheckOptions(options, dataset));
  return Trainer(dataset, options).Run(progress, cancel);
}

}  // namespace rg::policy
