#include "services/diagnosis/design/probe_motions.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <optional>

#include "common/base/printf.h"
#include "common/dynamics/dynamics.h"
#include "common/model/robot_model.h"
#include "services/diagnosis/data/words.h"
#include "services/sysid/drive_signal.h"

namespace rg::diagnosis {

namespace {

constexpr double kRow = 0.02;               // s between rows
constexpr double kShare = 0.7;              // of a velocity or effort limit
constexpr double kMargin = 0.03;            // rad or m kept from a position limit
constexpr double kLeastReach = 0.25;        // rad to each side
constexpr double kLeastSlide = 0.05;        // m to each side
constexpr double kAcceleration = 8.0;       // rad/s² or m/s²
constexpr double kLeastRise = 0.15;         // s from rest to speed
constexpr double kHold = 0.5;               // s at rest after a stroke
constexpr double kApart = 0.37;             // s by which one joint begins after the other
constexpr double kSlow = 0.03;              // rad/s or m/s
constexpr double kLongestWithoutLimit = 2;  // times the recorded speed, where the model has no limit
constexpr int kSlowDowns = 10;              // attempts to keep the limits

using Path = std::function<double(double t)>;

struct Room {
  double middle = 0, reach = 0, top = 1;  // top: speed
};

std::string TwoDigits(double x) { return Printf("%.2g", x); }

// From the end of the last one to `to`, at `speed` between raised-cosine rises and falls, then a hold.
struct Stroke {
  double begin = 0, from = 0, to = 0, speed = 1, rise = 0.1;
  double moving() const { return std::abs(to - from) / speed + rise; }
  double At(double t) const {
    const double x = std::clamp(t - begin, 0.0, moving()), sign = to < from ? -1.0 : 1.0;
    const auto risen = [&](double y) {
      return y >= rise ? y - 0.5 * rise
                       : 0.5 * (y - rise / std::numbers::pi * std::sin(std::numbers::pi * y / rise));
    };
    const double half = 0.5 * moving(), all = std::abs(to - from);
    return from + sign * (x <= half ? speed * risen(x) : all - speed * risen(moving() - x));
  }
};

class Strokes {
 public:
  explicit Strokes(double start) : at_(start) {}
  void Go(double to, double speed, double hold) {
    const double distance = std::abs(to - at_);
    double rise = std::max(kLeastRise, speed / kAcceleration);
    if (distance < speed * rise) {  // too short to reach that speed
      speed = std::min(distance / kLeastRise, std::sqrt(distance * kAcceleration));
      rise = std::max(1e-3, distance / std::max(1e-9, speed));
    }
    if (distance < 1e-6) return;
    strokes_.push_back({end_, at_, to, speed, rise});
    end_ += strokes_.back().moving() + hold;
    at_ = to;
  }
  double end() const { return end_; }
  Path Take() const {
    if (strokes_.empty()) return [at = at_](double) { return at; };
    return [strokes = strokes_](double t) {
      const Stroke* now = &strokes.front();
      for (const Stroke& s : strokes) {
        if (s.begin <= t) now = &s;
      }
      return now->At(t);
    };
  }

 private:
  std::vector<Stroke> strokes_;
  double at_, end_ = 0;
};

struct Program {
  std::string what;
  std::vector<Path> paths;  // one per moving joint
  double duration = 0;
};

class Maker {
 public:
  Maker(const FitSetting& setting, const std::vector<int>& joints)
      : model_(setting.nominal.model()),
        mechanism_(sysid::MechanismOf(setting.nominal, setting.nominal.parameters().Nominal())),
        data_(setting.data),
        joints_(joints) {
    for (const int j : joints) rooms_.push_back(RoomOf(j, setting.scales));
    for (const Room& room : rooms_) slowest_ = std::min(slowest_, room.top), top_ = std::max(top_, room.top);
    FindPose();
  }

  std::vector<ProbeMotion> Run() {
    std::vector<ProbeMotion> out;
    const double rate = 1.0 / std::max(1e-3, data_.recordings[0].recording->SamplePeriod());
    for (const Program& program : {Ramps(), Speeds(), Reversals(), Sweep(), Chirp(std::min(4.0, rate / 6))}) {
      if (auto motion = Sampled(program)) out.push_back(std::move(*motion));
    }
    return out;
  }

