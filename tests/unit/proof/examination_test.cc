#include "services/proof/examination.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "services/proof/proof_text.h"

namespace rg::proof {
namespace {

using nlohmann::json;

json Effect(const std::string& id, const std::vector<std::string>& joints, json equivalents = json::array()) {
  json parameters = json::object();
  for (const std::string& j : joints) parameters[j] = {{"coulomb", {{"value", 0.5}, {"unit", "N*m"}}}};
  return {{"id", id},
          {"joints", joints},
          {"localisation", joints.empty() ? "robot" : "joints"},
          {"equivalents", equivalents},
          {"also_acceptable", json::array()},
          {"parameters", parameters}};
}

json Label(std::vector<json> effects, std::vector<std::string> verdicts = {"unmodelled_physics"}) {
  return {{"name", "case"}, {"robot", "arm2"},     {"rate_hz", 100},
          {"weak", false},  {"verdict", verdicts}, {"effects", effects}};
}

json Finding(const std::string& id, const std::vector<std::string>& joints, double confidence = 0.9) {
  json f = {{"effect", id}, {"joints", joints}, {"confidence", confidence}, {"parameters", json::object()}};
  for (const std::string& j : joints) f["parameters"][j] = {{"coulomb", {{"value", 0.55}}}};
  return f;
}

json Diagnosis(const std::string& verdict, std::vector<json> findings) {
  return {{"verdict", verdict}, {"findings", findings}, {"elapsed_s", 2.0}};
}

CaseMarks Marked(const json& label, const json& diagnosis, PredictionMarks prediction = {1.0, 0.1, 0.1}) {
  auto marks = Mark(label, diagnosis, prediction);
  EXPECT_TRUE(marks.ok()) << marks.status().ToString();
  return *marks;
}

TEST(Examination, ARightNameOnTheRightJointsIsWhole) {
  const CaseMarks m = Marked(Label({Effect("coulomb_friction", {"elbow"})}),
                             Diagnosis("unmodelled_physics", {Finding("coulomb_friction", {"elbow"})}));
  EXPECT_EQ(m.first, 1.0);
  EXPECT_EQ(m.f1, 1.0);
  EXPECT_TRUE(*m.joints_exact);
  ASSERT_EQ(m.parameter_errors.size(), 1u);
  EXPECT_NEAR(m.parameter_errors[0], 0.1, 1e-12);
}

TEST(Examination, UnexplainedCountsInARowOfItsOwnWhereTheLabelAllowsIt) {
  const json swinging = Label({Effect("sloshing_payload", {})}, {"unmodelled_physics", "unexplained"}),
             spring = Label({Effect("position_spring", {"elbow"})}),
             said = Diagnosis("unexplained", {Finding("unknown_field", {"elbow"})});
  const CaseMarks allowed = Marked(swinging, said), not_allowed = Marked(spring, said);
  EXPECT_EQ(allowed.first, 0.0);
  EXPECT_EQ(allowed.first_or_unexplained, 1.0);
  EXPECT_LT(not_allowed.first_or_unexplained, 1.0);
  const Summary summary = Summarise({allowed, not_allowed});
  EXPECT_EQ(summary.right_first_or_unexplained.n, 2);
  EXPECT_NEAR(summary.right_first_or_unexplained.value - summary.right_first.value, 0.5, 1e-12);
}

TEST(Examination, UnexplainedStandsForWhatMayBeUnnamedInThePairsOwnRow) {
  const json pair = Label({Effect("sloshing_payload", {}), Effect("torque_gain", {"elbow"})},
                          {"unmodelled_physics", "unexplained"}),
             said = Diagnosis("unexplained", {Finding("unknown_field", {"elbow"})}),
             named = Diagnosis("unmodelled_physics", {Finding("unknown_field", {"elbow"})});
  const CaseMarks stands = Marked(pair, said), does_not = Marked(pair, named);
  EXPECT_NEAR(stands.f1_or_unexplained, 2.0 / 3, 1e-12);  // one of two, nothing that is wrong
  EXPECT_LT(stands.f1, 0.5);
  EXPECT_EQ(does_not.f1_or_unexplained, does_not.f1);
  EXPECT_NEAR(Summarise({stands, does_not}).pair_f1_or_unexplained, (2.0 / 3 + does_not.f1) / 2, 1e-12);
}

TEST(Examination, ARefusedSetIsToldWithItsReason) {
  CaseMarks refused = Marked(Label({Effect("coulomb_friction", {"elbow"})}), json(nullptr),
                             {1.0, 0.1, std::numeric_limits<double>::quiet_NaN()});
  refused.reason = "rec_000.csv: row 3";
  EXPECT_EQ(refused.first, 0.0);
  EXPECT_EQ(Summarise({refused}).undiagnosed, 1);
  EXPECT_EQ(Summarise({refused}).recovered, 0.0);
  EXPECT_NE(Markdown({"prove", "00", {refused}}).find("no diagnosis: rec_000.csv: row 3"), std::string::npos);
}

TEST(Examination, ASiblingIsHalfRightAndAStrangerIsWrong) {
  const json label = Label({Effect("coulomb_friction", {"elbow"})});
  EXPECT_EQ(Marked(label, Diagnosis("unmodelled_physics", {Finding("stribeck_friction", {"elbow"})})).first,
            0.5);
  EXPECT_EQ(Marked(label, Diagnosis("unmodelled_physics", {Finding("payload", {})})).first, 0.0);
  EXPECT_EQ(Marked(label, json(nullptr)).first, 0.0);
}

TEST(Examination, WhatTheDataCannotTellApartCountsAsRight) {
  const json label = Label({Effect("payload", {}, {"parameters_only"})}, {"parameters_only"});
  const CaseMarks m = Marked(label, Diagnosis("parameters_only", {Finding("parameters_only", {})}));
  EXPECT_EQ(m.first, 1.0);
  EXPECT_EQ(m.kind, CaseKind::kSingle);
}

TEST(Examination, AnEquivalentNameOfTheBodyIsNotAskedForJoints) {
  const json label = Label({Effect("rotor_inertia", {"hinge"}, {"parameters_only"})}, {"parameters_only"});
  EXPECT_FALSE(Marked(label, Diagnosis("parameters_only", {Finding("parameters_only", {})})).joints_exact);
  EXPECT_FALSE(*Marked(label, Diagnosis("unmodelled_physics", {Finding("rotor_inertia", {})})).joints_exact);
  EXPECT_FALSE(*Marked(label, Diagnosis("no_mismatch", {})).joints_exact) << "silence names no joint";
}

TEST(Examination, AForceWithoutANameNeedsTheJointItActsOnAndNoStranger) {
  const json label = Label({Effect("unknown_field", {"elbow", "shoulder"})}, {"unexplained"});
  const auto right = [&](const std::vector<std::string>& joints) {
    return *Marked(label, Diagnosis("unexplained", {Finding("unknown_field", joints)})).joints_exact;
  };
  EXPECT_TRUE(right({"elbow", "shoulder"}));
  EXPECT_TRUE(right({"elbow"})) << "it acts there";
  EXPECT_FALSE(right({"shoulder"})) << "it only depends on that one";
  EXPECT_FALSE(right({"elbow", "wrist"}));
}

TEST(Examination, TunedCasesHaveAShareOfTheirOwn) {
  json label = Label({Effect("coulomb_friction", {"elbow"})});
  const json right = Diagnosis("unmodelled_physics", {Finding("coulomb_friction", {"elbow"})});
  std::vector<CaseMarks> cases = {Marked(label, right)};
  label["tuned"] = true;
  cases.push_back(Marked(label, Diagnosis("no_mismatch", {})));
  const Summary s = Summarise(cases);
  EXPECT_EQ(s.right_first.n, 2);
  EXPECT_EQ(s.right_first_tuned.n, 1);
  EXPECT_EQ(s.right_first_tuned.value, 0.0);
}

TEST(Examination, APairNeedsBothNamesAndAWrongOneCosts) {
  const json label = Label({Effect("coulomb_friction", {"elbow"}), Effect("payload", {})});
  const auto f1 = [&](std::vector<json> findings) {
    return Marked(label, Diagnosis("unmodelled_physics", findings)).f1;
  };
  const json coulomb = Finding("coulomb_friction", {"elbow"}), payload = Finding("payload", {});
  EXPECT_EQ(f1({coulomb, payload}), 1.0);
  EXPECT_NEAR(f1({coulomb}), 2.0 / 3, 1e-12);
  EXPECT_NEAR(f1({coulomb, payload, Finding("torque_ripple", {"elbow"})}), 0.8, 1e-12);
  EXPECT_EQ(f1({coulomb, payload, Finding("torque_ripple", {"elbow"}, 0.2)}), 1.0) << "it is not claimed";
}

TEST(Examination, AControlWithANameIsAFalseAlarm) {
  const json label = Label({}, {"no_mismatch"});
  EXPECT_FALSE(Marked(label, Diagnosis("no_mismatch", {})).false_alarm);
  EXPECT_TRUE(Marked(label, Diagnosis("unmodelled_physics", {Finding("payload", {})})).false_alarm);
  EXPECT_TRUE(Marked(label, Diagnosis("unexplained", {Finding("unknown_field", {"elbow"})})).false_alarm);
  EXPECT_TRUE(Marked(label, json(nullptr)).false_alarm);
  const CaseMarks half = Marked(label, Diagnosis("parameters_only", {Finding("parameters_only", {})}));
  EXPECT_FALSE(half.false_alarm);
  EXPECT_EQ(half.first, 0.5);
}

json Ordinary(std::vector<json> effects) {
  json label = Label(std::move(effects));
  label["stratum"] = "ordinary";
  return label;
}

TEST(Examination, AnOrdinaryRobotIsMarkedByEffectsAndByTheirJoints) {
  json rotor = Effect("rotor_inertia", {"shoulder", "elbow"});
  rotor["optional_joints"] = {"shoulder"}, rotor["also_acceptable"] = {"parameters_only"};
  const json label = Ordinary({Effect("coulomb_friction", {"shoulder", "elbow"}), rotor});
  const auto marked = [&](const std::vector<json>& findings) {
    return Marked(label, Diagnosis("unmodelled_physics", findings));
  };
  const json friction = Finding("coulomb_friction", {"shoulder", "elbow"});
  for (const std::vector<std::string>& joints : {std::vector<std::string>{"shoulder", "elbow"}, {"elbow"}}) {
    const CaseMarks right = marked({friction, Finding("rotor_inertia", joints)});
    EXPECT_EQ(right.kind, CaseKind::kOrdinary);
    EXPECT_EQ(right.f1, 1.0);
    EXPECT_EQ(right.joints_f1, 1.0) << "the first joint's rotor is also its link's inertia";
    EXPECT_TRUE(*right.joints_exact);
  }
  EXPECT_EQ(
      marked({friction, Finding("rotor_inertia", {"elbow"}), Finding("parameters_only", {"l1"})}).joints_f1,
      1.0);
  EXPECT_NEAR(marked({friction}).joints_f1.value(), 2 * 2.0 / (2 + 3), 1e-12);
  EXPECT_NEAR(marked({friction, Finding("rotor_inertia", {"elbow"}), Finding("torque_gain", {"elbow"})})
                  .joints_f1.value(),
              2 * 3.0 / (4 + 3), 1e-12);
  EXPECT_NEAR(
      marked({Finding("coulomb_friction", {"elbow"}), Finding("rotor_inertia", {"elbow"})}).joints_f1.value(),
      2 * 2.0 / (2 + 3), 1e-12);
}

TEST(Examination, OrdinaryRobotsHaveRowsOfTheirOwn) {
  const json label = Ordinary({Effect("coulomb_friction", {"elbow"}), Effect("viscous_friction", {"elbow"})});
  const json right = Diagnosis("unmodelled_physics", {Finding("coulomb_friction", {"elbow"}),
                                                      Finding("viscous_friction", {"elbow"})}),
             wrong =
                 Diagnosis("unmodelled_physics", {Finding("payload", {}, 0.9), Finding("backlash", {}, 0.5)});
  const Summary s = Summarise({Marked(label, right, {1.0, 0.1, 0.12}), Marked(label, right, {1.0, 0.1, 0.1}),
                               Marked(label, wrong, {1.0, 0.1, 0.7}),
                               Marked(label, json(nullptr), {1.0, 0.1, std::nan("")})});
  EXPECT_EQ(s.ordinary.cases, 4);
  EXPECT_NEAR(s.ordinary.f1, 0.5, 1e-12);
  EXPECT_NEAR(s.ordinary.joints_f1, 0.5, 1e-12);
  EXPECT_NEAR(s.ordinary.against_oracle, (1.2 + 7) / 2, 1e-9);
  EXPECT_NEAR(s.ordinary.against_oracle_worst, 10, 1e-9) << "without a diagnosis the model is the one given";
  EXPECT_EQ(s.pairs, 0);
  EXPECT_EQ(s.joints.n, 0);
  const SureFindings& sure = s.sure[static_cast<size_t>(CaseKind::kOrdinary)];
  EXPECT_EQ(sure.n, 5);
  EXPECT_EQ(sure.wrong, 1);
  EXPECT_NE(Markdown({"prove", "00", {Marked(label, wrong)}}).find("0 of 0 / 1 of 1 / 0 of 0 |"),
            std::string::npos);
}

TEST(Examination, AnyFindingOnADeclaredControlIsAFalseAlarm) {
  json label = Label({}, {"no_mismatch"});
  label["stratum"] = "declared";
  const CaseMarks silent = Marked(label, Diagnosis("no_mismatch", {})),
                  remark = Marked(label, Diagnosis("parameters_only", {Finding("parameters_only", {})})),
                  named = Marked(
                      label, Diagnosis("unmodelled_physics", {Finding("joint_coupling", {"elbow"}, 0.8)})),
                  none = Marked(label, json(nullptr));
  EXPECT_FALSE(silent.false_alarm);
  EXPECT_TRUE(remark.false_alarm && named.false_alarm && none.false_alarm);
  const Summary s = Summarise({silent, remark, named, none});
  EXPECT_EQ(s.false_alarms.n, 0) << "the other controls have their own row";
  EXPECT_EQ(s.ordinary.false_alarms.n, 4);
  EXPECT_NEAR(s.ordinary.false_alarms.value, 0.75, 1e-12);
  EXPECT_EQ(s.sure[static_cast<size_t>(CaseKind::kDeclared)].wrong, 2);
}

TEST(Examination, OutsideTheCatalogueANameIsWrongAndSilenceRight) {
  const json label = Label({Effect("unknown_field", {"elbow"})}, {"unexplained"});
  const CaseMarks open = Marked(label, Diagnosis("unexplained", {Finding("unknown_field", {"elbow"})}));
  EXPECT_EQ(open.kind, CaseKind::kOpen);
  EXPECT_EQ(open.first, 1.0);
  const CaseMarks wrong =
      Marked(label, Diagnosis("unmodelled_physics", {Finding("torque_ripple", {"elbow"})}));
  EXPECT_EQ(wrong.first, 0.0);
  const Summary s = Summarise({open, wrong});
  EXPECT_EQ(s.open.n, 2);
  EXPECT_EQ(s.open.value, 0.5);
}

TEST(Examination, WilsonsIntervalIsTheTabulatedOne) {
  const Share s = ShareOf(0, 60);
  EXPECT_EQ(s.low, 0.0);
  EXPECT_NEAR(s.high, 0.0602, 5e-4);
  EXPECT_NEAR(ShareOf(9, 10).low, 0.596, 1e-3);
  EXPECT_TRUE(std::isnan(ShareOf(0, 0).value));
}

TEST(Examination, CalibrationComparesStatedWithHeld) {
  CaseMarks m;
  m.calls = {{0.9, true}, {0.9, true}, {0.9, false}, {0.9, true}, {0.3, false}};
  const Summary s = Summarise({m});
  EXPECT_NEAR(s.calibration_error, (4 * std::abs(0.9 - 0.75) + 0.3) / 5, 1e-12);
  EXPECT_EQ(s.bins[4].n, 4);
}

TEST(Examination, RecoveredIsOneAtTheTruthAndZeroAtTheNominal) {
  EXPECT_EQ(*(PredictionMarks{1.0, 0.2, 0.2}.recovered()), 1.0);
  EXPECT_EQ(*(PredictionMarks{1.0, 0.2, 1.0}.recovered()), 0.0);
  EXPECT_FALSE((PredictionMarks{1.0, 0.9, 0.9}.recovered().has_value()));
  EXPECT_EQ(*(PredictionMarks{1.0, 0.2, std::nan("")}.recovered()), 0.0) << "no prediction recovers nothing";
}

TEST(Examination, TheBaselineIsWhatParametersAloneRecover) {
  json diagnosis = Diagnosis("unmodelled_physics", {Finding("coulomb_friction", {"elbow"})});
  diagnosis["fit"]["holdout"] = {
      {"before_rms", 1.1}, {"calibrated_rms", 0.6}, {"after_rms", 0.1}, {"noise_floor_rms", 0.1}};
  const CaseMarks m = Marked(Label({Effect("coulomb_friction", {"elbow"})}), diagnosis);
  EXPECT_NEAR(*m.calibrated_alone, 0.5, 1e-12);
  EXPECT_NEAR(*m.with_findings, 1.0, 1e-12);
  EXPECT_NEAR(Summarise({m}).calibrated_alone, 0.5, 1e-12);
}

TEST(Examination, AModelThatCannotBeSimulatedHasNoBaseline) {
  json diagnosis = Diagnosis("unmodelled_physics", {Finding("coulomb_friction", {"elbow"})});
  diagnosis["fit"]["holdout"] = {{"before_rms", nullptr},
                                 {"calibrated_rms", 0.6},
                                 {"after_rms", 0.1},
                                 {"noise_floor_rms", 0.1},
                                 {"improvement_ci95", {nullptr, nullptr}}};
  const CaseMarks m = Marked(Label({Effect("coulomb_friction", {"elbow"})}), diagnosis);
  EXPECT_EQ(m.first, 1.0);
  EXPECT_FALSE(m.calibrated_alone.has_value());
  EXPECT_FALSE(m.with_findings.has_value());
}

TEST(ProofText, PrintsEveryMissAndTheSeal) {
  ProofRecord record{"realitygrad prove --seed 1", "abc123", {}};
  record.cases.push_back(Marked(Label({Effect("coulomb_friction", {"elbow"})}),
                                Diagnosis("unmodelled_physics", {Finding("payload", {})})));
  const std::string text = Markdown(record);
  EXPECT_NE(text.find("abc123"), std::string::npos);
  EXPECT_NE(text.find("| coulomb_friction [elbow] | unmodelled_physics | payload 0.90 |"), std::string::npos)
      << text;
  EXPECT_NE(ProofPage(record).find("Every case"), std::string::npos);
}

TEST(Examination, ALabelThatIsNoneIsNamed) { EXPECT_FALSE(Mark(json{{"name", "x"}}, nullptr, {}).ok()); }

}  // namespace
}  // namespace rg::proof
