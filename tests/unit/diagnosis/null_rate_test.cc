// The null's stated rate, simulated: ordinary robots that declare all they have (friction, damping and a
// rotor on every joint, drawn anew with motion and noise for each of 200 sets), how often the best hypothesis
// of a screen around the fitted model exceeds what chance is said to reach in 2 % of sets, and how often the
// whole diagnosis says that something is missing.
//
// RG_NULL_RATE_FILE: a file to which each set's row is added and from which a later run goes on.
// RG_NULL_RATE_SETS: other than 200.
#include <gtest/gtest.h>

#include <cstdlib>
#include <ctime>
#include <fstream>
#include <map>
#include <sstream>

#include "services/diagnosis/data/prepare_data.h"
#include "services/diagnosis/diagnosis.h"
#include "services/diagnosis/hypotheses/given_model.h"
#include "services/diagnosis/screening/screen_columns.h"
#include "services/diagnosis/search/fit_ledger.h"
#include "services/proof/statistics.h"
#include "tests/unit/diagnosis/simulated_set.h"

namespace rg::diagnosis {
namespace {

constexpr double kDuration = 2.0;     // s, of each of three recordings to fit and one to judge by
constexpr double kMostAlarms = 0.05;  // that the diagnosis is asked for on such robots
constexpr double kStatedRate = 0.02;  // of ScreenResult::null_gain

// One joint's typical friction [N·m or N], damping and rotor.
struct Robot {
  const char* name;
  double coulomb, viscous, armature;
};
constexpr int kSmall = 200;  // sets of these; the further ones are of a whole arm
constexpr Robot kWholeArm = {"mico2", 0.4, 0.4, 0.08};
constexpr Robot kRobots[] = {
    {"pendulum", 0.15, 0.1, 0.02}, {"slide", 2.0, 5.0, 0.5}, {"arm2", 0.3, 0.2, 0.05}};

std::vector<effects::EffectSpec> DrawEffects(const Robot& robot, const std::vector<std::string>& joints,
                                             Rng* rng) {
  std::vector<effects::EffectSpec> out;
  const auto around = [&](double typical) { return typical * std::exp(rng->Uniform(-0.7, 0.7)); };
  for (const std::string& joint : joints) {
    out.push_back(effects::MakeSpec("coulomb_friction", {joint}, {{"coulomb", around(robot.coulomb)}}));
    out.push_back(effects::MakeSpec("viscous_friction", {joint}, {{"viscous", around(robot.viscous)}}));
    out.push_back(effects::MakeSpec("rotor_inertia", {joint}, {{"armature", around(robot.armature)}}));
  }
  return out;
}

struct Row {
  int set = 0;
  std::string robot;
  double gain[2] = {0, 0}, null[2] = {0, 0};  // of the screen with fixed and with free base parameters
  std::string best[2];
  bool alarm = false;
  std::string said;
  double cpu_s = 0;
  bool Exceeds(int base) const { return gain[base] > null[base]; }
  // As a search asks (Acceptance::Needed) of a first name on one joint: beyond its prior, what is beyond the
  // null less the part of the prior that is in it, a null of 3 nats at least.
  bool IsWorthAName(int base) const {
    return gain[base] - kEffectPrior - kJointPrior > std::max(1.0, std::max(null[base], 3.0) - kEffectPrior);
  }
};

std::string Text(const Row& r) {
  std::ostringstream out;
  out << r.set << ',' << r.robot;
  for (int base = 0; base < 2; ++base)
    out << ',' << r.gain[base] << ',' << r.null[base] << ',' << r.best[base];
  out << ',' << r.alarm << ',' << r.said << ',' << r.cpu_s << '\n';
  return out.str();
}

std::map<int, Row> ReadRows(const char* file) {
  std::map<int, Row> out;
  std::ifstream in(file != nullptr ? file : "");
  for (std::string line; std::getline(in, line);) {
    std::stringstream cells(line);
    std::vector<std::string> cell;
    for (std::string x; std::getline(cells, x, ',');) cell.push_back(x);
    if (cell.size() != 11) continue;  // a run that was ended while it wrote
    Row r{std::stoi(cell[0]),
          cell[1],
          {std::stod(cell[2]), std::stod(cell[5])},
          {std::stod(cell[3]), std::stod(cell[6])},
          {cell[4], cell[7]},
          cell[8] == "1",
          cell[9],
          std::stod(cell[10])};
    out[r.set] = r;
  }
  return out;
}

// The best hypothesis that the model does not have, around the model fitted to the recordings.
void Screens(const recordings::RecordingSet& set, const DiagnosisOptions& options, Row* row) {
  const auto nominal = GivenPlant(set, options.model);
  RG_CHECK(nominal.ok()) << nominal.status().ToString();
  const auto data = PrepareData(set, *nominal, options);
  RG_CHECK(data.ok()) << data.status().ToString();
  const MotionScales scales = ScalesOf(*data, *nominal);
  const FitSetting setting{*data, *nominal, scales};
  const Trace trace(RealClock());
  FitLedger fits(setting, options, 1, trace, nullptr);
  const auto given = SeenEffects(*nominal, [&](const auto& specs) { return fits.Evaluate(specs, true); });
  std::map<double, std::vector<Eigen::VectorXd>> step_rules;  // by step, as a search keeps them
  for (const int base : {0, 1}) {
    const Candidate fitted = fits.Evaluate(given, base == 1);
    const LiftedOptions as_fitted = fits.AsFitted(fitted);
    const FeatureSet features = FeaturesAlongFit(setting, fitted, as_fitted);
    const ScreenResult screened = ScreenAround(setting, fitted, {true}, features, as_fitted,
                                               Rng(options.seed), &step_rules[as_fitted.step_s]);
    row->null[base] = screened.null_gain, row->gain[base] = -1e9, row->best[base] = "none";
    for (const Scored& h : screened.hypotheses) {
      if (IsUnnamed(h.effect) || HasKind(given, h.effect) || h.gain <= row->gain[base]) continue;
      row->gain[base] = h.gain, row->best[base] = h.effect;
    }
  }
}

// `undeclared`: of its effects, the last so many.
Row MakeRow(int set_number, size_t undeclared = 0) {
  const double start = static_cast<double>(std::clock()) / CLOCKS_PER_SEC;
  const Robot& robot =
      set_number < kSmall ? kRobots[static_cast<size_t>(set_number) % std::size(kRobots)] : kWholeArm;
  Rng rng = Rng(4711).Split(static_cast<uint64_t>(set_number));
  const auto joints = sysid::testing::LoadPlant(robot.name).joint_names();
  const auto effects = DrawEffects(robot, joints, &rng);
  const sim::Plant declared =
      sysid::testing::LoadPlant(robot.name, {effects.begin(), effects.end() - static_cast<long>(undeclared)});
  const auto set = testing::MakeSet(robot.name, effects, 5000 + static_cast<uint64_t>(set_number), kDuration);
  DiagnosisOptions options;
  options.threads = 1;
  options.model = sim::ModelFile{declared, declared.parameters().Nominal()};
  Row row;
  row.set = set_number, row.robot = robot.name;
  Screens(set, options, &row);
  const auto result = Diagnose(set, options, RealClock());
  RG_CHECK(result.ok()) << result.status().ToString();
  row.alarm = result->verdict != "no_mismatch" || !result->findings.empty();
  row.said = result->verdict;
  for (const Finding& f : result->findings) row.said += " " + f.effect;
  row.cpu_s = static_cast<double>(std::clock()) / CLOCKS_PER_SEC - start;
  return row;
}

void Print(const std::string& what, double hits, int n) {
  const proof::Share s = proof::ShareOf(hits, n);
  std::printf("%-58s %3.0f of %d: %.3f (%.3f to %.3f)\n", what.c_str(), hits, n, s.value, s.low, s.high);
}

TEST(NullRate, IsExceededWhereARotorIsNotDeclared) {
  for (const int set : {0, 1, 2}) {
    const Row row = MakeRow(set, 1);
    EXPECT_TRUE(row.Exceeds(0)) << row.robot << ' ' << row.gain[0];
    EXPECT_TRUE(row.alarm) << row.robot << ' ' << row.said;
  }
}

TEST(NullRate, OnOrdinaryRobotsThatDeclareAllTheyHaveIsWhatIsSaid) {
  const char* file = std::getenv("RG_NULL_RATE_FILE");
  const char* sets = std::getenv("RG_NULL_RATE_SETS");
  const int count = sets != nullptr ? std::atoi(sets) : 200;
  std::map<int, Row> rows = ReadRows(file);
  for (int i = 0; i < count; ++i) {
    if (rows.count(i) > 0) continue;
    rows[i] = MakeRow(i);
    if (file != nullptr) std::ofstream(file, std::ios::app) << Text(rows[i]) << std::flush;
  }
  double fixed = 0, free = 0, names = 0, alarms = 0, cpu = 0;
  std::map<std::string, int> n_of, alarms_of, exceed_of;
  for (const auto& [i, r] : rows) {
    fixed += r.Exceeds(0), free += r.Exceeds(1), names += r.IsWorthAName(0) || r.IsWorthAName(1),
        alarms += r.alarm, cpu += r.cpu_s;
    ++n_of[r.robot], alarms_of[r.robot] += r.alarm, exceed_of[r.robot] += r.Exceeds(0);
    if (r.alarm) std::printf("set %d (%s): %s\n", i, r.robot.c_str(), r.said.c_str());
  }
  const int n = static_cast<int>(rows.size());
  Print("best hypothesis exceeds the null, base parameters fixed", fixed, n);
  for (const auto& [robot, of] : n_of) Print("  " + robot, exceed_of[robot], of);
  Print("best hypothesis exceeds the null, base parameters free", free, n);
  Print("either is worth a name", names, n);
  Print("the diagnosis says that something is missing", alarms, n);
  for (const auto& [robot, of] : n_of) Print("  " + robot, alarms_of[robot], of);
  std::printf("%.1f s of CPU per set\n", cpu / n);
  EXPECT_LE(proof::ShareOf(alarms, n).low, kMostAlarms);
  EXPECT_LE(proof::ShareOf(fixed, n).low, kStatedRate);
  EXPECT_LE(proof::ShareOf(free, n).low, kStatedRate);
}

}  // namespace
}  // namespace rg::diagnosis