 private:
  Room RoomOf(int j, const MotionScales& scales) const {
    const model::Joint& joint = model_.joint(j);
    const double least = joint.is_revolute() ? kLeastReach : kLeastSlide;
    double middle = 0.5 * (scales.low[j] + scales.high[j]);
    double reach = std::max(least, 0.5 * (scales.high[j] - scales.low[j]));
    const double low = joint.lower + kMargin, high = joint.upper - kMargin;
    if (low < high) {  // also of joints without a limit: then infinite
      const double from = std::max(low, middle - reach), to = std::min(high, middle + reach);
      middle = 0.5 * (from + to), reach = std::max(0.0, 0.5 * (to - from));
    }
    const bool limited = std::isfinite(joint.velocity) && joint.velocity > 0;
    const double top =
        limited ? kShare * joint.velocity : std::max(0.2, kLongestWithoutLimit * scales.top_speed[j]);
    return {middle, reach, top};
  }

  void FindPose() {
    double nearest = 1e300;
    for (const sysid::FitRecording& r : data_.recordings) {
      const MatrixXd& q = r.recording->q;
      for (Eigen::Index k = 0; k < q.cols(); ++k) {
        double off = 0;
        for (size_t i = 0; i < joints_.size(); ++i) off += std::abs(q(joints_[i], k) - rooms_[i].middle);
        if (off < nearest) nearest = off, pose_ = q.col(k);
      }
    }
    for (size_t i = 0; i < joints_.size(); ++i) pose_[joints_[i]] = rooms_[i].middle;
  }

  Program OfStrokes(const std::string& what, const std::function<void(const Room&, Strokes*)>& fill) const {
    Program out{what, {}, 0};
    for (size_t i = 0; i < joints_.size(); ++i) {
      Strokes strokes(rooms_[i].middle);
      fill(rooms_[i], &strokes);
      const double wait = kApart * static_cast<double>(i);
      out.paths.push_back([path = strokes.Take(), wait](double t) { return path(t - wait); });
      out.duration = std::max(out.duration, strokes.end() + wait);
    }
    return out;
  }

  Program Ramps() const {
    return OfStrokes("slow ramps at " + TwoDigits(kSlow) + Unit() + "/s through reversals",
                     [](const Room& room, Strokes* s) {
                       const double far = std::min(room.reach, 2.5 * kSlow);
                       for (int k = 0; k < 2; ++k) {
                         s->Go(room.middle + far, kSlow, 0.2);
                         s->Go(room.middle, kSlow, 0.2);
                       }
                       s->Go(room.middle - far, kSlow, 0.2);
                       s->Go(room.middle, kSlow, 0.2);
                     });
  }

  Program Speeds() const {
    return OfStrokes("there and back at speeds from " + TwoDigits(0.08 * slowest_) + " to " +
                         TwoDigits(top_) + Unit() + "/s",
                     [](const Room& room, Strokes* s) {
                       double side = 1;
                       for (const double share : {0.08, 0.2, 0.4, 0.7, 1.0}) {
                         const double speed = share * room.top;
                         const double far = std::min(room.reach, 0.9 * speed);
                         for (int k = 0; k < 2; ++k, side = -side) {
                           s->Go(room.middle + side * far, speed, 0.1);
                           s->Go(room.middle, speed, 0.1);
                         }
                       }
                     });
  }

  Program Reversals() const {
    return OfStrokes("fast reversals and holds at up to " + TwoDigits(top_) + Unit() + "/s",
                     [](const Room& room, Strokes* s) {
                       for (const double at : {0.5, -0.5, 1.0, 0.0, -1.0, 0.3, -0.3, 0.0})
                         s->Go(room.middle + at * room.reach, room.top, kHold);
                     });
  }

  Program Sweep() const {
    return OfStrokes("a slow sweep of the whole recorded range in both directions",
                     [](const Room& room, Strokes* s) {
                       const double speed = std::min(0.5 * room.top, std::max(kSlow, room.reach / 2.5));
                       for (const double at : {1.0, -1.0, 1.0, 0.0})
                         s->Go(room.middle + at * room.reach, speed, 0.3);
                     });
  }

