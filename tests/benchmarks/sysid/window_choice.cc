// How much better a window chosen by its information is fitted than one drawn at random or the first: a Mico²
// whose inertias and friction differ from its URDF, one recording of 8 s to choose from, one held out. One
// line per length of the window; RG_SOURCE_DIR is the source tree.
//
//   window_choice [robots] [draws]     so many robots, so many random windows for each (default 10, 5)
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <vector>

#include "services/sysid/prediction.h"
#include "services/sysid/recording_shooting.h"
#include "services/sysid/shooting_fit.h"
#include "services/sysid/window_choice.h"
#include "tests/unit/sysid/simulated_recordings.h"

namespace rg::sysid {
namespace {

using Eigen::VectorXd;

constexpr double kPositionNoise = 3e-4, kVelocityNoise = 3e-3;

struct Outcome {
  double holdout = 0.0;  // median over windows of 1 s of the RMS error, rad
  double parameter_error =
      0.0;  // RMS in prior stddev, over the directions that the whole recording determines
};

VectorXd Home() {
  VectorXd q(6);
  q << 0.0, 4.4, 2.1, 0.5, 0.5, -1.2;
  return q;
}

struct Robot {
  sim::Plant plant = testing::LoadPlant(
      "mico2", {effects::MakeSpec("viscous_friction", testing::LoadPlant("mico2").joint_names()),
                effects::MakeSpec("coulomb_friction", testing::LoadPlant("mico2").joint_names())});
  std::vector<FitParameter> parameters;
  VectorXd theta, values;  // the truth
  Eigen::MatrixXd seen;    // directions that the whole recording determines
  recordings::Recording fit, holdout;
  recordings::SensorNoise noise;

  explicit Robot(uint64_t seed) {
    parameters = InertialFitParameters(plant);
    for (FitParameter& p : EffectFitParameters(plant)) {
      p.prior_stddev = p.name.starts_with("viscous") ? 0.5 : 0.3;  // of this family of arms
      parameters.push_back(std::move(p));
    }
    const FitSpace space(parameters);
    Rng rng(seed);
    theta = space.nominal();
    for (int i = 0; i < space.size(); ++i) {
      const double draw = space.prior_stddev()[i] * rng.Normal();
      theta[i] = space.IsItself(i) ? std::abs(draw) : theta[i] + draw;
    }
    values = space.Values(theta, plant.parameters().Nominal());
    testing::MakeOptions make{.duration_s = 8.0,
                              .position_noise = kPositionNoise,
                              .velocity_noise = kVelocityNoise,
                              .center = Home(),
                              .moves = true};
    fit = testing::MakeRecording(plant, values, 1000 + seed, make);
    holdout = testing::MakeRecording(plant, values, 2000 + seed, make);
    noise = {VectorXd::Constant(6, kPositionNoise), VectorXd::Constant(6, kVelocityNoise), VectorXd::Zero(6)};
    FindSeen();
  }

  // Directions of the fit space, in prior stddev, whose uncertainty the whole recording shrinks tenfold.
  void FindSeen() {
    const FitSpace space(parameters);
    const std::vector<FitWindow> windows = Candidates(1.0);
    WindowInformationOptions options;
    options.simulator.step_s = 2e-3;
    const auto H = InformationOfWindows(plant, plant.parameters().Nominal(), space, theta,
                                        {{&fit, DriveSignal(fit)}}, windows, noise, options);
    const auto D = space.prior_stddev().asDiagonal();
    Eigen::MatrixXd sum = Eigen::MatrixXd::Zero(space.size(), space.size());
    for (size_t w = 0; w < windows.size(); w += 2) sum += D * H[w] * D;
    const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> eigen(sum);
    const int count = static_cast<int>((eigen.eigenvalues().array() > 100.0).count());
    seen = eigen.eigenvectors().rightCols(count);
  }
  Outcome FitOn(const std::vector<FitWindow>& windows) const {
    const FitSpace space(parameters);
    std::vector<recordings::Recording> slices;
    for (const FitWindow& w : windows)
      slices.push_back(recordings::Slice(fit, w.first, w.last - w.first + 1));
    std::vector<FitRecording> recordings;
    for (const recordings::Recording& slice : slices) recordings.push_back({&slice, DriveSignal(fit)});
    ShootingFitOptions options;
    options.first_window_s = 0.5 * windows.front().length_s;
    options.window_s = windows.front().length_s;
    options.refinements = 6;
    options.residual_rate_hz = 1000.0;
    options.max_iterations = 60;
    options.relative_tolerance = 1e-6;
    options.simulator.step_s = 2e-3;
    const VectorXd nominal = plant.parameters().Nominal();
    const VectorXd start = RegressInverseDynamics(plant, nominal, space, space.nominal(), recordings).theta;
    const ShootingFit solved = FitByShooting(plant, nominal, space, start, recordings, noise, options, {});
    PredictionOptions prediction;
    prediction.simulator.step_s = 2e-3;
    prediction.noise = noise;
    Outcome out;
    out.holdout = ErrorOf(PredictRecording(plant, solved.values, holdout, prediction), holdout).median_window;
    const VectorXd error = seen.transpose() * (solved.theta - theta).cwiseQuotient(space.prior_stddev());
    out.parameter_error = error.norm() / std::sqrt(static_cast<double>(error.size()));
    return out;
  }

