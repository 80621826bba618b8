#include "services/diagnosis/data/motion_survey.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

#include "common/dynamics/dynamics.h"
#include "common/recordings/time_stamps.h"
#include "common/recordings/velocity_lag.h"
#include "services/diagnosis/data/motion.h"
#include "services/sysid/drive_signal.h"

namespace rg::diagnosis {

using recordings::Recording;

namespace {

constexpr double kBlock = 0.05;           // s: rows are averaged over such blocks to detect motion
constexpr double kBeyondNoise = 3.0;      // stddev of a block's step
constexpr double kHalfAverage = 0.015;    // s, of the effort
constexpr double kBetweenSamples = 0.02;  // s, at least
constexpr long kMostSamples = 4000;       // of a set
constexpr double kMostWork = 2e7;         // rows that the samples' local polynomials read, over all joints
constexpr int kLeastRows = 10;
constexpr int kEdge = 3;  // rows at either end of a stretch without a gap, left out: poor accelerations
constexpr double kHeld =
    0.5;  // share of the needed torque missing, above which something else holds a still joint
constexpr double kLeastPositionNoise = 1e-6, kLeastVelocityNoise = 1e-5;

std::vector<std::string> ColumnsOf(const Recording& r) {
  std::vector<std::string> out = {"position"};
  if (r.has_velocity()) out.emplace_back("velocity");
  if (r.has_effort_command()) out.emplace_back("effort_command");
  if (r.has_effort_measured()) out.emplace_back("effort_measured");
  std::set<std::string> others;
  for (const auto& [name, column] : r.other) others.insert(name.substr(0, name.find('.')));
  out.insert(out.end(), others.begin(), others.end());
  return out;
}

FileFigures FiguresOf(const Recording& r) {
  FileFigures f;
  f.name = r.name, f.split = r.split, f.rows = r.rows();
  f.period = std::max(1e-9, r.SamplePeriod());
  f.start = r.t[0] + r.time_offset, f.duration = r.t[r.rows() - 1] - r.t[0];
  f.columns = ColumnsOf(r);
  const double longest = recordings::LongestStep(r.t);
  for (int k = 1; k < r.rows(); ++k) {
    const double step = r.t[k] - r.t[k - 1];
    if (step > longest) {
      f.gaps.emplace_back(r.t[k - 1] + r.time_offset, r.t[k] + r.time_offset);
    } else {
      f.missing += std::max(0.0, std::round(step / f.period) - 1);
    }
  }
  return f;
}

// `piece` is what comes behind `file` of the same recording.
void Join(const FileFigures& piece, int longest_piece, FileFigures* file) {
  file->gaps.emplace_back(file->start + file->duration, piece.start);
  file->gaps.insert(file->gaps.end(), piece.gaps.begin(), piece.gaps.end());
  if (piece.rows > longest_piece) file->period = piece.period;
  file->duration = piece.start + piece.duration - file->start;
  file->rows += piece.rows, file->missing += piece.missing;
}

std::vector<FileFigures> FilesOf(const recordings::RecordingSet& set) {
  std::vector<FileFigures> out;
  int longest = 0;
  for (const Recording& r : set.recordings) {
    const FileFigures piece = FiguresOf(r);
    const bool goes_on = !out.empty() && out.back().name == r.name && out.back().split == r.split &&
                         piece.start > out.back().start + out.back().duration;
    if (goes_on) {
      Join(piece, longest, &out.back());
    } else {
      out.push_back(piece);
    }
    longest = std::max(goes_on ? longest : 0, piece.rows);
  }
  return out;
}

// Rows of one recording's joint averaged over blocks, none of which spans a gap.
struct Blocks {
  std::vector<double> t, q;
  std::vector<int> rows;
  std::vector<char> follows;  // on the block before, without a gap
};

Blocks BlocksOf(const Recording& r, int j) {
  Blocks out;
  const double longest = recordings::LongestStep(r.t);
  bool follows = false;
  for (int first = 0; first < r.rows();) {
    int last = first;
    while (last + 1 < r.rows() && r.t[last + 1] - r.t[first] < kBlock && r.t[last + 1] - r.t[last] <= longest)
      ++last;
    const int count = last - first + 1;
    out.t.push_back(r.t.segment(first, count).mean());
    out.q.push_back(r.q.row(j).segment(first, count).mean());
    out.rows.push_back(count);
    out.follows.push_back(follows);
    follows = last + 1 < r.rows() && r.t[last + 1] - r.t[last] <= longest;
    first = last + 1;
  }
  return out;
}

double Quantile(std::vector<double>* x, double p) {
  if (x->empty()) return 0;
  const auto at = x->begin() + static_cast<long>(p * static_cast<double>(x->size() - 1));
  std::nth_element(x->begin(), at, x->end());
  return *at;
}

class Surveyor {
 public:
  Surveyor(const recordings::RecordingSet& set, const sim::Plant& plant)
      : set_(set), plant_(plant), mechanism_(sysid::MechanismOf(plant, plant.parameters().Nominal())) {}

