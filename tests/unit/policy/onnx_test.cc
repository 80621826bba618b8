// The exported model is read back with Protobuf's own decoder and run by a small interpreter of its
// graph that knows nothing of the exporter.
#include "services/policy/onnx.h"

#include <google/protobuf/unknown_field_set.h>
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <cmath>
#include <cstring>
#include <map>

#include "common/base/rng.h"

namespace rg::policy {
namespace {

using google::protobuf::UnknownField;

struct Field {
  int number = 0;
  bool is_bytes = false;
  int64_t value = 0;
  std::string bytes;
};
using Fields = std::vector<Field>;

Fields Decode(const std::string& bytes) {
  google::protobuf::UnknownFieldSet set;
  EXPECT_TRUE(set.ParseFromString(bytes));
  Fields fields;
  for (int i = 0; i < set.field_count(); ++i) {
    const UnknownField& f = set.field(i);
    const bool is_bytes = f.type() == UnknownField::TYPE_LENGTH_DELIMITED;
    EXPECT_TRUE(is_bytes || f.type() == UnknownField::TYPE_VARINT);
    fields.push_back({f.number(), is_bytes, is_bytes ? 0 : static_cast<int64_t>(f.varint()),
                      is_bytes ? f.length_delimited() : std::string()});
  }
  return fields;
}

std::vector<std::string> Strings(const Fields& fields, int number) {
  std::vector<std::string> found;
  for (const Field& f : fields) {
    if (f.number == number && f.is_bytes) found.push_back(f.bytes);
  }
  return found;
}

std::vector<int64_t> Ints(const Fields& fields, int number) {
  std::vector<int64_t> found;
  for (const Field& f : fields) {
    if (f.number == number && !f.is_bytes) found.push_back(f.value);
  }
  return found;
}

// Runs the graph for one row. Initialisers of one dimension are rows.
class Interpreter {
 public:
  explicit Interpreter(const std::string& model) : graph_(Decode(Strings(Decode(model), 7).at(0))) {
    for (const std::string& bytes : Strings(graph_, 5)) AddTensor(Decode(bytes));
  }

  Eigen::MatrixXd Run(const Eigen::RowVectorXd& x) {
    values_["observation"] = x;
    for (const std::string& bytes : Strings(graph_, 1)) RunNode(Decode(bytes));
    return values_.at("effort");
  }

 private:
  void AddTensor(const Fields& tensor) {
    const auto dims = Ints(tensor, 1);
    const int64_t rows = dims.size() == 2 ? dims[0] : 1, cols = dims.back();
    const std::string raw = Strings(tensor, 9).at(0);
    const bool is_float = Ints(tensor, 2).at(0) == 1;
    ASSERT_EQ(raw.size(), static_cast<size_t>(rows * cols) * (is_float ? 4 : 8));
    Eigen::MatrixXd values(rows, cols);
    for (int64_t i = 0; i < rows * cols; ++i) {
      float f = 0.0f;
      int64_t n = 0;
      std::memcpy(is_float ? static_cast<void*>(&f) : &n, raw.data() + i * (is_float ? 4 : 8),
                  is_float ? 4 : 8);
      values(i / cols, i % cols) = is_float ? static_cast<double>(f) : static_cast<double>(n);
    }
    values_[Strings(tensor, 8).at(0)] = values;
  }

  void RunNode(const Fields& node) {
    std::vector<Eigen::MatrixXd> in;
    for (const std::string& name : Strings(node, 1)) in.push_back(values_.at(name));
    std::map<std::string, int64_t> attribute;
    for (const std::string& bytes : Strings(node, 5)) {
      const Fields fields = Decode(bytes);
      EXPECT_EQ(Ints(fields, 20).at(0), 2) << "an integer attribute says that it is one";
      attribute[Strings(fields, 1).at(0)] = Ints(fields, 3).at(0);
    }
    const std::string op = Strings(node, 4).at(0);
    Eigen::MatrixXd out;
    if (op == "Sin") out = in[0].array().sin();
    if (op == "Cos") out = in[0].array().cos();
    if (op == "Concat") {
      EXPECT_EQ(attribute.at("axis"), 1);
      out.resize(1, in[0].cols() + in[1].cols() + in[2].cols());
      out << in[0], in[1], in[2];
    }
    if (op == "Gather") {
      EXPECT_EQ(attribute.at("axis"), 1);
      out.resize(1, in[1].cols());
      for (Eigen::Index i = 0; i < in[1].cols(); ++i)
        out(0, i) = in[0](0, static_cast<Eigen::Index>(in[1](0, i)));
    }
    if (op == "Sub") out = in[0] - in[1];
    if (op == "Mul") out = in[0].cwiseProduct(in[1]);
    if (op == "Add") out = in[0] + in[1];
    if (op == "Relu") out = in[0].cwiseMax(0.0);
    if (op == "Gemm") {
      EXPECT_EQ(attribute.at("transB"), 1);
      out = in[0] * in[1].transpose() + in[2];
    }
    ASSERT_GT(out.size(), 0) << "unknown operator " << op;
    values_[Strings(node, 2).at(0)] = out;
  }

