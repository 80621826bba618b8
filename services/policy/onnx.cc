#include "services/policy/onnx.h"

#include <cstring>
#include <string_view>

namespace rg::policy {
namespace {

// Field numbers of onnx.proto (ONNX 1.x; frozen by that format).
namespace model_proto {
constexpr int kIrVersion = 1, kProducerName = 2, kProducerVersion = 3, kGraph = 7, kOpsetImport = 8,
              kMetadata = 14;
}
namespace graph_proto {
constexpr int kNode = 1, kName = 2, kInitializer = 5, kInput = 11, kOutput = 12;
}
namespace node_proto {
constexpr int kInput = 1, kOutput = 2, kName = 3, kOpType = 4, kAttribute = 5;
}
namespace attribute_proto {
constexpr int kName = 1, kInt = 3, kType = 20;
constexpr int kTypeInt = 2;
}  // namespace attribute_proto
namespace tensor_proto {
constexpr int kDims = 1, kDataType = 2, kName = 8, kRawData = 9;
constexpr int kFloat = 1, kInt64 = 7;
}  // namespace tensor_proto
namespace value_info_proto {
constexpr int kName = 1, kType = 2;
}
namespace type_proto {
constexpr int kTensorType = 1, kElemType = 1, kShape = 2, kDim = 1, kDimValue = 1, kDimParam = 2;
}
namespace pair_proto {
constexpr int kKey = 1, kValue = 2;
}
namespace opset_proto {
constexpr int kVersion = 2;
}

constexpr int kIr = 7, kOpset = 13;

// A Protobuf message under construction.
class Message {
 public:
  Message& Int(int field, uint64_t value) {
    Varint(static_cast<uint64_t>(field) << 3);
    Varint(value);
    return *this;
  }
  Message& Bytes(int field, std::string_view value) {
    Varint(static_cast<uint64_t>(field) << 3 | 2);
    Varint(value.size());
    bytes_.append(value);
    return *this;
  }
  Message& Sub(int field, const Message& message) { return Bytes(field, message.bytes_); }
  const std::string& bytes() const { return bytes_; }

 private:
  void Varint(uint64_t value) {
    for (; value >= 0x80; value >>= 7) bytes_ += static_cast<char>(value | 0x80);
    bytes_ += static_cast<char>(value);
  }
  std::string bytes_;
};

template <class T>
Message Tensor(const std::string& name, int type, const std::vector<int>& dims,
               const std::vector<T>& values) {
  Message tensor;
  for (const int dim : dims) tensor.Int(tensor_proto::kDims, static_cast<uint64_t>(dim));
  tensor.Int(tensor_proto::kDataType, static_cast<uint64_t>(type)).Bytes(tensor_proto::kName, name);
  tensor.Bytes(tensor_proto::kRawData,
               {reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T)});
  return tensor;
}

Message ValueInfo(const std::string& name, int size) {
  const Message batch = Message().Bytes(type_proto::kDimParam, "batch");
  const Message width = Message().Int(type_proto::kDimValue, static_cast<uint64_t>(size));
  const Message shape = Message().Sub(type_proto::kDim, batch).Sub(type_proto::kDim, width);
  const Message tensor =
      Message().Int(type_proto::kElemType, tensor_proto::kFloat).Sub(type_proto::kShape, shape);
  const Message type = Message().Sub(type_proto::kTensorType, tensor);
  return Message().Bytes(value_info_proto::kName, name).Sub(value_info_proto::kType, type);
}

struct IntAttribute {
  const char* name;
  int value;
};

class GraphBuilder {
 public:
  explicit GraphBuilder(const std::string& name) { graph_.Bytes(graph_proto::kName, name); }

  // Adds a node whose output is `output`; returns that name.
  std::string Node(const std::string& op, const std::vector<std::string>& inputs, const std::string& output,
                   const std::vector<IntAttribute>& attributes = {}) {
    Message node;
    for (const std::string& input : inputs) node.Bytes(node_proto::kInput, input);
    node.Bytes(node_proto::kOutput, output).Bytes(node_proto::kName, output + "/" + op);
    node.Bytes(node_proto::kOpType, op);
    for (const IntAttribute& a : attributes) {
      node.Sub(node_proto::kAttribute, Message()
                                           .Bytes(attribute_proto::kName, a.name)
                                           .Int(attribute_proto::kInt, static_cast<uint64_t>(a.value))
                                           .Int(attribute_proto::kType, attribute_proto::kTypeInt));
    }
    graph_.Sub(graph_proto::kNode, node);
    return output;
  }
  std::string Floats(const std::string& name, const std::vector<int>& dims,
                     const std::vector<float>& values) {
    graph_.Sub(graph_proto::kInitializer, Tensor(name, tensor_proto::kFloat, dims, values));
    return name;
  }
  std::string Ints(const std::string& name, const std::vector<int64_t>& values) {
    graph_.Sub(graph_proto::kInitializer,
               Tensor(name, tensor_proto::kInt64, {static_cast<int>(values.size())}, values));
    return name;
  }
  Message Finish(const std::string& input, int input_size, const std::string& output, int output_size) {
    graph_.Sub(graph_proto::kInput, ValueInfo(input, input_size));
    graph_.Sub(graph_proto::kOutput, ValueInfo(output, output_size));
    return graph_;
  }

