#include "services/diagnosis/diagnosis.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <set>

#include "common/base/file.h"
#include "common/effects/effect_catalog.h"
#include "common/sim/model_file.h"
#include "tests/unit/diagnosis/simulated_set.h"

namespace rg::diagnosis {
namespace {

using effects::EffectSpec;
using effects::MakeSpec;
using nlohmann::json;

DiagnosisResult Diagnosed(const recordings::RecordingSet& set,
                          double work_limit = DiagnosisOptions{}.work_limit) {
  DiagnosisOptions options;
  options.threads = 2, options.work_limit = work_limit;
  auto result = Diagnose(set, options, RealClock());
  RG_CHECK(result.ok()) << result.status().ToString();
  return *result;
}

std::string Pivot() { return sysid::testing::LoadPlant("pendulum").joint_names()[0]; }

// Every field of RECORDINGS.md, with its type.
void ExpectContract(const json& d) {
  EXPECT_EQ(d.at("format"), "realitygrad.diagnosis/1");
  const std::set<std::string> verdicts = {"no_mismatch", "parameters_only", "unmodelled_physics",
                                          "unexplained"};
  EXPECT_TRUE(verdicts.count(d.at("verdict").get<std::string>()));
  EXPECT_TRUE(d.at("elapsed_s").is_number());
  EXPECT_TRUE(d.at("fit").at("window_s").is_number());
  const json& h = d.at("fit").at("holdout");
  for (const char* name : {"before_rms", "calibrated_rms", "after_rms", "noise_floor_rms"}) {
    EXPECT_TRUE(h.at(name).is_number()) << name;
    EXPECT_GT(h.at(name).get<double>(), 0) << name;
  }
  ASSERT_EQ(h.at("improvement_ci95").size(), 2u);
  EXPECT_LE(h["improvement_ci95"][0].get<double>(), h["improvement_ci95"][1].get<double>());
  double last = 1.0;
  for (const json& f : d.at("findings")) {
    const std::string id = f.at("effect");
    EXPECT_TRUE(id == "parameters_only" || effects::FindEffect(id) != nullptr) << id;
    EXPECT_TRUE(f.at("joints").is_array());
    const double confidence = f.at("confidence");
    EXPECT_GE(confidence, 0.0);
    EXPECT_LE(confidence, last);
    last = confidence;
    EXPECT_TRUE(f.at("where").at("summary").is_string());
    EXPECT_GE(f["where"].at("share_of_mismatch").get<double>(), 0.0);
    EXPECT_LE(f["where"]["share_of_mismatch"].get<double>(), 1.0);
    for (const json& r : f["where"].at("regions"))
      EXPECT_LE(r.at("low").get<double>(), r.at("high").get<double>());
    for (const json& w : f["where"].at("windows")) {
      EXPECT_TRUE(w.at("recording").is_string());
      EXPECT_LT(w.at("start").get<double>(), w.at("end").get<double>());
    }
    EXPECT_FALSE(f.at("statement").get<std::string>().empty());
    EXPECT_FALSE(f.at("equation").get<std::string>().empty());
    const auto effect_class = f.at("class").get<std::vector<std::string>>();
    EXPECT_EQ(effect_class.front(), id);
    for (const auto& [owner, values] : f.at("parameters").items()) {
      for (const auto& [name, value] : values.items()) {
        EXPECT_TRUE(value.at("value").is_number()) << owner << " " << name;
        EXPECT_TRUE(value.at("stddev").is_number());
        EXPECT_TRUE(value.at("unit").is_string());
      }
    }
    for (const json& a : f.at("alternatives")) {
      EXPECT_TRUE(a.at("effect").is_string());
      EXPECT_TRUE(a.at("evidence").is_number());
      EXPECT_TRUE(a.at("separable").is_boolean());
      EXPECT_TRUE(a.at("experiment").is_string());
    }
  }
}

TEST(Diagnose, SaysNothingOfAPendulumThatLacksNothing) {
  const DiagnosisResult r = Diagnosed(testing::MakeSet("pendulum", {}, 11));
  EXPECT_EQ(r.verdict, "no_mismatch");
  EXPECT_TRUE(r.findings.empty());
  ExpectContract(json::parse(DiagnosisJson(r)));
}

TEST(Diagnose, NamesCoulombFrictionAndItsLevel) {
  const DiagnosisResult r = Diagnosed(
      testing::MakeSet("pendulum", {MakeSpec("coulomb_friction", {Pivot()}, {{"coulomb", 0.15}})}, 12));
  EXPECT_EQ(r.verdict, "unmodelled_physics");
  ASSERT_FALSE(r.findings.empty());
  EXPECT_EQ(r.findings[0].effect, "coulomb_friction");
  EXPECT_EQ(r.findings[0].joints, std::vector<std::string>{Pivot()});
  EXPECT_GT(r.findings[0].confidence, 0.5);
  ASSERT_FALSE(r.findings[0].parameters.empty());
  EXPECT_NEAR(r.findings[0].parameters[0].value, 0.15, 0.008);
  EXPECT_LT(r.holdout.after_rms, 0.5 * r.holdout.before_rms);
  ExpectContract(json::parse(DiagnosisJson(r)));
}

TEST(Diagnose, SaysWhenItsTimeLimitEndedIt) {
  const auto set =
      testing::MakeSet("pendulum", {MakeSpec("coulomb_friction", {Pivot()}, {{"coulomb", 0.15}})}, 12);
  for (const double limit : {0.0, 1e-6}) {
    DiagnosisOptions options;
    options.time_limit_s = limit;
    const auto r = Diagnose(set, options, RealClock());
    ASSERT_TRUE(r.ok()) << r.status().ToString();
    const bool says = std::ranges::any_of(
        r->notes, [](const std::string& note) { return note.find("time limit") != std::string::npos; });
    EXPECT_EQ(says, limit > 0);
    EXPECT_EQ(std::ranges::any_of(r->findings, [](const Finding& f) { return f.confidence > 0.5; }),
              limit == 0);
  }
}

TEST(Diagnose, NamesADelayAndWhatNoMotionTellsItFrom) {
  const DiagnosisResult r =
      Diagnosed(testing::MakeSet("pendulum", {MakeSpec("actuator_delay", {Pivot()}, {{"delay", 0.03}})}, 13));
  ASSERT_FALSE(r.findings.empty());
  const Finding& f = r.findings[0];
  EXPECT_EQ(f.effect, "actuator_delay");
  EXPECT_NEAR(f.parameters[0].value, 0.03, 0.003);
  // Readings that are old are the same motion under another clock.
  EXPECT_EQ(f.effect_class, (std::vector<std::string>{"actuator_delay", "sensor_delay"}));
  EXPECT_LE(f.confidence, 0.5);
  EXPECT_FALSE(r.motion.has_value());
}

TEST(Diagnose, SaysOfAForceThatNoEffectHasThatItHasNoName) {
  // A bump of two joints' positions is none of the catalogue's, nor is this of one joint's.
  EffectSpec bump =
      MakeSpec("unknown_field", {Pivot()}, {{"low", -1.2}, {"high", 1.2}, {"w3", 0.4}, {"w4", 0.5}});
  bump.options["variable"] = "position";
  const DiagnosisResult r = Diagnosed(testing::MakeSet("pendulum", {bump}, 20));
  EXPECT_EQ(r.verdict, "unexplained");
  ASSERT_EQ(r.findings.size(), 1u);
  EXPECT_EQ(r.findings[0].effect, "unknown_field");
  EXPECT_EQ(r.findings[0].joints, std::vector<std::string>{Pivot()});
  for (const Alternative& a : r.findings[0].alternatives) EXPECT_LT(a.evidence, 0) << a.effect;
}

TEST(Diagnose, OfWhatRubsInOnePlaceItSaysThatItIsADragWithoutAName) {
  EffectSpec rub =
      MakeSpec("unknown_field", {"shoulder"}, {{"low", -2.0}, {"high", 2.0}, {"w3", 0.8}, {"w4", 0.5}});
  rub.options["variable"] = "drag";
  // A longer search for names finds none either.
  const DiagnosisResult r = Diagnosed(testing::MakeSet("arm2", {rub}, 24), 50);
  EXPECT_EQ(r.verdict, "unexplained");
  ASSERT_EQ(r.findings.size(), 1u);
  EXPECT_EQ(r.findings[0].joints, std::vector<std::string>{"shoulder"});
  EXPECT_NE(r.findings[0].statement.find("a drag that depends on where it is"), std::string::npos);
  EXPECT_NE(r.findings[0].equation.find("-dq"), std::string::npos);
  EXPECT_EQ(r.findings[0].regions.at(0).variable, "position.shoulder");
  EXPECT_LT(r.remaining, 1.1);
}

TEST(Diagnose, OfAMassThatSwingsOnARodItSaysHowLongTheRodIs) {
  EffectSpec rod = MakeSpec("sloshing_payload", {},
                            {{"mass", 0.01}, {"length", 0.12}, {"radius", 0.01}, {"damping", 1e-3}});
  rod.options = {{"form", "rod"}, {"hinge", "y"}};
  const DiagnosisResult r = Diagnosed(testing::MakeSet("arm2", {rod}, 14), 1e9);
  EXPECT_EQ(r.verdict, "unmodelled_physics");
  ASSERT_FALSE(r.findings.empty());
  const Finding& f = r.findings[0];
  EXPECT_EQ(f.effect, "sloshing_payload");
  EXPECT_NE(f.statement.find("swings on a rod"), std::string::npos) << f.statement;
  EXPECT_NE(f.equation.find("ddphi"), std::string::npos) << f.equation;
  const auto length = std::find_if(f.parameters.begin(), f.parameters.end(),
                                   [](const auto& p) { return p.name == "length"; });
  ASSERT_NE(length, f.parameters.end());
  EXPECT_NEAR(length->value, 0.12, 0.006);
}

TEST(Diagnose, MotionThatNoForceFollowsIsNoNoise) {
  recordings::RecordingSet set = testing::MakeSet("pendulum", {}, 21);
  // A ring near half the sampling rate, thirty times the noise.
  for (recordings::Recording& r : set.recordings) {
    const double omega = 2 * M_PI * 37, size = 30 * testing::kPositionNoise;
    r.q.row(0).array() += size * (omega * r.t.transpose().array()).sin();
    r.v.row(0).array() += size * omega * (omega * r.t.transpose().array()).cos();
  }
  const DiagnosisResult r = Diagnosed(set, 20);
  EXPECT_LE(r.noise_scale, 4.0);
  EXPECT_NE(r.verdict, "no_mismatch");
  EXPECT_NE(r.verdict, "parameters_only");
}

TEST(Diagnose, NamesBothOfTwoEffects) {
  const DiagnosisResult r = Diagnosed(testing::MakeSet(
      "pendulum",
      {MakeSpec("coulomb_friction", {Pivot()}, {{"coulomb", 0.15}}),
       MakeSpec("torque_ripple", {Pivot()}, {{"amplitude", 0.2}, {"cycles_per_rev", 4.0}, {"phase", 0.5}})},
      17));
  EXPECT_EQ(r.verdict, "unmodelled_physics");
  std::set<std::string> names;
  for (const Finding& f : r.findings) names.insert(f.effect);
  EXPECT_EQ(names, (std::set<std::string>{"coulomb_friction", "torque_ripple"}));
}

// With free masses and losses a factor on one of two drives is its inverse on the other.
TEST(Diagnose, OfAGainBesideOtherMassesItSaysThatTheOtherDriveMayHaveIt) {
  recordings::RecordingSet set =
      testing::MakeSet("arm2", {MakeSpec("torque_gain", {"elbow"}, {{"gain", 0.9}})}, 20);
  const std::string mass = "<mass value=\"1.1\"/>";
  const size_t at = set.urdf_text.find(mass);
  ASSERT_NE(at, std::string::npos);
  set.urdf_text.replace(at, mass.size(), "<mass value=\"1.3\"/>");
  const DiagnosisResult r = Diagnosed(set);
  ASSERT_EQ(r.findings.size(), 2u);
  ASSERT_EQ(r.findings[0].effect, "torque_gain");
  EXPECT_LE(r.findings[0].confidence, 0.5);
  const std::string other = r.findings[0].joints[0] == "elbow" ? "shoulder" : "elbow";
  const auto& rivals = r.findings[0].alternatives;
  EXPECT_TRUE(std::any_of(rivals.begin(), rivals.end(), [&](const Alternative& a) {
    return a.effect == "torque_gain" && a.joints == std::vector<std::string>{other} && !a.separable;
  }));
}

TEST(Diagnose, DragBesideDryFrictionIsNoFrictionThatGrowsWithSpeed) {
  const DiagnosisResult r =
      Diagnosed(testing::MakeSet("pendulum",
                                 {MakeSpec("coulomb_friction", {Pivot()}, {{"coulomb", 0.08}}),
                                  MakeSpec("quadratic_drag", {Pivot()}, {{"quadratic", 0.1}})},
                                 19));
  EXPECT_EQ(r.verdict, "unmodelled_physics");
  std::set<std::string> names;
  for (const Finding& f : r.findings) names.insert(f.effect);
  EXPECT_EQ(names, (std::set<std::string>{"coulomb_friction", "quadratic_drag"}));
}

TEST(Diagnose, TellsAStiffSpringFromTheRotorBehindIt) {
  const DiagnosisResult r = Diagnosed(
      testing::MakeSet("pendulum",
                       {MakeSpec("joint_elasticity", {Pivot()},
                                 {{"stiffness", 900.0}, {"damping", 1.0}, {"motor_inertia", 0.07}})},
                       18));
  ASSERT_FALSE(r.findings.empty());
  EXPECT_EQ(r.findings[0].effect, "joint_elasticity");
}

TEST(Diagnose, WritesAModelThatPredictsAsItDoes) {
  const DiagnosisResult r = Diagnosed(
      testing::MakeSet("pendulum", {MakeSpec("viscous_friction", {Pivot()}, {{"viscous", 0.1}})}, 14));
  const std::string folder = (std::filesystem::temp_directory_path() / "rg_diagnosis_test").string();
  ASSERT_TRUE(WriteDiagnosis(folder, r, "<html></html>").ok());
  const auto model = sim::LoadModelFile(folder + "/model.json");
  ASSERT_TRUE(model.ok()) << model.status().ToString();
  EXPECT_EQ(model->plant.effects().size(), r.plant->effects().size());
  EXPECT_LT((model->values - r.values).cwiseAbs().maxCoeff(), 1e-12);
  EXPECT_TRUE(std::filesystem::exists(folder + "/diagnosis.json"));
  EXPECT_TRUE(std::filesystem::exists(folder + "/report.html"));
  std::filesystem::remove_all(folder);
}

TEST(Diagnose, DoesNotDependOnTheTimeOrigin) {
  auto set = testing::MakeSet("pendulum", {MakeSpec("coulomb_friction", {Pivot()}, {{"coulomb", 0.15}})}, 15);
  for (auto& rec : set.recordings) rec.t.array() += 100.0;
  const DiagnosisResult r = Diagnosed(set);
  ASSERT_FALSE(r.findings.empty());
  EXPECT_EQ(r.findings[0].effect, "coulomb_friction");
}

TEST(Diagnose, RefusesTooLittleData) {
  auto set = testing::MakeSet("pendulum", {}, 16, 1.0);
  set.recordings.resize(1);
  set.recordings[0] = recordings::Slice(set.recordings[0], 0, 8);
  EXPECT_FALSE(Diagnose(set, {}, RealClock()).ok());
}

TEST(Diagnosis, WhatOnlyARecordingKeptAsideShowsIsFittedToo) {
  // Three slow recordings stay below the limit, a fast one meets it.
  recordings::RecordingSet set = testing::MakeSet("pendulum", {}, 21);
  const auto record = [&](double limit, double amplitude, uint64_t seed) {
    std::vector<EffectSpec> truth;
    if (limit > 0) truth = {MakeSpec("torque_saturation", {Pivot()}, {{"limit", limit}})};
    const sim::Plant plant = sysid::testing::LoadPlant("pendulum", truth);
    sysid::testing::MakeOptions options;
    options.position_noise = testing::kPositionNoise, options.velocity_noise = testing::kVelocityNoise;
    options.amplitude = amplitude;
    return sysid::testing::MakeRecording(plant, plant.parameters().Nominal(), seed, options);
  };
  double most = 0;
  for (uint64_t k = 0; k < 3; ++k)
    most = std::max(most, record(0, 0.4, k).effort_command.cwiseAbs().maxCoeff());
  for (size_t k = 0; k < 4; ++k) {
    recordings::Recording made = record(1.2 * most, k < 3 ? 0.4 : 2.0, k);
    made.name = set.recordings[k].name, made.split = set.recordings[k].split, made.joints = set.joints;
    set.recordings[k] = std::move(made);
  }
  ASSERT_GT(set.recordings[3].effort_command.cwiseAbs().maxCoeff(), 1.5 * most);
  const DiagnosisResult result = Diagnosed(set);
  EXPECT_EQ(result.verdict, "unmodelled_physics");
  ASSERT_FALSE(result.findings.empty());
  EXPECT_EQ(result.findings[0].effect, "torque_saturation");
  EXPECT_TRUE(std::any_of(result.notes.begin(), result.notes.end(), [](const std::string& note) {
    return note.find("rec_003.csv shows what the recordings to fit do not") != std::string::npos;
  }));
}

}  // namespace
}  // namespace rg::diagnosis
