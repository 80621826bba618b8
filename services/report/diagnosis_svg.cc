#include "services/report/diagnosis_svg.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <vector>

#include "services/report/page.h"

namespace rg::report {
namespace {

using diagnosis::DiagnosisResult;

constexpr int kWidth = 330, kHeight = 240, kLeft = 52, kRight = 10, kTop = 26, kBottom = 36;
constexpr size_t kPoints = 260;

struct Point {
  double x, estimated, explained;
};

std::vector<Point> PointsOf(const DiagnosisResult& r, int joint) {
  std::vector<Point> all;
  for (const auto& f : r.force_plots) {
    for (Eigen::Index k = 0; k < f.force.cols(); ++k) {
      if (f.force(joint, k) != 0) all.push_back({f.v(joint, k), f.force(joint, k), f.explained(joint, k)});
    }
  }
  std::sort(all.begin(), all.end(), [](const Point& a, const Point& b) { return a.x < b.x; });
  std::vector<Point> out;
  const double stride = std::max(1.0, static_cast<double>(all.size()) / kPoints);
  for (double i = 0; i < static_cast<double>(all.size()); i += stride)
    out.push_back(all[static_cast<size_t>(i)]);
  return out;
}

std::string Text(double x, double y, const std::string& text, const char* more = "") {
  char head[160];
  std::snprintf(head, sizeof head, "<text x=\"%.0f\" y=\"%.0f\" %s>", x, y, more);
  return head + EscapeHtml(text) + "</text>\n";
}

// A round step that cuts `range` into three to seven.
double TickStep(double range) {
  const double raw = range / 4, power = std::pow(10.0, std::floor(std::log10(std::max(1e-300, raw))));
  for (const double m : {1.0, 2.0, 5.0}) {
    if (m * power >= raw) return m * power;
  }
  return 10 * power;
}

class Panel {
 public:
  Panel(const std::vector<Point>& points, int left, int top) : points_(points), left_(left), top_(top) {
    for (const Point& p : points) {
      x0_ = std::min(x0_, p.x), x1_ = std::max(x1_, p.x);
      for (const double y : {p.estimated, p.explained}) y0_ = std::min(y0_, y), y1_ = std::max(y1_, y);
    }
    if (!(x1_ > x0_)) x1_ = x0_ + 1;
    if (!(y1_ > y0_)) y1_ = y0_ + 1;
  }

  std::string Draw(const std::string& title, const std::string& x_unit, const std::string& y_unit) const {
    std::string svg = Text(left_ + kLeft, top_ + 16, title, "font-weight=\"bold\"");
    svg += Axes();
    svg += Dots("#9aa5b1", [](const Point& p) { return p.estimated; });
    svg += Dots("#c2410c", [](const Point& p) { return p.explained; });
    svg += Text(left_ + kLeft + 0.5 * (kWidth - kLeft - kRight), top_ + kHeight - 4,
                "velocity [" + x_unit + "]", "text-anchor=\"middle\"");
    svg += Text(left_ + 4, top_ + 16, y_unit);
    return svg;
  }

