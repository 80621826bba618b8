#include "common/recordings/noise.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <cstdlib>

#include "common/base/rng.h"
#include "common/recordings/local_polynomial.h"

namespace rg::recordings {
namespace {

struct Signal {
  Eigen::VectorXd t, clean, rate, noisy;
};

// A motion of a few harmonics below 1.5 Hz, with jitter of the sampling times and missing rows.
Signal Motion(Rng& rng, Eigen::Index rows, double period, double stddev, double jitter = 0.0,
              double resolution = 0.0) {
  Signal s;
  s.t = s.clean = s.rate = s.noisy = Eigen::VectorXd(rows);
  double time = 0.0;
  for (Eigen::Index k = 0; k < rows; ++k) {
    time += period * (1.0 + jitter * rng.Uniform(-1.0, 1.0)) + (k % 97 == 96 ? 3.0 * period : 0.0);
    s.t[k] = time;
    s.clean[k] = 0.8 * std::sin(2.0 * time) + 0.2 * std::sin(7.0 * time + 1.0);
    s.rate[k] = 1.6 * std::cos(2.0 * time) + 1.4 * std::cos(7.0 * time + 1.0);
    s.noisy[k] = s.clean[k] + stddev * rng.Normal();
    if (resolution > 0.0) s.noisy[k] = resolution * std::round(s.noisy[k] / resolution);
  }
  return s;
}

Recording AsRecording(const Signal& s) {
  Recording r;
  r.joints = {"a"};
  r.t = s.t;
  r.q = s.noisy.transpose();
  return r;
}

double Rms(const Eigen::VectorXd& x) { return std::sqrt(x.squaredNorm() / static_cast<double>(x.size())); }

TEST(EstimateNoise, FindsAKnownNoiseUnderMotionWithIrregularSampling) {
  Rng rng(3);
  for (const double period : {0.04, 0.01, 0.002}) {
    for (const double jitter : {0.0, 0.3}) {
      const Signal s = Motion(rng, 2000, period, 6e-4, jitter);
      EXPECT_NEAR(EstimateNoise(s.t, s.noisy).stddev, 6e-4, 0.12 * 6e-4) << period << " s, jitter " << jitter;
    }
  }
}

TEST(EstimateNoise, SeesLittleWhereThereIsNoNoise) {
  Rng rng(4);
  const Signal s = Motion(rng, 2000, 0.01, 0.0);
  EXPECT_LT(EstimateNoise(s.t, s.clean).stddev, 1e-6);
}

TEST(EstimateNoise, FindsTheResolutionOfAnEncoder) {
  Rng rng(5);
  for (const double resolution : {1e-4, 3.8e-4, 1.4572366e-3}) {
    const Signal s = Motion(rng, 2000, 0.002, 2e-4, 0.1, resolution);
    EXPECT_NEAR(EstimateNoise(s.t, s.noisy).resolution, resolution, 1e-3 * resolution);
  }
}

// The grid is a fifth of the noise, and its values are written with six digits: each is up to a two-hundredth
// of a step off.
TEST(EstimateNoise, FindsAFineGridThatTheFilePrintsWithSixDigits) {
  for (const double step : {9.6e-5, 1.534e-3, 2.5e-5}) {
    Rng rng(7);
    Signal s = Motion(rng, 5000, 0.01, 4.9e-4);
    for (Eigen::Index k = 0; k < s.noisy.size(); ++k) {
      char text[32];
      std::snprintf(text, sizeof text, "%.6g", 2.0 + step * std::round((s.noisy[k] - 2.0) / step));
      s.noisy[k] = std::strtod(text, nullptr);
    }
    EXPECT_NEAR(EstimateNoise(s.t, s.noisy).resolution, step, 0.01 * step);
  }
}

TEST(EstimateNoise, SeesNoGridInContinuousValues) {
  Rng rng(6);
  const Signal s = Motion(rng, 2000, 0.01, 6e-4);
  EXPECT_LT(EstimateNoise(s.t, s.noisy).resolution, 1e-5);
}

TEST(EstimateNoise, CountsTheEncodersStepAsNoiseOfAJointAtRest) {
  Rng rng(8);
  Eigen::VectorXd t = Eigen::VectorXd::LinSpaced(500, 0.0, 5.0), x(500);
  for (int k = 0; k < 500; ++k) x[k] = k % 17 == 0 ? 1e-3 : 0.0;
  EXPECT_GE(EstimateNoise(t, x).stddev, 0.99e-3 / std::sqrt(12.0));
}

TEST(LocalPolynomial, IsExactForPolynomialsOfItsDegreeOnIrregularTimes) {
  Eigen::VectorXd t(6), x(6);
  t << 10.0, 10.1, 10.15, 10.4, 10.41, 10.6;
  for (int k = 0; k < 6; ++k) x[k] = 3.0 + 2.0 * (t[k] - 10.0) - 5.0 * (t[k] - 10.0) * (t[k] - 10.0);
  const LocalPolynomial fit = FitLocalPolynomial(t, 0, 5, 10.3, 2);
  EXPECT_NEAR(fit.value.dot(x), 3.0 + 0.6 - 0.45, 1e-10);
  EXPECT_NEAR(fit.slope.dot(x), 2.0 - 3.0, 1e-9);
}

TEST(SmoothVelocity, IsNearTheTrueVelocityAtEachRate) {
  Rng rng(9);
  for (const double period : {0.04, 0.01, 0.002}) {
    const Signal s = Motion(rng, 3000, period, 6e-4, 0.1);
    const Eigen::VectorXd v = SmoothVelocity(AsRecording(s)).row(0).transpose();
    const Eigen::VectorXd difference =
        (s.noisy.tail(2999) - s.noisy.head(2999)).cwiseQuotient(s.t.tail(2999) - s.t.head(2999));
    const double error = Rms(v - s.rate), naive = Rms(difference - s.rate.head(2999));
    EXPECT_LT(error, 0.035) << period;  // of a motion of 1.5 rad/s RMS
    EXPECT_LT(error, 0.4 * naive) << period;
  }
}

TEST(EstimateStateCausal, KnowsNothingOfLaterRows) {
  Rng rng(10);
  Recording r = AsRecording(Motion(rng, 400, 0.01, 6e-4));
  const StateEstimate before = EstimateStateCausal(r, 250);
  r.q.rightCols(149).setConstant(1e3);
  const StateEstimate after = EstimateStateCausal(r, 250);
  EXPECT_EQ(before.v, after.v);
  EXPECT_EQ(before.q, after.q);
}

TEST(EstimateStateCausal, ErrsAboutAsMuchAsItSaysAndLessThanTheMeasuredPosition) {
  Rng rng(11);
  const Signal s = Motion(rng, 3000, 0.002, 6e-4);
  const Recording r = AsRecording(s);
  double v_error = 0.0, said = 0.0, q_error = 0.0;
  int count = 0;
  for (int row = 300; row < 3000; row += 25, ++count) {
    const StateEstimate x = EstimateStateCausal(r, row);
    v_error += std::pow(x.v[0] - s.rate[row], 2);
    said += std::pow(x.v_stddev[0], 2);
    q_error += std::pow(x.q[0] - s.clean[row], 2);
  }
  EXPECT_LT(std::sqrt(v_error / count), 2.5 * std::sqrt(said / count));
  EXPECT_GT(std::sqrt(v_error / count), 0.4 * std::sqrt(said / count));
  EXPECT_LT(std::sqrt(q_error / count), 6e-4);
}

TEST(EstimateStateCausal, StartsAtRestFromTheFirstRowAlone) {
  Rng rng(12);
  const Recording r = AsRecording(Motion(rng, 20, 0.01, 6e-4));
  const StateEstimate x = EstimateStateCausal(r, 0);
  EXPECT_EQ(x.q[0], r.q(0, 0));
  EXPECT_EQ(x.v[0], 0.0);
}

TEST(EstimateSensorNoise, TakesTheDataSheetWhereThereIsOneAndEstimatesTheRest) {
  Rng rng(13);
  RecordingSet set;
  set.joints = {"a"};
  set.noise.position_resolution = 1e-4;
  for (int i = 0; i < 3; ++i) {
    Recording r = AsRecording(Motion(rng, 1500, 0.01, 6e-4));
    r.v = Eigen::MatrixXd::NullaryExpr(1, 1500, [&] { return 0.01 * rng.Normal(); });
    set.recordings.push_back(r);
  }
  const SensorNoise noise = EstimateSensorNoise(set);
  EXPECT_NEAR(noise.position_stddev[0], 6e-4, 0.1 * 6e-4);
  EXPECT_NEAR(noise.velocity_stddev[0], 0.01, 0.1 * 0.01);
  EXPECT_EQ(noise.position_resolution[0], 1e-4);
}

}  // namespace
}  // namespace rg::recordings
