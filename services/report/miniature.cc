#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include "common/base/check.h"
#include "services/report/page.h"
#include "services/report/palette.h"

namespace rg::report {
namespace {

constexpr double kWidth = 300, kHeight = 116, kLeft = 40, kRight = 4, kTop = 6, kBottom = 16;

struct Range {
  double low = std::numeric_limits<double>::infinity(), high = -low;
  void Take(const std::vector<double>& values) {
    for (double x : values) {
      if (std::isfinite(x)) low = std::min(low, x), high = std::max(high, x);
    }
  }
  void Widen() {
    if (!(high >= low)) low = 0, high = 1;
    if (high == low) high = low + 1;
  }
};

std::string Format(const char* format, double a, double b) {
  char text[160];
  std::snprintf(text, sizeof text, format, a, b);
  return text;
}

std::string Label(double x, double y, const std::string& text, const char* anchor) {
  return Format("<text x=\"%.1f\" y=\"%.1f\"", x, y) + " text-anchor=\"" + anchor + "\">" + EscapeHtml(text) +
         "</text>";
}

std::string Svg(const Miniature& m) {
  Range x, y;
  for (const Series& s : m.series) {
    RG_CHECK(s.x.size() == s.y.size()) << s.name;
    x.Take(s.x), y.Take(s.y);
  }
  x.Widen(), y.Widen();
  const auto at_x = [&](double v) {
    return kLeft + (v - x.low) / (x.high - x.low) * (kWidth - kLeft - kRight);
  };
  const auto at_y = [&](double v) {
    return kHeight - kBottom - (v - y.low) / (y.high - y.low) * (kHeight - kTop - kBottom);
  };
  std::string svg = Format("<svg viewBox=\"0 0 %.0f %.0f\" role=\"img\">", kWidth, kHeight);
  if (y.low <= 0 && y.high >= 0) {
    svg += Format("<path d=\"M%.1f %.1f", kLeft, at_y(0)) +
           Format("H%.1f\" stroke=\"#8a8f98\" stroke-width=\"%.1f\"/>", kWidth - kRight, 0.5);
  }
  for (size_t i = 0; i < m.series.size(); ++i) {
    const Series& s = m.series[i];
    std::string path;
    bool pen_down = false;
    for (size_t k = 0; k < s.x.size(); ++k) {
      const bool there = std::isfinite(s.y[k]);
      if (there) path += (pen_down ? "L" : "M") + Format("%.1f %.1f", at_x(s.x[k]), at_y(s.y[k]));
      pen_down = there;
    }
    const int color = s.color >= 0 ? s.color : static_cast<int>(i);
    svg += "<path d=\"" + path + "\" fill=\"none\" stroke=\"" + kPalette[color % kPaletteSize] +
           "\" stroke-width=\"1.2\"" + (s.style == SeriesStyle::kDashed ? " stroke-dasharray=\"4 3\"" : "") +
           "/>";
  }
  svg += Label(kLeft - 3, kTop + 6, FormatNumber(y.high, 2), "end");
  svg += Label(kLeft - 3, kHeight - kBottom, FormatNumber(y.low, 2), "end");
  svg += Label(kLeft, kHeight - 4, m.y_label, "start");
  svg += Label(kWidth - kRight, kHeight - 4, FormatNumber(x.high, 2) + " s", "end");
  return svg + "</svg>";
}

}  // namespace

void Page::AddMiniatures(const std::vector<Miniature>& miniatures) {
  if (miniatures.empty()) return;
  body_ += "<p class=\"key\">";
  const std::vector<Series>& first = miniatures.front().series;
  for (size_t i = 0; i < first.size(); ++i) {
    const int color = first[i].color >= 0 ? first[i].color : static_cast<int>(i);
    body_ += std::string("<i style=\"background:") + kPalette[color % kPaletteSize] + "\"></i>" +
             EscapeHtml(first[i].name);
  }
  body_ += "</p>\n<div class=\"minis\">\n";
  for (const Miniature& m : miniatures) {
    const std::string title = EscapeHtml(m.title);
    body_ += std::string("<div class=\"mini") + (m.warning ? " warning" : "") + "\"><b>" +
             (m.link.empty() ? title : "<a href=\"" + EscapeHtml(m.link) + "\">" + title + "</a>") + "</b>" +
             Svg(m) + "<p>" + EscapeHtml(m.text) + "</p></div>\n";
  }
  body_ += "</div>\n";
}

}  // namespace rg::report