 private:
  double X(double x) const { return left_ + kLeft + (x - x0_) / (x1_ - x0_) * (kWidth - kLeft - kRight); }
  double Y(double y) const {
    return top_ + kHeight - kBottom - (y - y0_) / (y1_ - y0_) * (kHeight - kTop - kBottom);
  }
  // Round ends of strokes without length.
  template <class Value>
  std::string Dots(const char* color, const Value& value) const {
    std::string path;
    for (const Point& p : points_) {
      char text[40];
      std::snprintf(text, sizeof text, "M%.0f %.0fh0", X(p.x), Y(value(p)));
      path += text;
    }
    return std::string("<path stroke=\"") + color + "\" stroke-width=\"3\" stroke-linecap=\"round\" d=\"" +
           path + "\"/>\n";
  }
  std::string Line(double x0, double y0, double x1, double y1) const {
    char text[160];
    std::snprintf(text, sizeof text,
                  "<line x1=\"%.1f\" y1=\"%.1f\" x2=\"%.1f\" y2=\"%.1f\" stroke=\"#d5dae0\"/>\n", x0, y0, x1,
                  y1);
    return text;
  }
  std::string Axes() const {
    std::string svg;
    const double dx = TickStep(x1_ - x0_), dy = TickStep(y1_ - y0_);
    for (double x = std::ceil(x0_ / dx) * dx; x <= x1_; x += dx) {
      svg += Line(X(x), Y(y0_), X(x), Y(y1_));
      svg += Text(X(x), top_ + kHeight - kBottom + 14, FormatNumber(std::abs(x) < 1e-9 * dx ? 0 : x),
                  "text-anchor=\"middle\"");
    }
    for (double y = std::ceil(y0_ / dy) * dy; y <= y1_; y += dy) {
      svg += Line(X(x0_), Y(y), X(x1_), Y(y));
      svg += Text(left_ + kLeft - 4, Y(y) + 4, FormatNumber(std::abs(y) < 1e-9 * dy ? 0 : y),
                  "text-anchor=\"end\"");
    }
    return svg;
  }

  const std::vector<Point>& points_;
  int left_, top_;
  double x0_ = 1e300, x1_ = -1e300, y0_ = 1e300, y1_ = -1e300;
};

std::vector<int> JointsToDraw(const DiagnosisResult& r) {
  std::vector<int> out;
  for (const auto& f : r.findings) {
    for (const std::string& name : f.joints) {
      const int j = static_cast<int>(std::find(r.joints.begin(), r.joints.end(), name) - r.joints.begin());
      if (j < static_cast<int>(r.joints.size()) && std::find(out.begin(), out.end(), j) == out.end())
        out.push_back(j);
    }
  }
  std::sort(out.begin(), out.end());
  // The first and the last joints of an arm tell most.
  if (out.size() > 4) out = {out[0], out[1], out[out.size() - 2], out.back()};
  return out;
}

}  // namespace

std::string DiagnosisSvg(const DiagnosisResult& r) {
  const std::vector<int> joints = r.force_plots.empty() ? std::vector<int>{} : JointsToDraw(r);
  const int columns = std::max<int>(1, std::min<int>(2, static_cast<int>(joints.size())));
  const int rows = std::max<int>(1, (static_cast<int>(joints.size()) + 1) / 2);
  char head[300];
  std::snprintf(head, sizeof head,
                "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 %d %d\" width=\"%d\" "
                "font-family=\"sans-serif\" font-size=\"11\" fill=\"#333\">\n<rect width=\"100%%\" "
                "height=\"100%%\" fill=\"white\"/>\n",
                columns * kWidth, rows * kHeight + 18, columns * kWidth);
  std::string svg = head;
  if (joints.empty()) svg += Text(10, 20, "Nothing is missing that could be drawn over velocity.");
  for (size_t i = 0; i < joints.size(); ++i) {
    const int j = joints[i];
    const auto points = PointsOf(r, j);
    if (points.empty()) continue;
    const Panel panel(points, static_cast<int>(i % 2) * kWidth, static_cast<int>(i / 2) * kHeight);
    svg += panel.Draw(r.joints[j], r.units[j] + "/s", r.units[j] == "m" ? "N" : "N·m");
  }
  svg += "<circle cx=\"60\" cy=\"" + std::to_string(rows * kHeight + 8) + "\" r=\"3\" fill=\"#9aa5b1\"/>";
  svg += Text(68, rows * kHeight + 12, "missing force, estimated");
  svg += "<circle cx=\"210\" cy=\"" + std::to_string(rows * kHeight + 8) + "\" r=\"3\" fill=\"#c2410c\"/>";
  svg += Text(218, rows * kHeight + 12, "explained");
  return svg + "</svg>\n";
}

}  // namespace rg::report
