// Raw inertial parameters against their log-Cholesky form, on the same recordings.
#include <gtest/gtest.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "common/base/file.h"
#include "services/sysid/sysid_on_set.h"
#include "tests/unit/sysid/simulated_recordings.h"

namespace rg::sysid {
namespace {

using Eigen::VectorXd;

// A Mico² whose links are not what its URDF says: masses, centres of mass, and all six inertias.
recordings::RecordingSet WrongLinks() {
  const sim::Plant plant = testing::LoadPlant("mico2");
  const FitSpace space(InertialFitParameters(plant));
  Rng rng(4);
  VectorXd theta = space.nominal();
  for (int i = 0; i < space.size(); ++i) theta[i] += 0.7 * space.prior_stddev()[i] * rng.Normal();
  VectorXd values = space.Values(theta, plant.parameters().Nominal());
  for (const int i : plant.parameters().OfKind(sim::ParameterKind::kDamping)) values[i] = 0.2;
  VectorXd center(6);
  center << 0.0, 4.4, 2.1, 0.5, 0.5, -1.2;
  recordings::RecordingSet set;
  set.urdf_path = testing::RobotPath("mico2");
  set.urdf_text = *ReadFile(set.urdf_path);
  set.joints = plant.joint_names();
  for (int k = 0; k < 3; ++k) {
    set.recordings.push_back(testing::MakeRecording(plant, values, 30 + k,
                                                    {.duration_s = 5.0,
                                                     .rate_hz = 50.0,
                                                     .position_noise = 6e-4,
                                                     .velocity_noise = 1e-2,
                                                     .step_s = 2e-3,
                                                     .center = center}));
  }
  set.recordings.back().split = recordings::Split::kHoldout;
  return set;
}

bool Impossible(const std::string& warning) {
  return warning.find("negative") != std::string::npos || warning.find("triangle") != std::string::npos;
}

TEST(Parametrisation, RawGoesWhereNoBodyIsAndTheConsistentOnePredictsAsWell) {
  const recordings::RecordingSet set = WrongLinks();
  SysidOptions options;
  options.threads = 1;
  options.consistent_inertias = false;
  const auto raw = SysidOnSet(set, options, RealClock());
  options.consistent_inertias = true;
  const auto consistent = SysidOnSet(set, options, RealClock());
  ASSERT_TRUE(raw.ok() && consistent.ok());
  ASSERT_NE(raw->chosen.find("inertial"), std::string::npos) << raw->chosen;
  ASSERT_NE(consistent->chosen.find("inertial"), std::string::npos) << consistent->chosen;
  const auto warning = std::find_if(raw->warnings.begin(), raw->warnings.end(), Impossible);
  ASSERT_NE(warning, raw->warnings.end()) << "the raw fit stayed physical";
  EXPECT_NE(warning->find("no proof"), std::string::npos) << "said beside the small error: " << *warning;
  EXPECT_EQ(std::count_if(consistent->warnings.begin(), consistent->warnings.end(), Impossible), 0);
  EXPECT_LT(consistent->after_rms, 1.1 * raw->after_rms);
  EXPECT_LT(raw->after_rms, 0.2 * raw->before_rms) << "a small error, yet impossible";
  EXPECT_EQ(SysidToJson(*raw)["parametrisation"], "raw");
  EXPECT_EQ(SysidToJson(*consistent)["parametrisation"], "log-cholesky");
}

TEST(Parametrisation, NamesReadBackAndOthersAreRefused) {
  EXPECT_TRUE(*ParseParametrisation(ParametrisationName(true)));
  EXPECT_FALSE(*ParseParametrisation(ParametrisationName(false)));
  EXPECT_FALSE(ParseParametrisation("cholesky").ok());
}

}  // namespace
}  // namespace rg::sysid
