#include "services/importing/align.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <numeric>
#include <optional>

#include "common/base/printf.h"

namespace rg::importing {
namespace {

constexpr double kSecond = 1e9;
constexpr double kOtherHostNs = 0.05 * kSecond;
constexpr double kDriftWorthALineNs = 2e6;
constexpr double kMostDrift = 0.01;  // of a clock against another: more is no clock (simulated time)
constexpr int64_t kJumpBackNs = 1'000'000'000;
constexpr size_t kClockPieces = 20;

double Quantile(std::vector<double> values, double share) {
  const auto at =
      values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

// log time − stamp as a line over the stamps.
struct ClockLine {
  double middle_ns = 0.0;  // a stamp
  double offset_ns = 0.0;  // there
  double slope = 0.0;
  double span_ns = 0.0;

  double At(double stamp_ns) const { return offset_ns + slope * (stamp_ns - middle_ns); }
};

ClockLine FitClock(const Track& track) {
  const size_t n = track.stamps_ns.size();
  std::vector<double> all(n);
  for (size_t i = 0; i < n; ++i) all[i] = static_cast<double>(track.log_ns[i] - track.stamps_ns[i]);
  const auto first = static_cast<double>(track.stamps_ns.front());
  const auto last = static_cast<double>(track.stamps_ns.back());
  ClockLine line{0.5 * (first + last), Quantile(all, 0.05), 0.0, last - first};
  // The median of the slopes between the lower edges of pieces.
  const size_t pieces = std::min(kClockPieces, n / 50);
  std::vector<double> x(pieces), y(pieces), slopes;
  for (size_t p = 0; p < pieces; ++p) {
    const size_t begin = p * n / pieces, end = (p + 1) * n / pieces;
    x[p] =
        0.5 * (static_cast<double>(track.stamps_ns[begin]) + static_cast<double>(track.stamps_ns[end - 1]));
    y[p] = Quantile(
        {all.begin() + static_cast<std::ptrdiff_t>(begin), all.begin() + static_cast<std::ptrdiff_t>(end)},
        0.05);
    for (size_t q = 0; q < p; ++q)
      if (x[p] > x[q]) slopes.push_back((y[p] - y[q]) / (x[p] - x[q]));
  }
  if (slopes.empty()) return line;
  const double slope = Quantile(slopes, 0.5);
  if (std::abs(slope * line.span_ns) < kDriftWorthALineNs) return line;
  line.slope = slope;
  for (size_t p = 0; p < pieces; ++p) y[p] -= slope * (x[p] - line.middle_ns);
  line.offset_ns = Quantile(y, 0.5);
  return line;
}

// Sorted by stamp, of equal stamps the first only; says what it did.
Status PutInOrder(const std::string& log_name, Track* track, std::vector<std::string>* notes) {
  const size_t n = track->stamps_ns.size();
  size_t backwards = 0;
  int64_t furthest = 0;
  for (size_t i = 1; i < n; ++i) {
    const int64_t step = track->stamps_ns[i] - track->stamps_ns[i - 1];
    if (step < 0) ++backwards;
    furthest = std::min(furthest, step);
  }
  const std::string where = log_name + (track->topic.empty() ? "" : ": topic " + track->topic);
  if (furthest < -kJumpBackNs && track->clock != "log") {
    return InvalidError(where + ": its stamps jump back by " +
                        Printf("%.3f", -1e-9 * static_cast<double>(furthest)) + " s" +
                        (track->clock.empty() ? "" : ": say \"clock\": \"log\" in the mapping"));
  }
  std::vector<size_t> order(n);
  std::iota(order.begin(), order.end(), size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](size_t a, size_t b) { return track->stamps_ns[a] < track->stamps_ns[b]; });
  const auto last = std::unique(order.begin(), order.end(), [&](size_t a, size_t b) {
    return track->stamps_ns[a] == track->stamps_ns[b];
  });
  const auto repeated = static_cast<size_t>(order.end() - last);
  order.erase(last, order.end());
  if (backwards > 0 && track->clock != "log")
    notes->push_back(where + ": " + std::to_string(backwards) + " stamps went back, sorted");
  if (repeated > 0)
    notes->push_back(where + ": " + std::to_string(repeated) + " repeated stamps, the first of each kept");
  if (backwards == 0 && repeated == 0) return Status::Ok();
  const auto apply = [&](auto& values) {
    auto sorted = values;
    sorted.resize(order.size());
    for (size_t i = 0; i < order.size(); ++i) sorted[i] = values[order[i]];
    values = std::move(sorted);
  };
  if (!track->log_ns.empty()) apply(track->log_ns);
  for (auto& values : track->values) apply(values);
  apply(track->stamps_ns);
  return Status::Ok();
}

double PeriodNs(const std::vector<int64_t>& stamps) {
  if (stamps.size() < 2) return 0.0;
  std::vector<double> steps(stamps.size() - 1);
  for (size_t i = 0; i < steps.size(); ++i) steps[i] = static_cast<double>(stamps[i + 1] - stamps[i]);
  return Quantile(std::move(steps), 0.5);
}

// The samples of one column that are there.
struct Series {
  std::vector<int64_t> stamps;
  std::vector<double> values;
  double period_ns = 0.0;
  double gap_ns = 0.0;  // a longer step is a gap
};

Series SeriesOf(const Track& track, size_t column, bool keep_nan) {
  Series series;
  const std::vector<double>& values = track.values[column];
  for (size_t i = 0; i < values.size(); ++i) {
    if (!keep_nan && !std::isfinite(values[i])) continue;
    series.stamps.push_back(track.stamps_ns[i]);
    series.values.push_back(values[i]);
  }
  series.period_ns = PeriodNs(series.stamps);
  series.gap_ns = std::max(5.0 * series.period_ns, 0.1 * kSecond);
  return series;
}

enum class Missing { kNo, kOutside, kGap };

double Between(const Series& s, size_t j, int64_t t, bool wraps) {
  double rise = s.values[j + 1] - s.values[j];
  if (wraps) rise = std::remainder(rise, 2.0 * std::numbers::pi);
  return s.values[j] +
         rise * (static_cast<double>(t - s.stamps[j]) / static_cast<double>(s.stamps[j + 1] - s.stamps[j]));
}

Missing SampleAt(const Series& s, int64_t t, const WantedColumn& column, double* value) {
  const auto after = std::upper_bound(s.stamps.begin(), s.stamps.end(), t);
  if (after == s.stamps.begin()) return Missing::kOutside;
  const auto j = static_cast<size_t>(after - s.stamps.begin()) - 1;
  *value = s.values[j];
  if (s.stamps[j] == t) return Missing::kNo;
  const bool is_last = after == s.stamps.end();
  if (is_last) {
    // A command holds for about a period; a measurement only where it was made.
    const bool holds =
        column.hold == Hold::kZeroOrder && static_cast<double>(t - s.stamps[j]) <= 1.5 * s.period_ns;
    return holds ? Missing::kNo : Missing::kOutside;
  }
  if (static_cast<double>(s.stamps[j + 1] - s.stamps[j]) > s.gap_ns) return Missing::kGap;
  if (column.hold == Hold::kLinear) *value = Between(s, j, t, column.wraps);
  return Missing::kNo;
}

class Aligner {
 public:
  Aligner(const std::vector<WantedColumn>& wanted, std::vector<Track> tracks, const std::string& log_name)
      : wanted_(wanted), tracks_(std::move(tracks)), log_name_(log_name) {}

