#include "services/diagnosis/likelihood/move_states.h"

#include <algorithm>
#include <utility>

#include "common/base/parallel.h"

namespace rg::diagnosis {

namespace {

constexpr double kThrown = 1.1;  // times its χ² so far, at which a window's start was moved too far
constexpr double kShares[] = {0.4, 0.1, 0.0};  // of what it was moved by, which are tried then
constexpr double kStandsOut = 4.0;             // times the median of all windows' χ², or what noise leaves
constexpr double kUnusual = 1.5;               // times the middle χ² of windows, from where they start anew
constexpr double kMostlyMet = 2.0;  // χ² per row of the middle window, below which only starts are amiss
constexpr double kStrayed = 0.3;    // rad or m from the record

struct Moved {
  int window;
  VectorXd e0, start;  // of the free directions, and what they move the start by
  VectorXd tied;       // the start without that: what is not free goes with the parameters
  double share = 1.0;
};

// A hidden state that hardly shows, or a joint that sticks, may be thrown far: then a shorter step in the
// window's start. Returns how many windows were simulated.
size_t Shorten(Lineariser& lin, int worker, const std::vector<double>& adopted, std::vector<Moved>* moved,
               std::vector<double>* chi2) {
  std::vector<int> windows;
  std::vector<VectorXd> starts;
  std::vector<std::pair<Moved*, double>> shorter;
  for (Moved& m : *moved) {
    if (!((*chi2)[m.window] > kThrown * adopted[m.window])) continue;
    for (const double less : kShares) {
      shorter.push_back({&m, less});
      windows.push_back(m.window), starts.push_back(m.tied + less * m.start);
    }
  }
  const std::vector<double> c = lin.Simulated(worker, windows, starts);
  for (size_t i = 0; i < shorter.size(); ++i) {
    auto& [m, less] = shorter[i];
    if (c[i] < (*chi2)[m->window]) (*chi2)[m->window] = c[i], m->share = less;
  }
  return windows.size();
}

double Middle(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// States at the windows' ends.
std::vector<VectorXd> Ends(const NodeStates& states) {
  std::vector<VectorXd> out;
  for (const MatrixXd& s : states) out.push_back(s.col(s.cols() - 1));
  return out;
}

// Whether a window begins where the one before it ends.
bool GoesOn(const FitData& data, int w) {
  return w > 0 && data.windows[w].recording == data.windows[w - 1].recording &&
         data.windows[w].t.front() - data.windows[w - 1].t.back() == 0;
}

}  // namespace

size_t MoveStates(Lineariser& lin, int worker, int first, int last, const std::vector<Linear>& linear,
                  const std::vector<BestStart>& best, const VectorXd& step,
                  const std::vector<double>& adopted, NodeStates* states, std::vector<double>* chi2) {
  std::vector<Moved> moved;
  std::vector<int> windows;
  std::vector<VectorXd> starts;
  for (int w = first; w < last; ++w) {
    if (!linear[w].ok) {
      (*chi2)[w] = lin.WorstChi2(w);
      continue;
    }
    const VectorXd at = (*states)[w].col(0);
    const auto E = linear[w].Node(0);
    moved.push_back({w, best[w].After(step, at), {}, {}});
    moved.back().start = E.leftCols(at.size()) * moved.back().e0;
    moved.back().tied = at + E.middleCols(at.size(), step.size()) * step + E.rightCols<1>();
    windows.push_back(w), starts.push_back(moved.back().tied + moved.back().start);
  }
  const std::vector<double> full = lin.Simulated(worker, windows, starts);
  for (size_t i = 0; i < moved.size(); ++i) (*chi2)[moved[i].window] = full[i];
  size_t simulated = windows.size();
  if (!adopted.empty()) simulated += Shorten(lin, worker, adopted, &moved, chi2);
  for (const Moved& m : moved) {
    MatrixXd& at = (*states)[m.window];
    VectorXd all(at.rows() + step.size() + 1);
    all << m.share * m.e0, step, 1.0;
    at.reshaped() += linear[m.window].E * all;
  }
  return simulated;
}

size_t TryRecordedStarts(Lineariser& lin, const FitData& data, int threads, NodeStates* states,
                         std::vector<double>* chi2) {
  const int W = static_cast<int>(chi2->size());
  const double middle = Middle(*chi2);
  std::vector<int> lost;
  for (int w = 0; w < W; ++w) {
    if ((*chi2)[w] > kStandsOut * std::max(middle, static_cast<double>(lin.RowsOf(data.windows[w]))))
      lost.push_back(w);
  }
  const std::vector<VectorXd> ends = Ends(*states);
  ParallelFor(threads, static_cast<int>(lost.size()), [&](int worker, int i) {
    const int w = lost[i];
    const VectorXd* before = GoesOn(data, w) ? &ends[w - 1] : nullptr;
    lin.TryRecordedStart(worker, w, before, &(*states)[w], &(*chi2)[w]);
  });
  return lost.size();
}

void ChooseFaces(const FitData& data, Lineariser& lin, int threads, double noise_scale,
                 std::vector<double>* chi2, NodeStates* states) {
  const int W = static_cast<int>(data.windows.size());
  std::vector<double> per_row;
  for (int w = 0; w < W; ++w) per_row.push_back((*chi2)[w] / lin.RowsOf(data.windows[w]));
  const double usual = Middle(per_row);
  const bool closely = usual < kMostlyMet * noise_scale;
  const std::vector<VectorXd> ends = Ends(*states);
  ParallelFor(threads, W, [&](int worker, int w) {
    if (per_row[w] < kUnusual * usual) return;
    const VectorXd* before = GoesOn(data, w) ? &ends[w - 1] : nullptr;
    const double chosen = lin.ChooseFace(worker, w, before, closely, (*chi2)[w], &(*states)[w]);
    if (!(chosen < (*chi2)[w])) return;
    (*chi2)[w] = chosen;
    lin.CarryHidden(worker, data.windows[w], lin.sensed_motors(), &(*states)[w]);
  });
}

void FollowSimulations(const FitData& data, Lineariser& lin, int threads, NodeStates* states) {
  ParallelFor(threads, static_cast<int>(data.windows.size()),
                     [&](int worker, int w) { lin.Simulate(worker, w, &(*states)[w]); });
}

void ReturnStrayed(const Lineariser& lin, const FitData& data, const NodeStates& before, NodeStates* states) {
  const int n = data.n;
  for (size_t w = 0; w < states->size(); ++w) {
    const NodeWindow& window = data.windows[w];
    MatrixXd& own = (*states)[w];
    const long nz = own.rows() - 2 * n;
    for (long k = 0; k < own.cols(); ++k) {
      const VectorXd recorded = window.q0.col(k) - lin.sensor_offsets();
      if (own.col(k).allFinite() && !((own.col(k).head(n) - recorded).cwiseAbs().maxCoeff() > kStrayed))
        continue;
      own.col(k).head(n) = recorded;
      own.col(k).segment(n, n) = window.v0.col(k);
      if (!own.col(k).allFinite()) own.col(k).tail(nz) = before[w].col(k).tail(nz);
    }
  }
}

}  // namespace rg::diagnosis
