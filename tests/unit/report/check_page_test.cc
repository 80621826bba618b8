#include "services/report/check_page.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "services/sysid/sysid_on_set.h"
#include "tests/unit/diagnosis/simulated_set.h"

namespace rg::report {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

std::string PageOf(const recordings::RecordingSet& set) {
  const auto plant = sysid::NominalPlant(set);
  RG_CHECK(plant.ok()) << plant.status().ToString();
  const auto check = diagnosis::CheckSet(set, *plant, false);
  RG_CHECK(check.ok()) << check.status().ToString();
  return CheckPage(set, *plant, *check, diagnosis::WhatShows(check->survey, *plant));
}

nlohmann::json PlotOf(const std::string& html, int index) {
  const std::string open = "id=\"plot" + std::to_string(index) + "-data\">";
  const size_t begin = html.find(open) + open.size();
  return nlohmann::json::parse(html.substr(begin, html.find("</script>", begin) - begin));
}

TEST(CheckPage, DrawsPositionSpeedAndEffortOfEachJointWithWhatIsKeptAside) {
  const std::string html = PageOf(diagnosis::testing::MakeSet("arm2", {}, 81));
  for (int k = 0; k < 6; ++k) {
    const auto plot = PlotOf(html, k);
    EXPECT_GT(plot["rows"].size(), 300u) << k;
    ASSERT_EQ(plot["bands"].size(), 1u) << "one recording is kept aside";
    EXPECT_EQ(plot["bands"][0][2], "aside");
  }
  EXPECT_THAT(html, Not(HasSubstr("id=\"plot6-data\"")));
  EXPECT_THAT(html, HasSubstr("Nothing about these recordings is odd"));
  EXPECT_THAT(html, HasSubstr("coulomb_friction"));
}

TEST(CheckPage, ShadesAGapAndBreaksTheLinesThere) {
  auto set = diagnosis::testing::MakeSet("arm2", {}, 82);
  recordings::Recording behind = recordings::Slice(set.recordings[0], 200, 150);
  behind.t.array() += 500.0;
  set.recordings[0] = recordings::Slice(set.recordings[0], 0, 200);
  set.recordings.insert(set.recordings.begin() + 1, behind);
  const auto plot = PlotOf(PageOf(set), 0);
  ASSERT_EQ(plot["bands"].size(), 2u);
  EXPECT_EQ(plot["bands"][0][2], "missing");
  // A gap of minutes takes no more than a hand's width of a few seconds.
  EXPECT_LT(plot["bands"][0][1].get<double>() - plot["bands"][0][0].get<double>(), 1.0);
  EXPECT_TRUE(plot["breaks"].get<bool>());
  const double from = plot["bands"][0][0];
  bool broken = false;
  for (const auto& row : plot["rows"])
    broken = broken || (std::abs(row[0].get<double>() - from) < 1e-3 && row[1].is_null());
  EXPECT_TRUE(broken);
}

TEST(CheckPage, ShowsARefusalFirst) {
  auto set = diagnosis::testing::MakeSet("arm2", {}, 83);
  for (auto& rec : set.recordings) rec.effort_command.row(1) *= -1.0;
  const std::string html = PageOf(set);
  EXPECT_THAT(html, HasSubstr("cannot be what they say they are"));
  EXPECT_THAT(html, HasSubstr("effort_command.elbow"));
}

}  // namespace
}  // namespace rg::report
