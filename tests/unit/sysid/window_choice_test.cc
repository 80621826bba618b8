#include "services/sysid/window_choice.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <cmath>

#include "services/sysid/prediction.h"
#include "services/sysid/shooting_fit.h"
#include "tests/unit/sysid/simulated_recordings.h"

namespace rg::sysid {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

std::vector<FitWindow> Windows(int count) {
  std::vector<FitWindow> out;
  for (int i = 0; i < count; ++i) out.push_back({0, 5 * i, 5 * i + 10, 0.05 * i, 0.1, 0.0});
  return out;  // each overlaps its neighbours
}

TEST(CandidateWindows, AreOfTheLengthAndHalfAWindowApart) {
  recordings::Recording rec;
  rec.t = VectorXd::LinSpaced(101, 0.0, 1.0);
  rec.t.tail(50).array() += 3.0;  // a gap
  rec.q = MatrixXd::Zero(1, 101);
  const auto windows = CandidateWindows({{&rec, {}}}, 0.2);
  ASSERT_FALSE(windows.empty());
  for (const FitWindow& w : windows) {
    EXPECT_NEAR(rec.t[w.last] - rec.t[w.first], 0.2, 0.011);
    EXPECT_FALSE(rec.t[w.first] < 1.0 && rec.t[w.last] > 1.0) << "none reaches over the gap";
  }
  EXPECT_NEAR(windows[1].start_s - windows[0].start_s, 0.1, 0.006);
  EXPECT_EQ(windows.front().first, 0);
  EXPECT_TRUE(CandidateWindows({{&rec, {}}}, 20.0).empty());
}

TEST(TakeMostInformative, IsTheLogDeterminantAndTakesNoWindowTwice) {
  const std::vector<FitWindow> windows = Windows(4);
  const VectorXd prior = Eigen::Vector2d(2.0, 0.5);
  std::vector<MatrixXd> H(4, MatrixXd::Zero(2, 2));
  H[0] << 1.0, 0.0, 0.0, 0.0;
  H[1] << 9.0, 1.0, 1.0, 9.0;
  H[2] << 8.0, 0.0, 0.0, 8.0;
  H[3] << 0.1, 0.0, 0.0, 30.0;
  const auto taken = TakeMostInformative(windows, {H}, prior, 3);
  const auto value = [&](const MatrixXd& sum) {
    const MatrixXd scaled = prior.asDiagonal() * sum * prior.asDiagonal();
    return 0.5 * std::log((scaled + MatrixXd::Identity(2, 2)).determinant());
  };
  ASSERT_EQ(taken.size(), 2u) << "windows 0 and 2 overlap window 1";
  EXPECT_EQ(taken[0].first, windows[1].first);
  EXPECT_NEAR(taken[0].gain_nats, value(H[1]), 1e-12);
  EXPECT_EQ(taken[1].first, windows[3].first);
  EXPECT_NEAR(taken[1].gain_nats, value(H[1] + H[3]) - value(H[1]), 1e-12);
}

TEST(TakeAtRandom, IsTheSeedsAndDoesNotOverlap) {
  const auto a = TakeAtRandom(Windows(40), 3, 8), b = TakeAtRandom(Windows(40), 3, 8);
  const auto c = TakeAtRandom(Windows(40), 4, 8);
  ASSERT_EQ(a.size(), 8u);
  bool same = true;
  for (size_t i = 0; i < a.size(); ++i) {
    EXPECT_EQ(a[i].first, b[i].first);
    same = same && a[i].first == c[i].first;
    for (size_t j = 0; j < i; ++j) EXPECT_GE(std::abs(a[i].first - a[j].first), 10);
  }
  EXPECT_FALSE(same);
}

TEST(WindowChoice, NamesReadBackAndOthersAreRefused) {
  for (const char* name : {"first", "random", "information"}) {
    EXPECT_EQ(WindowChoiceName(*ParseWindowChoice(name)), name);
  }
  EXPECT_FALSE(ParseWindowChoice("best").ok());
}

// Arms with other masses and friction than their URDF's, which move, rest, and move again, as rollouts do.
struct Arm {
  sim::Plant plant =
      testing::LoadPlant("arm2", {effects::MakeSpec("viscous_friction", {"shoulder", "elbow"}),
                                  effects::MakeSpec("coulomb_friction", {"shoulder", "elbow"})});
  std::vector<FitParameter> parameters;
  FitSpace space;
  VectorXd theta, values;
  MatrixXd seen;  // directions in prior stddev that the whole recording determines
  recordings::Recording fit, holdout;
  recordings::SensorNoise noise{VectorXd::Constant(2, 3e-4), VectorXd::Constant(2, 3e-3), VectorXd::Zero(2)};

