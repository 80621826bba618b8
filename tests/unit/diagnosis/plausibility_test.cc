// Data that cannot be what they say they are: one clear line, and nothing is diagnosed.
#include "services/diagnosis/data/plausibility.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>

#include "services/diagnosis/reporting/data_notes.h"
#include "services/diagnosis/reporting/holdout.h"
#include "tests/unit/diagnosis/simulated_set.h"

namespace rg::diagnosis {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

std::string ErrorOf(const recordings::RecordingSet& set) {
  const auto result = Diagnose(set, {.threads = 1, .work_limit = 0}, RealClock());
  EXPECT_EQ(result.status().message().find('\n'), std::string::npos);
  return result.ok() ? "accepted" : result.status().message();
}

recordings::RecordingSet Scaled(recordings::RecordingSet set, int joint, double factor) {
  for (auto& rec : set.recordings) rec.effort_command.row(joint) *= factor;
  return set;
}

TEST(Plausibility, EffortWithTheWrongSignIsSuspectedOnTheJointThatHasIt) {
  const auto set = testing::MakeSet("arm2", {}, 21);
  EXPECT_THAT(ErrorOf(Scaled(set, 1, -1.0)),
              AllOf(HasSubstr("effort_command.elbow"), HasSubstr("sign looks turned around")));
  EXPECT_THAT(ErrorOf(Scaled(set, 0, -1.0)), HasSubstr("effort_command.shoulder"));
}

TEST(Plausibility, EffortInAnotherUnitIsSuspected) {
  const auto set = testing::MakeSet("arm2", {}, 22);
  EXPECT_THAT(ErrorOf(Scaled(set, 0, 1000.0)), HasSubstr("looks like mN m"));
  EXPECT_THAT(ErrorOf(Scaled(set, 0, 1e-3)), HasSubstr("looks like kN m"));
  EXPECT_THAT(ErrorOf(Scaled(set, 1, 0.01)), HasSubstr("raw current"));
}

// What an effect can do is no error of the file.
TEST(Plausibility, StrongEffectsAreNotTakenForWrongUnits) {
  using effects::MakeSpec;
  const auto names = sysid::testing::LoadPlant("arm2").joint_names();
  for (const effects::EffectSpec& e :
       {MakeSpec("torque_gain", {names[1]}, {{"gain", 2.5}}),
        MakeSpec("torque_gain", {names[1]}, {{"gain", 0.3}}),
        MakeSpec("coulomb_friction", {names[0]}, {{"coulomb", 6.0}}),
        MakeSpec("rotor_inertia", {names[1]}, {{"armature", 0.5}}),
        MakeSpec("position_spring", {names[0]}, {{"stiffness", 30.0}, {"cubic", 0.0}, {"center", 0.2}}),
        MakeSpec("actuator_delay", {names[0]}, {{"delay", 0.04}})}) {
    EXPECT_EQ(ErrorOf(testing::MakeSet("arm2", {e}, 23)), "accepted") << e.id;
  }
}

TEST(Plausibility, SuspectedEffortsAreDiagnosedAllTheSameOnRequest) {
  const auto set = Scaled(testing::MakeSet("arm2", {}, 24), 1, -1.0);
  const auto r = Diagnose(set, {.threads = 1, .work_limit = 0, .trust_effort = true}, RealClock());
  ASSERT_TRUE(r.ok()) << r.status().ToString();
  EXPECT_THAT(r->notes, ::testing::Contains(HasSubstr("sign looks turned around")));
}

TEST(Plausibility, RefusesRecordingsInWhichNothingMoves) {
  auto set = testing::MakeSet("arm2", {}, 25);
  Rng rng(5);
  for (auto& rec : set.recordings) {
    for (int k = 0; k < rec.rows(); ++k) {
      rec.q.col(k) << 0.3 + 5e-4 * rng.Normal(), -0.2 + 5e-4 * rng.Normal();
      rec.v.col(k) << 8e-3 * rng.Normal(), 8e-3 * rng.Normal();
    }
  }
  EXPECT_THAT(ErrorOf(set), AllOf(HasSubstr("too little motion"), HasSubstr("elbow")));
}

TEST(Plausibility, SaysWhichJointNeverMoved) {
  auto set = testing::MakeSet("arm2", {}, 26);
  for (auto& rec : set.recordings) rec.q.row(0).setConstant(0.3), rec.v.row(0).setZero();
  const auto r = Diagnose(set, {.threads = 1, .work_limit = 0, .trust_effort = true}, RealClock());
  ASSERT_TRUE(r.ok()) << r.status().ToString();
  EXPECT_THAT(r->notes,
              ::testing::Contains(AllOf(HasSubstr("shoulder never moved"), Not(HasSubstr("elbow")))));
}

TEST(Plausibility, RefusesHalfASecond) {
  auto set = testing::MakeSet("pendulum", {}, 27, 1.0);
  for (auto& rec : set.recordings) rec = recordings::Slice(rec, 0, 15);
  EXPECT_THAT(ErrorOf(set), HasSubstr("too little to say anything"));
}

TEST(Plausibility, AnEffortThatIsZeroWhileItsJointIsDrivenIsNotBelieved) {
  const auto set = testing::MakeSet("arm2", {}, 27);
  EXPECT_THAT(ErrorOf(Scaled(set, 1, 0.0)),
              AllOf(HasSubstr("effort_command.elbow is zero"), HasSubstr("does work"),
                    HasSubstr("\"passive\" in the manifest says that nothing did")));
}

TEST(Plausibility, EffortsInEachOthersColumnsAreSuspected) {
  auto set = testing::MakeSet("arm2", {}, 28);
  for (auto& rec : set.recordings) rec.effort_command.row(0).swap(rec.effort_command.row(1));
  EXPECT_THAT(ErrorOf(set), AllOf(HasSubstr("follows the torque"), HasSubstr("exchanged")));
}

std::vector<std::string> NotesOf(recordings::RecordingSet set) {
  const auto r = Diagnose(set, {.threads = 1, .work_limit = 0, .trust_effort = true}, RealClock());
  EXPECT_TRUE(r.ok()) << r.status().ToString();
  return r.ok() ? r->notes : std::vector<std::string>();
}

recordings::RecordingSet EveryNth(recordings::RecordingSet set, int n) {
  for (auto& rec : set.recordings) {
    const Eigen::Index rows = rec.rows() / n;
    for (Eigen::Index k = 0; k < rows; ++k) {
      rec.t[k] = rec.t[k * n];
      for (Eigen::MatrixXd* m : {&rec.q, &rec.v, &rec.effort_command}) m->col(k) = m->col(k * n);
    }
    rec.t.conservativeResize(rows);
    for (Eigen::MatrixXd* m : {&rec.q, &rec.v, &rec.effort_command})
      m->conservativeResize(Eigen::NoChange, rows);
  }
  return set;
}

TEST(DataNotes, SayWhyAFreeSwingIsNotPredicted) {
  HoldoutFit fit;
  fit.before_rms = 0.3, fit.calibrated_rms = 0.1, fit.after_rms = 0.2;
  EXPECT_THAT(NoteOnFreeSwing(fit), HasSubstr("swings on from each window"));
  fit.after_rms = 0.05;
  EXPECT_EQ(NoteOnFreeSwing(fit), "");
  fit.before_rms = std::numeric_limits<double>::quiet_NaN();  // a given model that cannot be simulated
  EXPECT_EQ(NoteOnFreeSwing(fit), "");
}

TEST(DataNotes, SayWhichEffectsARateIsTooLowFor) {
  auto set = EveryNth(testing::MakeSet("arm2", {}, 29), 10);
  const double rate = 1.0 / set.recordings[0].SamplePeriod();
  set.control_rate_hz = 10 * rate, set.sample_rate_hz = 10 * rate;
  const auto notes = NotesOf(set);
  for (const char* text :
       {"joint_elasticity", "stribeck_friction", "actuator_delay", "commands change at", "the manifest says"})
    EXPECT_THAT(notes, ::testing::Contains(HasSubstr(text)));
}

TEST(DataNotes, SayThatSomethingElseThanItsEffortHeldAJoint) {
  auto set = testing::MakeSet("arm2", {}, 32);
  for (auto& rec : set.recordings) rec.q.row(1).setConstant(0.3), rec.v.row(1).setZero();
  EXPECT_THAT(NotesOf(set),
              ::testing::Contains(
                  AllOf(HasSubstr("elbow never moved: it holds against at least"), HasSubstr("locked"))));
}

TEST(DataNotes, SayHowManyRowsAreMissing) {
  auto set = testing::MakeSet("arm2", {}, 30);
  // Three rows are lost after every tenth: too few for a gap.
  for (auto& rec : set.recordings) {
    const double period = rec.SamplePeriod();
    for (int k = 10; k < rec.rows(); k += 10) rec.t.tail(rec.rows() - k).array() += 3 * period;
  }
  EXPECT_THAT(NotesOf(set),
              ::testing::Contains(AllOf(HasSubstr("of the rows are missing"), HasSubstr("commands"))));
  EXPECT_THAT(NotesOf(testing::MakeSet("arm2", {}, 30)), Not(::testing::Contains(HasSubstr("missing"))));
}

TEST(DataNotes, SayThatAJointWasOutsideTheLimitsOfTheUrdf) {
  auto set = testing::MakeSet("arm2", {}, 31);
  for (auto& rec : set.recordings) rec.q.row(0).array() += 4.0;
  EXPECT_THAT(NotesOf(set),
              ::testing::Contains(AllOf(HasSubstr("shoulder was recorded"), HasSubstr("limits"))));
}

}  // namespace
}  // namespace rg::diagnosis
