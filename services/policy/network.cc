#include "services/policy/network.h"

#include <algorithm>
#include <cmath>
#include <cstring>

#include "common/base/check.h"

namespace rg::policy {
namespace {

int Padded(int n) { return (n + kLane - 1) / kLane * kLane; }

// Sum of products in a fixed order of eight partial sums, so that it does not depend on how the
// compiler would like to add.
float Dot(const float* a, const float* b, int n) {
  float part[8] = {};
  int i = 0;
  for (; i + 8 <= n; i += 8) {
    for (int j = 0; j < 8; ++j) part[j] += a[i + j] * b[i + j];
  }
  for (; i < n; ++i) part[i % 8] += a[i] * b[i];
  return ((part[0] + part[4]) + (part[1] + part[5])) + ((part[2] + part[6]) + (part[3] + part[7]));
}

}  // namespace

Network::Network(const std::vector<int>& sizes) : sizes_(sizes) {
  RG_CHECK(sizes.size() >= 2) << "a network needs an input and an output";
  std::size_t at = 0;
  for (std::size_t l = 0; l + 1 < sizes.size(); ++l) {
    RG_CHECK(sizes[l] > 0 && sizes[l + 1] > 0) << "layer " << l << ": " << sizes[l] << " to " << sizes[l + 1];
    LayerShape layer{sizes[l], sizes[l + 1], Padded(sizes[l]), at, 0};
    layer.biases = at + static_cast<std::size_t>(layer.out) * static_cast<std::size_t>(layer.stride);
    at = layer.biases + static_cast<std::size_t>(Padded(layer.out));
    layers_.push_back(layer);
  }
  parameters_.assign(at, 0.0f);
}

std::size_t Network::num_parameters() const {
  std::size_t count = 0;
  for (const LayerShape& l : layers_)
    count += static_cast<std::size_t>(l.out) * static_cast<std::size_t>(l.in + 1);
  return count;
}

std::size_t Network::WeightIndex(int layer, int row, int col) const {
  const LayerShape& l = layers_[static_cast<std::size_t>(layer)];
  return l.weights + static_cast<std::size_t>(row) * static_cast<std::size_t>(l.stride) +
         static_cast<std::size_t>(col);
}

std::size_t Network::BiasIndex(int layer, int row) const {
  return layers_[static_cast<std::size_t>(layer)].biases + static_cast<std::size_t>(row);
}

int Network::widest() const { return *std::max_element(sizes_.begin(), sizes_.end()); }

void Network::StartHe(Rng& rng) {
  std::fill(parameters_.begin(), parameters_.end(), 0.0f);
  for (std::size_t l = 0; l < layers_.size(); ++l) {
    const double stddev = std::sqrt(2.0 / layers_[l].in);
    for (int row = 0; row < layers_[l].out; ++row) {
      for (int col = 0; col < layers_[l].in; ++col) {
        parameters_[WeightIndex(static_cast<int>(l), row, col)] = static_cast<float>(stddev * rng.Normal());
      }
    }
  }
}

void Network::Evaluate(const float* x, float* y, float* scratch) const {
  const float* from = x;
  for (std::size_t l = 0; l < layers_.size(); ++l) {
    const LayerShape& layer = layers_[l];
    const bool last = l + 1 == layers_.size();
    float* to = last ? y : scratch + (l % 2) * static_cast<std::size_t>(widest());
    const float* w = parameters_.data() + layer.weights;
    for (int row = 0; row < layer.out; ++row, w += layer.stride) {
      const float sum = Dot(w, from, layer.in) + parameters_[layer.biases + static_cast<std::size_t>(row)];
      // Written so that NaN stays NaN.
      to[row] = !last && sum < 0.0f ? 0.0f : sum;
    }
    from = to;
  }
}

BatchWorkspace::BatchWorkspace(const Network& network, int batch, const Kernels& kernels)
    : kernels_(kernels),
      input_stride_(Padded(network.sizes().front())),
      target_stride_(Padded(network.sizes().back())),
      outputs_(network.sizes().back()),
      column_stride_(Padded(batch)) {
  const auto points = static_cast<std::size_t>(column_stride_);
  for (const int size : network.sizes()) {
    by_feature_.emplace_back(points * static_cast<std::size_t>(Padded(size)), 0.0f);
    by_point_.emplace_back(points * static_cast<std::size_t>(Padded(size)), 0.0f);
  }
  delta_.assign(points * static_cast<std::size_t>(Padded(network.widest())), 0.0f);
  previous_delta_ = delta_;
  gradient_.assign(network.parameters().size(), 0.0f);
}

void BatchWorkspace::Forward(const Network& network, const float* inputs, const int* points, int count) {
  columns_ = Padded(count);
  float* rows = by_point_[0].data();
  const auto row_bytes = static_cast<std::size_t>(input_stride_) * sizeof(float);
  for (int i = 0; i < count; ++i) {
    std::memcpy(rows + i * input_stride_, inputs + static_cast<std::ptrdiff_t>(points[i]) * input_stride_,
                row_bytes);
  }
  std::memset(rows + count * input_stride_, 0, static_cast<std::size_t>(columns_ - count) * row_bytes);
  kernels_.transpose(rows, input_stride_, columns_, input_stride_, by_feature_[0].data(), column_stride_);
  const auto& layers = network.layers();
  for (std::size_t l = 0; l < layers.size(); ++l) {
    const LayerShape& layer = layers[l];
    const float* parameters = network.parameters().data();
    const Gemm gemm{layer.out,
                    columns_,
                    layer.in,
                    parameters + layer.weights,
                    layer.stride,
                    1,
                    by_feature_[l].data(),
                    column_stride_,
                    by_feature_[l + 1].data(),
                    column_stride_,
                    parameters + layer.biases};
    kernels_.gemm(gemm, l + 1 < layers.size() ? Epilogue::kBiasRelu : Epilogue::kBias);
  }
}

double BatchWorkspace::OutputError(const float* targets, const int* points, int count) {
  const float* y = by_feature_.back().data();
  const float scale = 2.0f / (static_cast<float>(count) * static_cast<float>(outputs_));
  double sum = 0.0;
  for (int o = 0; o < outputs_; ++o) {
    float* delta = delta_.data() + o * column_stride_;
    for (int i = 0; i < count; ++i) {
      const float error =
          y[o * column_stride_ + i] - targets[static_cast<std::ptrdiff_t>(points[i]) * target_stride_ + o];
      delta[i] = scale * error;
      sum += static_cast<double>(error) * static_cast<double>(error);
    }
    for (int i = count; i < columns_; ++i) delta[i] = 0.0f;
  }
  return sum;
}

void BatchWorkspace::Backward(const Network& network) {
  const auto& layers = network.layers();
  for (std::size_t l = layers.size(); l-- > 0;) {
    const LayerShape& layer = layers[l];
    float* gradient = gradient_.data();
    // dW = delta · h_{l}ᵀ, so the activations are wanted with one point per row.
    if (l > 0) {
      kernels_.transpose(by_feature_[l].data(), column_stride_, layer.stride, columns_, by_point_[l].data(),
                         layer.stride);
    }
    kernels_.gemm({layer.out, layer.stride, columns_, delta_.data(), column_stride_, 1, by_point_[l].data(),
                   layer.stride, gradient + layer.weights, layer.stride, nullptr},
                  Epilogue::kNone);
    kernels_.row_sums(delta_.data(), column_stride_, layer.out, columns_, gradient + layer.biases);
    if (l == 0) break;
    const float* weights = network.parameters().data() + layer.weights;
    kernels_.gemm({layer.in, columns_, layer.out, weights, 1, layer.stride, delta_.data(), column_stride_,
                   previous_delta_.data(), column_stride_, by_feature_[l].data()},
                  Epilogue::kReluMask);
    std::swap(delta_, previous_delta_);
  }
}

double BatchWorkspace::Loss(const Network& network, const float* inputs, const float* targets,
                            const int* points, int count) {
  RG_CHECK(count > 0 && count <= column_stride_) << count << " points, room for " << column_stride_;
  Forward(network, inputs, points, count);
  return OutputError(targets, points, count);
}

double BatchWorkspace::LossAndGradient(const Network& network, const float* inputs, const float* targets,
                                       const int* points, int count) {
  const double loss = Loss(network, inputs, targets, points, count);
  Backward(network);
  return loss;
}

}  // namespace rg::policy
