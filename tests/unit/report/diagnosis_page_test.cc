#include "services/report/diagnosis_page.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "services/diagnosis/reporting/told_in_tables.h"

namespace rg::report {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

diagnosis::DiagnosisResult OneFinding() {
  diagnosis::DiagnosisResult r;
  r.verdict = "unmodelled_physics", r.robot = "arm2";
  r.joints = {"shoulder", "elbow"}, r.units = {"rad", "rad"};
  r.joint_share = Eigen::Vector2d(0.1, 0.9);
  diagnosis::Finding f;
  f.effect = "actuator_delay", f.joints = {"elbow"}, f.confidence = 0.9;
  f.statement = "elbow's torque acts 0.011 s after it is commanded.";
  f.effect_class = {"actuator_delay"};
  f.share_of_mismatch = 0.9;
  r.findings.push_back(f);
  r.holdout.before_rms = 0.08, r.holdout.after_rms = 0.004;
  r.candidates = {{"actuator_delay (elbow) + payload", false, 105.0, 0.99, 2, false},
                  {"actuator_delay (elbow)", false, 103.0, 1.0, 1, true},
                  {"none", false, 0.0, 3.0, 0, false}};
  return r;
}

TEST(DiagnosisPage, BeginsWithTheSentenceAndHowSureItIs) {
  const std::string html = DiagnosisPage(OneFinding());
  EXPECT_THAT(html, HasSubstr("elbow's torque acts 0.011 s after it is commanded. (confidence 0.90)"));
  EXPECT_THAT(html, HasSubstr("the model leaves physics out (unmodelled_physics)"));
  EXPECT_THAT(html, HasSubstr("0.0800 rad"));
  EXPECT_THAT(html, Not(HasSubstr("cannot tell")));
  EXPECT_THAT(html, Not(HasSubstr("Which parameters had absorbed it")));
}

TEST(DiagnosisPage, MeasuresRivalsAgainstTheChosenModelAndSaysWhyABetterOneIsNotTaken) {
  const std::string html = DiagnosisPage(OneFinding());
  EXPECT_THAT(html, HasSubstr("<td>0</td><td>1.000</td><td class=\"text\">chosen</td>"));
  EXPECT_THAT(
      html,
      HasSubstr("<td>2.00</td><td>0.9900</td><td class=\"text\">more, but too little for what it adds</td>"));
  EXPECT_THAT(html, HasSubstr("<td>-103</td>"));
}

TEST(DiagnosisPage, SaysInItsFirstSentenceWhatElseItMayBeAndHowToFindOut) {
  diagnosis::DiagnosisResult r = OneFinding();
  diagnosis::Finding& f = r.findings[0];
  f.effect_class.push_back("actuator_lag");
  f.alternatives.push_back({"actuator_lag", {"elbow"}, -0.1, false, "elbow: a chirp (motion.csv)"});
  EXPECT_THAT(DiagnosisPage(r), HasSubstr("Or it is actuator_lag: these recordings cannot tell."));
  r.motion = diagnosis::ProposedMotion{
      {"actuator_delay", "actuator_lag"}, "elbow: a chirp", 120.0, {0, 1}, Eigen::MatrixXd::Zero(2, 2), {}};
  r.motion->q(1, 1) = 0.3;
  const std::string html = DiagnosisPage(r);
  EXPECT_THAT(html, HasSubstr("cannot tell; motion.csv would"));
  EXPECT_THAT(html, HasSubstr("submit rollout --trajectory motion.csv"));
}

TEST(DiagnosisPage, HasARowPerJointAndAColumnPerParameter) {
  diagnosis::DiagnosisResult r = OneFinding();
  r.findings[0].parameters = {{"elbow", "delay", "s", 0.0112, 0.00021}};
  diagnosis::Finding f;
  f.effect = "coulomb_friction", f.joints = {"shoulder", "elbow"};
  f.parameters = {{"shoulder", "coulomb", "N*m", 1.25, 0.032}, {"elbow", "coulomb", "N*m", 0.4, 0.5}};
  r.findings.push_back(f);
  const diagnosis::JointTable table = diagnosis::ParametersOfJoints(r);
  EXPECT_EQ(table.columns, (std::vector<std::string>{"delay [s]", "coulomb [N·m]"}));
  EXPECT_EQ(table.cells[0], (std::vector<std::string>{"–", "1.250 ± 0.032"}));
  EXPECT_EQ(table.cells[1], (std::vector<std::string>{"0.01120 ± 0.00021", "0.40 ± 0.50"}));
  EXPECT_THAT(DiagnosisPage(r), HasSubstr("1.250 ± 0.032"));
}

TEST(DiagnosisPage, SaysHowMuchOfTheGapIsClosedAndWhatRemains) {
  diagnosis::DiagnosisResult r = OneFinding();
  r.holdout.noise_floor_rms = 0.002;
  EXPECT_EQ(diagnosis::GapInWords(r), "explains 95 % of the error; 2 × the noise floor remains");
  r.holdout.before_rms = std::nan("");
  EXPECT_EQ(diagnosis::GapInWords(r), "the remaining error is 2 × the noise floor");
  r.verdict = "no_mismatch";
  EXPECT_EQ(diagnosis::GapInWords(r), "");
}

TEST(DiagnosisPage, SaysWhenErrorsAreOfTheFittedRecordings) {
  diagnosis::DiagnosisResult r = OneFinding();
  r.holdout.judged_on_fit = true;
  r.units = {"rad", "m"};
  r.joint_share.setZero();
  const std::string html = DiagnosisPage(r);
  EXPECT_THAT(html, HasSubstr("Before and after, on the fitted recordings"));
  EXPECT_THAT(html, Not(HasSubstr("recordings that were not fitted")));
  EXPECT_THAT(html, Not(HasSubstr("0.0800 rad"))) << "an error over rad and m has no unit";
  EXPECT_THAT(html, HasSubstr("does not rise above its noise"));
}

}  // namespace
}  // namespace rg::report