  // Amplitude falls with the frequency so that speed and acceleration keep their bounds.
  Program Chirp(double highest) const {
    constexpr double kLowest = 0.2, kDuration = 10.0;
    Program out{"a chirp from " + TwoDigits(kLowest) + " to " + TwoDigits(highest) + " Hz", {}, kDuration};
    for (size_t i = 0; i < joints_.size(); ++i) {
      const Room room = rooms_[i];
      const double phase = 0.7 * static_cast<double>(i);
      out.paths.push_back([=](double t) {
        const double x = std::clamp(t, 0.0, kDuration), slope = (highest - kLowest) / kDuration;
        const double w = 2 * std::numbers::pi * (kLowest + slope * x);
        const double size = std::min({0.8 * room.reach, 0.7 * room.top / w, kAcceleration / (w * w)});
        const double in = std::clamp(x, 0.0, 1.0), fade = std::clamp(kDuration - x, 0.0, 1.0);
        const double window = in * in * (3 - 2 * in) * fade * fade * (3 - 2 * fade);
        const double angle = 2 * std::numbers::pi * (kLowest * x + 0.5 * slope * x * x) + phase;
        return room.middle + window * size * std::sin(angle);
      });
    }
    return out;
  }

  std::string Unit() const { return model_.joint(joints_.front()).is_revolute() ? " rad" : " m"; }

  std::optional<ProbeMotion> Sampled(const Program& program) {
    double slower = 1.0;
    for (int attempt = 0; attempt < kSlowDowns; ++attempt, slower *= 1.25) {
      ProbeMotion motion = Rows(program, slower);
      if (motion.q.cols() < 3) return {};
      if (!Keeps(motion)) continue;
      std::vector<std::string> who;
      for (const int j : joints_) who.push_back(model_.joint(j).name);
      motion.description = Listed(who) + ": " + program.what +
                           (slower > 1 ? ", slowed down by " + TwoDigits(slower) : "") + ", " +
                           std::to_string(std::lround(motion.t.back())) + " s";
      return motion;
    }
    return {};
  }

  ProbeMotion Rows(const Program& program, double slower) const {
    constexpr double h = 1e-3;
    ProbeMotion out;
    const int rows = 1 + static_cast<int>(std::ceil((program.duration * slower + 0.2) / kRow));
    out.q = pose_.replicate(1, rows);
    out.v.setZero(data_.n, rows), out.a.setZero(data_.n, rows);
    for (int k = 0; k < rows; ++k) {
      out.t.push_back(k * kRow);
      const double t = k * kRow / slower;
      for (size_t i = 0; i < joints_.size(); ++i) {
        const Path& path = program.paths[i];
        const double before = path(t - h), now = path(t), after = path(t + h);
        out.q(joints_[i], k) = now;
        if (k == 0 || k + 1 == rows) continue;
        out.v(joints_[i], k) = (after - before) / (2 * h * slower);
        out.a(joints_[i], k) = (after - 2 * now + before) / (h * h * slower * slower);
      }
    }
    return out;
  }

  // Velocities and the nominal model's torques within a share of their limits.
  bool Keeps(const ProbeMotion& motion) {
    VectorXd torque(data_.n);
    for (Eigen::Index k = 0; k < motion.q.cols(); ++k) {
      dynamics::Rnea(mechanism_, workspace_, motion.q.col(k), motion.v.col(k), motion.a.col(k), torque);
      for (int j = 0; j < data_.n; ++j) {
        const model::Joint& joint = model_.joint(j);
        if (joint.velocity > 0 && std::abs(motion.v(j, k)) > 1.01 * kShare * joint.velocity) return false;
        if (joint.effort > 0 && std::abs(torque[j]) > kShare * joint.effort) return false;
      }
    }
    return true;
  }

  const model::RobotModel& model_;
  dynamics::Mechanism mechanism_;
  dynamics::Workspace workspace_;
  const FitData& data_;
  std::vector<int> joints_;
  std::vector<Room> rooms_;
  double slowest_ = 1e300, top_ = 0;
  VectorXd pose_;
};

}  // namespace

std::vector<ProbeMotion> ProbeMotions(const FitSetting& setting, const std::vector<int>& joints) {
  if (joints.empty()) return {};
  return Maker(setting, joints).Run();
}

}  // namespace rg::diagnosis
