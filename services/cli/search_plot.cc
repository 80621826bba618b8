#include "services/cli/search_plot.h"

#include <algorithm>
#include <limits>
#include <nlohmann/json.hpp>

#include "services/cli/output.h"

namespace rg::cli {
namespace {

using nlohmann::json;

// A cost that a chain came to.
struct Point {
  double seconds, cost;
  enum class Kind { kAccepted, kRejected, kBetween } kind;  // a hop's, or where a chain stood between hops
};

bool HasWhole(const json& chain) { return chain.at("whole_from").is_number(); }

// What a chain came to on the windows alone, or on the whole recording too.
void AddPoints(const json& chain, bool whole, std::vector<Point>* points) {
  const std::vector<double> seconds = Numbers(chain.at("seconds")), start = Numbers(chain.at("start")),
                            cost = Numbers(chain.at("cost"));
  const size_t hops = std::min(seconds.size(), cost.size());
  const size_t change = HasWhole(chain) ? std::min(hops, chain.at("whole_from").get<size_t>()) : hops;
  for (size_t i = whole ? change : 0; i < (whole ? hops : change); ++i) {
    points->push_back({i > 0 ? seconds[i - 1] : 0.0, start[i], Point::Kind::kBetween});
    points->push_back(
        {seconds[i], cost[i],
         chain.at("accepted")[i].get<bool>() ? Point::Kind::kAccepted : Point::Kind::kRejected});
  }
  if (HasWhole(chain) == whole)
    points->push_back({chain.at("search_seconds").get<double>(), chain.at("best_cost").get<double>(),
                       Point::Kind::kBetween});
}

// In the order of time; no point where a hop failed (infinite, or the largest number where nothing else is
// known).
std::vector<Point> PointsOf(const json& identification, bool whole) {
  std::vector<Point> points;
  for (const json& chain : identification.value("search", json::array())) AddPoints(chain, whole, &points);
  std::erase_if(points, [](const Point& p) { return !(p.cost < std::numeric_limits<double>::max()); });
  std::ranges::stable_sort(points, {}, &Point::seconds);
  return points;
}

report::Series Staircase(const std::vector<Point>& points, const std::string& name) {
  report::Series series{name, {}, {}, report::SeriesStyle::kSteps};
  for (const Point& p : points) {
    if (!series.y.empty() && p.cost >= series.y.back()) continue;
    series.x.push_back(p.seconds), series.y.push_back(p.cost);
  }
  if (!points.empty()) series.x.push_back(points.back().seconds), series.y.push_back(series.y.back());
  return series;
}

report::Series Hops(const std::vector<Point>& points, Point::Kind kind, const std::string& name) {
  report::Series series{name, {}, {}, report::SeriesStyle::kPoints};
  for (const Point& p : points) {
    if (p.kind == kind) series.x.push_back(p.seconds), series.y.push_back(p.cost);
  }
  return series;
}

}  // namespace

std::vector<report::Plot> SearchPlots(const json& identification) {
  std::vector<report::Plot> plots;
  for (const bool whole : {false, true}) {
    const std::vector<Point> points = PointsOf(identification, whole);
    if (points.empty()) continue;
    report::Plot plot{whole ? "Basin hopping, last round: the whole recording too" : "Basin hopping",
                      "search of each chain [s]",
                      "cost",
                      {}};
    plot.log_y = true;
    plot.series = {Staircase(points, "least so far"), Hops(points, Point::Kind::kAccepted, "accepted hop"),
                   Hops(points, Point::Kind::kRejected, "rejected hop")};
    std::erase_if(plot.series, [](const report::Series& series) { return series.x.empty(); });
    plots.push_back(std::move(plot));
  }
  return plots;
}

report::Series LeastCost(const json& identification, const std::string& name) {
  std::vector<Point> points = PointsOf(identification, true);
  if (points.empty()) points = PointsOf(identification, false);
  return Staircase(points, name);
}

}  // namespace rg::cli
