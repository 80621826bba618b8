// A fully connected network with ReLU between its layers, in the layout that training wants.
//
//   h_0 = x,  h_l = max(0, W_l·h_{l−1} + b_l),  y = W_L·h_{L−1} + b_L
//
// Weights, biases, gradient and Adam's moments are each one flat buffer. A layer holds W (out × in,
// rows of `stride` floats, the padding stays zero) and then b (padded to kLane).
#pragma once

#include <cstddef>
#include <vector>

#include "common/base/rng.h"
#include "services/policy/kernels.h"

namespace rg::policy {

struct LayerShape {
  int in = 0, out = 0;
  int stride = 0;           // floats per row of W, a multiple of kLane
  std::size_t weights = 0;  // where W starts in the flat buffer
  std::size_t biases = 0;   // where b starts
};

class Network {
 public:
  // sizes: input, hidden…, output; at least two. All parameters are zero.
  explicit Network(const std::vector<int>& sizes);

  const std::vector<int>& sizes() const { return sizes_; }
  const std::vector<LayerShape>& layers() const { return layers_; }
  std::vector<float>& parameters() { return parameters_; }
  const std::vector<float>& parameters() const { return parameters_; }
  // Parameters without padding.
  std::size_t num_parameters() const;

  float weight(int layer, int row, int col) const { return parameters_[WeightIndex(layer, row, col)]; }
  float bias(int layer, int row) const { return parameters_[BiasIndex(layer, row)]; }
  std::size_t WeightIndex(int layer, int row, int col) const;
  std::size_t BiasIndex(int layer, int row) const;

  // He et al. 2015: W ~ N(0, 2 / in), b = 0.
  void StartHe(Rng& rng);

  // y for one x, by plain loops in a fixed order: the same bits whatever the processor. x: sizes()
  // first, y: sizes() last. `scratch` holds 2 · the widest layer.
  void Evaluate(const float* x, float* y, float* scratch) const;
  int widest() const;

 private:
  std::vector<int> sizes_;
  std::vector<LayerShape> layers_;
  std::vector<float> parameters_;
};

// Buffers and gradient for batches of up to `batch` points.
class BatchWorkspace {
 public:
  BatchWorkspace(const Network& network, int batch, const Kernels& kernels);

  // Rows of inputs and targets: this many floats apart (padded with zeros by the caller).
  int input_stride() const { return input_stride_; }
  int target_stride() const { return target_stride_; }
  static int PaddedSize(int n) { return (n + kLane - 1) / kLane * kLane; }

  // Sum over points and outputs of (y − target)² for `count` points, points[i] being a row of inputs
  // (input_stride floats each) and of targets. `count` ≤ batch.
  double Loss(const Network& network, const float* inputs, const float* targets, const int* points,
              int count);
  // The same, and gradient() = d(mean square error) / d(parameters), the mean over count · outputs.
  double LossAndGradient(const Network& network, const float* inputs, const float* targets, const int* points,
                         int count);
  const std::vector<float>& gradient() const { return gradient_; }

 private:
  void Forward(const Network& network, const float* inputs, const int* points, int count);
  double OutputError(const float* targets, const int* points, int count);
  void Backward(const Network& network);

  const Kernels& kernels_;
  int input_stride_, target_stride_;
  int outputs_;
  int columns_ = 0;  // points of this batch, padded to kLane
  int column_stride_;
  std::vector<std::vector<float>> by_feature_;  // h_l as features × points
  std::vector<std::vector<float>> by_point_;    // h_l as points × features
  std::vector<float> delta_, previous_delta_;   // d(loss)/d(h_l), features × points
  std::vector<float> gradient_;
};

}  // namespace rg::policy
