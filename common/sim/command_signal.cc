#include "common/sim/command_signal.h"

#include <algorithm>
#include <cmath>
#include <string>

#include "common/base/check.h"

namespace rg::sim {

Result<CommandSignal> CommandSignal::Create(std::vector<double> times, Eigen::MatrixXd values, Hold hold) {
  const auto count = static_cast<Eigen::Index>(times.size());
  if (count == 0) return InvalidError("a command signal without rows");
  if (values.cols() != count) {
    return InvalidError("a command signal of " + std::to_string(count) + " times with " +
                        std::to_string(values.cols()) + " values");
  }
  for (Eigen::Index k = 0; k < count; ++k) {
    if (!std::isfinite(times[k]) || !values.col(k).allFinite()) {
      return InvalidError("command row " + std::to_string(k) + " is not finite");
    }
    if (k > 0 && !(times[k] > times[k - 1])) {
      return InvalidError("command row " + std::to_string(k) + ": time does not increase");
    }
  }
  CommandSignal signal;
  signal.hold_ = hold;
  signal.integral_.setZero(values.rows(), count);
  for (Eigen::Index k = 1; k < count; ++k) {
    const double span = times[k] - times[k - 1];
    const auto mean = hold == Hold::kZeroOrder ? Eigen::VectorXd(values.col(k - 1))
                                               : Eigen::VectorXd(0.5 * (values.col(k - 1) + values.col(k)));
    signal.integral_.col(k) = signal.integral_.col(k - 1) + span * mean;
  }
  signal.times_ = std::move(times);
  signal.values_ = std::move(values);
  return signal;
}

CommandSignal CommandSignal::Constant(const Eigen::VectorXd& u) {
  return Create({0.0}, u, Hold::kZeroOrder).value();
}

CommandSignal CommandSignal::WithMotion(std::shared_ptr<const GivenMotion> motion) const {
  CommandSignal out = *this;
  out.motion_ = std::move(motion);
  return out;
}

double CommandSignal::At(int joint, double t) const {
  const int k = SegmentAt(times_, t);
  if (hold_ == Hold::kZeroOrder || t <= times_[0] || k + 1 >= size()) return values_(joint, k);
  const double share = (t - times_[k]) / (times_[k + 1] - times_[k]);
  return values_(joint, k) + share * (values_(joint, k + 1) - values_(joint, k));
}

double CommandSignal::Integral(int joint, double t) const {
  const int k = SegmentAt(times_, t);
  const double since = t - times_[k];
  const double mean =
      hold_ == Hold::kZeroOrder ? values_(joint, k) : 0.5 * (values_(joint, k) + At(joint, t));
  return integral_(joint, k) + since * mean;
}

double CommandSignal::Average(int joint, double begin, double end) const {
  const int first = SegmentAt(times_, begin);
  if (first + 1 >= size() || end <= times_[first + 1]) {  // inside one piece: exact, without cancellation
    if (hold_ == Hold::kZeroOrder) return values_(joint, first);
    if (begin >= times_[0]) return 0.5 * (At(joint, begin) + At(joint, end));
  }
  return (Integral(joint, end) - Integral(joint, begin)) / (end - begin);
}

}  // namespace rg::sim
