#include <algorithm>
#include <cmath>

#include "common/base/printf.h"
#include "services/lab/scaling.h"

namespace rg::lab {
namespace {

constexpr double kWidth = 380, kHeight = 260, kLeft = 52, kRight = 12, kTop = 28, kBottom = 40;

// A round step that cuts `range` into three to seven.
double TickStep(double range) {
  const double raw = range / 4, power = std::pow(10.0, std::floor(std::log10(raw)));
  for (const double m : {1.0, 2.0, 5.0}) {
    if (m * power >= raw) return m * power;
  }
  return 10 * power;
}

std::string Text(double x, double y, const std::string& text, const char* anchor) {
  return Printf("<text x=\"%.0f\" y=\"%.0f\" ", x, y) + "text-anchor=\"" + anchor + "\">" + text +
         "</text>\n";
}

// Both axes begin at zero: what is proportional looks so.
class Panel {
 public:
  Panel(const std::vector<ScalingPoint>& points, double left) : points_(points), left_(left) {
    for (const ScalingPoint& p : points) x_ = std::max(x_, p.x), y_ = std::max(y_, p.ms);
    x_ *= 1.05, y_ *= 1.1;
  }

  std::string Draw(const std::string& title, const std::string& x_label) const {
    const ScalingLine line = LineThrough(points_);
    std::string svg = Text(left_ + kLeft, 16, title, "start") + Axes();
    svg += "<line" +
           Printf(" x1=\"%.1f\" y1=\"%.1f\" x2=\"%.1f\" y2=\"%.1f\"", X(0), Y(line.at_zero), X(x_),
                  Y(line.at_zero + line.slope * x_)) +
           " stroke=\"#9aa5b1\" stroke-dasharray=\"5 4\"/>\n";
    for (const ScalingPoint& p : points_) {
      svg +=
          "<circle" + Printf(" cx=\"%.1f\" cy=\"%.1f\"", X(p.x), Y(p.ms)) + " r=\"4\" fill=\"#c2410c\"/>\n";
    }
    svg += Text(left_ + kWidth - kRight, Y(0) - 8,
                Printf("%.3g ms + %.3g ms each, R² %.4f", line.at_zero, line.slope, line.r_squared), "end");
    return svg + Text(left_ + kLeft + (kWidth - kLeft - kRight) / 2, kHeight - 6, x_label, "middle");
  }

 private:
  double X(double x) const { return left_ + kLeft + x / x_ * (kWidth - kLeft - kRight); }
  double Y(double y) const { return kHeight - kBottom - y / y_ * (kHeight - kTop - kBottom); }
  std::string Line(double x0, double y0, double x1, double y1) const {
    return "<line" + Printf(" x1=\"%.1f\" y1=\"%.1f\" x2=\"%.1f\" y2=\"%.1f\"", X(x0), Y(y0), X(x1), Y(y1)) +
           " stroke=\"#d5dae0\"/>\n";
  }
  std::string Axes() const {
    std::string svg;
    const double dx = TickStep(x_), dy = TickStep(y_);
    for (double x = 0; x <= x_; x += dx) {
      svg += Line(x, 0, x, y_) + Text(X(x), kHeight - kBottom + 15, Printf("%g", x), "middle");
    }
    for (double y = 0; y <= y_; y += dy) {
      svg += Line(0, y, x_, y) + Text(left_ + kLeft - 5, Y(y) + 4, Printf("%g", y), "end");
    }
    return svg;
  }

  const std::vector<ScalingPoint>& points_;
  double left_, x_ = 0, y_ = 0;
};

}  // namespace

std::string ScalingSvg(const Scaling& scaling) {
  const double length = scaling.by_length.empty() ? 0 : scaling.by_length.back().x;
  return Printf("<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 %.0f %.0f\" ", 2 * kWidth, kHeight) +
         "font-family=\"sans-serif\" font-size=\"12\" fill=\"#334155\">\n" +
         "<rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n" +
         Panel(scaling.by_length, 0)
             .Draw("ms for a Jacobian by " + std::to_string(scaling.paper_parameters) + " parameters",
                   Printf("seconds of motion, up to %g, at 1 ms steps", length, 0)) +
         Panel(scaling.by_parameters, kWidth)
             .Draw(Printf("ms for a Jacobian of %g s", scaling.seconds, 0), "parameters") +
         "</svg>\n";
}

}  // namespace rg::lab
