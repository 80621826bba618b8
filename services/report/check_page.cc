#include "services/report/check_page.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "common/model/robot_model.h"
#include "services/diagnosis/data/words.h"
#include "services/report/page.h"

namespace rg::report {
namespace {

using diagnosis::EffectShows;
using diagnosis::FileFigures;
using diagnosis::JointFigures;
using diagnosis::Listed;
using diagnosis::SetCheck;
using recordings::Recording;
using recordings::RecordingSet;

constexpr int kBuckets = 600;         // per plot, of two points each
constexpr double kWidestGap = 0.03;   // of all that was recorded, as drawn
constexpr double kRoom = 0.08;        // above and below what was measured, of its range
constexpr double kLimitWithin = 0.6;  // of the range, up to which a limit beyond it is drawn

std::string OrDash(double x) { return std::isfinite(x) ? FormatNumber(x) : "–"; }

std::string Limits(const model::Joint& joint) {
  return std::isfinite(joint.lower) || std::isfinite(joint.upper)
             ? OrDash(joint.lower) + " to " + OrDash(joint.upper)
             : "–";
}

// Where each row of each piece of a recording is drawn: one behind the other, gaps no wider than they need
// be.
struct Axis {
  std::vector<std::vector<double>> x;  // [piece][row]
  std::vector<Band> bands;
};

Axis AxisOf(const RecordingSet& set, const SetCheck& check) {
  Axis axis;
  double recorded = 0;
  for (const FileFigures& f : check.survey.files) recorded += f.rows * f.period;
  const double widest = kWidestGap * recorded, between = 0.3 * widest;
  double at = 0;
  for (size_t i = 0; i < set.recordings.size(); ++i) {
    const Recording& r = set.recordings[i];
    const Recording* before = i > 0 ? &set.recordings[i - 1] : nullptr;
    if (before != nullptr && before->name == r.name && before->split == r.split) {
      const double gap = std::min(widest, r.t[0] - before->t[before->rows() - 1]);
      axis.bands.push_back({Band::Kind::kMissing, at, at + gap});
      at += gap;
    } else if (before != nullptr) {
      at += between;
    }
    std::vector<double> x;
    for (const double t : r.t) x.push_back(at + t - r.t[0]);
    if (r.split == recordings::Split::kHoldout) axis.bands.push_back({Band::Kind::kAside, at, x.back()});
    at = x.back();
    axis.x.push_back(std::move(x));
  }
  return axis;
}

// Rows of one kind as drawn: the least and the most of each of some hundred buckets, NaN between pieces.
using RowOf = Eigen::VectorXd (*)(const Recording&, int joint);

class Drawing {
 public:
  Drawing(const RecordingSet& set, const SetCheck& check) : set_(set), axis_(AxisOf(set, check)) {
    size_t rows = 0;
    for (const auto& x : axis_.x) rows += x.size();
    stride_ = std::max<size_t>(1, rows / kBuckets);
  }

  const std::vector<Band>& bands() const { return axis_.bands; }

  Series Of(const std::string& name, int joint, RowOf row) const {
    Series out{name, {}, {}};
    for (size_t i = 0; i < set_.recordings.size(); ++i) {
      const Eigen::VectorXd y = row(set_.recordings[i], joint);
      if (y.size() == 0) continue;
      const size_t rows = axis_.x[i].size();
      for (size_t first = 0; first < rows; first += stride_)
        Bucket(y, i, first, std::min(first + stride_, rows), &out);
      Break(&out);
    }
    return out;
  }

 private:
  void Bucket(const Eigen::VectorXd& y, size_t recording, size_t first, size_t last, Series* out) const {
    size_t low = first, high = first;
    for (size_t k = first; k < last; ++k) {
      if (y[static_cast<long>(k)] < y[static_cast<long>(low)]) low = k;
      if (y[static_cast<long>(k)] > y[static_cast<long>(high)]) high = k;
    }
    for (const size_t k : {std::min(low, high), std::max(low, high)}) {
      if (!out->x.empty() && out->x.back() == axis_.x[recording][k]) continue;
      out->x.push_back(axis_.x[recording][k]), out->y.push_back(y[static_cast<long>(k)]);
    }
  }

  static void Break(Series* out) {
    if (out->x.empty()) return;
    out->x.push_back(out->x.back() + 1e-6), out->y.push_back(std::nan(""));
  }

