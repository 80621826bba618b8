#include "services/report/page.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <limits>
#include <map>
#include <nlohmann/json.hpp>

#include "common/base/check.h"
#include "services/report/assets.h"
#include "services/report/palette.h"

namespace rg::report {
namespace {

using nlohmann::json;

const char* StyleName(SeriesStyle style) {
  static constexpr const char* kNames[] = {"line", "dashed", "points", "steps"};
  return kNames[static_cast<int>(style)];
}

constexpr int kDigits = 6;  // more than a screen shows, and a third of the bytes of all

json Number(double x, int digits = kDigits) {
  if (!std::isfinite(x)) return nullptr;
  char text[32];
  std::snprintf(text, sizeof text, "%.*g", digits, x);
  return std::strtod(text, nullptr);
}

// Of values that differ late only, as many more digits as they share.
int Digits(const std::vector<Series>& series, std::vector<double> Series::*axis) {
  double low = std::numeric_limits<double>::infinity(), high = -low;
  for (const Series& s : series) {
    for (const double value : s.*axis) {
      if (std::isfinite(value)) low = std::min(low, value), high = std::max(high, value);
    }
  }
  if (!(high > low)) return kDigits;
  const double shared = std::round(std::log10(std::max(std::abs(low), std::abs(high)) / (high - low)));
  return kDigits + std::clamp(static_cast<int>(shared), 0, 17 - kDigits);
}

// One row per distinct x over all series; a series without a value there has null.
json MergedRows(const std::vector<Series>& series) {
  std::map<double, std::vector<double>> rows;
  for (size_t i = 0; i < series.size(); ++i) {
    RG_CHECK(series[i].x.size() == series[i].y.size()) << series[i].name;
    for (size_t k = 0; k < series[i].x.size(); ++k) {
      auto [row, fresh] = rows.try_emplace(series[i].x[k]);
      if (fresh) row->second.assign(series.size(), std::nan(""));
      row->second[i] = series[i].y[k];
    }
  }
  json out = json::array();
  const int x_digits = Digits(series, &Series::x), y_digits = Digits(series, &Series::y);
  for (const auto& [x, ys] : rows) {
    json row = json::array({Number(x, x_digits)});
    for (double y : ys) row.push_back(Number(y, y_digits));
    out.push_back(std::move(row));
  }
  return out;
}

json PlotData(const Plot& plot) {
  json data = {{"labels", {"x"}},        {"colors", json::array()}, {"styles", json::array()},
               {"xlabel", plot.x_label}, {"ylabel", plot.y_label},  {"logy", plot.log_y}};
  if (plot.y_high > plot.y_low) data["range"] = {plot.y_low, plot.y_high};
  if (plot.breaks) data["breaks"] = true;
  for (const Band& band : plot.bands)
    data["bands"].push_back(
        {Number(band.low), Number(band.high), band.kind == Band::Kind::kMissing ? "missing" : "aside"});
  int next = 0;
  for (const Series& s : plot.series) {
    data["labels"].push_back(s.name);
    data["colors"].push_back(kPalette[(s.color >= 0 ? s.color : next++) % kPaletteSize]);
    data["styles"].push_back(StyleName(s.style));
  }
  data["rows"] = MergedRows(plot.series);
  return data;
}

// JSON inside <script>: "</" must not appear.
std::string ScriptSafe(std::string text) {
  for (size_t at = 0; (at = text.find("</", at)) != std::string::npos; at += 3) text.replace(at, 2, "<\\/");
  return text;
}

bool IsText(const Table& table, int column) {
  return std::find(table.text_columns.begin(), table.text_columns.end(), column) != table.text_columns.end();
}

}  // namespace

std::string EscapeHtml(std::string_view text) {
  std::string out;
  out.reserve(text.size());
  for (char c : text) {
    switch (c) {
      case '&':
        out += "&amp;";
        break;
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      case '"':
        out += "&quot;";
        break;
      default:
        out += c;
    }
  }
  return out;
}

std::string FormatNumber(double value, int digits) {
  if (!std::isfinite(value)) return std::isnan(value) ? "–" : value > 0 ? "∞" : "−∞";
  const double size = std::abs(value);
  char text[64];
  if (value != 0.0 && (size < 1e-4 || size >= 1e6)) {
    std::snprintf(text, sizeof text, "%.*e", digits - 1, value);
  } else {
    const int before = size < 1.0 ? (value == 0.0 ? 1 : static_cast<int>(std::floor(std::log10(size))) + 1)
                                  : static_cast<int>(std::floor(std::log10(size))) + 1;
    std::snprintf(text, sizeof text, "%.*f", std::max(0, digits - before), value);
  }
  return text;
}

Page::Page(std::string title, std::string subtitle)
    : title_(std::move(title)), subtitle_(std::move(subtitle)) {}

void Page::Lead(std::string_view text) { body_ += "<p class=\"lead\">" + EscapeHtml(text) + "</p>\n"; }
void Page::Heading(std::string_view text) { body_ += "<h2>" + EscapeHtml(text) + "</h2>\n"; }
void Page::Subheading(std::string_view text) { body_ += "<h3>" + EscapeHtml(text) + "</h3>\n"; }
void Page::Paragraph(std::string_view text) { body_ += "<p>" + EscapeHtml(text) + "</p>\n"; }
void Page::Note(std::string_view text, bool warning) {
  body_ += std::string("<p class=\"note") + (warning ? " warning" : "") + "\">" + EscapeHtml(text) + "</p>\n";
}
void Page::Code(std::string_view text) { body_ += "<pre>" + EscapeHtml(text) + "</pre>\n"; }

void Page::Cards(const std::vector<Card>& cards) {
  body_ += "<div class=\"cards\">\n";
  for (const Card& card : cards) {
    body_ += "<div class=\"card\"><span>" + EscapeHtml(card.label) + "</span><b>" + EscapeHtml(card.value) +
             "</b><span>" + EscapeHtml(card.note) + "</span></div>\n";
  }
  body_ += "</div>\n";
}

void Page::AddTable(const Table& table) {
  body_ += "<div class=\"scroll\"><table><thead><tr>";
  for (size_t c = 0; c < table.columns.size(); ++c) {
    body_ += std::string(IsText(table, static_cast<int>(c)) ? "<th class=\"text\">" : "<th>") +
             EscapeHtml(table.columns[c]) + "</th>";
  }
  body_ += "</tr></thead><tbody>\n";
  for (const auto& row : table.rows) {
    RG_CHECK(row.size() == table.columns.size()) << "a table row has " << row.size() << " cells";
    body_ += "<tr>";
    for (size_t c = 0; c < row.size(); ++c) {
      body_ += std::string(IsText(table, static_cast<int>(c)) ? "<td class=\"text\">" : "<td>") +
               EscapeHtml(row[c]) + "</td>";
    }
    body_ += "</tr>\n";
  }
  body_ += "</tbody></table></div>\n";
  if (!table.caption.empty()) body_ += "<p class=\"caption\">" + EscapeHtml(table.caption) + "</p>\n";
}

void Page::AppendFigure(const Plot& plot) {
  const std::string id = "plot" + std::to_string(plots_++);
  body_ += "<figure><figcaption>" + EscapeHtml(plot.title) + "</figcaption><div class=\"plot" +
           (plot.tall ? " tall" : "") + "\" id=\"" + id + "\"></div><div class=\"legend\" id=\"" + id +
           "-legend\"></div>";
  if (!plot.caption.empty()) body_ += "<p class=\"caption\">" + EscapeHtml(plot.caption) + "</p>";
  body_ += "<script type=\"application/json\" id=\"" + id + "-data\">" + ScriptSafe(PlotData(plot).dump()) +
           "</script></figure>\n";
}

void Page::AddPlot(const Plot& plot) { AppendFigure(plot); }

void Page::AddPlots(const std::vector<Plot>& plots, int min_width_px) {
  body_ += "<div class=\"plots\" style=\"--plot-width:" + std::to_string(min_width_px) + "px\">\n";
  for (const Plot& plot : plots) AppendFigure(plot);
  body_ += "</div>\n";
}

std::string Page::Html() const {
  std::string html =
      "<!doctype html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\n"
      "<meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>" +
      EscapeHtml(title_) + "</title>\n<style>";
  html += DygraphsStyle();
  html += PageStyle();
  html += "</style></head><body><main>\n<h1>" + EscapeHtml(title_) + "</h1>\n<p class=\"subtitle\">" +
          EscapeHtml(subtitle_) + "</p>\n" + body_ +
          "<footer>Written by RealityGrad. Drag across a plot to zoom, double-click to go "
          "back.</footer>\n</main>\n";
  if (plots_ > 0) {
    html += "<script>";
    html += DygraphsScript();
    html += "</script>\n<script>";
    html += PageScript();
    html += "</script>\n";
  }
  return html + "</body></html>\n";
}

}  // namespace rg::report