  explicit Arm(uint64_t seed) : parameters(ParametersOf(plant)), space(parameters), theta(space.nominal()) {
    Rng rng(seed);
    for (int i = 0; i < space.size(); ++i) {
      const double draw = space.prior_stddev()[i] * rng.Normal();
      theta[i] += space.IsItself(i) ? std::abs(draw) : draw;
    }
    values = space.Values(theta, plant.parameters().Nominal());
    const testing::MakeOptions make{
        .duration_s = 8.0, .position_noise = 3e-4, .velocity_noise = 3e-3, .amplitude = 0.9, .moves = true};
    fit = testing::MakeRecording(plant, values, 100 + seed, make);
    holdout = testing::MakeRecording(plant, values, 200 + seed, make);
    FindSeen();
  }

  void FindSeen() {
    const auto windows = TakeFirst(CandidateWindows(Recordings(), 1.0), 8);
    const auto H = InformationOfWindows(plant, values, space, theta, Recordings(), windows, noise, {});
    MatrixXd sum = MatrixXd::Zero(space.size(), space.size());
    for (const MatrixXd& h : H)
      sum += space.prior_stddev().asDiagonal() * h * space.prior_stddev().asDiagonal();
    const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(sum);
    seen = eigen.eigenvectors().rightCols((eigen.eigenvalues().array() > 100.0).count());
  }

  static std::vector<FitParameter> ParametersOf(const sim::Plant& plant) {
    std::vector<FitParameter> out = InertialFitParameters(plant);
    for (FitParameter& p : EffectFitParameters(plant)) {
      p.prior_stddev = 0.3;
      out.push_back(std::move(p));
    }
    return out;
  }

  std::vector<FitRecording> Recordings() const { return {{&fit, DriveSignal(fit)}}; }

  FitWindow MostInformative(double window_s) const {
    WindowInformationOptions options;
    options.simulator.step_s = 4e-3;
    return ChooseByInformation(plant, plant.parameters().Nominal(), space, Recordings(),
                               CandidateWindows(Recordings(), window_s), noise, 1, options)
        .front();
  }

  // Held-out error; the parameters' in prior stddev along `seen`.
  double HeldOut(const FitWindow& window, double* parameter_error) const {
    const recordings::Recording slice = recordings::Slice(fit, window.first, window.last - window.first + 1);
    ShootingFitOptions options;
    options.first_window_s = options.window_s = window.length_s;
    options.residual_rate_hz = 1000.0;
    options.refinements = 3;
    options.simulator.step_s = 4e-3;
    const std::vector<FitRecording> recordings{{&slice, DriveSignal(fit)}};
    const VectorXd nominal = plant.parameters().Nominal();
    const VectorXd start = RegressInverseDynamics(plant, nominal, space, space.nominal(), recordings).theta;
    const ShootingFit solved = FitByShooting(plant, nominal, space, start, recordings, noise, options, {});
    *parameter_error = (seen.transpose() * (solved.theta - theta).cwiseQuotient(space.prior_stddev())).norm();
    PredictionOptions prediction;
    prediction.simulator.step_s = 4e-3;
    prediction.noise = noise;
    return ErrorOf(PredictRecording(plant, solved.values, holdout, prediction), holdout).median_window;
  }
};

TEST(WindowChoice, ByInformationBeatsARandomWindowOfTheSameLength) {
  const double window_s = 0.5;
  int better = 0, count = 0;
  double log_ratio = 0.0, chosen_parameters = 0.0, random_parameters = 0.0;
  for (uint64_t seed = 1; seed <= 8; ++seed) {
    const Arm arm(seed);
    double error = 0.0;
    const double chosen = arm.HeldOut(arm.MostInformative(window_s), &error);
    for (uint64_t draw = 0; draw < 4; ++draw, ++count) {
      const auto windows = CandidateWindows(arm.Recordings(), window_s);
      double random_error = 0.0;
      const double random = arm.HeldOut(TakeAtRandom(windows, 10 * seed + draw, 1).front(), &random_error);
      better += chosen < random ? 1 : 0;
      log_ratio += std::log(random / chosen);
      chosen_parameters += std::log(error);
      random_parameters += std::log(random_error);
    }
  }
  EXPECT_GT(better, 0.65 * count);
  EXPECT_GT(log_ratio / count, std::log(2.0)) << "held-out error, geometric mean";
  EXPECT_LT(chosen_parameters - random_parameters, count * std::log(0.8))
      << "geometric mean" << std::exp((chosen_parameters - random_parameters) / count);
}

}  // namespace
}  // namespace rg::sysid
