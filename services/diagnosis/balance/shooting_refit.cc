#include "services/diagnosis/balance/shooting_refit.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <memory>

#include "common/effects/effect_catalog.h"
#include "common/effects/inference.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/hypotheses/hypotheses.h"
#include "services/sysid/prediction.h"
#include "services/sysid/shooting_fit.h"

namespace rg::diagnosis {

namespace {

constexpr double kTrust =
    0.3;  // prior stddev over a start value's stddev: model errors bias long windows more
constexpr double kLeastKnown = 0.02;  // relative stddev of a start value, at least

// The first parameter of the first effect of a kind on the joint; `none` where there is no such effect.
double FirstValue(const std::vector<EffectSpec>& specs, const std::string& joint,
                  bool (*is)(const std::string& effect), double none) {
  for (const EffectSpec& s : specs) {
    if (!is(s.id) || std::ranges::find(s.joints, joint) == s.joints.end()) continue;
    return effects::ValueOf(s, effects::FindEffect(s.id)->parameters[0].name);
  }
  return none;
}

// Subtracts the torques of coupled drives from the efforts along the recorded motion.
void TakeOffDrive(const FineMotion& m, const sim::Plant& plant, const std::vector<EffectSpec>& specs,
                  const std::vector<double>& t, MatrixXd* u) {
  for (const EffectSpec& s : specs) {
    if (!IsCoupledDrive(s)) continue;
    const int other = plant.model().FindJoint(s.joints[0]), joint = plant.model().FindJoint(s.joints[1]);
    const auto& values = s.values.at("*");
    const double ratio = values.at("coefficient");
    for (size_t k = 0; k < t.size(); ++k) {
      const auto at = std::clamp<long>(std::lround((t[k] - m.t[0]) / (m.t[1] - m.t[0])), 0, m.v.cols() - 1);
      const double w = m.v(joint, at) + ratio * m.v(other, at), dw = m.a(joint, at) + ratio * m.a(other, at);
      const double force =
          values.at("viscous") * w + values.at("coulomb") * ((w > 0) - (w < 0)) + values.at("armature") * dw;
      (*u)(joint, static_cast<long>(k)) -= force;
      (*u)(other, static_cast<long>(k)) -= ratio * force;
    }
  }
}

// The recordings with delays, gains and coupled drives taken out of the efforts.
std::vector<sysid::FitRecording> Advanced(const FitData& data, const sim::Plant& plant,
                                          const std::vector<EffectSpec>& specs) {
  std::vector<sysid::FitRecording> out = data.recordings;
  VectorXd delay(data.n), gain(data.n);
  for (int j = 0; j < data.n; ++j) {
    const std::string& joint = plant.joint_names()[j];
    delay[j] = FirstValue(specs, joint, IsLateDrive, 0.0);
    gain[j] = FirstValue(
        specs, joint, [](const std::string& id) { return effects::ScalesEffort(id); }, 1.0);
  }
  for (size_t i = 0; i < out.size(); ++i) {
    sysid::FitRecording& r = out[i];
    const std::vector<double>& t = r.command.times();
    MatrixXd u = r.command.values();
    for (int j = 0; j < data.n; ++j) {
      for (size_t k = 0; k < t.size(); ++k)
        u(j, static_cast<long>(k)) = gain[j] * r.command.At(j, t[k] - delay[j]);
    }
    TakeOffDrive(data.fine[i], plant, specs, t, &u);
    auto shifted = sim::CommandSignal::Create(t, u, r.command.hold());
    if (shifted.ok()) r.command = shifted->WithMotion(r.command.motion());
  }
  return out;
}

// The Coulomb level of a refined dry friction: the parameter to which the plain term alone contributes.
std::string LevelOf(const effects::Inference& friction) {
  std::map<std::string, int> terms;
  for (const effects::Term& t : friction.terms) {
    for (const std::string& name : t.adds_to) ++terms[name];
  }
  for (const effects::Term& t : friction.terms) {
    for (const std::string& name : t.adds_to) {
      if (t.regressor == effects::Regressor::kDirection && terms[name] == 1) return name;
    }
  }
  return "";
}

// The effects that the regression of the inverse dynamics knows; refined friction in its plain form.
std::vector<EffectSpec> Plain(const std::vector<EffectSpec>& specs) {
  const effects::EffectInfo& dry = effects::LawOf(effects::Regressor::kDirection);
  std::vector<EffectSpec> out;
  for (const EffectSpec& s : specs) {
    const std::string level = LevelOf(effects::InferenceOf(s.id));
    if (sysid::RegressionKnows(s.id)) {
      out.push_back(s);
    } else if (!level.empty()) {
      out.push_back(
          effects::MakeSpec(dry.id, s.joints, {{dry.parameters[0].name, effects::ValueOf(s, level)}}));
    }
  }
  return out;
}

// Base parameters by regression, effects fixed.
void RegressBase(const FitSetting& setting, const std::vector<EffectSpec>& specs,
                 const sysid::FitSpace& space, VectorXd* theta) {
  const auto& [data, nominal, scales] = setting;
  const auto plain = sim::Plant::Create(nominal.shared_model(), nominal.options(), Plain(specs));
  if (!plain.ok()) return;
  const sysid::FitSpace twin(FreeParameters(*plain, scales, true));
  const auto found =
      sysid::RegressInverseDynamics(*plain, plain->parameters().Nominal(), twin,
                                    twin.From(plain->parameters().Nominal()), Advanced(data, nominal, specs));
  if (found.rows == 0) return;
  for (int i = 0; i < space.size(); ++i) {
    if (nominal.parameters().Find(space.parameters()[i].name) < 0) continue;
    for (int k = 0; k < twin.size(); ++k) {
      if (space.parameters()[i].name == twin.parameters()[k].name) (*theta)[i] = found.theta[k];
    }
  }
}

double ErrorOnFit(const FitData& data, const sim::Plant& plant, const VectorXd& values, double step,
                  double window) {
  sysid::PredictionOptions options;
  options.window_s = window;
  options.simulator.step_s = step;
  options.noise = data.noise;
  double squares = 0, rows = 0;
  for (const auto& r : data.recordings) {
    const auto e =
        sysid::ErrorOf(sysid::PredictRecording(plant, values, *r.recording, options), *r.recording);
    squares += e.rms * e.rms * r.recording->rows(), rows += r.recording->rows();
  }
  return std::sqrt(squares / std::max(1.0, rows));
}

}  // namespace

Candidate RefitByShooting(const FitSetting& setting, const std::vector<EffectSpec>& specs, bool base,
                          const RefitOptions& options) {
  const auto& [data, nominal, scales] = setting;
  Candidate c;
  c.specs = specs, c.base = base;
  const auto plant = sim::Plant::Create(nominal.shared_model(), nominal.options(), specs);
  if (!plant.ok()) return c;
  c.plant = std::make_shared<const sim::Plant>(*plant);
  c.parameters = FreeParameters(*c.plant, scales, base);
  // The balance's estimates are the shooting's priors: over long windows a small missing force would else
  // bias friction and inertia without bound.
  for (sysid::FitParameter& p : c.parameters) {
    const sim::Parameter& row = c.plant->parameters()[p.index];
    if (row.kind != sim::ParameterKind::kEffect) continue;
    const auto known = options.spread.find(p.name);
    p.prior_stddev = std::max(p.prior_stddev, std::abs(row.nominal));
    const bool timing = IsLateDrive(row.effect);
    if (known == options.spread.end()) continue;
    p.nominal = row.nominal;
    // Timing stays as estimated: friction would bias it.
    p.prior_stddev = timing ? kLeastKnown * std::abs(row.nominal)
                            : kTrust * std::max(known->second, kLeastKnown * std::abs(row.nominal));
  }
  const sysid::FitSpace space(c.parameters);
  const VectorXd start_values = c.plant->parameters().Nominal();
  VectorXd theta = space.From(start_values);
  if (base) RegressBase(setting, specs, space, &theta);
  c.fit.ok = true;
  c.fit.values = space.Values(theta, start_values);
  if (space.size() > 0) {
    sysid::ShootingFitOptions shooting;
    shooting.window_s = options.window_s;
    shooting.first_window_s = 0.5 * options.window_s;
    shooting.threads = options.threads;
    shooting.use_velocity = data.use_velocity;
    shooting.simulator.step_s =
        sysid::ChooseStep(*c.plant, c.fit.values, space, theta, data.recordings, data.noise);
    const double step = shooting.simulator.step_s;
    const auto error_of = [&](const VectorXd& values) {
      return ErrorOnFit(data, *c.plant, values, step, options.window_s);
    };
    double best = error_of(c.fit.values);
    const double untouched = error_of(start_values);
    if (untouched < best) best = untouched, c.fit.values = start_values;
    const auto keep = [&](const sysid::ShootingFit& fit) {
      const double error = error_of(fit.values);
      if (error < best) best = error, c.fit.values = fit.values;
    };
    const auto fit = sysid::FitByShooting(*c.plant, start_values, space, theta, data.recordings, data.noise,
                                          shooting, sysid::StopCondition(options.cancel), keep);
    const auto report = sysid::IdentifiabilityOf(space, fit);
    c.fit.stddev.setZero(space.size());
    for (int i = 0; i < space.size(); ++i) {
      c.fit.stddev[i] = c.parameters[i].prior_stddev;
      for (const auto& p : report.parameters) {
        if (p.name == c.parameters[i].name) c.fit.stddev[i] = p.stddev;
      }
      const auto known = options.spread.find(c.parameters[i].name);
      if (known != options.spread.end()) c.fit.stddev[i] = std::max(c.fit.stddev[i], known->second);
    }
    c.fit.iterations = fit.solution.iterations;
  }
  c.fit.theta.resize(space.size());
  for (int i = 0; i < space.size(); ++i) c.fit.theta[i] = c.fit.values[c.parameters[i].index];
  return c;
}

}  // namespace rg::diagnosis