  Result<MotionSurvey> Run() {
    out_.n = plant_.num_joints();
    if (set_.Fit().empty())
      return InvalidError("no recording is there to fit: give one the split \"fit\" in the manifest");
    for (const Recording& r : set_.recordings) {
      if (r.drive_effort().size() == 0) return InvalidError(r.name + ": no effort drives the model");
      if (r.rows() < kLeastRows)
        return InvalidError(r.name + ": fewer than " + std::to_string(kLeastRows) +
                            " rows, too little to fit; leave it out of the manifest");
    }
    out_.files = FilesOf(set_);
    EstimateNoise();
    for (int j = 0; j < out_.n; ++j) out_.joints.push_back(JointOf(j));
    TakeSamples();
    for (int j = 0; j < out_.n; ++j) FromSamples(j);
    out_.velocity_lag = VectorXd::Zero(out_.n);
    const recordings::VelocityLag lag = recordings::EstimateVelocityLag(*set_.Fit().front());
    for (int j = 0; j < out_.n; ++j) {
      if (lag.error[j] > 0) out_.velocity_lag[j] = lag.lag[j];
    }
    return std::move(out_);
  }

 private:
  void EstimateNoise() {
    recordings::RecordingSet bare;
    bare.joints = set_.joints, bare.recordings = set_.recordings;
    out_.estimated = recordings::EstimateSensorNoise(bare);
    recordings::SensorNoise noise = out_.estimated;
    if (set_.noise.position_stddev) noise.position_stddev.setConstant(*set_.noise.position_stddev);
    if (set_.noise.position_resolution)
      noise.position_resolution.setConstant(*set_.noise.position_resolution);
    if (set_.noise.velocity_stddev) noise.velocity_stddev.setConstant(*set_.noise.velocity_stddev);
    out_.noise = WorkingNoise(noise, set_.noise);
  }

  JointFigures JointOf(int j) const {
    JointFigures f;
    f.prescribed = set_.Fit().front()->IsPrescribed(j);
    f.low = std::numeric_limits<double>::infinity(), f.high = -f.low;
    f.temperature_low = f.temperature_high = std::nan("");
    double squares = 0, rows = 0;
    for (size_t i = 0; i < set_.recordings.size(); ++i) {
      const Recording& r = set_.recordings[i];
      f.low = std::min(f.low, r.q.row(j).minCoeff()), f.high = std::max(f.high, r.q.row(j).maxCoeff());
      if (r.has_velocity()) f.peak_speed = std::max(f.peak_speed, r.v.row(j).cwiseAbs().maxCoeff());
      const auto u = r.drive_effort().row(j);
      f.peak_effort = std::max(f.peak_effort, u.cwiseAbs().maxCoeff());
      squares += u.squaredNorm(), rows += r.rows();
      if (r.split == recordings::Split::kFit) {
        const auto q = r.q.row(j).array();
        f.spread = std::max(f.spread, std::sqrt((q - q.mean()).square().mean()));
      }
      Temperature(r, set_.joints[j], &f);
    }
    f.effort_rms = std::sqrt(squares / rows);
    OverBlocks(j, &f);
    return f;
  }

