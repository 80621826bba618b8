#include "services/proof/generator/references.h"

#include <algorithm>
#include <cmath>

namespace rg::proof {
namespace {

constexpr double kTau = 6.283185307179586;

// Minimum-jerk position between 0 and 1 and its rate.
void MinimumJerk(double s, double* x, double* dx) {
  s = std::clamp(s, 0.0, 1.0);
  *x = s * s * s * (10 - 15 * s + 6 * s * s);
  *dx = 30 * s * s * (1 - s) * (1 - s);
}

double Fade(double t, double duration) { return std::min({1.0, t / 0.8, (duration - t) / 0.4 + 0.05}); }

struct Curve {
  std::vector<double> q;  // one joint
};

Curve Multisine(double home, double amplitude, double velocity, double duration, double rate, Rng& rng) {
  const int waves = 4;
  double f[waves], phase[waves], weight[waves], sum = 0, speed = 0;
  for (int w = 0; w < waves; ++w) {
    f[w] = rng.Uniform(0.12, 0.35) * (w + 1);
    phase[w] = rng.Uniform(0, kTau);
    weight[w] = rng.Uniform(0.5, 1.0) / (1.0 + 0.5 * w);
    sum += weight[w];
    speed += weight[w] * kTau * f[w];
  }
  const double scale = std::min(amplitude / sum, 0.8 * velocity / speed);
  Curve curve;
  for (int k = 0; k < static_cast<int>(duration * rate) + 1; ++k) {
    const double t = k / rate;
    double x = 0;
    for (int w = 0; w < waves; ++w) x += weight[w] * std::sin(kTau * f[w] * t + phase[w]);
    curve.q.push_back(home + scale * x * Fade(t, duration));
  }
  return curve;
}

// A sequence of moves: each to a point within reach, over `move` seconds, then a rest.
Curve Moves(double home, double amplitude, double velocity, double duration, double rate, double slow,
            double rest, bool straight, Rng& rng) {
  Curve curve;
  double from = home, to = home, start = 0, move = 0.1, pause = 0.2;
  for (int k = 0; k < static_cast<int>(duration * rate) + 1; ++k) {
    const double t = k / rate;
    if (t >= start + move + pause) {
      from = to, start = t;
      to = home + rng.Uniform(-1, 1) * amplitude;
      move = std::max(0.3, slow * 1.9 * std::abs(to - from) / velocity);
      pause = rest * rng.Uniform(0.3, 1.0);
    }
    const double s = std::clamp((t - start) / move, 0.0, 1.0);
    double x = s, dx;
    if (!straight) MinimumJerk(s, &x, &dx);
    curve.q.push_back(from + (to - from) * x);
  }
  return curve;
}

Curve Chirp(double home, double amplitude, double velocity, double duration, double rate, Rng& rng) {
  const double f0 = rng.Uniform(0.1, 0.2), f1 = rng.Uniform(0.7, 1.4), phase = rng.Uniform(0, kTau);
  Curve curve;
  for (int k = 0; k < static_cast<int>(duration * rate) + 1; ++k) {
    const double t = k / rate, f = f0 + (f1 - f0) * t / duration;
    const double a = std::min(amplitude, 0.8 * velocity / (kTau * f));
    curve.q.push_back(home + a * std::sin(kTau * (f0 * t + 0.5 * (f1 - f0) * t * t / duration) + phase) *
                                 Fade(t, duration));
  }
  return curve;
}

}  // namespace

Reference MakeReference(const std::string& kind, const ReferenceLimits& limits, double duration_s,
                        double rate_hz, Rng rng) {
  const int n = static_cast<int>(limits.home.size());
  const int rows = static_cast<int>(duration_s * rate_hz) + 1;
  Reference out{Eigen::MatrixXd(n, rows), Eigen::MatrixXd(n, rows)};
  for (int i = 0; i < n; ++i) {
    const double home = limits.home[i], a = limits.amplitude[i], v = limits.velocity[i];
    Curve curve;
    if (kind == "multisine") {
      curve = Multisine(home, a, v, duration_s, rate_hz, rng);
    } else if (kind == "chirp") {
      curve = Chirp(home, a, v, duration_s, rate_hz, rng);
    } else if (kind == "ramps") {
      curve = Moves(home, 0.7 * a, v, duration_s, rate_hz, 4.0, 0.0, true, rng);
    } else if (kind == "holds") {
      curve = Moves(home, a, v, duration_s, rate_hz, 1.3, 1.6, false, rng);
    } else if (kind == "sequential") {
      curve = Moves(home, a, v, duration_s, rate_hz, 1.1, 0.1, false, rng);
      for (int k = 0; k < rows; ++k) {  // one joint after another moves
        const double share = duration_s / n, t = k / rate_hz - share * i;
        curve.q[static_cast<size_t>(k)] =
            home + (curve.q[static_cast<size_t>(k)] - home) *
                       std::clamp(std::min(t / 0.3, (share - t) / 0.3), 0.0, 1.0);
      }
    } else {
      curve = Moves(home, a, v, duration_s, rate_hz, 1.0, 0.5, false, rng);
    }
    for (int k = 0; k < rows; ++k) out.q(i, k) = curve.q[static_cast<size_t>(k)];
    for (int k = 0; k < rows; ++k) {
      const int lo = std::max(0, k - 1), hi = std::min(rows - 1, k + 1);
      out.v(i, k) = (out.q(i, hi) - out.q(i, lo)) * rate_hz / (hi - lo);
    }
  }
  return out;
}

}  // namespace rg::proof
