#include "services/cli/search_plot.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <nlohmann/json.hpp>

namespace rg::cli {
namespace {

using nlohmann::json;

// Two chains; from their third hop on, which one of them has, costs weigh the whole recording too.
json Identification() {
  return json::parse(R"({"search": [
      {"chain": 0, "seconds": [1.0, 2.5, 4.0], "start": [40.0, null, 9.0], "cost": [5.0, 6.0, 7.0],
       "accepted": [true, false, true], "whole_from": 2, "search_seconds": 4.5, "best_cost": 7.0},
      {"chain": 1, "seconds": [1.5, 3.0], "start": [null, null], "cost": [4.0, null],
       "accepted": [true, false], "whole_from": null, "search_seconds": 3.5, "best_cost": 3.9}]})");
}

const report::Series& Named(const report::Plot& plot, const std::string& name) {
  return *std::ranges::find(plot.series, name, &report::Series::name);
}

TEST(SearchPlots, ShowTheLeastCostOfAllChainsAsAFallingStaircaseOverTime) {
  const auto plots = SearchPlots(Identification());
  ASSERT_EQ(plots.size(), 2u) << "costs on the whole recording are on another scale";
  const report::Series& least = Named(plots[0], "least so far");
  EXPECT_EQ(least.style, report::SeriesStyle::kSteps);
  EXPECT_EQ(least.x, (std::vector<double>{0.0, 1.0, 1.5, 3.5, 3.5}));
  EXPECT_EQ(least.y, (std::vector<double>{40.0, 5.0, 4.0, 3.9, 3.9}))
      << "a hop that the clock cut counts too";
  const report::Series& whole = Named(plots[1], "least so far");
  EXPECT_EQ(whole.x, (std::vector<double>{2.5, 4.0, 4.5}));
  EXPECT_EQ(whole.y, (std::vector<double>{9.0, 7.0, 7.0}));
  EXPECT_NE(plots[0].x_label.find("[s]"), std::string::npos);
}

TEST(SearchPlots, TellAcceptedHopsFromOthers) {
  const auto plots = SearchPlots(Identification());
  ASSERT_EQ(plots.size(), 2u);
  EXPECT_EQ(Named(plots[0], "accepted hop").x, (std::vector<double>{1.0, 1.5}));
  EXPECT_EQ(Named(plots[0], "accepted hop").y, (std::vector<double>{5.0, 4.0}));
  EXPECT_EQ(Named(plots[0], "rejected hop").y, std::vector<double>{6.0}) << "without the hop that failed";
  EXPECT_EQ(Named(plots[1], "accepted hop").y, std::vector<double>{7.0});
}

TEST(SearchPlots, OfAResultOfEarlierVersionsAreNone) {
  EXPECT_TRUE(SearchPlots(json::parse(R"({"history": [[0, 2.0, 2.0]]})")).empty());
  EXPECT_TRUE(LeastCost(json::object(), "a").x.empty());
}

TEST(LeastCost, IsThatOfTheLastCostSearchedOn) {
  json identification = Identification();
  EXPECT_EQ(LeastCost(identification, "a").y, (std::vector<double>{9.0, 7.0, 7.0}));
  identification["search"].erase(0);
  EXPECT_EQ(LeastCost(identification, "a").y, (std::vector<double>{4.0, 3.9, 3.9}));
}

}  // namespace
}  // namespace rg::cli