  static void Temperature(const Recording& r, const std::string& joint, JointFigures* f) {
    const auto column = r.other.find("temperature." + joint);
    if (column == r.other.end()) return;
    for (const double x : column->second) {
      if (!std::isfinite(x)) continue;
      f->temperature_low = std::isfinite(f->temperature_low) ? std::min(f->temperature_low, x) : x;
      f->temperature_high = std::isfinite(f->temperature_high) ? std::max(f->temperature_high, x) : x;
    }
  }

  void OverBlocks(int j, JointFigures* f) const {
    double low = std::numeric_limits<double>::infinity(), high = -low, squares = 0, seconds = 0;
    std::vector<double> speeds;
    std::vector<std::pair<double, int>> moving;  // speed, rows
    for (size_t i = 0; i < set_.recordings.size(); ++i) {
      const Recording& r = set_.recordings[i];
      const bool fitted = r.split == recordings::Split::kFit;
      const Blocks blocks = BlocksOf(r, j);
      double moved_s = 0;
      for (size_t b = 0; b < blocks.t.size(); ++b) {
        if (fitted) low = std::min(low, blocks.q[b]), high = std::max(high, blocks.q[b]);
        if (!blocks.follows[b]) continue;
        const double dt = blocks.t[b] - blocks.t[b - 1], step = blocks.q[b] - blocks.q[b - 1];
        const double speed = std::abs(step) / dt;
        const bool moves = std::abs(step) > kBeyondNoise * StepNoise(j, blocks.rows[b - 1], blocks.rows[b]);
        if (moves && !r.has_velocity()) f->peak_speed = std::max(f->peak_speed, speed);
        if (!fitted) continue;
        squares += speed * speed * dt, seconds += dt;
        if (!moves) continue;
        (step > 0 ? f->up : f->down) += std::abs(step);
        moved_s += dt;
        speeds.push_back(speed), moving.emplace_back(speed, blocks.rows[b]);
      }
      f->moving_s = std::max(f->moving_s, moved_s);
    }
    f->moved = high - low >= kMovesBy * out_.noise.position_stddev[j];
    f->speed = std::sqrt(squares / std::max(1e-9, seconds));
    f->slow = Quantile(&speeds, 0.1), f->fast = Quantile(&speeds, 0.9);
    const double usual = Quantile(&speeds, 0.5);
    for (const auto& [speed, rows] : moving) f->slow_rows += speed < kSlow * usual ? rows : 0;
  }

  // Stddev of the difference of two blocks' means. Rows within a step of an encoder share its error.
  double StepNoise(int j, int a, int b) const {
    const double white = std::pow(out_.noise.position_stddev[j], 2),
                 grid = std::pow(out_.noise.position_resolution[j], 2) / 12;
    const double rest = std::max(0.0, white - grid);
    return std::sqrt(rest / a + rest / b + 2 * grid);
  }

  void TakeSamples() {
    double seconds = 0, rows_per_second = 1;
    for (const FileFigures& f : out_.files) {
      if (f.split != recordings::Split::kFit) continue;
      seconds += f.rows * f.period;
      rows_per_second = std::max(rows_per_second, 1.0 / f.period);
    }
    const double window = 0.1 * rows_per_second;
    const double most = std::min<double>(kMostSamples, kMostWork / (window * out_.n));
    const double every = std::max(kBetweenSamples, seconds / most);
    for (const Recording* r : set_.Fit()) out_.samples.push_back(SamplesOf(*r, every));
  }

