// Pages as a browser draws them.
#include <gtest/gtest.h>

#include <filesystem>
#include <optional>
#include <set>

#include "common/base/file.h"
#include "common/base/ids.h"
#include "services/report/page.h"
#include "tests/support/browser/browser.h"

namespace rg::report {
namespace {

using nlohmann::json;

// A page of such series, one plot each, open in a browser.
class Drawn {
 public:
  Drawn(const std::vector<Series>& all, bool log_y) : folder_("/tmp/rg-page-" + RandomHex(6)) {
    Page page("Ticks", "");
    for (const Series& series : all) {
      Plot plot{"plot", "time [s]", "cost", {series}};
      plot.log_y = log_y;
      page.AddPlot(plot);
    }
    std::filesystem::create_directories(folder_);
    EXPECT_TRUE(WriteFileAtomically(folder_ + "/page.html", page.Html()).ok());
    browser_.emplace(folder_);
    browser_->Open("file://" + folder_ + "/page.html");
    EXPECT_TRUE(browser_->WaitFor("document.querySelectorAll('.dygraph-axis-label-y').length > 0"));
  }
  ~Drawn() {
    browser_.reset();
    std::filesystem::remove_all(folder_);
  }

  std::vector<std::string> Labels(size_t plot, const std::string& axis) {
    return browser_->Evaluate("Array.from(document.querySelectorAll('#plot" + std::to_string(plot) +
                              " .dygraph-axis-label-" + axis + "')).map(e => e.textContent).filter(t => t)");
  }
  std::string Title(size_t plot) {
    return browser_->Text("#plot" + std::to_string(plot) + " .dygraph-ylabel");
  }
  const std::vector<std::string>& complaints() const { return browser_->complaints(); }

 private:
  const std::string folder_;
  std::optional<testing::Browser> browser_;
};

const std::vector<double> kTime = {0, 1, 2, 3};

TEST(PageInABrowser, NoTwoTicksOfAnAxisReadTheSame) {
  if (testing::Browser::Program().empty()) GTEST_SKIP() << "no Chromium";
  const std::vector<Series> all = {
      {"narrow", kTime, {0.8123471, 0.8123458, 0.8123449, 0.8123449}, SeriesStyle::kSteps},
      {"small", kTime, {1.1e-5, 1.3e-5, 1.9e-5, 2e-5}},
      {"far from zero", {1e5 + 0.001, 1e5 + 0.002}, {1234567.1, 1234567.9}},
      {"decades", kTime, {1e-9, 1e-3, 10, 1e7}},
      {"one value", kTime, {0.5, 0.5, 0.5, 0.5}}};
  for (const bool log_y : {false, true}) {
    Drawn drawn(all, log_y);
    for (size_t plot = 0; plot < all.size(); ++plot) {
      for (const char* axis : {"x", "y"}) {
        const auto labels = drawn.Labels(plot, axis);
        EXPECT_GE(labels.size(), 2u) << all[plot].name << " " << axis << " log " << log_y;
        EXPECT_EQ(std::set<std::string>(labels.begin(), labels.end()).size(), labels.size())
            << all[plot].name << " " << axis << " log " << log_y << " " << json(labels);
        for (const std::string& label : labels) EXPECT_LE(label.size(), 9u) << "has room: " << label;
      }
    }
    EXPECT_TRUE(drawn.complaints().empty()) << json(drawn.complaints());
  }
}

TEST(PageInABrowser, WhatAllTicksShareIsSaidInTheAxisTitle) {
  if (testing::Browser::Program().empty()) GTEST_SKIP() << "no Chromium";
  Drawn drawn({{"late", kTime, {0.8123471, 0.8123458, 0.8123449, 0.8123449}}, {"wide", kTime, {1, 2, 3, 4}}},
              false);
  EXPECT_EQ(drawn.Title(0), "cost − 0.81234");
  EXPECT_EQ(drawn.Title(1), "cost");
}

}  // namespace
}  // namespace rg::report
