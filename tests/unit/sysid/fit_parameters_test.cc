#include "services/sysid/fit_parameters.h"

#include <gtest/gtest.h>

#include "tests/unit/sysid/simulated_recordings.h"

namespace rg::sysid {
namespace {

TEST(FitParameters, InertialOnesAreTenPerMovingBodyAndNeverOfTheBase) {
  const sim::Plant plant = testing::LoadPlant("mico2");
  const auto parameters = InertialFitParameters(plant);
  EXPECT_EQ(parameters.size(), 60u);
  for (const FitParameter& p : parameters) {
    EXPECT_EQ(p.name.find("link_base"), std::string::npos);
    EXPECT_EQ(p.name.find("finger"), std::string::npos) << "the hand is heavier and stands for its body";
    EXPECT_GT(p.prior_stddev, 0.0) << p.name;
    EXPECT_LT(p.lower, p.nominal) << p.name;
    EXPECT_GT(p.upper, p.nominal) << p.name;
  }
}

TEST(FitParameters, ByNameOrWithTheNameThatWasMeant) {
  const sim::Plant plant = testing::LoadPlant("arm2");
  EXPECT_TRUE(NamedFitParameters(plant, {"mass.forearm"}).ok());
  const auto wrong = NamedFitParameters(plant, {"mass.forarm"});
  ASSERT_FALSE(wrong.ok());
  EXPECT_NE(wrong.status().message().find("mass.forearm"), std::string::npos);
}

TEST(FitParameters, FittedValuesGoToTheirPlaces) {
  const sim::Plant plant = testing::LoadPlant("arm2");
  const auto parameters = *NamedFitParameters(plant, {"mass.forearm"});
  const Eigen::VectorXd nominal = plant.parameters().Nominal();
  const Eigen::VectorXd values = WithFitted(parameters, nominal, Eigen::VectorXd::Constant(1, 7.0));
  EXPECT_EQ(values[parameters[0].index], 7.0);
  EXPECT_EQ((values - nominal).cwiseAbs().sum(), std::abs(7.0 - nominal[parameters[0].index]));
}

}  // namespace
}  // namespace rg::sysid
