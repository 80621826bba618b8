#include "services/policy/network.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numeric>

#include "common/math/gradient_check.h"

namespace rg::policy {
namespace {

std::vector<const Kernels*> AllKernels() {
  std::vector<const Kernels*> all;
  for (const Kernels* k : {KernelsBaseline(), KernelsAvx2(), KernelsAvx512()}) {
    if (k) all.push_back(k);
  }
  return all;
}

std::vector<float> RandomFloats(Rng& rng, size_t count) {
  std::vector<float> values(count);
  for (float& x : values) x = static_cast<float>(rng.Normal());
  return values;
}

// Mean square error of the network with parameters p, in double and by the textbook's loops.
double ReferenceLoss(const Network& network, const Eigen::VectorXd& p, const Eigen::MatrixXd& x,
                     const Eigen::MatrixXd& y) {
  Eigen::MatrixXd h = x;
  for (size_t l = 0; l < network.layers().size(); ++l) {
    const LayerShape& layer = network.layers()[l];
    Eigen::MatrixXd next(layer.out, h.cols());
    for (int row = 0; row < layer.out; ++row) {
      next.row(row).setConstant(p[static_cast<Eigen::Index>(network.BiasIndex(static_cast<int>(l), row))]);
      for (int col = 0; col < layer.in; ++col) {
        next.row(row) +=
            p[static_cast<Eigen::Index>(network.WeightIndex(static_cast<int>(l), row, col))] * h.row(col);
      }
    }
    h = l + 1 < network.layers().size() ? Eigen::MatrixXd(next.cwiseMax(0.0)) : next;
  }
  return (h - y).squaredNorm() / static_cast<double>(y.size());
}

struct Problem {
  Network network;
  std::vector<float> inputs, targets;  // padded rows
  std::vector<int> points;
  Eigen::MatrixXd x, y;
};

Problem RandomProblem(const std::vector<int>& sizes, int count, uint64_t seed) {
  Rng rng(seed);
  Problem p{Network(sizes), {}, {}, std::vector<int>(static_cast<size_t>(count)), {}, {}};
  p.network.StartHe(rng);
  for (size_t l = 0; l < p.network.layers().size(); ++l) {
    for (int row = 0; row < p.network.layers()[l].out; ++row) {
      p.network.parameters()[p.network.BiasIndex(static_cast<int>(l), row)] =
          static_cast<float>(0.1 * rng.Normal());
    }
  }
  const int in_stride = BatchWorkspace::PaddedSize(sizes.front()),
            out_stride = BatchWorkspace::PaddedSize(sizes.back());
  p.inputs.assign(static_cast<size_t>(count * in_stride), 0.0f);
  p.targets.assign(static_cast<size_t>(count * out_stride), 0.0f);
  p.x.resize(sizes.front(), count);
  p.y.resize(sizes.back(), count);
  std::iota(p.points.begin(), p.points.end(), 0);
  std::reverse(p.points.begin(), p.points.end());
  for (int i = 0; i < count; ++i) {
    for (int j = 0; j < sizes.front(); ++j) {
      p.inputs[static_cast<size_t>(i * in_stride + j)] = static_cast<float>(rng.Normal());
      p.x(j, i) = static_cast<double>(p.inputs[static_cast<size_t>(i * in_stride + j)]);
    }
    for (int j = 0; j < sizes.back(); ++j) {
      p.targets[static_cast<size_t>(i * out_stride + j)] = static_cast<float>(rng.Normal());
      p.y(j, i) = static_cast<double>(p.targets[static_cast<size_t>(i * out_stride + j)]);
    }
  }
  return p;
}

TEST(Backpropagation, MatchesCentralDifferencesOnEveryInstructionSet) {
  // Odd sizes and batches: every remainder of the kernels' tiles is met.
  for (const auto& [sizes, count] : std::vector<std::pair<std::vector<int>, int>>{
           {{3, 5, 2}, 1}, {{18, 20, 17, 6}, 32}, {{7, 33, 9, 4, 1}, 19}}) {
    Problem p = RandomProblem(sizes, count, 5);
    Eigen::VectorXd at(static_cast<Eigen::Index>(p.network.parameters().size()));
    for (Eigen::Index i = 0; i < at.size(); ++i)
      at[i] = static_cast<double>(p.network.parameters()[static_cast<size_t>(i)]);
    const auto loss = [&](const Eigen::VectorXd& w) {
      return Eigen::VectorXd::Constant(1, ReferenceLoss(p.network, w, p.x, p.y));
    };
    for (const Kernels* kernels : AllKernels()) {
      BatchWorkspace workspace(p.network, count, *kernels);
      const double sum =
          workspace.LossAndGradient(p.network, p.inputs.data(), p.targets.data(), p.points.data(), count);
      EXPECT_NEAR(sum / static_cast<double>(p.y.size()), loss(at)[0], 1e-5 * loss(at)[0]) << kernels->name;
      Eigen::MatrixXd gradient(1, at.size());
      for (Eigen::Index i = 0; i < at.size(); ++i) {
        gradient(0, i) = static_cast<double>(workspace.gradient()[static_cast<size_t>(i)]);
      }
      math::GradientCheckOptions options;
      options.tolerance = 1e-5;  // float32
      options.scale_floor = 1e-3;
      options.relative_step = 1e-6;
      options.richardson = false;
      const auto check = math::CheckGradient(loss, at, gradient, options);
      EXPECT_TRUE(check.ok) << kernels->name << " " << check.message;
    }
  }
}

TEST(Kernels, GemmAgreesWithThePlainSumForEveryRemainder) {
  Rng rng(2);
  for (const Kernels* kernels : AllKernels()) {
    for (int m = 1; m <= 20; ++m) {
      const int n = 16 * (1 + m % 5), k = 3 + m;
      const auto a = RandomFloats(rng, static_cast<size_t>(m * k)),
                 b = RandomFloats(rng, static_cast<size_t>(k * n));
      const auto bias = RandomFloats(rng, static_cast<size_t>(m)),
                 mask = RandomFloats(rng, static_cast<size_t>(m * n));
      for (const auto epilogue :
           {Epilogue::kNone, Epilogue::kBias, Epilogue::kBiasRelu, Epilogue::kReluMask}) {
        std::vector<float> c(static_cast<size_t>(m * n), 9.0f);
        const float* extra = epilogue == Epilogue::kReluMask ? mask.data() : bias.data();
        // a is stored transposed here: m along rows.
        kernels->gemm({m, n, k, a.data(), 1, m, b.data(), n, c.data(), n, extra}, epilogue);
        for (int i = 0; i < m; ++i) {
          for (int j = 0; j < n; ++j) {
            double sum = 0.0;
            for (int l = 0; l < k; ++l) {
              sum += static_cast<double>(a[static_cast<size_t>(l * m + i)]) *
                     static_cast<double>(b[static_cast<size_t>(l * n + j)]);
            }
            if (epilogue == Epilogue::kBias || epilogue == Epilogue::kBiasRelu) {
              sum += static_cast<double>(bias[static_cast<size_t>(i)]);
            }
            if (epilogue == Epilogue::kBiasRelu) sum = std::max(0.0, sum);
            if (epilogue == Epilogue::kReluMask && mask[static_cast<size_t>(i * n + j)] <= 0.0f) sum = 0.0;
            ASSERT_NEAR(static_cast<double>(c[static_cast<size_t>(i * n + j)]), sum, 2e-5)
                << kernels->name << " m " << m << " at " << i << ", " << j;
          }
        }
      }
    }
  }
}

TEST(Kernels, TransposeIsAnInvolution) {
  Rng rng(3);
  const auto a = RandomFloats(rng, 32 * 48);
  for (const Kernels* kernels : AllKernels()) {
    std::vector<float> once(a.size()), twice(a.size());
    kernels->transpose(a.data(), 48, 32, 48, once.data(), 32);
    EXPECT_EQ(once[5 * 32 + 7], a[7 * 48 + 5]);
    kernels->transpose(once.data(), 32, 48, 32, twice.data(), 48);
    EXPECT_EQ(twice, a);
  }
}

TEST(Kernels, AdamsFirstStepIsTheLearningRateInTheGradientsDirection) {
  // m = (1 − b1) g and v = (1 − b2) g², so after the bias correction the step is rate · sign(g).
  for (const Kernels* kernels : AllKernels()) {
    std::vector<float> w(16, 1.0f), m(16, 0.0f), v(16, 0.0f), g(16, -3.0f);
    AdamStep step{0.9f, 0.999f, static_cast<float>(0.01 * std::sqrt(0.001) / 0.1), 1e-12f, 1.0f};
    kernels->adam(w.data(), m.data(), v.data(), g.data(), 16, step);
    for (const float x : w) EXPECT_NEAR(x, 1.01f, 1e-5f) << kernels->name;
  }
}

TEST(HeStart, HasVarianceTwoOverFanInAndNoBias) {
  Network network({50, 400, 300, 6});
  Rng rng(11);
  network.StartHe(rng);
  for (int l = 0; l < 3; ++l) {
    const LayerShape& layer = network.layers()[static_cast<size_t>(l)];
    double sum = 0.0, square = 0.0;
    for (int row = 0; row < layer.out; ++row) {
      EXPECT_EQ(network.bias(l, row), 0.0f);
      for (int col = 0; col < layer.in; ++col) {
        sum += static_cast<double>(network.weight(l, row, col));
        square += std::pow(static_cast<double>(network.weight(l, row, col)), 2);
      }
    }
    const double count = layer.out * layer.in, expected = 2.0 / layer.in;
    // Four standard errors of the mean and of the variance of normal samples.
    EXPECT_NEAR(sum / count, 0.0, 4.0 * std::sqrt(expected / count)) << l;
    EXPECT_NEAR(square / count, expected, 4.0 * expected * std::sqrt(2.0 / count)) << l;
  }
}

TEST(Network, EvaluatesTheSameWithoutABatch) {
  const Problem p = RandomProblem({18, 128, 128, 6}, 40, 8);
  BatchWorkspace workspace(p.network, 40, BestKernels());
  double sum = 0.0;
  std::vector<float> y(6), scratch(256);
  for (int i = 0; i < 40; ++i) {
    p.network.Evaluate(p.inputs.data() + i * workspace.input_stride(), y.data(), scratch.data());
    for (int j = 0; j < 6; ++j)
      sum += std::pow(static_cast<double>(y[static_cast<size_t>(j)]) - p.y(j, i), 2);
  }
  const double batched = workspace.Loss(p.network, p.inputs.data(), p.targets.data(), p.points.data(), 40);
  EXPECT_NEAR(sum, batched, 1e-5 * batched);
}

}  // namespace
}  // namespace rg::policy