  std::vector<FitWindow> Candidates(double window_s) const {
    return CandidateWindows({{&fit, DriveSignal(fit)}}, window_s);
  }

  std::vector<FitWindow> MostInformative(double window_s, int count) const {
    const FitSpace space(parameters);
    const std::vector<FitWindow> windows = Candidates(window_s);
    WindowInformationOptions options;
    options.simulator.step_s = 2e-3;
    return ChooseByInformation(plant, plant.parameters().Nominal(), space, {{&fit, DriveSignal(fit)}},
                               windows, noise, count, options);
  }
};

double Median(std::vector<double> x) {
  std::nth_element(x.begin(), x.begin() + static_cast<std::ptrdiff_t>(x.size() / 2), x.end());
  return x[x.size() / 2];
}

void Compare(int count, double window_s, int robots, int draws) {
  std::vector<double> chosen, random, first, chosen_error, random_error, first_error;
  int better = 0;
  for (int seed = 1; seed <= robots; ++seed) {
    const Robot robot(static_cast<uint64_t>(seed));
    const Outcome best = robot.FitOn(robot.MostInformative(window_s, count));
    std::vector<double> holdout;
    for (int draw = 1; draw <= draws; ++draw) {
      const auto window =
          TakeAtRandom(robot.Candidates(window_s), static_cast<uint64_t>(100 * seed + draw), count);
      const Outcome out = robot.FitOn(window);
      holdout.push_back(out.holdout);
      random_error.push_back(out.parameter_error);
    }
    const Outcome earliest = robot.FitOn(TakeFirst(robot.Candidates(window_s), count));
    first.push_back(earliest.holdout);
    first_error.push_back(earliest.parameter_error);
    better += best.holdout < Median(holdout) ? 1 : 0;
    chosen.push_back(best.holdout);
    chosen_error.push_back(best.parameter_error);
    random.insert(random.end(), holdout.begin(), holdout.end());
  }
  std::printf("%2d x %.1f s %10.4g %10.4g %10.4g %10.3f %10.3f %10.3f %8d/%d\n", count, window_s,
              Median(chosen), Median(random), Median(first), Median(chosen_error), Median(random_error),
              Median(first_error), better, robots);
  std::fflush(stdout);
}

}  // namespace
}  // namespace rg::sysid

int main(int argc, char** argv) {
  const int robots = argc > 1 ? std::max(1, std::atoi(argv[1])) : 10;
  const int draws = argc > 2 ? std::max(1, std::atoi(argv[2])) : 5;
  std::printf("%10s %10s %10s %10s %10s %10s %10s %10s\n", "windows", "held out", "at random", "the first",
              "parameters", "at random", "the first", "better");
  rg::sysid::Compare(1, 0.2, robots, draws);
  rg::sysid::Compare(5, 0.2, robots, draws);
  rg::sysid::Compare(1, 0.5, robots, draws);
  rg::sysid::Compare(1, 1.0, robots, draws);
  return 0;
}
