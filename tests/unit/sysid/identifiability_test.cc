#include "services/sysid/identifiability.h"

#include <gtest/gtest.h>

#include <Eigen/Dense>

#include <limits>
#include <nlohmann/json.hpp>

namespace rg::sysid {
namespace {

using Eigen::MatrixXd;
using Eigen::VectorXd;

IdentifiabilityInput Input(const MatrixXd& J, const VectorXd& prior) {
  const int P = static_cast<int>(J.cols());
  IdentifiabilityInput in;
  for (int i = 0; i < P; ++i) in.names.push_back("p" + std::to_string(i));
  in.units.assign(P, "kg");
  in.value = in.nominal = VectorXd::Constant(P, 1.0);
  in.lower = VectorXd::Constant(P, -std::numeric_limits<double>::infinity());
  in.upper = -in.lower;
  in.prior_stddev = prior;
  in.information = InformationOf(J);
  return in;
}

TEST(Identifiability, ColumnsOfZeroAreThePriorsAlone) {
  MatrixXd J = 100.0 * MatrixXd::Random(50, 4);
  J.col(1).setZero();
  const auto report = Identify(Input(J, VectorXd::Ones(4)));
  EXPECT_EQ(report.parameters[1].verdict, Verdict::kUnseen);
  EXPECT_DOUBLE_EQ(report.parameters[1].stddev, 1.0);
  EXPECT_EQ(report.parameters[0].verdict, Verdict::kDetermined);
  EXPECT_EQ(report.determined, 3);
  EXPECT_EQ(report.unseen, 1);
}

TEST(Identifiability, ASumIsDeterminedThoughItsTermsAreNot) {
  // The data see p0 + p1 only.
  MatrixXd J = MatrixXd::Zero(1, 2);
  J << 1000.0, 1000.0;
  const auto report = Identify(Input(J, VectorXd::Ones(2)));
  EXPECT_EQ(report.determined, 1);
  EXPECT_EQ(report.unseen, 1);
  EXPECT_EQ(report.parameters[0].verdict, Verdict::kWeak);
  ASSERT_EQ(report.correlations.size(), 1u);
  EXPECT_LT(report.correlations[0].value, -0.99);
  EXPECT_NEAR(std::abs(report.directions[0].loadings[0].second), std::sqrt(0.5), 1e-9);
}

TEST(Identifiability, CovarianceIsTheClosedForm) {
  const MatrixXd J = MatrixXd::Random(20, 3);
  const VectorXd prior = Eigen::Vector3d(0.5, 1.0, 10.0);
  auto in = Input(J, prior);
  in.residual_variance = 4.0;
  MatrixXd H = J.transpose() * J / 4.0;
  H.diagonal() += prior.array().square().inverse().matrix();
  EXPECT_LT((Identify(in).covariance - H.inverse()).norm(), 1e-9);
}

TEST(Identifiability, DoesNotDependOnUnits) {
  const MatrixXd J = MatrixXd::Random(20, 3);
  const VectorXd units = Eigen::Vector3d(1.0, 1e6, 1e-6);
  const auto a = Identify(Input(J, VectorXd::Ones(3)));
  const auto b = Identify(Input(J * units.cwiseInverse().asDiagonal(), units));
  for (int i = 0; i < 3; ++i) EXPECT_NEAR(a.parameters[i].shrink, b.parameters[i].shrink, 1e-9);
}

TEST(Identifiability, SaysWhatSitsOnItsBound) {
  auto in = Input(100.0 * MatrixXd::Random(20, 2), VectorXd::Ones(2));
  in.lower[0] = 1.0;
  in.upper[0] = 2.0;
  const auto report = Identify(in);
  EXPECT_EQ(report.parameters[0].verdict, Verdict::kAtBound);
  EXPECT_EQ(report.parameters[1].verdict, Verdict::kDetermined);
}

TEST(ImpossibleInertias, AreNamedAndPossibleOnesAreNot) {
  const Eigen::Matrix3d good = Eigen::Vector3d(1.0, 1.0, 1.5).asDiagonal();
  const Eigen::Matrix3d triangle = Eigen::Vector3d(1.0, 1.0, 2.5).asDiagonal();
  const Eigen::Matrix3d negative = Eigen::Vector3d(1.0, -1.0, 1.5).asDiagonal();
  const auto warnings = ImpossibleInertias({{"good", 1.0, good},
                                            {"empty", 0.0, Eigen::Matrix3d::Zero()},
                                            {"light", -0.1, good},
                                            {"flat", 1.0, triangle},
                                            {"odd", 1.0, negative}});
  ASSERT_EQ(warnings.size(), 3u);
  EXPECT_NE(warnings[0].find("light: negative mass"), std::string::npos);
  EXPECT_NE(warnings[1].find("flat"), std::string::npos);
  EXPECT_NE(warnings[1].find("triangle"), std::string::npos);
  EXPECT_NE(warnings[2].find("odd"), std::string::npos);
}

TEST(Identifiability, TableAndJsonNameEveryParameter) {
  const auto report = Identify(Input(MatrixXd::Random(20, 3), VectorXd::Ones(3)));
  const std::string table = FormatIdentifiability(report);
  const auto j = IdentifiabilityToJson(report);
  for (const char* name : {"p0", "p1", "p2"}) EXPECT_NE(table.find(name), std::string::npos);
  EXPECT_EQ(j["parameters"].size(), 3u);
  EXPECT_EQ(j["determined"].get<int>() + j["weak"].get<int>() + j["prior_only"].get<int>(), 3);
}

}  // namespace
}  // namespace rg::sysid
