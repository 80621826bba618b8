// Identification and prediction on whole recording sets, as `realitygrad sysid SET` runs them. The sets lie
// in $RG_RECORDINGS_DIR, or in shared/recordings beside the source tree; without them these tests skip.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>

#include "common/base/file.h"
#include "common/recordings/csv.h"
#include "services/sysid/prediction.h"
#include "services/sysid/sysid_on_set.h"

namespace rg::sysid {
namespace {

std::string RecordingsDir() {
  if (const char* dir = std::getenv("RG_RECORDINGS_DIR")) return dir;
  const char* root = std::getenv("RG_SOURCE_DIR");
  return std::string(root != nullptr ? root : ".") + "/../shared/recordings";
}

#define RG_NEEDS_SET(set)                                                        \
  const std::string folder = RecordingsDir() + "/" set;                          \
  if (!std::filesystem::exists(folder + "/manifest.json")) {                     \
    GTEST_SKIP() << "no recordings in " << folder << " (set RG_RECORDINGS_DIR)"; \
  }                                                                              \
  const auto loaded = recordings::LoadSet(folder);                               \
  ASSERT_TRUE(loaded.ok()) << loaded.status().ToString();                        \
  const recordings::RecordingSet& set_ = *loaded

double ValueOf(const SysidReport& report, const std::string& name) {
  const int i = report.plant->parameters().Find(name);
  RG_CHECK(i >= 0) << name;
  return report.values[i];
}

// The oracle of a practice set restarted its windows from the measured state in another engine.
TEST(PredictionOnRecordings, MeasuredRestartsGiveTheErrorThatAnotherEngineGives) {
  RG_NEEDS_SET("practice/p00_none");
  const auto plant = NominalPlant(set_);
  ASSERT_TRUE(plant.ok()) << plant.status().ToString();
  const auto oracle = nlohmann::json::parse(*ReadFile(folder + "/hidden/oracle.json"));
  double squares[2] = {0.0, 0.0}, count = 0.0;
  for (const char* file : {"hidden_000.csv", "hidden_001.csv"}) {
    const auto rec = recordings::LoadCsv(folder + "/hidden/" + file, {.joints = set_.joints});
    ASSERT_TRUE(rec.ok()) << rec.status().ToString();
    const Eigen::MatrixXd truth = rec->OtherKind("true_position");
    const int rows = (rec->rows() - 1) / 100 * 100;
    PredictionOptions options;
    options.noise = recordings::EstimateSensorNoise(set_);
    for (const RestartState restart : {RestartState::kMeasured, RestartState::kFiltered}) {
      options.restart = restart;
      const Prediction p = PredictRecording(*plant, plant->parameters().Nominal(), *rec, options);
      squares[restart == RestartState::kMeasured ? 0 : 1] += (p.q - truth).middleCols(1, rows).squaredNorm();
    }
    count += static_cast<double>(rows) * rec->n();
  }
  const double nominal = oracle["nominal_rms"].get<double>();
  EXPECT_NEAR(std::sqrt(squares[0] / count), nominal, 0.03 * nominal);
  EXPECT_LT(std::sqrt(squares[1] / count), 0.7 * nominal) << "the filter knows the state better";
}

TEST(SysidOnRecordings, FitsARobotNeverSeenAndPredictsWhatItWasNotFittedTo) {
  RG_NEEDS_SET("real/ur10e");
  const auto report = SysidOnSet(set_, {}, RealClock());
  ASSERT_TRUE(report.ok()) << report.status().ToString();
  EXPECT_EQ(report->holdout.size(), 2u);
  EXPECT_GT(report->before_rms, 0.5) << "a frictionless arm under the torques of a real one";
  EXPECT_LT(report->after_rms, 0.03);
  // The source's own figures, from other methods: within a third.
  EXPECT_NEAR(ValueOf(*report, "viscous_friction.shoulder_pan_joint.viscous"), 21.3, 7.0);
  EXPECT_NEAR(ValueOf(*report, "coulomb_friction.shoulder_pan_joint.coulomb"), 12.5, 4.0);
  EXPECT_GT(ValueOf(*report, "rotor_inertia.wrist_3_joint.armature"), 0.2);
  const auto j = SysidToJson(*report);
  EXPECT_EQ(j["holdout"]["before_rms"].get<double>(), report->before_rms);
  EXPECT_EQ(j["holdout"]["after_rms"].get<double>(), report->after_rms);
  EXPECT_FALSE(j["identifiability"]["parameters"].empty());
  for (const std::string& warning : report->warnings) {
    EXPECT_EQ(warning.find("triangle"), std::string::npos) << "only bodies that can exist: " << warning;
  }
}

TEST(SysidOnRecordings, FindsFrictionAndMassOfASlideFromPositionsAlone) {
  RG_NEEDS_SET("real/emps");
  const auto report = SysidOnSet(set_, {}, RealClock());
  ASSERT_TRUE(report.ok()) << report.status().ToString();
  EXPECT_LT(report->after_rms, 0.1 * report->before_rms);
  ASSERT_GE(report->plant->parameters().Find("asymmetric_friction.slide.coulomb_positive"), 0)
      << report->chosen;
  const double positive = ValueOf(*report, "asymmetric_friction.slide.coulomb_positive");
  const double negative = ValueOf(*report, "asymmetric_friction.slide.coulomb_negative");
  EXPECT_NEAR(0.5 * (positive + negative), 21.5, 3.0);  // N; the literature says 20.4 to 23.5
  EXPECT_NEAR(ValueOf(*report, "viscous_friction.slide.viscous"), 190.0, 40.0);
}

TEST(SysidOnRecordings, LeavesARobotAloneWhoseModelIsRight) {
  RG_NEEDS_SET("practice/p00_none");
  const auto report = SysidOnSet(set_, {}, RealClock());
  ASSERT_TRUE(report.ok()) << report.status().ToString();
  EXPECT_EQ(report->chosen, "nominal");
  EXPECT_EQ(report->values, report->plant->parameters().Nominal());
}

TEST(SysidOnRecordings, FindsWrongMassesAt25Hz) {
  RG_NEEDS_SET("practice/p01_parameters_only");
  const auto report = SysidOnSet(set_, {}, RealClock());
  ASSERT_TRUE(report.ok()) << report.status().ToString();
  EXPECT_LT(report->after_rms, 0.05 * report->before_rms);
}

TEST(SysidOnRecordings, StopsOnCancelWithAReport) {
  RG_NEEDS_SET("practice/p04_stribeck");
  CancelToken cancel;
  cancel.Cancel();
  const auto report = SysidOnSet(set_, {}, RealClock(), {}, &cancel);
  ASSERT_TRUE(report.ok()) << report.status().ToString();
  EXPECT_TRUE(report->stopped_early);
  EXPECT_TRUE(std::isfinite(report->after_rms));
}

}  // namespace
}  // namespace rg::sysid
