#include "services/report/page.h"

#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

namespace rg::report {
namespace {

nlohmann::json PlotJson(const std::string& html, int index) {
  const std::string open = "id=\"plot" + std::to_string(index) + "-data\">";
  const size_t begin = html.find(open) + open.size();
  return nlohmann::json::parse(html.substr(begin, html.find("</script>", begin) - begin));
}

TEST(Page, IsSelfContained) {
  Page page("Title", "sub");
  page.AddPlot({"a", "t [s]", "q [rad]", {{"measured", {0, 1}, {2, 3}}}});
  const std::string html = page.Html();
  EXPECT_EQ(html.find("src=\"http"), std::string::npos);
  EXPECT_EQ(html.find("href=\"http"), std::string::npos);
  EXPECT_NE(html.find("Dygraph"), std::string::npos);
}

TEST(Page, TextCannotBecomeMarkup) {
  Page page("<b>", "x");
  page.Paragraph("<script>alert(1)</script>");
  page.AddPlot({"t", "x", "y", {{"</script><b>", {0}, {1}}}});
  const std::string html = page.Html();
  EXPECT_EQ(html.find("<script>alert"), std::string::npos);
  EXPECT_EQ(html.find("</script><b>"), std::string::npos);
  EXPECT_EQ(PlotJson(html, 0)["labels"][1], "</script><b>");
}

TEST(Page, SeriesOnDifferentGridsAreMergedByX) {
  Page page("t", "s");
  page.AddPlot({"p", "x", "y", {{"a", {0, 1}, {5, 6}}, {"b", {0.5, 1}, {7, std::nan("")}}}});
  const auto rows = PlotJson(page.Html(), 0)["rows"];
  ASSERT_EQ(rows.size(), 3u);
  EXPECT_EQ(rows[1][0], 0.5);
  EXPECT_TRUE(rows[1][1].is_null());
  EXPECT_EQ(rows[1][2], 7);
  EXPECT_TRUE(rows[2][2].is_null()) << "NaN must be a gap";
}

TEST(Page, ShadesStretchesAndBreaksLinesWhereAsked) {
  Page page("t", "s");
  Plot plot{"p", "x", "y", {{"a", {0, 1, 2}, {5, std::nan(""), 6}}}};
  page.AddPlot(plot);
  plot.bands = {{Band::Kind::kMissing, 0.5, 1.5}, {Band::Kind::kAside, 1.5, 2.0}};
  plot.breaks = true;
  page.AddPlot(plot);
  const std::string html = page.Html();
  EXPECT_FALSE(PlotJson(html, 0).contains("bands"));
  EXPECT_FALSE(PlotJson(html, 0).contains("breaks"));
  const auto shaded = PlotJson(html, 1);
  EXPECT_EQ(shaded["bands"], nlohmann::json::parse(R"([[0.5, 1.5, "missing"], [1.5, 2.0, "aside"]])"));
  EXPECT_TRUE(shaded["breaks"].get<bool>());
}

TEST(Page, ValuesThatDifferLateStayApart) {
  Page page("t", "s");
  page.AddPlot(
      {"p", "x", "y", {{"a", {0, 1, 2}, {0.81234561, 0.81234558, 0.81234549}, SeriesStyle::kSteps}}});
  page.AddPlot({"p", "x", "y", {{"a", {0, 1}, {1.0 / 3, 2.0 / 3}}}});
  const std::string html = page.Html();
  const auto late = PlotJson(html, 0);
  EXPECT_EQ(late["styles"][0], "steps");
  EXPECT_GT(late["rows"][0][1], late["rows"][1][1]);
  EXPECT_GT(late["rows"][1][1], late["rows"][2][1]);
  EXPECT_LE(PlotJson(html, 1)["rows"][0][1].dump().size(), 10u) << "others are short";
}

TEST(FormatNumber, KeepsSignificantDigits) {
  EXPECT_EQ(FormatNumber(0.012345), "0.0123");
  EXPECT_EQ(FormatNumber(123.456), "123");
  EXPECT_EQ(FormatNumber(12.3456), "12.3");
  EXPECT_EQ(FormatNumber(0.0), "0.00");
  EXPECT_EQ(FormatNumber(3.2e-7), "3.20e-07");
  EXPECT_EQ(FormatNumber(std::nan("")), "–");
}

TEST(PageDeathTest, ATableRowOfTheWrongLengthIsABug) {
  Page page("t", "s");
  EXPECT_DEATH(page.AddTable({{"a", "b"}, {{"1"}}}), "table row");
}

TEST(Page, MiniaturesAreDrawnWithoutScripts) {
  Page page("many", "");
  const double gap = std::nan("");
  Miniature one{.title = "a < b", .link = "x.html", .text = "said", .y_label = "error [rad]"};
  one.series = {{"nominal", {0, 1, 2, 3}, {-1, gap, 1, 2}}, {"tool", {0, 3}, {0, 0}}};
  page.AddMiniatures({one, one});
  const std::string html = page.Html();
  EXPECT_EQ(html.find("<script"), std::string::npos);
  EXPECT_NE(html.find("<a href=\"x.html\">a &lt; b</a>"), std::string::npos);
  EXPECT_NE(html.find("M40.0 100.0M"), std::string::npos)
      << "a gap lifts the pen, the lowest value stands lowest";
  EXPECT_NE(html.find("error [rad]"), std::string::npos);
}

}  // namespace
}  // namespace rg::report