  // Rows k after which a sample is taken, in the middle of the row's interval.
  static std::vector<int> Instants(const Recording& r, double every) {
    const double gap = recordings::LongestStep(r.t), period = r.SamplePeriod();
    std::vector<int> out;
    int stretch = 0;                   // its first row
    const auto close = [&](int end) {  // rows [stretch, end]
      double next = -std::numeric_limits<double>::infinity();
      for (int k = stretch + kEdge; k + 1 + kEdge <= end; ++k) {
        if (r.t[k] < next) continue;
        out.push_back(k), next = r.t[k] + every - 0.5 * period;
      }
    };
    for (int k = 1; k < r.rows(); ++k) {
      if (r.t[k] - r.t[k - 1] <= gap) continue;
      close(k - 1), stretch = k;
    }
    close(r.rows() - 1);
    return out;
  }

  MotionSamples SamplesOf(const Recording& r, double every) {
    const std::vector<int> rows = Instants(r, every);
    const auto S = static_cast<Eigen::Index>(rows.size());
    const SmoothMotion motion(r, out_.noise);
    half_span_ = motion.half_span();
    MotionSamples out;
    for (MatrixXd* m : {&out.q, &out.v, &out.a, &out.u, &out.rigid, &out.gravity, &out.needed})
      m->resize(out_.n, S);
    VectorXd q, v, a, torque(out_.n);
    for (Eigen::Index s = 0; s < S; ++s) {
      const int k = rows[s];
      out.t.push_back(0.5 * (r.t[k] + r.t[k + 1]));
      motion.At(out.t.back(), &q, &v, &a);
      out.q.col(s) = q, out.v.col(s) = v, out.a.col(s) = a;
      out.u.col(s) = Effort(r, k);
      dynamics::Rnea(mechanism_, workspace_, q, v, a, torque);
      out.rigid.col(s) = torque;
      dynamics::GravityTorque(mechanism_, workspace_, q, torque);
      out.gravity.col(s) = torque;
      out.needed.col(s) = out.rigid.col(s);
      if (set_.effort_excludes_gravity) out.needed.col(s) -= torque;
    }
    return out;
  }

  // A command is constant from its row to the next; a measured effort belongs to its row.
  static VectorXd Effort(const Recording& r, int k) {
    const bool held = r.drive == recordings::EffortKind::kCommand;
    int first = k, last = held ? k : k + 1;
    const double middle = 0.5 * (r.t[k] + r.t[k + 1]);
    const auto near = [&](int row) {
      const double at = held ? 0.5 * (r.t[row] + r.t[row + 1]) : r.t[row];
      return std::abs(at - middle) <= kHalfAverage;
    };
    while (first > 0 && last + 2 < r.rows() && near(first - 1) && near(last + 1)) --first, ++last;
    return r.drive_effort().middleCols(first, last - first + 1).rowwise().mean();
  }

  void FromSamples(int j) {
    JointFigures& f = out_.joints[j];
    double squares = 0, sum = 0, effort2 = 0, load = 0, load2 = 0, moving = 0;
    f.effort_least = std::numeric_limits<double>::infinity(), f.effort_most = -f.effort_least;
    for (const MotionSamples& m : out_.samples) {
      squares += m.a.row(j).squaredNorm();
      sum += m.u.row(j).sum(), effort2 += m.u.row(j).squaredNorm();
      if (m.u.cols() == 0) continue;
      f.effort_least = std::min(f.effort_least, m.u.row(j).minCoeff());
      f.effort_most = std::max(f.effort_most, m.u.row(j).maxCoeff());
      for (Eigen::Index s = 0; s < m.u.cols(); ++s) {
        if (std::abs(m.v(j, s)) < kSlow * f.speed) continue;
        const double size = std::abs(m.u(j, s));
        load += size, load2 += size * size, ++moving;
      }
    }
    const double count = std::max(1.0, static_cast<double>(out_.Samples()));
    f.acceleration = std::sqrt(squares / count);
    f.effort_stddev = std::sqrt(std::max(0.0, effort2 / count - std::pow(sum / count, 2)));
    f.load_mean = load / std::max(1.0, moving);
    f.load_stddev = std::sqrt(std::max(0.0, load2 / std::max(1.0, moving) - f.load_mean * f.load_mean));
    SmoothingNoise(j, &f);
  }