  Fields graph_;
  std::map<std::string, Eigen::MatrixXd> values_;
};

Policy RandomPolicy(const std::vector<int>& periodic) {
  Rng rng(4);
  Policy::Parts p;
  p.joints = {"a", "b"};
  p.encoding = {6, periodic};
  const int features = p.encoding.features();
  p.network = Network({features, 128, 128, 2});
  p.network.StartHe(rng);
  for (int l = 0; l < 3; ++l) p.network.parameters()[p.network.BiasIndex(l, 1)] = 0.3f;
  for (int i = 0; i < features; ++i) {
    p.input_mean.push_back(rng.Normal());
    p.input_scale.push_back(i == 2 ? 0.0 : rng.Uniform(0.5, 2.0));
  }
  p.output_mean = {3.0, -20.0};
  p.output_scale = {7.0, 0.1};
  return Policy(std::move(p));
}

TEST(ExportOnnx, GivesAGraphThatComputesWhatThePolicyDoes) {
  Rng rng(6);
  for (const std::vector<int>& periodic : {std::vector<int>{}, {1, 5}, {0, 1, 4, 5}}) {
    const Policy policy = RandomPolicy(periodic);
    Interpreter onnx(ExportOnnx(policy, "1.2.3"));
    for (int trial = 0; trial < 20; ++trial) {
      std::vector<double> x(6), u(2);
      for (double& value : x) value = rng.Uniform(-3.0, 3.0);
      ASSERT_TRUE(policy.Evaluate(x, u).ok());
      const Eigen::MatrixXd y = onnx.Run(Eigen::Map<const Eigen::RowVectorXd>(x.data(), 6));
      ASSERT_EQ(y.cols(), 2);
      EXPECT_NEAR(y(0, 0), u[0], 1e-5 * 7.0);
      EXPECT_NEAR(y(0, 1), u[1], 1e-5 * 20.0);
    }
  }
}

TEST(ExportOnnx, SaysWhoMadeItAndWhichOperatorsItMeans) {
  const Fields model = Decode(ExportOnnx(RandomPolicy({}), "1.2.3"));
  EXPECT_EQ(Ints(model, 1).at(0), 7);
  EXPECT_EQ(Strings(model, 2).at(0), "realitygrad");
  EXPECT_EQ(Strings(model, 3).at(0), "1.2.3");
  EXPECT_EQ(Ints(Decode(Strings(model, 8).at(0)), 2).at(0), 13);
  const Fields metadata = Decode(Strings(model, 14).at(0));
  EXPECT_EQ(Strings(metadata, 1).at(0), "joints");
  EXPECT_EQ(Strings(metadata, 2).at(0), "a,b");
  // Input and output: batch × size, float.
  const Fields graph = Decode(Strings(model, 7).at(0));
  for (const auto& [field, size] : {std::pair<int, int64_t>{11, 6}, {12, 2}}) {
    const Fields tensor =
        Decode(Strings(Decode(Strings(Decode(Strings(graph, field).at(0)), 2).at(0)), 1).at(0));
    EXPECT_EQ(Ints(tensor, 1).at(0), 1);
    const auto dims = Strings(Decode(Strings(tensor, 2).at(0)), 1);
    ASSERT_EQ(dims.size(), 2u);
    EXPECT_EQ(Strings(Decode(dims[0]), 2).at(0), "batch");
    EXPECT_EQ(Ints(Decode(dims[1]), 1).at(0), size);
  }
}

}  // namespace
}  // namespace rg::policy