 private:
  Message graph_;
};

std::vector<float> AsFloats(const std::vector<double>& values) { return {values.begin(), values.end()}; }

// Sine and cosine of all inputs beside them, and of the three the columns that are features.
std::string Encode(const InputEncoding& encoding, const std::string& x, GraphBuilder* graph) {
  if (encoding.periodic.empty()) return x;
  const std::string sine = graph->Node("Sin", {x}, "sine"), cosine = graph->Node("Cos", {x}, "cosine");
  const std::string all = graph->Node("Concat", {x, sine, cosine}, "candidates", {{"axis", 1}});
  std::vector<int64_t> columns;
  size_t next = 0;
  for (int i = 0; i < encoding.inputs; ++i) {
    if (next < encoding.periodic.size() && encoding.periodic[next] == i) {
      columns.push_back(encoding.inputs + i);
      columns.push_back(2 * encoding.inputs + i);
      ++next;
    } else {
      columns.push_back(i);
    }
  }
  return graph->Node("Gather", {all, graph->Ints("feature_columns", columns)}, "features", {{"axis", 1}});
}

std::string NormaliseInput(const Policy::Parts& p, const std::string& features, GraphBuilder* graph) {
  const int size = p.encoding.features();
  std::vector<float> inverse;
  for (const double scale : p.input_scale)
    inverse.push_back(scale > 0.0 ? static_cast<float>(1.0 / scale) : 0.0f);
  const std::string mean = graph->Floats("input_mean", {size}, AsFloats(p.input_mean));
  const std::string centred = graph->Node("Sub", {features, mean}, "centred");
  return graph->Node("Mul", {centred, graph->Floats("input_scale_inverse", {size}, inverse)}, "normalised");
}

std::string Layers(const Network& network, std::string h, GraphBuilder* graph) {
  for (size_t l = 0; l < network.layers().size(); ++l) {
    const LayerShape& layer = network.layers()[l];
    const int index = static_cast<int>(l);
    std::vector<float> weights, biases;
    for (int row = 0; row < layer.out; ++row) {
      for (int col = 0; col < layer.in; ++col) weights.push_back(network.weight(index, row, col));
      biases.push_back(network.bias(index, row));
    }
    const std::string number = std::to_string(l + 1);
    const std::string w = graph->Floats("weight_" + number, {layer.out, layer.in}, weights);
    const std::string b = graph->Floats("bias_" + number, {layer.out}, biases);
    h = graph->Node("Gemm", {h, w, b}, "layer_" + number, {{"transB", 1}});
    if (l + 1 < network.layers().size()) h = graph->Node("Relu", {h}, "hidden_" + number);
  }
  return h;
}

}  // namespace

std::string ExportOnnx(const Policy& policy, const std::string& version) {
  const Policy::Parts& p = policy.parts();
  GraphBuilder graph("realitygrad_policy");
  const std::string features = Encode(p.encoding, "observation", &graph);
  const std::string y = Layers(p.network, NormaliseInput(p, features, &graph), &graph);
  const int outputs = policy.output_size();
  const std::string scaled =
      graph.Node("Mul", {y, graph.Floats("output_scale", {outputs}, AsFloats(p.output_scale))}, "scaled");
  graph.Node("Add", {scaled, graph.Floats("output_mean", {outputs}, AsFloats(p.output_mean))}, "effort");

  Message model;
  model.Int(model_proto::kIrVersion, kIr).Bytes(model_proto::kProducerName, "realitygrad");
  model.Bytes(model_proto::kProducerVersion, version);
  model.Sub(model_proto::kGraph, graph.Finish("observation", policy.input_size(), "effort", outputs));
  model.Sub(model_proto::kOpsetImport, Message().Int(opset_proto::kVersion, kOpset));
  std::string joints;
  for (const std::string& joint : policy.joints()) joints += (joints.empty() ? "" : ",") + joint;
  model.Sub(model_proto::kMetadata,
            Message().Bytes(pair_proto::kKey, "joints").Bytes(pair_proto::kValue, joints));
  return model.bytes();
}

}  // namespace rg::policy