  Result<Aligned> Run() {
    RG_RETURN_IF_ERROR(CheckThere());
    for (Track& track : tracks_) RG_RETURN_IF_ERROR(PutInOrder(log_name_, &track, &out_.notes));
    ChooseBase();
    RG_RETURN_IF_ERROR(MoveToBaseClock());
    SampleColumns();
    RG_RETURN_IF_ERROR(KeepWholeRows());
    NoteCommandLag();
    return std::move(out_);
  }

 private:
  struct Place {
    size_t track = 0, column = 0;
  };

  Status Error(const std::string& what) const { return InvalidError(log_name_ + ": " + what); }
  std::string NameOf(const Track& track) const { return track.topic.empty() ? log_name_ : track.topic; }

  Status CheckThere() {
    place_.resize(wanted_.size());
    bool any_position = false;
    for (size_t t = 0; t < tracks_.size(); ++t) {
      for (size_t c = 0; c < tracks_[t].columns.size(); ++c) place_[tracks_[t].columns[c]] = {t, c};
    }
    for (size_t i = 0; i < wanted_.size(); ++i) {
      const auto& values = tracks_[place_[i].track].values[place_[i].column];
      const bool none = std::none_of(values.begin(), values.end(), [](double v) { return std::isfinite(v); });
      if (none && wanted_[i].IsRequired()) {
        return Error((wanted_[i].topic.empty() ? "" : "topic " + wanted_[i].topic + ": ") + "field '" +
                     wanted_[i].field + "': holds no number, but is mapped to " + wanted_[i].Name());
      }
      any_position = any_position || wanted_[i].kind == "position";
    }
    return any_position ? Status::Ok() : Error("the mapping takes no position column");
  }

