#include "common/math/lanes.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "common/base/rng.h"
#include "common/math/sincos.h"
#include "tests/unit/math/isa_probe.h"

namespace rg::math {
namespace {

std::vector<const IsaProbe*> SupportedProbes() {
  std::vector<const IsaProbe*> out;
  for (Isa isa : {Isa::kV1, Isa::kV3, Isa::kV4}) {
    if (IsaSupported(isa)) out.push_back(&GetProbe(isa));
  }
  return out;
}

// Distance in units of the last place of 1 (or of the result where that is larger): sines near zero
// are judged absolutely, as dynamics does.
double UlpsOfOne(double got, long double want) {
  return static_cast<double>(std::abs(static_cast<long double>(got) - want)) /
         std::numeric_limits<double>::epsilon();
}

TEST(Lanes, DoArithmeticLaneByLane) {
  for (const IsaProbe* probe : SupportedProbes()) {
    double a[8], b[8], out[8][8];
    for (int i = 0; i < 8; ++i) a[i] = 1.5 * i - 3.0, b[i] = 0.7 * i + 0.5;
    probe->arithmetic(a, b, out[0]);
    for (int i = 0; i < probe->lanes; ++i) {
      EXPECT_EQ(out[0][i], a[i] + b[i]);
      EXPECT_EQ(out[1][i], a[i] - b[i]);
      EXPECT_EQ(out[2][i], a[i] * b[i]);
      EXPECT_EQ(out[3][i], a[i] / b[i]);
      EXPECT_EQ(out[4][i], std::sqrt(b[i]));
      EXPECT_EQ(out[5][i], std::abs(a[i]));
      EXPECT_EQ(out[6][i], a[i] < b[i] ? a[i] : b[i]);
      EXPECT_EQ(out[7][i], a[i] > b[i] ? a[i] : b[i]);
    }
  }
}

TEST(Exp, IsWithinOneUlp) {
  Rng rng(6);
  for (const IsaProbe* probe : SupportedProbes()) {
    double worst = 0.0;
    for (double range : {1e-9, 1e-3, 1.0, 30.0, 700.0}) {
      for (int i = 0; i < 4000; ++i) {
        double x[8], e[8];
        for (double& value : x) value = rng.Uniform(-range, range);
        probe->exp(x, e);
        for (int lane = 0; lane < probe->lanes; ++lane) {
          const double want = std::exp(x[lane]);
          worst = std::max(worst, std::abs(e[lane] - want) / (std::nextafter(want, 1e308) - want));
        }
      }
    }
    EXPECT_LE(worst, 1.0);
  }
}

TEST(Exp, TakesEveryNumber) {
  constexpr double kInf = std::numeric_limits<double>::infinity();
  for (const IsaProbe* probe : SupportedProbes()) {
    for (const double x : {0.0, -0.0, 709.7, 709.8, 1e5, kInf, -708.3, -740.0, -745.2, -1e5, -kInf}) {
      double in[8] = {x, x, x, x, x, x, x, x}, e[8];
      probe->exp(in, e);
      const double want = std::exp(x);
      if (std::isinf(want)) {
        EXPECT_EQ(e[0], want) << x;
      } else {
        EXPECT_NEAR(e[0], want, 3e-16 * want + 5e-324) << x;
      }
    }
    double in[8] = {std::nan(""), 1, 1, 1, 1, 1, 1, 1}, e[8];
    probe->exp(in, e);
    EXPECT_TRUE(std::isnan(e[0]));
    EXPECT_DOUBLE_EQ(e[1], std::exp(1.0));
  }
}

TEST(SinCos, AreWithinOneUlpOfOne) {
  Rng rng(5);
  for (const IsaProbe* probe : SupportedProbes()) {
    double worst = 0.0;
    for (double range : {1e-3, 1.0, 10.0, 1e3, 1e5, 9.9e5}) {
      for (int i = 0; i < 4000; ++i) {
        double x[8], s[8], c[8];
        for (double& value : x) value = rng.Uniform(-range, range);
        probe->sincos(x, s, c);
        for (int lane = 0; lane < probe->lanes; ++lane) {
          worst = std::max(worst, UlpsOfOne(s[lane], std::sin(static_cast<long double>(x[lane]))));
          worst = std::max(worst, UlpsOfOne(c[lane], std::cos(static_cast<long double>(x[lane]))));
        }
      }
    }
    EXPECT_LT(worst, 1.0) << probe->lanes;
  }
}

TEST(SinCos, KeepRelativeAccuracyForSmallAngles) {
  for (const IsaProbe* probe : SupportedProbes()) {
    for (double x = 1e-300; x < 0.5; x *= 7.3) {
      double in[8], s[8], c[8];
      for (double& value : in) value = x;
      probe->sincos(in, s, c);
      EXPECT_NEAR(s[0] / std::sin(x), 1.0, 4e-16) << x;
    }
  }
}

TEST(SinCos, AnswerEveryQuadrantAndEveryAxis) {
  for (const IsaProbe* probe : SupportedProbes()) {
    for (int k = -9; k <= 9; ++k) {
      double x[8], s[8], c[8];
      for (double& value : x) value = k * M_PI / 4;
      probe->sincos(x, s, c);
      EXPECT_NEAR(s[0], std::sin(x[0]), 3e-16);
      EXPECT_NEAR(c[0], std::cos(x[0]), 3e-16);
    }
  }
}

TEST(SinCos, HugeAndNonFiniteAnglesGoToTheLibraryInTheirLaneOnly) {
  for (const IsaProbe* probe : SupportedProbes()) {
    double x[8] = {1e22,
                   0.5,
                   std::numeric_limits<double>::quiet_NaN(),
                   std::numeric_limits<double>::infinity(),
                   -2e7,
                   0.1,
                   0.2,
                   0.3};
    double s[8], c[8];
    probe->sincos(x, s, c);
    EXPECT_EQ(s[0], std::sin(1e22));
    EXPECT_NEAR(c[1], std::cos(0.5), 1e-16);
    if (probe->lanes >= 4) {
      EXPECT_TRUE(std::isnan(s[2]));
      EXPECT_TRUE(std::isnan(c[3]));
    }
  }
}

TEST(Isa, PlainX86IsAlwaysThere) {
  EXPECT_TRUE(IsaSupported(Isa::kV1));
  EXPECT_TRUE(IsaSupported(DetectIsa()));
  EXPECT_STREQ(IsaName(Isa::kV3), "v3");
}

}  // namespace
}  // namespace rg::math
