// A policy as an ONNX model, for other programs.
//
// One float32 input "observation" (batch × inputs) and one output "effort" (batch × outputs), both in the
// units of the training data: encoding and normalisation are part of the graph. Operators: Sin, Cos,
// Concat, Gather (only for periodic inputs), Sub, Mul, Gemm, Relu, Add; opset 13, IR version 7. Metadata
// carries the joint names. The wire format is written by hand: no dependency on Protobuf or ONNX.
#pragma once

#include <string>

#include "services/policy/policy.h"

namespace rg::policy {

// Bytes of an onnx.ModelProto. `version` becomes producer_version.
std::string ExportOnnx(const Policy& policy, const std::string& version);

}  // namespace rg::policy