  void ChooseBase() {
    size_t most = 0;
    for (size_t i = 0; i < wanted_.size(); ++i) {
      if (wanted_[i].kind != "position") continue;
      const Series series = SeriesOf(tracks_[place_[i].track], place_[i].column, false);
      if (series.stamps.size() <= most) continue;
      most = series.stamps.size();
      out_.base_column = i;
    }
    base_track_ = place_[out_.base_column].track;
  }

  Status MoveToBaseClock() {
    const Track& base = tracks_[base_track_];
    const std::optional<ClockLine> base_line =
        base.log_ns.empty() ? std::nullopt : std::optional<ClockLine>(FitClock(base));
    for (size_t t = 0; t < tracks_.size(); ++t) {
      if (t == base_track_ || tracks_[t].stamps_ns.empty()) continue;
      RG_RETURN_IF_ERROR(MoveTrack(base_line, &tracks_[t]));
    }
    return Status::Ok();
  }

  Status CheckIsAClock(const std::optional<ClockLine>& line, const Track& track) const {
    if (!line || std::abs(line->slope) <= kMostDrift) return Status::Ok();
    return Error(
        "topic " + NameOf(track) + ": a second of its stamps takes " + Printf("%.3f", 1.0 + line->slope) +
        " s of the log's clock (simulated time?), so that topics with other clocks cannot be placed");
  }

  Status MoveTrack(const std::optional<ClockLine>& base_line, Track* track) {
    const std::optional<ClockLine> line =
        track->log_ns.empty() ? std::nullopt : std::optional<ClockLine>(FitClock(*track));
    if (!base_line && !line) return Status::Ok();  // both in the log's clock
    if (base_line && line && std::abs(line->offset_ns - base_line->offset_ns) <= kOtherHostNs &&
        std::abs(line->slope - base_line->slope) * line->span_ns <= kOtherHostNs) {
      return Status::Ok();  // one host's clock
    }
    RG_RETURN_IF_ERROR(CheckIsAClock(base_line, tracks_[base_track_]));
    RG_RETURN_IF_ERROR(CheckIsAClock(line, *track));
    const auto first = static_cast<double>(track->stamps_ns.front());
    const auto last = static_cast<double>(track->stamps_ns.back());
    const auto shift = [&](double stamp) {
      const double to_log = line ? line->At(stamp) : 0.0;
      if (!base_line) return to_log;
      return to_log - base_line->At(stamp + to_log - base_line->offset_ns);
    };
    ClockOffset offset{track->topic, track->clock, 1e-9 * shift(0.5 * (first + last)),
                       1e-9 * (shift(last) - shift(first))};
    for (int64_t& stamp : track->stamps_ns) stamp += std::llround(shift(static_cast<double>(stamp)));
    NoteOffset(offset);
    out_.offsets.push_back(offset);
    return Status::Ok();
  }

  void NoteOffset(const ClockOffset& offset) {
    const Track& base = tracks_[base_track_];
    std::string note = log_name_ + ": topic " + offset.topic + " (clock " + offset.clock + ") is moved by " +
                       Printf("%.6f", offset.offset_s) + " s to the clock of " + NameOf(base) + " (" +
                       base.clock + ")";
    if (offset.drift_s != 0.0)
      note += Printf(", and by %.1f ms more from its beginning to its end", 1e3 * offset.drift_s);
    out_.notes.push_back(note);
  }

