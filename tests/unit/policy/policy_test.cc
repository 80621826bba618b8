#include "services/policy/policy.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "services/policy/byte_stream.h"
#include "services/policy/dataset.h"

namespace rg::policy {
namespace {

using ::testing::HasSubstr;

Policy RandomPolicy(uint64_t seed = 1) {
  Rng rng(seed);
  Policy::Parts p;
  p.joints = {"a", "b"};
  p.encoding = {6, {1, 5}};
  p.network = Network({8, 16, 2});
  p.network.StartHe(rng);
  p.input_mean.assign(8, 0.5);
  p.input_scale.assign(8, 2.0);
  p.output_mean = {1.0, -1.0};
  p.output_scale = {3.0, 0.5};
  p.record = {7, 2, 90, 10, {{1.0, 1.1}, {0.5, std::nan("")}}};
  return Policy(std::move(p));
}

TEST(Policy, ReadsBackTheSame) {
  const Policy policy = RandomPolicy();
  const auto back = ParsePolicy(SerializePolicy(policy), "p.policy");
  ASSERT_TRUE(back.ok()) << back.status().ToString();
  EXPECT_EQ(back->joints(), policy.joints());
  EXPECT_EQ(back->parts().network.parameters(), policy.parts().network.parameters());
  EXPECT_EQ(back->parts().encoding.periodic, policy.parts().encoding.periodic);
  EXPECT_EQ(back->record().seed, 7u);
  ASSERT_EQ(back->record().curve.size(), 2u);
  EXPECT_EQ(back->record().curve[0].validation, 1.1);
  EXPECT_TRUE(std::isnan(back->record().curve[1].validation));
  const std::vector<double> x = {0.1, 0.2, 0.3, 0.4, 0.5, 0.6};
  std::vector<double> u(2), v(2);
  ASSERT_TRUE(policy.Evaluate(x, u).ok());
  ASSERT_TRUE(back->Evaluate(x, v).ok());
  EXPECT_EQ(u, v);
}

TEST(Policy, IsItsFormula) {
  // One layer, no hidden one: y = mean + scale · (W f + b) with f the normalised input.
  Policy::Parts p;
  p.encoding = {2, {}};
  p.network = Network({2, 1});
  p.network.parameters()[p.network.WeightIndex(0, 0, 0)] = 2.0f;
  p.network.parameters()[p.network.WeightIndex(0, 0, 1)] = -1.0f;
  p.network.parameters()[p.network.BiasIndex(0, 0)] = 0.25f;
  p.input_mean = {1.0, 0.0};
  p.input_scale = {2.0, 4.0};
  p.output_mean = {10.0};
  p.output_scale = {3.0};
  std::vector<double> u(1);
  ASSERT_TRUE(Policy(p).Evaluate(std::vector<double>{5.0, 2.0}, u).ok());
  EXPECT_DOUBLE_EQ(u[0], 10.0 + 3.0 * (2.0 * 2.0 - 0.5 + 0.25));
}

TEST(Policy, ReportsNaNWithItsPlace) {
  const Policy policy = RandomPolicy();
  std::vector<double> x(6, 0.0), u = {5.0, 6.0};
  x[4] = std::nan("");
  const EvaluateOutcome outcome = policy.Evaluate(x, u);
  EXPECT_EQ(outcome.kind, EvaluateOutcome::Kind::kBadInput);
  EXPECT_EQ(outcome.ToString(), "policy input 4 is not finite");
  EXPECT_EQ(u[0], 5.0);
  x[4] = std::numeric_limits<double>::infinity();
  EXPECT_FALSE(policy.Evaluate(x, u).ok());
  x[4] = 1e300;  // finite, but beyond float inside
  EXPECT_EQ(policy.Evaluate(x, u).kind, EvaluateOutcome::Kind::kBadOutput);
}

TEST(ParsePolicy, RefusesEveryTruncationAndEveryFlippedByte) {
  const std::string bytes = SerializePolicy(RandomPolicy());
  for (size_t size = 0; size < bytes.size(); size += 13) {
    EXPECT_FALSE(ParsePolicy(bytes.substr(0, size), "p").ok()) << size;
  }
  for (size_t at = 0; at < bytes.size(); at += 7) {
    std::string changed = bytes;
    changed[at] = static_cast<char>(changed[at] ^ 0x20);
    const auto policy = ParsePolicy(changed, "p.policy");
    EXPECT_FALSE(policy.ok()) << at;
    EXPECT_THAT(policy.status().message(), HasSubstr("p.policy")) << at;
  }
}

TEST(ParsePolicy, NamesAVersionItDoesNotKnowAndAFileOfAnotherKind) {
  std::string bytes = SerializePolicy(RandomPolicy());
  bytes[bytes.find('/') + 1] = '9';
  EXPECT_THAT(ParsePolicy(bytes, "p").status().message(), HasSubstr("realitygrad.policy/9"));
  EXPECT_THAT(ParsePolicy("not a policy\n", "p").status().message(), HasSubstr("not a file of the kind"));
  EXPECT_THAT(ParsePolicy(ByteWriter("realitygrad.dataset/1").Finish(), "p").status().message(),
              HasSubstr("not a file of the kind"));
}

TEST(ParsePolicy, RefusesSizesThatDoNotFitEvenWithAGoodChecksum) {
  ByteWriter out("realitygrad.policy/1");
  out.Put(static_cast<uint32_t>(0));
  out.Put(static_cast<int32_t>(3));
  const int none = 0;
  out.Array(&none, 0);
  const double one[4] = {1, 1, 1, 1};
  for (int i = 0; i < 4; ++i) out.Array(one, 4);
  const uint32_t sizes[2] = {4000000000u, 4000000000u};
  out.Array(sizes, 2);
  EXPECT_THAT(ParsePolicy(out.Finish(), "p").status().message(), HasSubstr("4000000000"));
}

Dataset TwoTrajectories() {
  Dataset dataset;
  const Eigen::MatrixXd q = Eigen::MatrixXd::Constant(2, 3, 0.5), u = Eigen::MatrixXd::Constant(2, 3, 7.0);
  dataset.AddTrajectory(11, q, 2.0 * q, Eigen::Vector2d(8.0, 9.0), u);
  dataset.AddTrajectory(12, q, 2.0 * q, Eigen::Vector2d(8.0, 9.0), u);
  return dataset;
}

TEST(Dataset, StacksStateVelocityAndGoal) {
  const Dataset dataset = TwoTrajectories();
  EXPECT_EQ(dataset.size(), 6);
  EXPECT_EQ(dataset.inputs.col(4), (Eigen::VectorXf(6) << 0.5, 0.5, 1, 1, 8, 9).finished());
  EXPECT_EQ(dataset.trajectory, (std::vector<uint64_t>{11, 11, 11, 12, 12, 12}));
}

TEST(Dataset, RefusesWhatIsNotFiniteByItsPlace) {
  Dataset bad = TwoTrajectories();
  bad.outputs(1, 2) = std::numeric_limits<float>::infinity();
  EXPECT_THAT(CheckDataset(bad).message(), HasSubstr("point 2, output 1"));
}

TEST(Dataset, AppendsPointsOfTheSameShapeOnly) {
  Dataset dataset = TwoTrajectories();
  ASSERT_TRUE(Append(&dataset, TwoTrajectories()).ok());
  EXPECT_EQ(dataset.size(), 12);
  EXPECT_EQ(dataset.inputs.col(11), dataset.inputs.col(0));
  Dataset one_joint;
  one_joint.AddTrajectory(1, Eigen::MatrixXd::Zero(1, 2), Eigen::MatrixXd::Zero(1, 2),
                          Eigen::VectorXd::Zero(1), Eigen::MatrixXd::Zero(1, 2));
  EXPECT_THAT(Append(&dataset, one_joint).message(), HasSubstr("3 inputs"));
  EXPECT_EQ(dataset.size(), 12);
  Dataset empty;
  ASSERT_TRUE(Append(&empty, dataset).ok());
  EXPECT_EQ(empty.size(), 12);
}

}  // namespace
}  // namespace rg::policy
