// Recordings made by the simulator itself, for tests of identification and prediction.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <memory>
#include <string>
#include <vector>

#include "common/base/check.h"
#include "common/base/rng.h"
#include "common/dynamics/dynamics.h"
#include "common/model/robot_model.h"
#include "common/model/urdf_loader.h"
#include "common/recordings/recording.h"
#include "common/sim/plant.h"
#include "common/sim/simulator.h"
#include "services/sysid/drive_signal.h"

namespace rg::sysid::testing {

inline std::string RobotPath(const std::string& name) {
  const char* root = std::getenv("RG_SOURCE_DIR");
  return std::string(root != nullptr ? root : ".") + "/deploy/robots/" + name + ".urdf";
}

// joint_1 … joint_6 of the Mico² move, the fingers are locked.
inline sim::Plant LoadPlant(const std::string& robot, std::vector<effects::EffectSpec> effects = {}) {
  model::LoadOptions load;
  if (robot == "mico2") load.joints = {"joint_1", "joint_2", "joint_3", "joint_4", "joint_5", "joint_6"};
  auto model = model::LoadUrdf(RobotPath(robot), load);
  RG_CHECK(model.ok()) << model.status().ToString();
  auto plant = sim::Plant::Create(std::make_shared<const model::RobotModel>(*model), {}, std::move(effects));
  RG_CHECK(plant.ok()) << plant.status().ToString();
  return *plant;
}

struct MakeOptions {
  double duration_s = 4.0;
  double rate_hz = 100.0;
  double position_noise = 0.0, velocity_noise = 0.0;
  bool with_velocity = true;
  double amplitude = 0.6;  // rad, of the reference
  double step_s = 1e-3;
  Eigen::VectorXd center;  // of the reference; empty: zero
  // Instead of a multi-sine: moves from pose to pose (half a second to one and a half), with rests between.
  bool moves = false;
};

struct Move {
  double start = 0.0, duration = 1.0;
  Eigen::VectorXd from, to;
};

inline std::vector<Move> DrawMoves(const Eigen::VectorXd& center, const MakeOptions& options, Rng* rng) {
  std::vector<Move> out;
  Eigen::VectorXd at = center;
  for (double t = rng->Uniform(0.2, 1.0); t < options.duration_s;) {
    Eigen::VectorXd to = center;
    for (int j = 0; j < to.size(); ++j) to[j] += options.amplitude * rng->Uniform(-1.0, 1.0);
    out.push_back({t, rng->Uniform(0.5, 1.5), at, to});
    at = to;
    t += out.back().duration + rng->Uniform(0.5, 2.0);
  }
  return out;
}

// Minimum jerk.
inline void MoveAt(const std::vector<Move>& moves, double t, Eigen::VectorXd* q, Eigen::VectorXd* v,
                   Eigen::VectorXd* a) {
  const Move* move = &moves.front();
  for (const Move& m : moves) {
    if (m.start <= t) move = &m;
  }
  const double T = move->duration, s = std::clamp((t - move->start) / T, 0.0, 1.0);
  const Eigen::VectorXd reach = move->to - move->from;
  *q = move->from + reach * (s * s * s * (10.0 + s * (6.0 * s - 15.0)));
  *v = reach * (30.0 * s * s * (1.0 - s) * (1.0 - s) / T);
  *a = reach * (60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / (T * T));
}

// The plant follows a multi-sine under a computed torque, recorded with its held command.
inline recordings::Recording MakeRecording(const sim::Plant& plant, const Eigen::VectorXd& values,
                                           uint64_t seed, const MakeOptions& options = {}) {
  const int n = plant.num_joints();
  const int K = static_cast<int>(std::lround(options.duration_s * options.rate_hz)) + 1;
  const double dt = 1.0 / options.rate_hz;
  Rng rng(seed);
  Eigen::MatrixXd frequency(n, 3), phase(n, 3);
  for (int i = 0; i < n * 3; ++i) {
    frequency.data()[i] = 2.0 * M_PI * rng.Uniform(0.15, 0.9);
    phase.data()[i] = rng.Uniform(0.0, 2.0 * M_PI);
  }
  const Eigen::VectorXd center = options.center.size() > 0 ? options.center : Eigen::VectorXd::Zero(n);
  const auto sines = [&](double t, Eigen::VectorXd* q, Eigen::VectorXd* v, Eigen::VectorXd* a) {
    *q = center;
    v->setZero(n);
    a->setZero(n);
    for (int j = 0; j < n; ++j) {
      for (int m = 0; m < 3; ++m) {
        const double w = frequency(j, m), s = options.amplitude / 3.0;
        (*q)[j] += s * std::sin(w * t + phase(j, m));
        (*v)[j] += s * w * std::cos(w * t + phase(j, m));
        (*a)[j] -= s * w * w * std::sin(w * t + phase(j, m));
      }
    }
  };
  std::vector<Move> moves;
  if (options.moves) moves = DrawMoves(center, options, &rng);
  const auto reference = [&](double t, Eigen::VectorXd* q, Eigen::VectorXd* v, Eigen::VectorXd* a) {
    if (options.moves) {
      MoveAt(moves, t, q, v, a);
    } else {
      sines(t, q, v, a);
    }
  };
  const dynamics::Mechanism mechanism = MechanismOf(plant, values);
  dynamics::Workspace workspace;
  Eigen::VectorXd rotors = Eigen::VectorXd::Zero(n);  // where the links bring no inertia
  for (const int i : plant.parameters().OfKind(sim::ParameterKind::kArmature))
    rotors[plant.model().FindJoint(plant.parameters()[i].owner)] = values[i];
  sim::Simulator simulator(plant, {.step_s = options.step_s});
  simulator.SetParameters(values);
  Eigen::VectorXd q, v, a, u(n), mq(n), mv(n);
  reference(0.0, &q, &v, &a);
  sim::State x = simulator.MakeState(q, v);
  recordings::Recording rec;
  rec.name = "simulated_" + std::to_string(seed);
  rec.joints = plant.joint_names();
  rec.t.resize(K);
  rec.q.resize(n, K);
  rec.effort_command.resize(n, K);
  if (options.with_velocity) rec.v.resize(n, K);
  for (int k = 0; k < K; ++k) {
    reference(k * dt, &q, &v, &a);
    const Eigen::VectorXd wanted = a + 60.0 * (q - x.q) + 12.0 * (v - x.v);
    dynamics::Rnea(mechanism, workspace, x.q, x.v, wanted, u);
    u += rotors.cwiseProduct(wanted);
    simulator.Measure(x, &mq, &mv);
    rec.t[k] = k * dt;
    for (int j = 0; j < n; ++j) {
      rec.q(j, k) = mq[j] + options.position_noise * rng.Normal();
      const double dv = options.velocity_noise * rng.Normal();
      if (options.with_velocity) rec.v(j, k) = mv[j] + dv;
    }
    rec.effort_command.col(k) = u;
    const sim::Outcome outcome = simulator.Advance(x, u, dt);
    RG_CHECK(outcome.ok()) << outcome.ToString();
  }
  return rec;
}

inline Eigen::VectorXd CandlePose() {
  Eigen::VectorXd q(6);
  q << 0.0, M_PI, M_PI, 0.0, 0.0, 0.0;
  return q;
}

}  // namespace rg::sysid::testing