  void SampleColumns() {
    const Series base = SeriesOf(tracks_[base_track_], place_[out_.base_column].column, false);
    out_.stamps_ns = base.stamps;
    const size_t rows = base.stamps.size();
    missing_.assign(rows, Missing::kNo);
    out_.columns.resize(wanted_.size());
    out_.use.resize(wanted_.size());
    for (size_t i = 0; i < wanted_.size(); ++i) {
      const WantedColumn& column = wanted_[i];
      const Series series =
          SeriesOf(tracks_[place_[i].track], place_[i].column, !column.IsRequired() && !column.topic.empty());
      out_.use[i] = {series.period_ns > 0.0 ? kSecond / series.period_ns : 0.0, series.stamps.size()};
      out_.columns[i].assign(rows, kNone);
      size_t in_gaps = 0;
      for (size_t k = 0; k < rows; ++k) {
        double value = kNone;
        const Missing missing = SampleAt(series, base.stamps[k], column, &value);
        if (missing == Missing::kNo) {
          out_.columns[i][k] = value;
        } else if (column.IsRequired()) {
          if (missing == Missing::kGap) ++in_gaps;
          missing_[k] = missing == Missing::kOutside || missing_[k] == Missing::kNo ? missing : missing_[k];
        }
      }
      if (in_gaps > 0) rows_in_gaps_of_[NameOf(tracks_[place_[i].track])] = in_gaps;
    }
  }

  Status KeepWholeRows() {
    const size_t rows = out_.stamps_ns.size();
    size_t kept = 0, outside = 0;
    for (size_t k = 0; k < rows; ++k) {
      if (missing_[k] == Missing::kOutside) ++outside;
      if (missing_[k] != Missing::kNo) continue;
      out_.stamps_ns[kept] = out_.stamps_ns[k];
      for (auto& column : out_.columns) column[kept] = column[k];
      ++kept;
    }
    if (kept < 2) return Error(NoCommonTime());
    out_.stamps_ns.resize(kept);
    for (auto& column : out_.columns) column.resize(kept);
    if (outside > 0) {
      out_.notes.push_back(log_name_ + ": " + std::to_string(outside) + " of " + std::to_string(rows) +
                           " rows lie outside the time that all columns share, left out");
    }
    for (const auto& [topic, count] : rows_in_gaps_of_) {
      out_.notes.push_back(log_name_ + ": " + std::to_string(count) + " rows lie in gaps of " + topic +
                           ", left out");
    }
    return Status::Ok();
  }

  std::string NoCommonTime() const {
    std::string spans;
    const double zero = static_cast<double>(tracks_[base_track_].stamps_ns.front());
    for (const Track& track : tracks_) {
      if (track.stamps_ns.empty()) continue;
      spans += (spans.empty() ? "" : ", ") + NameOf(track) +
               Printf(" from %.3f to %.3f s", 1e-9 * (static_cast<double>(track.stamps_ns.front()) - zero),
                      1e-9 * (static_cast<double>(track.stamps_ns.back()) - zero));
    }
    return "the columns share less than two rows (" + spans + ")";
  }

  // A row's command is the last one before it: one that came between two rows acts from the later row on.
  void NoteCommandLag() {
    for (const Track& track : tracks_) {
      if (&track == &tracks_[base_track_] || track.stamps_ns.size() < 2) continue;
      const bool commands = std::any_of(track.columns.begin(), track.columns.end(), [&](size_t i) {
        return wanted_[i].kind == "effort_command" && wanted_[i].hold == Hold::kZeroOrder;
      });
      if (!commands) continue;
      std::vector<double> lags;
      for (const int64_t stamp : track.stamps_ns) {
        const auto row = std::lower_bound(out_.stamps_ns.begin(), out_.stamps_ns.end(), stamp);
        if (row != out_.stamps_ns.end() && row != out_.stamps_ns.begin())
          lags.push_back(static_cast<double>(*row - stamp));
      }
      const double period = PeriodNs(out_.stamps_ns);
      if (lags.empty() || Quantile(lags, 0.5) < 0.02 * period) continue;
      out_.notes.push_back(
          log_name_ + ": commands of " + NameOf(track) + " come " +
          Printf("%.1f ms (median) before the row that takes them, of %.1f ms between rows: a delay of "
                 "that size is the import's",
                 1e-6 * Quantile(lags, 0.5), 1e-6 * period));
    }
  }

  const std::vector<WantedColumn>& wanted_;
  std::vector<Track> tracks_;
  const std::string& log_name_;
  std::vector<Place> place_;
  size_t base_track_ = 0;
  std::vector<Missing> missing_;
  std::map<std::string, size_t> rows_in_gaps_of_;
  Aligned out_;
};

}  // namespace

Result<Aligned> Align(const std::vector<WantedColumn>& wanted, std::vector<Track> tracks,
                      const std::string& log_name) {
  return Aligner(wanted, std::move(tracks), log_name).Run();
}

}  // namespace rg::importing