  const RecordingSet& set_;
  Axis axis_;
  size_t stride_ = 1;
};

// Limits that are near what was measured, as dashed lines over all of it; the range shown holds them.
void AddLimits(double lower, double upper, Plot* plot) {
  double low = std::numeric_limits<double>::infinity(), high = -low;
  for (const Series& s : plot->series) {
    for (const double y : s.y) {
      if (std::isfinite(y)) low = std::min(low, y), high = std::max(high, y);
    }
  }
  if (!(low <= high)) return;
  const double range = std::max(1e-9, high - low);
  const std::vector<double> x = plot->series.front().x;
  const auto add = [&](const char* name, double limit) {
    if (!std::isfinite(limit) || limit < low - kLimitWithin * range || limit > high + kLimitWithin * range)
      return;
    plot->series.push_back({name, x, std::vector<double>(x.size(), limit), SeriesStyle::kDashed, 6});
    plot->y_low = std::min(plot->y_low, limit), plot->y_high = std::max(plot->y_high, limit);
  };
  plot->y_low = low, plot->y_high = high;
  add("lower limit", lower), add("upper limit", upper);
  const double room = kRoom * (plot->y_high - plot->y_low) + 1e-9;
  plot->y_low -= room, plot->y_high += room;
}

std::vector<Plot> PlotsOf(const RecordingSet& set, const sim::Plant& plant, const SetCheck& check) {
  const Drawing drawing(set, check);
  std::vector<Plot> out;
  const auto any = [&](bool (Recording::*has)() const) {
    return std::any_of(set.recordings.begin(), set.recordings.end(),
                       [&](const Recording& r) { return (r.*has)(); });
  };
  const auto push = [&](std::string title, std::string unit, std::vector<Series> series, double lower,
                        double upper) {
    Plot plot{std::move(title), "recordings one behind the other [s]", std::move(unit), std::move(series)};
    AddLimits(lower, upper, &plot);
    plot.bands = drawing.bands(), plot.breaks = true;
    out.push_back(std::move(plot));
  };
  for (int j = 0; j < check.survey.n; ++j) {
    const model::Joint& joint = plant.model().joint(j);
    const bool revolute = joint.is_revolute();
    push(joint.name, revolute ? "position [rad]" : "position [m]",
         {drawing.Of("position", j, [](const Recording& r, int i) -> Eigen::VectorXd { return r.q.row(i); })},
         joint.lower, joint.upper);
    if (any(&Recording::has_velocity))
      push(joint.name, revolute ? "velocity [rad/s]" : "velocity [m/s]",
           {drawing.Of("velocity", j,
                       [](const Recording& r, int i) -> Eigen::VectorXd {
                         return r.has_velocity() ? Eigen::VectorXd(r.v.row(i)) : Eigen::VectorXd();
                       })},
           -joint.velocity, joint.velocity);
    std::vector<Series> efforts;
    if (any(&Recording::has_effort_command))
      efforts.push_back(drawing.Of("commanded", j, [](const Recording& r, int i) -> Eigen::VectorXd {
        return r.has_effort_command() ? Eigen::VectorXd(r.effort_command.row(i)) : Eigen::VectorXd();
      }));
    if (any(&Recording::has_effort_measured))
      efforts.push_back(drawing.Of("measured", j, [](const Recording& r, int i) -> Eigen::VectorXd {
        return r.has_effort_measured() ? Eigen::VectorXd(r.effort_measured.row(i)) : Eigen::VectorXd();
      }));
    push(joint.name, revolute ? "effort [N·m]" : "effort [N]", std::move(efforts), -joint.effort,
         joint.effort);
  }
  return out;
}

void Summary(const sim::Plant& plant, const SetCheck& check, const std::vector<EffectShows>& effects,
             Page* page) {
  double seconds = 0;
  size_t gaps = 0;
  for (const FileFigures& f : check.survey.files) seconds += f.duration, gaps += f.gaps.size();
  long moved = 0, shown = 0;
  for (const JointFigures& f : check.survey.joints) moved += f.moved ? 1 : 0;
  for (const EffectShows& e : effects) shown += e.shows ? 1 : 0;
  const size_t odd = check.warnings.size();
  page->Lead(!check.refusal.ok()
                 ? "These recordings cannot be what they say they are; nothing is diagnosed of them."
             : odd == 0 ? "Nothing about these recordings is odd."
             : odd == 1 ? "One thing about these recordings is worth knowing first."
                        : std::to_string(odd) + " things about these recordings are worth knowing first.");
  if (!check.refusal.ok()) page->Note(check.refusal.message(), true);
  for (const std::string& warning : check.warnings) page->Note(warning);
  page->Cards({{"recordings", std::to_string(check.survey.files.size()), FormatNumber(seconds) + " s"},
               {"rows", FormatNumber(1 / check.survey.FirstToFit().period) + " Hz",
                gaps == 0 ? "no gaps" : std::to_string(gaps) + " gaps"},
               {"joints", std::to_string(moved) + " of " + std::to_string(plant.num_joints()), "moved"},
               {"effects", std::to_string(shown) + " of " + std::to_string(effects.size()), "could show"}});
}

void Recordings(const SetCheck& check, Page* page) {
  page->Heading("Recordings");
  Table table{{"recording", "split", "duration [s]", "rows", "rate [Hz]", "gaps", "rows missing", "columns"},
              {},
              {},
              {0, 1, 7}};
  for (const FileFigures& f : check.survey.files) {
    std::string columns;
    for (const std::string& kind : f.columns) columns += (columns.empty() ? "" : ", ") + kind;
    table.rows.push_back({f.name, f.split == recordings::Split::kFit ? "fit" : "holdout",
                          FormatNumber(f.duration), std::to_string(f.rows), FormatNumber(1 / f.period),
                          std::to_string(f.gaps.size()), FormatNumber(f.missing), columns});
  }
  page->AddTable(table);
}

void Joints(const RecordingSet& set, const sim::Plant& plant, const SetCheck& check, Page* page) {
  page->Heading("Joints");
  std::string given = "estimated from the data; the manifest says ";
  given += set.noise.position_stddev ? FormatNumber(*set.noise.position_stddev) : "nothing";
  given += " for the noise, ";
  given += set.noise.position_resolution ? FormatNumber(*set.noise.position_resolution) : "nothing";
  Table table{{"joint", "moved", "from", "to", "limits", "peak speed", "limit", "effort RMS", "peak", "limit",
               "noise", "step"},
              {},
              "SI units. Noise and step of the positions are " + given + " for their step.",
              {0, 1}};
  for (int j = 0; j < check.survey.n; ++j) {
    const model::Joint& joint = plant.model().joint(j);
    const JointFigures& f = check.survey.joints[static_cast<size_t>(j)];
    table.rows.push_back({joint.name, f.moved ? "yes" : "no", FormatNumber(f.low), FormatNumber(f.high),
                          Limits(joint), FormatNumber(f.peak_speed), OrDash(joint.velocity),
                          FormatNumber(f.effort_rms), FormatNumber(f.peak_effort), OrDash(joint.effort),
                          FormatNumber(check.survey.estimated.position_stddev[j]),
                          FormatNumber(check.survey.estimated.position_resolution[j])});
  }
  page->AddTable(table);
  std::vector<std::string> locked;
  for (const auto& [joint, q] : diagnosis::LockedJoints(set))
    locked.push_back(joint + " at " + FormatNumber(q));
  if (!locked.empty()) page->Paragraph("Locked: " + Listed(locked) + ".");
}

void Effects(const std::vector<EffectShows>& effects, int joints, Page* page) {
  page->Heading("What these recordings could show");
  page->Paragraph(
      "By what each effect needs of a motion. That an effect could show does not say that it is there, nor "
      "how "
      "small a one would be found.");
  Table table{{"effect", "could show on", "within", "not on"}, {}, {}, {0, 1, 2, 3}};
  for (const EffectShows& e : effects) table.rows.push_back(diagnosis::InWords(e, joints));
  page->AddTable(table);
}

}  // namespace

std::string CheckPage(const RecordingSet& set, const sim::Plant& plant, const SetCheck& check,
                      const std::vector<EffectShows>& effects) {
  Page page("Recordings of " + plant.model().name(), set.folder);
  Summary(plant, check, effects, &page);
  Recordings(check, &page);
  Joints(set, plant, check, &page);
  page.Heading("What was measured");
  page.Paragraph(
      "All recordings one behind the other, the least and the most of each short stretch. Red: rows are "
      "missing (long gaps are drawn short). Grey: kept aside to judge by. Dashed: limits of the URDF.");
  page.AddPlots(PlotsOf(set, plant, check), 340);
  Effects(effects, check.survey.n, &page);
  return page.Html();
}

}  // namespace rg::report
