#include "common/effects/effect_catalog.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <set>

namespace rg::effects {
namespace {

using ::testing::HasSubstr;

// The ids and parameter names of the contract EFFECTS.md.
const std::map<std::string, std::vector<std::string>> kContract = {
    {"viscous_friction", {"viscous"}},
    {"coulomb_friction", {"coulomb"}},
    {"stribeck_friction", {"coulomb", "static", "stribeck_velocity"}},
    {"asymmetric_friction", {"coulomb_positive", "coulomb_negative"}},
    {"load_dependent_friction", {"coulomb", "load_coefficient"}},
    {"quadratic_drag", {"quadratic"}},
    {"presliding_hysteresis", {"bristle_stiffness", "coulomb"}},
    {"joint_elasticity", {"stiffness", "damping", "motor_inertia"}},
    {"backlash", {"gap", "contact_stiffness", "contact_damping", "motor_inertia", "motor_viscous"}},
    {"actuator_delay", {"delay"}},
    {"actuator_lag", {"time_constant"}},
    {"torque_gain", {"gain"}},
    {"torque_deadband", {"deadband"}},
    {"torque_saturation", {"limit"}},
    {"torque_offset", {"offset"}},
    {"torque_ripple", {"amplitude", "cycles_per_rev", "phase"}},
    {"rotor_inertia", {"armature"}},
    {"payload", {"mass", "com_x", "com_y", "com_z"}},
    {"gravity_misalignment", {"tilt", "azimuth"}},
    {"encoder_offset", {"offset"}},
    {"sensor_delay", {"delay"}},
    {"position_spring", {"stiffness", "cubic", "center"}},
    {"thermal_drift", {"initial", "final", "time_constant"}},
    {"external_disturbance", {"start", "end", "force_x", "torque"}},
    {"contact", {"stiffness", "damping", "height"}},
    {"joint_coupling", {"coefficient", "viscous", "coulomb", "armature"}},
    {"base_flexibility", {"stiffness", "damping"}},
    {"sloshing_payload", {"mass", "length", "stiffness"}},
    {"unknown_field", {}},
    // One more form of unknown_field; a diagnosis reports it as that.
    {"unknown_field_pair", {}},
};

TEST(Catalog, HoldsTheContractsIdsAndParameters) {
  EXPECT_EQ(Catalog().size(), kContract.size());
  for (const auto& [id, parameters] : kContract) {
    const EffectInfo* info = FindEffect(id);
    ASSERT_NE(info, nullptr) << id;
    for (const auto& name : parameters) EXPECT_GE(info->FindParameter(name), 0) << id << " " << name;
  }
  EXPECT_EQ(FindEffect("none"), nullptr);
}

TEST(SloshingPayload, SaysWhichOfItsFormsItIs) {
  const EffectSpec springs = MakeSpec("sloshing_payload");
  EXPECT_EQ(Sentence(springs, "the robot", false, {{"mass", 0.2}, {"stiffness", 40}, {"damping", 1}}),
            "The last link carries 0.2 kg that moves in a hold of 40 N/m.");
  EXPECT_THAT(Equation(springs), HasSubstr("-k*s"));
  EffectSpec rod = MakeSpec("sloshing_payload", {}, {{"mass", 0.2}, {"length", 0.1}});
  const Status refused = ValidateSpec(rod);
  EXPECT_FALSE(refused.ok());
  EXPECT_NE(refused.message().find("length needs option form rod"), std::string::npos) << refused.message();
  rod.options["form"] = "rod";
  EXPECT_EQ(Sentence(rod, "the robot", false, {{"mass", 0.2}, {"length", 0.1}, {"damping", 1}}),
            "The last link carries 0.2 kg that swings on a rod of 0.1 m.");
  EXPECT_THAT(Equation(rod), HasSubstr("ddphi"));
  EXPECT_TRUE(ValidateSpec(rod).ok());
  rod.values["*"]["stiffness"] = 40;
  EXPECT_FALSE(ValidateSpec(rod).ok()) << "a rod has no springs";
}

TEST(JointCoupling, SaysWhichOfItsFormsItIs) {
  EffectSpec spec = MakeSpec("joint_coupling", {"joint_5", "joint_6"}, {{"coefficient", 0.3}});
  EXPECT_EQ(Equation(spec), "tau_j += kappa*tau_i");
  EXPECT_EQ(ShowsOver(spec), Variable::kEffort);
  EXPECT_TRUE(ValidateSpec(spec).ok());
  spec.values["*"]["coulomb"] = 2.0;
  EXPECT_THAT(ValidateSpec(spec).message(), HasSubstr("coulomb needs option form kinematic"));
  spec.options["form"] = "kinematic";
  EXPECT_TRUE(ValidateSpec(spec).ok());
  EXPECT_THAT(Equation(spec), HasSubstr("w = dq_j + kappa*dq_i"));
  EXPECT_EQ(ShowsOver(spec), Variable::kVelocity);
  EXPECT_EQ(
      Sentence(spec, "joint_5 and joint_6", false,
               {{"coefficient", 1}, {"viscous", 0.5}, {"coulomb", 2}, {"armature", 0.1}}),
      "The motor of the second joint of joint_5 and joint_6 turns with it and with 1 times the first: its "
      "friction (0.5 N*m*s/rad, 2 N*m) and its rotor (0.1 kg*m^2) act on both.");
}

TEST(Catalog, RowsAreComplete) {
  for (const EffectInfo& info : Catalog()) {
    for (const FormInfo& form : info.forms) {
      const auto& values = info.options.at(form.option);
      EXPECT_NE(std::find(values.begin(), values.end(), form.value), values.end())
          << info.id << " " << form.value;
      EXPECT_FALSE(form.equation.empty() || form.sentence.empty()) << info.id << " " << form.value;
    }
    EXPECT_FALSE(info.title.empty() || info.equation.empty() || info.sentence.empty() || info.family.empty())
        << info.id;
    std::set<std::string> names;
    for (const ParameterInfo& p : info.parameters) {
      EXPECT_TRUE(names.insert(p.name).second) << info.id << " " << p.name;
      EXPECT_FALSE(p.unit.empty() || p.unit_prismatic.empty() || p.meaning.empty())
          << info.id << " " << p.name;
      EXPECT_GT(p.prior_stddev, 0.0) << info.id << " " << p.name;
      EXPECT_TRUE(p.default_is_effort || (p.default_value >= p.lower && p.default_value <= p.upper))
          << info.id << " " << p.name;
    }
    for (const auto& id : info.confused_with) {
      EXPECT_TRUE(id == "parameters_only" || FindEffect(id) != nullptr) << info.id << " " << id;
      EXPECT_NE(id, info.id);
    }
  }
}

TEST(Catalog, EveryRowButAPushSaysWhatRecordingsMustHoldForIt) {
  std::set<std::string_view> names;
  for (const EffectInfo& info : Catalog()) {
    std::set<Need> needs(info.needs.begin(), info.needs.end());
    EXPECT_EQ(needs.size(), info.needs.size()) << info.id << " names a need twice";
    // A push may come at any time, whatever the robot does.
    EXPECT_EQ(needs.empty(), info.id == "external_disturbance") << info.id;
    for (const Need need : needs) {
      EXPECT_NE(NeedName(need), "unknown") << info.id;
      names.insert(NeedName(need));
    }
  }
  EXPECT_EQ(names.size(), static_cast<size_t>(Need::kOtherEffort) + 1) << "a need that no effect has";
}

TEST(Sentence, FillsInJointValuesAndUnits) {
  const std::string text = Sentence(MakeSpec("coulomb_friction"), "joint_2", false, {{"coulomb", 0.84}});
  EXPECT_EQ(
      text,
      "joint_2 loses a constant torque against its motion that the model does not have: Coulomb friction of "
      "0.84 N*m.");
  EXPECT_THAT(Sentence(MakeSpec("coulomb_friction"), "slide", true, {{"coulomb", 20.4}}),
              HasSubstr("20.4 N."));
}

TEST(ValidateSpec, RefusesWithNamesAndLimits) {
  EffectSpec bad = MakeSpec("stribeck_friction", {"j"}, {{"stribeck_velocity", 0.0}});
  EXPECT_THAT(ValidateSpec(bad).message(), HasSubstr("stribeck_velocity = 0 is outside [1e-06"));
  bad = MakeSpec("coulomb_friction", {"j"}, {{"coulomb", std::nan("")}});
  EXPECT_THAT(ValidateSpec(bad).message(), HasSubstr("not finite"));
  bad = MakeSpec("coulomb_friction", {"j", "j"});
  EXPECT_THAT(ValidateSpec(bad).message(), HasSubstr("j is listed twice"));
  bad = MakeSpec("external_disturbance", {"j"}, {{"force_x", 1.0}});
  EXPECT_THAT(ValidateSpec(bad).message(), HasSubstr("no parameter force_x"));
  bad = MakeSpec("external_disturbance", {}, {{"torque", 1.0}});
  EXPECT_THAT(ValidateSpec(bad).message(), HasSubstr("no parameter torque"));
  bad = MakeSpec("coulomb_friction", {"j"});
  bad.values["k"]["coulomb"] = 1.0;
  EXPECT_THAT(ValidateSpec(bad).message(), HasSubstr("values for k"));
}

TEST(ValidateSpec, RefusesEveryParameterBeyondItsBounds) {
  for (const EffectInfo& info : Catalog()) {
    const bool joints = info.scope == Scope::kJoint || info.scope == Scope::kJointPair;
    for (const ParameterInfo& p : info.parameters) {
      if (p.only == ParameterInfo::Only::kWithJoints) continue;
      for (const double limit : {p.lower, p.upper}) {
        if (!std::isfinite(limit)) continue;
        const double beyond = limit == p.lower ? limit - 1.0 : limit + 1.0;
        std::vector<std::string> names;
        if (joints) names = {"j"};
        if (info.scope == Scope::kJointPair) names.push_back("k");
        EXPECT_FALSE(ValidateSpec(MakeSpec(info.id, names, {{p.name, beyond}})).ok())
            << info.id << " " << p.name;
      }
    }
  }
}

}  // namespace
}  // namespace rg::effects