  // Of a local polynomial over `rows` positions or velocities: slope's and curvature's stddev.
  void SmoothingNoise(int j, JointFigures* f) {
    const double period = out_.FirstToFit().period, T = 2 * half_span_;
    const double rows = std::max(1.0, half_span_ / period);
    const double q = out_.noise.position_stddev[j] / std::sqrt(rows);
    double speed = 1.5 * q / half_span_, acceleration = std::sqrt(720.0) * q / (T * T);
    if (set_.Fit().front()->has_velocity()) {
      const double v = out_.noise.velocity_stddev[j] / std::sqrt(rows);
      speed = std::min(speed, v), acceleration = std::min(acceleration, std::sqrt(12.0) * v / T);
    }
    if (out_.speed_noise.size() == 0) out_.speed_noise = VectorXd::Zero(out_.n);
    out_.speed_noise[j] = speed, f->acceleration_noise = acceleration;
  }

  const recordings::RecordingSet& set_;
  const sim::Plant& plant_;
  dynamics::Mechanism mechanism_;
  dynamics::Workspace workspace_;
  double half_span_ = 0.05;
  MotionSurvey out_;
};

}  // namespace

long MotionSurvey::Samples() const {
  long count = 0;
  for (const MotionSamples& m : samples) count += static_cast<long>(m.t.size());
  return count;
}

VectorXd MotionSurvey::Along(MatrixXd MotionSamples::*of, int joint) const {
  VectorXd out(Samples());
  long at = 0;
  for (const MotionSamples& m : samples) {
    const auto S = static_cast<long>(m.t.size());
    out.segment(at, S) = (m.*of).row(joint).transpose(), at += S;
  }
  return out;
}

const FileFigures& MotionSurvey::FirstToFit() const {
  return *std::ranges::find_if(files,
                               [](const FileFigures& f) { return f.split == recordings::Split::kFit; });
}

recordings::SensorNoise WorkingNoise(recordings::SensorNoise noise, const recordings::NoiseSpec& given) {
  for (Eigen::Index j = 0; j < noise.position_stddev.size(); ++j) {
    const double step = noise.position_resolution[j];
    // The manifest's stddev is of the sensor before quantisation.
    double variance = noise.position_stddev[j] * noise.position_stddev[j];
    if (given.position_stddev) variance += step * step / 12.0;
    noise.position_stddev[j] = std::max(kLeastPositionNoise, std::sqrt(variance));
    noise.velocity_stddev[j] = std::max(kLeastVelocityNoise, noise.velocity_stddev[j]);
  }
  return noise;
}

Result<MotionSurvey> Survey(const recordings::RecordingSet& set, const sim::Plant& plant) {
  return Surveyor(set, plant).Run();
}

std::vector<StillJoint> StillJoints(const MotionSurvey& survey) {
  std::vector<StillJoint> out;
  for (int j = 0; j < survey.n; ++j) {
    const JointFigures& f = survey.joints[j];
    if (f.moved || f.prescribed) continue;
    StillJoint s;
    s.joint = j;
    for (const MotionSamples& m : survey.samples) {
      const VectorXd missed = (m.u.row(j) - m.needed.row(j)).transpose();
      s.missed += missed.squaredNorm(), s.needed += m.needed.row(j).squaredNorm();
      if (missed.size() > 0) s.withstood = std::max(s.withstood, missed.cwiseAbs().maxCoeff());
    }
    const double count = std::max(1.0, static_cast<double>(survey.Samples()));
    s.missed = std::sqrt(s.missed / count), s.needed = std::sqrt(s.needed / count);
    s.held = s.missed > kHeld * s.needed;
    out.push_back(s);
  }
  return out;
}

}  // namespace rg::diagnosis
