// A force as its effect declares it is the force of its law.
#include "services/diagnosis/likelihood/regressors.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>

#include "common/effects/effect_catalog.h"
#include "common/effects/effect_list.h"

namespace rg::diagnosis {
namespace {

using effects::Inference;
using effects::JointLaw;

struct Moment {
  double q, v, a, u, t;
};
constexpr double kRow = 0.01, kLoad = 1.7;

// At two rows that hardly differ, as a regressor may look at the row before.
JointMotion MotionAt(const Moment& x) {
  const auto both = [](double value) -> Eigen::ArrayXd { return Eigen::ArrayXd::Constant(2, value); };
  JointMotion m{both(x.q), both(x.v), both(x.a), both(x.t), both(x.u), both(x.v > 0 ? 1.0 : -1.0)};
  m.t[1] += kRow;
  return m;
}

// What the law makes of the drive's torque, with the effect's values, less that torque.
template <class E>
double ForceOfLaw(const effects::EffectInfo& info, const effects::Values& values, const Moment& x) {
  std::vector<double> p;
  for (const auto& parameter : info.parameters)
    p.push_back(values.count(parameter.name) ? values.at(parameter.name) : parameter.default_value);
  JointLaw<double> law{};
  std::array<double, 8> states{};  // of laws that are not compared here
  law.z0 = law.z1 = states.data();
  law.step = {1e-9, x.t, false, 1e-9};
  law.mass = law.reference_mass = 1;
  law.q0 = law.q1 = x.q, law.v0 = law.v1 = x.v, law.acceleration = x.a;
  law.drive = law.link = x.u;
  law.rough = true;
  E::Apply(p.data(), law);
  return law.drive - x.u + law.Force() - law.link;
}

double ForceAsDeclared(const Inference& own, const std::vector<double>& c, double shape, const Moment& x) {
  double sum = 0;
  for (size_t i = 0; i < c.size(); ++i)
    sum += c[i] * ForceOf(own.terms[i].regressor, MotionAt(x), {shape, 1})[0];
  return sum;
}

TEST(Regressors, ADeclaredForceIsThatOfTheLaw) {
  int compared = 0;
  for (const effects::EffectInfo& info : effects::Catalog()) {
    const Inference& own = effects::InferenceOf(info.id);
    // What is linear only near a shape, has states or needs more than its joint is seen elsewhere.
    const bool here = !own.terms.empty() && !own.pieces && own.coefficient == Inference::Near::kAny &&
                      info.scope == effects::Scope::kJoint &&
                      own.terms[0].regressor != effects::Regressor::kBristle;
    if (!here) continue;
    ++compared;
    const double shape = 0.4;
    const std::vector<double> c =
        own.terms.size() == 1 ? std::vector<double>{0.3} : std::vector<double>{0.3, 0.2};
    const effects::Values values = effects::StartsOf(info, effects::Found{c, shape})[0].values;
    for (const Moment& x : {Moment{0.3, 0.5, 2.0, kLoad, 0.6}, Moment{-0.7, -0.25, -3.0, -0.4, 1.1}}) {
      effects::WithEffectType(effects::KindOf(info.id), [&]<class E>() {
        if constexpr (requires(const double* p, JointLaw<double>& law) { E::Apply(p, law); }) {
          EXPECT_NEAR(ForceOfLaw<E>(info, values, x), ForceAsDeclared(own, c, shape, x), 1e-6) << info.id;
        } else {
          FAIL() << info.id << " declares a force on its joint and has none";
        }
      });
    }
  }
  EXPECT_EQ(compared, 12);
}

TEST(Regressors, LateEffortIsTheEffortOfBeforeLessThatOfNow) {
  JointMotion m = MotionAt({0, 1, 0, 1, 0});
  m.effort[1] = 3;
  EXPECT_DOUBLE_EQ(ForceOf(effects::Regressor::kDelayed, m, {0.25 * kRow, 0})[1], 2.5 - 3);
  EXPECT_DOUBLE_EQ(ForceOf(effects::Regressor::kLagging, m, {kRow, 0})[1], (1 - 3) * std::exp(-1.0));
}

// J θ̈ = u − T,  T = k (θ − q) + b (θ̇ − v), in steps of 10 µs along a motion that shakes near the resonance.
TEST(Regressors, TheTermsOfASpringAreItsTorque) {
  const double J = 0.03, omega = 2 * M_PI * 12, k = J * omega * omega, dt = 2.5e-3;
  const effects::EffectInfo& spring = effects::Spring();
  const effects::Values values = effects::StartsOf(spring, effects::Found{{J, 1.0}, omega}).front().values;
  ASSERT_NEAR(values.at("stiffness"), k, 1e-9 * k);
  const double b = values.at("damping");
  const auto q = [](double t) {
    return 0.2 * std::sin(3 * t) * std::sin(3 * t) + 2e-3 * (1 - std::cos(70 * t));
  };
  const auto v = [](double t) { return 0.6 * std::sin(6 * t) + 0.14 * std::sin(70 * t); };
  const auto u = [](double t) { return 2 * std::sin(5 * t) + 0.5 * std::sin(60 * t); };
  const Eigen::Index rows = 800;
  JointMotion m;
  for (auto* x : {&m.q, &m.v, &m.a, &m.t, &m.effort, &m.direction}) x->setZero(rows);
  Eigen::ArrayXd torque(rows);
  double theta = 0, speed = 0, t = 0;
  for (Eigen::Index i = 0; i < rows; ++i) {
    const double middle = t + 0.5 * dt;
    m.t[i] = middle, m.q[i] = q(middle), m.v[i] = v(middle), m.effort[i] = u(middle);
    double mean = 0;
    for (int step = 0; step < 250; ++step, t += 1e-5) {
      const double T = k * (theta - q(t)) + b * (speed - v(t));
      mean += T / 250;
      speed += 1e-5 * (m.effort[i] - T) / J, theta += 1e-5 * speed;
    }
    torque[i] = mean;
  }
  const RegressorShape shape{omega, 0};
  const Eigen::ArrayXd terms = J * ForceOf(effects::Regressor::kSprungRotor, m, shape) +
                               ForceOf(effects::Regressor::kThroughSpring, m, shape) + m.effort;
  EXPECT_LT(std::sqrt((terms - torque).square().mean()), 0.03 * std::sqrt(torque.square().mean()));
}

TEST(Regressors, ABristleBendsBeforeItSlides) {
  JointMotion m = MotionAt({0, 1, 0, 0, 0});
  m.q[1] = 1e-4;
  EXPECT_NEAR(ForceOf(effects::Regressor::kBristle, m, {0.01, 0})[1], -0.01, 2e-4);
  m.q[1] = 10;
  EXPECT_NEAR(ForceOf(effects::Regressor::kBristle, m, {0.01, 0})[1], -1, 2e-3);
}

}  // namespace
}  // namespace rg::diagnosis
