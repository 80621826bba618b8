// ONNX's own reader and checker on the exported model; built where libonnx-dev is installed.
#include <gtest/gtest.h>
#include <onnx/checker.h>
#include <onnx/shape_inference/implementation.h>

#include "common/base/rng.h"
#include "services/policy/onnx.h"

namespace rg::policy {
namespace {

Policy RandomPolicy(const std::vector<int>& periodic) {
  Rng rng(4);
  Policy::Parts p;
  p.joints = {"a", "b"};
  p.encoding = {6, periodic};
  const int features = p.encoding.features();
  p.network = Network({features, 128, 128, 2});
  p.network.StartHe(rng);
  p.input_mean.assign(static_cast<size_t>(features), 0.1);
  p.input_scale.assign(static_cast<size_t>(features), 2.0);
  p.output_mean = {3.0, -20.0};
  p.output_scale = {7.0, 0.1};
  return Policy(std::move(p));
}

TEST(OnnxChecker, AcceptsTheExportedModelAndInfersItsShapes) {
  for (const std::vector<int>& periodic : {std::vector<int>{}, {1, 5}}) {
    onnx::ModelProto model;
    ASSERT_TRUE(model.ParseFromString(ExportOnnx(RandomPolicy(periodic), "0.1")));
    EXPECT_NO_THROW(onnx::checker::check_model(model));
    onnx::shape_inference::InferShapes(model);
    ASSERT_GT(model.graph().value_info_size(), 0);
    for (const auto& value : model.graph().value_info()) {
      EXPECT_EQ(value.type().tensor_type().shape().dim_size(), 2) << value.name();
    }
  }
}

}  // namespace
}  // namespace rg::policy
