#include "services/policy/policy.h"

#include <algorithm>
#include <cmath>

#include "common/base/check.h"
#include "services/policy/byte_stream.h"

namespace rg::policy {
namespace {

constexpr std::string_view kPolicyFormat = "realitygrad.policy/1";
constexpr uint32_t kMaxLayers = 16;

int FirstNotFinite(std::span<const double> values) {
  for (size_t i = 0; i < values.size(); ++i) {
    if (!std::isfinite(values[i])) return static_cast<int>(i);
  }
  return -1;
}

std::string WhatDoesNotFit(const Policy::Parts& p) {
  const auto features = static_cast<size_t>(p.encoding.features());
  const auto outputs = static_cast<size_t>(p.network.sizes().back());
  if (p.encoding.inputs < 1 || p.encoding.inputs > kMaxInputs) return "number of inputs";
  if (outputs < 1 || outputs > kMaxOutputs) return "number of outputs";
  if (p.network.widest() > std::max({kMaxHidden, 2 * kMaxInputs, kMaxOutputs})) return "width of the network";
  int last = -1;
  for (const int i : p.encoding.periodic) {
    if (i <= last || i >= p.encoding.inputs) return "periodic inputs";
    last = i;
  }
  if (static_cast<size_t>(p.network.sizes().front()) != features) return "network's input";
  if (p.input_mean.size() != features || p.input_scale.size() != features) return "input normalisation";
  if (p.output_mean.size() != outputs || p.output_scale.size() != outputs) return "output normalisation";
  for (const auto* values : {&p.input_mean, &p.input_scale, &p.output_mean, &p.output_scale}) {
    if (FirstNotFinite(*values) >= 0) return "normalisation (not finite)";
  }
  for (const float w : p.network.parameters()) {
    if (!std::isfinite(w)) return "weights (not finite)";
  }
  return "";
}

void PutNetwork(const Network& network, ByteWriter* out) {
  std::vector<uint32_t> sizes(network.sizes().begin(), network.sizes().end());
  out->Array(sizes.data(), sizes.size());
  std::vector<float> values;
  values.reserve(network.num_parameters());
  for (size_t l = 0; l < network.layers().size(); ++l) {
    const int layer = static_cast<int>(l);
    for (int row = 0; row < network.layers()[l].out; ++row) {
      for (int col = 0; col < network.layers()[l].in; ++col)
        values.push_back(network.weight(layer, row, col));
    }
    for (int row = 0; row < network.layers()[l].out; ++row) values.push_back(network.bias(layer, row));
  }
  out->Array(values.data(), values.size());
}

Result<Network> GetNetwork(ByteReader* in, const std::string& source) {
  std::vector<uint32_t> sizes;
  RG_RETURN_IF_ERROR(in->Array(&sizes));
  if (sizes.size() < 2 || sizes.size() > kMaxLayers) {
    return InvalidError(source + ": a network of " + std::to_string(sizes.size()) + " sizes");
  }
  for (const uint32_t size : sizes) {
    if (size < 1 || size > kMaxHidden) return InvalidError(source + ": a layer of " + std::to_string(size));
  }
  std::vector<float> values;
  RG_RETURN_IF_ERROR(in->Array(&values));
  Network network(std::vector<int>(sizes.begin(), sizes.end()));
  if (values.size() != network.num_parameters()) {
    return InvalidError(source + ": " + std::to_string(values.size()) + " weights, must be " +
                        std::to_string(network.num_parameters()));
  }
  const float* from = values.data();
  for (size_t l = 0; l < network.layers().size(); ++l) {
    const int layer = static_cast<int>(l);
    for (int row = 0; row < network.layers()[l].out; ++row) {
      for (int col = 0; col < network.layers()[l].in; ++col) {
        network.parameters()[network.WeightIndex(layer, row, col)] = *from++;
      }
    }
    for (int row = 0; row < network.layers()[l].out; ++row) {
      network.parameters()[network.BiasIndex(layer, row)] = *from++;
    }
  }
  return network;
}

}  // namespace

void InputEncoding::Encode(const double* x, double* f) const {
  size_t next = 0;
  for (int i = 0; i < inputs; ++i) {
    if (next < periodic.size() && periodic[next] == i) {
      *f++ = std::sin(x[i]);
      *f++ = std::cos(x[i]);
      ++next;
    } else {
      *f++ = x[i];
    }
  }
}

std::string EvaluateOutcome::ToString() const {
  if (ok()) return "ok";
  return std::string(kind == Kind::kBadInput ? "policy input " : "policy output ") + std::to_string(index) +
         " is not finite";
}

Policy::Policy(Parts parts) : parts_(std::move(parts)) {
  const std::string wrong = WhatDoesNotFit(parts_);
  RG_CHECK(wrong.empty()) << "policy: its " << wrong << " does not fit";
}

EvaluateOutcome Policy::Evaluate(std::span<const double> in, std::span<double> out) const {
  RG_CHECK(static_cast<int>(in.size()) == input_size() && static_cast<int>(out.size()) == output_size())
      << in.size() << " inputs and " << out.size() << " outputs, must be " << input_size() << " and "
      << output_size();
  if (const int bad = FirstNotFinite(in); bad >= 0) return {EvaluateOutcome::Kind::kBadInput, bad};
  double encoded[2 * kMaxInputs];
  float features[2 * kMaxInputs], outputs[kMaxOutputs], scratch[2 * kMaxHidden];
  parts_.encoding.Encode(in.data(), encoded);
  for (size_t i = 0; i < parts_.input_mean.size(); ++i) {
    const double scale = parts_.input_scale[i];
    features[i] = scale > 0.0 ? static_cast<float>((encoded[i] - parts_.input_mean[i]) / scale) : 0.0f;
  }
  parts_.network.Evaluate(features, outputs, scratch);
  for (size_t i = 0; i < out.size(); ++i) {
    out[i] = parts_.output_mean[i] + parts_.output_scale[i] * static_cast<double>(outputs[i]);
  }
  if (const int bad = FirstNotFinite(out); bad >= 0) return {EvaluateOutcome::Kind::kBadOutput, bad};
  return {};
}

std::string SerializePolicy(const Policy& policy) {
  const Policy::Parts& p = policy.parts();
  ByteWriter out(kPolicyFormat);
  out.Put(static_cast<uint32_t>(p.joints.size()));
  for (const std::string& joint : p.joints) out.Text(joint);
  out.Put(static_cast<int32_t>(p.encoding.inputs));
  out.Array(p.encoding.periodic.data(), p.encoding.periodic.size());
  for (const auto* values : {&p.input_mean, &p.input_scale, &p.output_mean, &p.output_scale}) {
    out.Array(values->data(), values->size());
  }
  PutNetwork(p.network, &out);
  out.Put(p.record.seed);
  out.Put(static_cast<int32_t>(p.record.epochs));
  out.Put(static_cast<int32_t>(p.record.points));
  out.Put(static_cast<int32_t>(p.record.validation_points));
  std::vector<double> curve;
  for (const EpochLoss& e : p.record.curve) curve.insert(curve.end(), {e.train, e.validation});
  out.Array(curve.data(), curve.size());
  return out.Finish();
}

Result<Policy> ParsePolicy(std::string_view bytes, const std::string& source) {
  RG_ASSIGN_OR_RETURN(ByteReader in, ByteReader::Open(bytes, kPolicyFormat, source));
  Policy::Parts p;
  uint32_t joints = 0;
  RG_RETURN_IF_ERROR(in.Get(&joints));
  if (joints > static_cast<uint32_t>(kMaxOutputs)) return InvalidError(source + ": too many joints");
  p.joints.resize(joints);
  for (std::string& joint : p.joints) RG_RETURN_IF_ERROR(in.Text(&joint));
  int32_t inputs = 0, epochs = 0, points = 0, validation_points = 0;
  RG_RETURN_IF_ERROR(in.Get(&inputs));
  p.encoding.inputs = inputs;
  RG_RETURN_IF_ERROR(in.Array(&p.encoding.periodic));
  for (auto* values : {&p.input_mean, &p.input_scale, &p.output_mean, &p.output_scale}) {
    RG_RETURN_IF_ERROR(in.Array(values));
  }
  RG_ASSIGN_OR_RETURN(p.network, GetNetwork(&in, source));
  RG_RETURN_IF_ERROR(in.Get(&p.record.seed));
  RG_RETURN_IF_ERROR(in.Get(&epochs));
  RG_RETURN_IF_ERROR(in.Get(&points));
  RG_RETURN_IF_ERROR(in.Get(&validation_points));
  p.record.epochs = epochs;
  p.record.points = points;
  p.record.validation_points = validation_points;
  std::vector<double> curve;
  RG_RETURN_IF_ERROR(in.Array(&curve));
  for (size_t i = 0; i + 1 < curve.size(); i += 2) p.record.curve.push_back({curve[i], curve[i + 1]});
  RG_RETURN_IF_ERROR(in.ExpectEnd());
  const std::string wrong = WhatDoesNotFit(p);
  if (!wrong.empty()) return InvalidError(source + ": its " + wrong + " does not fit");
  return Policy(std::move(p));
}

}  // namespace rg::policy
