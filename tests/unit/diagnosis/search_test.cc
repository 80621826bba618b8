// Where a search ends: what holds on recordings kept aside too has no free parameters as its rivals.
#include "services/diagnosis/search/search.h"

#include <gtest/gtest.h>

#include <memory>
#include <set>

#include "services/diagnosis/data/prepare_data.h"
#include "services/diagnosis/hypotheses/group_start.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/diagnosis/screening/screen_columns.h"
#include "services/diagnosis/search/drive_search.h"
#include "services/diagnosis/search/fit_ledger.h"
#include "services/diagnosis/search/forward_step.h"
#include "services/diagnosis/search/refinement.h"
#include "services/diagnosis/search/search_state.h"
#include "services/diagnosis/search/simplifier.h"
#include "services/diagnosis/search/trials.h"
#include "tests/unit/diagnosis/prepared_set.h"

namespace rg::diagnosis {
namespace {

using effects::EffectSpec;
using effects::MakeSpec;

constexpr char kElbow[] = "joint_3";

// Kinds of effects that were fitted beside free base parameters.
std::set<std::string> KindsBesideFreeParameters(const SearchResult& result) {
  std::set<std::string> out;
  for (const Candidate& c : result.tried) {
    for (const EffectSpec& s : c.base ? c.specs : std::vector<EffectSpec>{}) out.insert(s.id);
  }
  return out;
}

SearchResult Searched(std::vector<EffectSpec> truth, uint64_t seed) {
  auto p = testing::Prepare("mico2", std::move(truth), seed);
  p->data.held_out = PrepareHeldOut(p->set, p->data, p->nominal, p->options);
  RG_CHECK(p->data.held_out != nullptr);
  return SearchEffects({p->data, p->nominal, p->scales}, p->options, 2, RealClock(), nullptr, nullptr);
}

TEST(Search, AForceWithoutANameThatHoldsIsNotSoughtAmongFreeParameters) {
  const auto still = testing::Prepare("mico2", {}, 51);
  const EffectSpec saddle = MakeSpec("unknown_field_pair", {"joint_2", kElbow},
                                     {{"low", still->scales.low[1]},
                                      {"high", still->scales.high[1]},
                                      {"other_low", still->scales.low[2]},
                                      {"other_high", still->scales.high[2]},
                                      {"w22", 0.06},
                                      {"w23", -0.04},
                                      {"w32", -0.04},
                                      {"w33", 0.06}});
  const SearchResult r = Searched({saddle}, 51);
  ASSERT_TRUE(HasUnnamed(r.best));
  EXPECT_LT(r.best.fit.chi2 / r.best.fit.rows, kExplained);
  EXPECT_TRUE(KindsBesideFreeParameters(r).empty());
}

TEST(Search, AnAccountWithHiddenStatesThatHoldsIsNotSoughtAmongFreeParameters) {
  const SearchResult r = Searched({MakeSpec("actuator_lag", {kElbow}, {{"time_constant", 0.008}})}, 52);
  ASSERT_EQ(r.best.specs.size(), 1u);
  EXPECT_EQ(r.best.specs[0].id, "actuator_lag");
  EXPECT_LT(r.best.fit.chi2 / r.best.fit.rows, kExplained);
  // Its own twin, and what it is easily taken for.
  const std::set<std::string> timing = {"actuator_lag", "actuator_delay", "sensor_delay"};
  for (const std::string& kind : KindsBesideFreeParameters(r)) EXPECT_TRUE(timing.count(kind)) << kind;
}

// A search begins again with more recordings: it need not find anew what it had come to, nor believe it.
TEST(Search, WhatAnEarlierSearchCameToIsWeighedFirst) {
  auto p = testing::Prepare("arm2", {MakeSpec("coulomb_friction", {"elbow"}, {{"coulomb", 0.2}})}, 53);
  const auto search = [&] {
    return SearchEffects({p->data, p->nominal, p->scales}, p->options, 2, RealClock(), nullptr, nullptr);
  };
  const SearchResult first = search();
  ASSERT_EQ(first.best.specs.size(), 1u);
  ASSERT_EQ(first.best.specs[0].id, "coulomb_friction");

  auto earlier = std::make_shared<Candidate>(first.best);
  earlier->fit.states.clear(), earlier->fit.window_chi2.clear();
  p->options.earlier = earlier;
  const SearchResult again = search();
  ASSERT_EQ(again.best.specs.size(), 1u);
  EXPECT_EQ(again.best.specs[0].id, "coulomb_friction");
  // Screens count too, and are made again: what is saved are fits.
  EXPECT_LT(again.work, 0.7 * first.work);
  EXPECT_LT(again.tried.size(), first.tried.size());

  auto wrong = std::make_shared<Candidate>();
  wrong->specs = {MakeSpec("viscous_friction", {"shoulder"}, {{"viscous", 0.1}})};
  wrong->plant = std::make_shared<const sim::Plant>(
      *sim::Plant::Create(p->nominal.shared_model(), p->nominal.options(), wrong->specs));
  p->options.earlier = wrong;
  const SearchResult still = search();
  ASSERT_EQ(still.best.specs.size(), 1u);
  EXPECT_EQ(still.best.specs[0].id, "coulomb_friction");
}

EffectSpec OnBoth(const char* id, const char* name, double shoulder, double elbow) {
  EffectSpec spec = MakeSpec(id, {"shoulder", "elbow"});
  spec.values = {{"shoulder", {{name, shoulder}}}, {"elbow", {{name, elbow}}}};
  return spec;
}

std::vector<EffectSpec> LossesOfBoth() {
  return {OnBoth("viscous_friction", "viscous", 0.5, 0.25), OnBoth("coulomb_friction", "coulomb", 0.6, 0.3),
          OnBoth("rotor_inertia", "armature", 0.06, 0.03)};
}

std::set<std::string> Found(const SearchResult& r) {
  std::set<std::string> out;
  for (const EffectSpec& s : r.best.specs) {
    for (const std::string& joint : s.joints) out.insert(s.id + " " + joint);
  }
  return out;
}

// At 25 Hz a lag of a period bends all of friction and rotors: they are found with it or not at all.
TEST(Search, DrivesThatAreLateAreFoundWithTheirLosses) {
  std::vector<EffectSpec> truth = LossesOfBoth();
  truth.push_back(OnBoth("actuator_lag", "time_constant", 0.04, 0.03));
  testing::Sampling sampling;
  sampling.rate_hz = 25;
  const auto p = testing::Prepare("arm2", truth, 56, sampling);
  const SearchResult r =
      SearchEffects({p->data, p->nominal, p->scales}, p->options, 2, RealClock(), nullptr, nullptr);
  EXPECT_LT(r.best.fit.chi2 / r.best.fit.rows, kExplained);
  const std::set<std::string> found = Found(r);
  for (const char* name :
       {"viscous_friction shoulder", "viscous_friction elbow", "coulomb_friction shoulder",
        "coulomb_friction elbow", "rotor_inertia elbow", "actuator_lag shoulder", "actuator_lag elbow"})
    EXPECT_TRUE(found.count(name)) << name;
  for (const std::string& name : found) {
    EXPECT_EQ(name.find("delay"), std::string::npos) << name;
    EXPECT_EQ(name.find("gain"), std::string::npos) << name;
  }
}

// A spring that takes more than all losses: without it they do not come near the recordings.
TEST(Search, OneThingMoreIsFoundBesideTheLossesOfAllDrives) {
  std::vector<EffectSpec> truth = LossesOfBoth();
  truth.push_back(
      MakeSpec("position_spring", {"elbow"}, {{"stiffness", 6.0}, {"cubic", 0.0}, {"center", 0.4}}));
  const auto p = testing::Prepare("arm2", truth, 57);
  const SearchResult r =
      SearchEffects({p->data, p->nominal, p->scales}, p->options, 2, RealClock(), nullptr, nullptr);
  EXPECT_LT(r.best.fit.chi2 / r.best.fit.rows, kExplained);
  const std::set<std::string> found = Found(r);
  for (const char* name : {"viscous_friction shoulder", "viscous_friction elbow", "coulomb_friction shoulder",
                           "coulomb_friction elbow", "rotor_inertia elbow", "position_spring elbow"})
    EXPECT_TRUE(found.count(name)) << name;
  EXPECT_LE(found.size(), 7u);
}

// The regression tells whether the losses of drives have to do with what is missing at all.
TEST(Search, LossesTakeOfTheRegressionOnlyWhatIsTheirs) {
  const std::vector<std::string> losses = {"viscous_friction", "coulomb_friction", "rotor_inertia"};
  const auto left = [&](std::vector<EffectSpec> truth) {
    const auto p = testing::Prepare("arm2", std::move(truth), 60);
    return LeftByGroup({p->data, p->nominal, p->scales}, losses);
  };
  const Eigen::VectorXd theirs = left(LossesOfBoth());
  EXPECT_LT(theirs.maxCoeff(), 0.6) << theirs.transpose();
  const Eigen::VectorXd of_others =
      left({MakeSpec("position_spring", {"elbow"}, {{"stiffness", 6.0}, {"cubic", 0.0}, {"center", 0.4}})});
  EXPECT_GT(of_others.minCoeff(), 0.85) << of_others.transpose();
}

// Stiffness and centre follow from two coefficients of one regression, beside those of the losses.
TEST(Drives, ALawOnAllJointsIsRegressedBesideTheirLosses) {
  const std::vector<std::string> losses = {"viscous_friction", "coulomb_friction", "rotor_inertia"};
  std::vector<EffectSpec> truth = LossesOfBoth();
  const auto plain = testing::Prepare("arm2", truth, 60);
  EXPECT_TRUE(LawsOnAll({plain->data, plain->nominal, plain->scales}, losses, false, 0.85).empty());
  // Nor is what a mass does, which free base parameters say.
  std::vector<EffectSpec> loaded = truth;
  loaded.push_back(
      MakeSpec("payload", {}, {{"mass", 1.5}, {"com_x", 0.05}, {"com_y", 0.0}, {"com_z", 0.02}}));
  const auto heavy = testing::Prepare("arm2", loaded, 60);
  EXPECT_TRUE(LawsOnAll({heavy->data, heavy->nominal, heavy->scales}, losses, false, 0.85).empty());
  const std::map<std::string, std::pair<double, double>> springs = {{"shoulder", {4.0, 0.3}},
                                                                    {"elbow", {2.0, -0.4}}};
  for (const auto& [joint, spring] : springs) {
    truth.push_back(MakeSpec("position_spring", {joint},
                             {{"stiffness", spring.first}, {"cubic", 0.0}, {"center", spring.second}}));
  }
  const auto p = testing::Prepare("arm2", truth, 60);
  const std::vector<LawOnAll> laws = LawsOnAll({p->data, p->nominal, p->scales}, losses, false, 0.85);
  ASSERT_FALSE(laws.empty());
  ASSERT_EQ(laws[0].specs.size(), 2u);
  for (const EffectSpec& s : laws[0].specs) {
    EXPECT_EQ(s.id, "position_spring");
    const auto& [stiffness, center] = springs.at(s.joints[0]);
    EXPECT_NEAR(s.values.at(s.joints[0]).at("stiffness"), stiffness, 0.15 * stiffness) << s.joints[0];
    EXPECT_NEAR(s.values.at(s.joints[0]).at("center"), center, 0.1) << s.joints[0];
  }
}

// No single one of six brings a fit near such recordings.
TEST(Search, FrictionAndRotorsOfAllJointsAreFoundTogether) {
  const std::vector<EffectSpec> truth = LossesOfBoth();
  const auto p = testing::Prepare("arm2", truth, 54);
  const Candidate start = RegressedGroup({p->data, p->nominal, p->scales},
                                         {"viscous_friction", "coulomb_friction", "rotor_inertia"}, false);
  ASSERT_TRUE(start.fit.ok);
  EXPECT_EQ(start.specs.size(), 6u);
  const SearchResult r =
      SearchEffects({p->data, p->nominal, p->scales}, p->options, 2, RealClock(), nullptr, nullptr);
  EXPECT_LT(r.best.fit.chi2 / r.best.fit.rows, kExplained);
  const std::set<std::string> found = Found(r);
  for (const EffectSpec& s : r.best.specs) {
    ASSERT_EQ(s.joints.size(), 1u);
    for (const EffectSpec& t : truth) {
      if (t.id != s.id) continue;
      const auto& [name, value] = *t.values.at(s.joints[0]).begin();
      const double is =
          r.best.fit.values[r.best.plant->parameters().Find(s.id + "." + s.joints[0] + "." + name)];
      EXPECT_NEAR(is, value, 0.05 * value) << s.id << " " << s.joints[0];
    }
  }
  // The rotor of the first joint is its link's inertia.
  for (const char* name : {"viscous_friction shoulder", "viscous_friction elbow", "coulomb_friction shoulder",
                           "coulomb_friction elbow", "rotor_inertia elbow"})
    EXPECT_TRUE(found.count(name)) << name;
}

// The same motion of an arm whose URDF states an elbow of 1.3 kg where it has 1.1.
std::unique_ptr<testing::Prepared> PreparedWithAnotherMass(const EffectSpec& truth, uint64_t seed) {
  recordings::RecordingSet set = testing::MakeSet("arm2", {truth}, seed);
  const std::string mass = "<mass value=\"1.1\"/>";
  const size_t at = set.urdf_text.find(mass);
  RG_CHECK(at != std::string::npos);
  set.urdf_text.replace(at, mass.size(), "<mass value=\"1.3\"/>");
  return testing::Prepare(std::move(set));
}

// A law of what is recorded beside other masses is not looked for among hidden states, which would follow
// some of both.
TEST(Search, ALawBesideOtherMassesIsFoundBeforeHiddenStates) {
  const auto p = PreparedWithAnotherMass(MakeSpec("quadratic_drag", {"elbow"}, {{"quadratic", 0.1}}), 58);
  const SearchResult r =
      SearchEffects({p->data, p->nominal, p->scales}, p->options, 2, RealClock(), nullptr, nullptr);
  EXPECT_LT(r.best.fit.chi2 / r.best.fit.rows, kExplained);
  EXPECT_TRUE(r.best.base);
  EXPECT_EQ(Found(r), (std::set<std::string>{"quadratic_drag elbow"}));
  for (const Candidate& c : r.tried) EXPECT_FALSE(HasHiddenStates(c)) << KeyOf(c.specs);
}

// A search before its first forward step.
struct FirstRound {
  explicit FirstRound(const testing::Prepared& p)
      : state({p.data, p.nominal, p.scales}, p.options, 2, clock, progress, nullptr) {
    step.MakeFeatures();
    step.SetRound(1);
  }
  FakeClock clock;
  ProgressFn progress;
  SearchState state;
  ForwardStep step{state};
};

// A stiff spring is a rotor and a little more: that shows around the rotor's fit, and nowhere far from one.
TEST(ForwardStep, SeesASpringAroundAModelThatFits) {
  const double J = 0.05, omega = 2 * M_PI * 10, k = J * omega * omega;
  const auto p =
      testing::Prepare("pendulum",
                       {MakeSpec("joint_elasticity", {"hinge"},
                                 {{"stiffness", k}, {"damping", 0.2 * J * omega}, {"motor_inertia", J}})},
                       63);
  FirstRound round(*p);
  SearchState& state = round.state;
  ForwardStep& step = round.step;
  const Candidate bare = state.fits.Evaluate({}, false);
  const Candidate rotor =
      state.fits.Evaluate({MakeSpec("rotor_inertia", {"hinge"}, {{"armature", 0.8 * J}})}, false);
  ASSERT_GT(state.fits.PerRow(bare), kConsistent);
  ASSERT_LT(state.fits.PerRow(rotor), kConsistent);
  ASSERT_GT(state.fits.PerRow(rotor), kExplained);
  for (const Scored& h : step.Screen(bare).hypotheses) EXPECT_NE(h.effect, "joint_elasticity");
  const ScreenResult screened = step.Screen(rotor);
  ASSERT_EQ(screened.hypotheses.front().effect, "joint_elasticity");
  // What the screen says of it alone is a start.
  const auto no_force = []() -> const MissingForce* { return nullptr; };
  const auto none = [](const std::vector<TrialSpecs>&, size_t) { return std::vector<TrialSpecs>{}; };
  const TrialSpecs first =
      Trials(p->data, p->nominal, p->scales, rotor, screened, 2.0, no_force, none).front();
  ASSERT_EQ(first.front().id, "joint_elasticity");
  EXPECT_NEAR(effects::ValueOf(first.front(), "motor_inertia"), J, 0.1 * J);
  EXPECT_NEAR(effects::ValueOf(first.front(), "stiffness"), k, 0.5 * k);
  Candidate sprung = rotor;
  step.AddFrom(rotor, screened, 2.0, 10.0, 1, &sprung);
  EXPECT_LT(state.fits.PerRow(sprung), 1.01);
  ASSERT_EQ(sprung.specs.size(), 1u);
  ASSERT_EQ(sprung.specs.front().id, "joint_elasticity");
  const EffectSpec spring = Refreshed(sprung).front();
  EXPECT_NEAR(effects::ValueOf(spring, "motor_inertia"), J, 0.1 * J);
  EXPECT_NEAR(effects::ValueOf(spring, "stiffness"), k, 0.1 * k);
}

// Along what was recorded a stiff spring's columns hold the noise of the residuals, and take it from them;
// along the fitted motion they do not.
TEST(ForwardStep, SeesNoSpringWhereNoneIs) {
  for (const uint64_t seed : {5015, 5018, 5024}) {
    const std::vector<EffectSpec> all = {MakeSpec("coulomb_friction", {"hinge"}, {{"coulomb", 0.15}}),
                                         MakeSpec("viscous_friction", {"hinge"}, {{"viscous", 0.1}}),
                                         MakeSpec("rotor_inertia", {"hinge"}, {{"armature", 0.02}})};
    const auto p = testing::Prepare(testing::MakeSet("pendulum", all, seed, 2.0));
    FirstRound round(*p);
    SearchState& state = round.state;
    const Candidate fitted = state.fits.Evaluate(all, false);
    ASSERT_LT(state.fits.PerRow(fitted), kExplained);
    const auto spring = [](const ScreenResult& screened) {
      const auto found = std::ranges::find_if(screened.hypotheses,
                                              [](const Scored& h) { return h.effect == "joint_elasticity"; });
      return found == screened.hypotheses.end() ? 0.0 : found->gain;
    };
    const ScreenResult screened = round.step.Screen(fitted);
    EXPECT_LT(spring(screened), std::max(1.0, screened.null_gain)) << seed;
    const FeatureSet recorded = MakeFeatures(p->data, p->nominal, p->scales, p->data.fine);
    const LiftedOptions options = state.fits.AsFitted(fitted);
    EXPECT_GT(spring(ScreenAround(state.setting, fitted, {true}, recorded, options, Rng(1), nullptr)), 50);
  }
}

// What a model has already is no addition to it.
TEST(ForwardStep, PromisesNothingThatTheModelHas) {
  const EffectSpec rotor = MakeSpec("rotor_inertia", {"hinge"}, {{"armature", 0.05}});
  const auto p = testing::Prepare("pendulum", {rotor}, 64);
  FirstRound round(*p);
  const Candidate bare = round.state.fits.Evaluate({}, false);
  const Candidate with = round.state.fits.Evaluate({rotor}, false);
  ScreenResult screened;
  Scored known, fresh;
  known.effect = "rotor_inertia", known.joints = {0}, known.gain = 9;
  fresh.effect = "viscous_friction", fresh.joints = {0}, fresh.gain = 4;
  screened.hypotheses = {known, fresh};
  screened.pairs = {{{known, fresh}, 12}};
  EXPECT_EQ(round.step.BestGain(bare, screened), 9);
  EXPECT_EQ(round.step.MostPromised(bare, screened), 12);
  EXPECT_EQ(round.step.BestGain(with, screened), 4);
  EXPECT_EQ(round.step.MostPromised(with, screened), 4);
}

// On more joints than the model has it on, it is one.
TEST(ForwardStep, PromisesOnFurtherJointsWhatTheModelHasOnOne) {
  const auto rotor = [](const char* joint) {
    return MakeSpec("rotor_inertia", {joint}, {{"armature", 0.05}});
  };
  const auto p = testing::Prepare("arm2", {rotor("elbow")}, 64);
  FirstRound round(*p);
  const Candidate one = round.state.fits.Evaluate({rotor("elbow")}, false);
  const Candidate both = round.state.fits.Evaluate({rotor("elbow"), rotor("shoulder")}, false);
  ScreenResult screened;
  Scored of_all, coupling;
  of_all.effect = "rotor_inertia", of_all.joints = {0, 1}, of_all.gain = 9;
  coupling.effect = "joint_coupling", coupling.joints = {0, 1}, coupling.gain = 4;
  screened.hypotheses = {of_all, coupling};
  EXPECT_EQ(round.step.BestGain(one, screened), 9);
  EXPECT_EQ(round.step.BestGain(both, screened), 4);
  EXPECT_EQ(round.step.MostPromised(one, screened), 4);
}

// Behind a gap a motor as heavy as the link looks like a small gain beside the spring, until play is tried
// beside both.
TEST(ForwardStep, TriesPlayBesideLawsThatStoodForItsMotor) {
  const EffectSpec spring =
      MakeSpec("position_spring", {"hinge"}, {{"stiffness", 3.0}, {"cubic", 1.0}, {"center", 0.0}});
  const auto p = testing::Prepare("pendulum",
                                  {MakeSpec("backlash", {"hinge"},
                                            {{"gap", 0.06},
                                             {"contact_stiffness", 2000.0},
                                             {"contact_damping", 3.0},
                                             {"motor_inertia", 0.05},
                                             {"motor_viscous", 0.0}}),
                                   spring},
                                  62);
  FirstRound round(*p);
  SearchState& state = round.state;
  ForwardStep& step = round.step;
  state.fits.Evaluate({}, false);
  const Candidate laws =
      state.fits.Evaluate({spring, MakeSpec("torque_gain", {"hinge"}, {{"gain", 0.8}})}, false);
  ASSERT_TRUE(laws.fit.ok);
  ASSERT_GT(state.fits.PerRow(laws), kConsistent);
  Candidate found = laws;
  step.AddTransmission(laws, &found);
  EXPECT_TRUE(Contains(found.specs, "backlash", "hinge")) << KeyOf(found.specs);
  EXPECT_LT(state.fits.Excess(found), 0.2 * state.fits.Excess(laws));
}

// Beside the wrong masses friction that drops with speed is not told from what does not.
TEST(Refinement, ExchangesMassesAndThenWhatTheyHid) {
  const EffectSpec drops = MakeSpec("stribeck_friction", {"elbow"},
                                    {{"coulomb", 0.1}, {"static", 0.3}, {"stribeck_velocity", 0.3}});
  const auto p = PreparedWithAnotherMass(drops, 59);
  FirstRound round(*p);
  FitLedger& fits = round.state.fits;
  Refinement refinement{round.state};
  const Candidate bare = fits.Evaluate({}, false);
  Candidate model =
      fits.Evaluate({MakeSpec("coulomb_friction", {"elbow"}, {{"coulomb", 0.2}})}, false, &bare);
  ASSERT_TRUE(model.fit.ok);
  ASSERT_GT(fits.PerRow(model), kConsistent);
  refinement.ExchangeMasses(bare, &model);
  EXPECT_TRUE(model.base);
  EXPECT_EQ(KeyOf(model.specs), KeyOf({drops}));
  EXPECT_LT(fits.PerRow(model), kExplained);
  // Masses that are right stay as they are.
  FirstRound another(*p);
  const Candidate freed = another.state.fits.Evaluate(Refreshed(model), true);
  model = freed;
  Refinement{another.state}.ExchangeMasses(bare, &model);
  EXPECT_EQ(KeyOf(model.specs, model.base), KeyOf(freed.specs, freed.base));
  EXPECT_EQ(another.state.fits.tried().size(), 1u) << "what was asked before its turn is forgotten";
}

TEST(SearchState, KeepsTheMissingForceOfEachFit) {
  const auto p = testing::Prepare("arm2", {MakeSpec("torque_offset", {"elbow"}, {{"offset", 0.3}})}, 66);
  FirstRound round(*p);
  SearchState& state = round.state;
  const Candidate bare = state.fits.Evaluate({}, false);
  const MissingForce& first = state.Force(bare);
  EXPECT_GT(first.evidence(1, 1), first.evidence(0, 0));
  const double evidence = first.evidence(1, 1), *kept = first.evidence.data();
  const Candidate with =
      state.fits.Evaluate({MakeSpec("torque_offset", {"elbow"}, {{"offset", 0.2}})}, false);
  EXPECT_LT(state.Force(with).evidence(1, 1), 0.1 * evidence);
  EXPECT_EQ(state.Force(bare).evidence.data(), kept) << "estimated anew";
  // With more noise the same fit lacks less.
  state.fits.SetNoiseScale(4);
  EXPECT_LT(state.Force(bare).evidence(1, 1), 0.5 * evidence);
  EXPECT_EQ(first.evidence(1, 1), evidence);
}

// Chosen while the base was taken to stand upright, friction by direction stood for its tilt as well.
TEST(DriveSearch, ChoosesFrictionAgainBesideALawThatWasMissing) {
  std::vector<EffectSpec> truth, directed;
  for (const char* joint : {"shoulder", "elbow"}) {
    truth.push_back(MakeSpec("stribeck_friction", {joint},
                             {{"coulomb", 0.15}, {"static", 0.5}, {"stribeck_velocity", 0.3}}));
    directed.push_back(
        MakeSpec("asymmetric_friction", {joint}, {{"coulomb_positive", 0.25}, {"coulomb_negative", 0.25}}));
  }
  const EffectSpec tilt = MakeSpec("gravity_misalignment", {}, {{"tilt", 0.05}, {"azimuth", 0.3}});
  truth.push_back(tilt);
  const auto p = testing::Prepare("arm2", truth, 64);
  FirstRound round(*p);
  DriveSearch drives{round.state, round.step};
  FitLedger& fits = round.state.fits;
  const Candidate before = fits.Evaluate(directed, false);
  const Candidate beside = fits.Evaluate(Joined(Refreshed(before), {tilt}), false);
  ASSERT_TRUE(beside.fit.ok);
  ASSERT_GT(fits.PerRow(beside), kExplained);
  Candidate again = beside;
  drives.Reconsider(before, &again);
  EXPECT_EQ(KeyOf(again.specs), KeyOf(truth));
  EXPECT_LT(fits.PerRow(again), kExplained);
  // What was found beside them is not the drives' own.
  Candidate own = beside;
  drives.Reconsider(fits.Evaluate({}, false), &own);
  EXPECT_TRUE(HasKind(own.specs, "asymmetric_friction")) << KeyOf(own.specs);
}

TEST(Simplifier, PutsThePlainLawInThePlaceOfARicherOneThatSaysNoMore) {
  const auto p =
      testing::Prepare("arm2", {MakeSpec("coulomb_friction", {"shoulder"}, {{"coulomb", 0.4}})}, 60);
  FirstRound round(*p);
  FitLedger& fits = round.state.fits;
  fits.Evaluate({}, false);
  const EffectSpec by_direction = MakeSpec("asymmetric_friction", {"shoulder"},
                                           {{"coulomb_positive", 0.4}, {"coulomb_negative", 0.4}}),
                   none = MakeSpec("viscous_friction", {"elbow"}, {{"viscous", 0.001}});
  Candidate best = fits.Evaluate({by_direction, none}, false, nullptr, 12);
  ASSERT_LT(fits.PerRow(best), kExplained);
  Simplifier(round.state).Run(&best);
  EXPECT_EQ(KeyOf(best.specs), "coulomb_friction[shoulder ] ");
  EXPECT_LT(fits.PerRow(best), kExplained);
}

// Late drives and friction that drops with speed each take less than half of what losses leave, and less than
// a hundredth of what these explain.
TEST(DriveSearch, TakesTheBetterOfTwoStepsThatNeedEachOther) {
  std::vector<EffectSpec> truth;
  for (const char* joint : {"shoulder", "elbow"}) {
    truth.push_back(MakeSpec("viscous_friction", {joint}, {{"viscous", 1.5}}));
    truth.push_back(MakeSpec("rotor_inertia", {joint}, {{"armature", 0.1}}));
    truth.push_back(MakeSpec("stribeck_friction", {joint},
                             {{"coulomb", 0.3}, {"static", 0.9}, {"stribeck_velocity", 0.15}}));
    truth.push_back(MakeSpec("actuator_lag", {joint}, {{"time_constant", 0.0265}}));
  }
  testing::Sampling sampling;
  sampling.rate_hz = 50;
  const auto p = testing::Prepare("arm2", truth, 65, sampling);
  FirstRound round(*p);
  FitLedger& fits = round.state.fits;
  const Candidate plain = fits.Evaluate({}, false), freed = fits.Evaluate({}, true);
  const auto found = DriveSearch(round.state, round.step).Run(plain, freed);
  ASSERT_TRUE(found.has_value());
  EXPECT_LT(fits.PerRow(*found), kExplained) << KeyOf(found->specs);
  EXPECT_EQ(KeyOf(found->specs), KeyOf(truth));
}

// What the given model says is not doubted, though less would do.
TEST(Simplifier, LeavesADeclaredLawAsItIs) {
  const auto p =
      testing::Prepare("arm2", {MakeSpec("coulomb_friction", {"shoulder"}, {{"coulomb", 0.4}})}, 60);
  FirstRound round(*p);
  FitLedger& fits = round.state.fits;
  round.state.given = {
      MakeSpec("asymmetric_friction", {"shoulder"}, {{"coulomb_positive", 0.4}, {"coulomb_negative", 0.4}})};
  fits.Evaluate(round.state.given, false);
  Candidate best = fits.Evaluate(round.state.given, false, nullptr, 12);
  Simplifier(round.state).Run(&best);
  EXPECT_EQ(KeyOf(best.specs), KeyOf(round.state.given));
  Candidate none = fits.Evaluate({}, false);  // nor is one missed that is not there
  Simplifier(round.state).Run(&none);
  EXPECT_TRUE(none.specs.empty());
}

TEST(Search, AGroupLeavesAloneWhatAJointHas) {
  auto p = testing::Prepare("arm2", {}, 55);
  p->nominal = *p->nominal.WithEffect(MakeSpec("coulomb_friction", {"elbow"}, {{"coulomb", 0.3}}));
  const Candidate start = RegressedGroup({p->data, p->nominal, p->scales}, {"coulomb_friction"}, false);
  ASSERT_EQ(start.specs.size(), 2u);
  EXPECT_NE(start.specs[0].joints, start.specs[1].joints);
}

}  // namespace
}  // namespace rg::diagnosis
