// A self-contained HTML page: text, cards, tables and interactive plots in one file that opens
// without a network. All text is escaped; a page is written as it is built, top to bottom.
#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace rg::report {

enum class SeriesStyle { kLine, kDashed, kPoints, kSteps };  // kSteps: each y holds until the next x

struct Series {
  std::string name;
  std::vector<double> x;  // ascending for lines; same size as y
  std::vector<double> y;  // NaN leaves a gap
  SeriesStyle style = SeriesStyle::kLine;
  int color = -1;  // index into the palette; -1: the next one
};

// A stretch of x that is shaded.
struct Band {
  enum class Kind { kMissing, kAside } kind = Kind::kMissing;
  double low = 0.0, high = 0.0;
};

struct Plot {
  std::string title;
  std::string x_label;  // with unit: "time [s]"
  std::string y_label;
  std::vector<Series> series;  // names within a plot differ
  std::string caption = {};
  bool log_y = false;
  bool tall = false;
  double y_low = 0.0, y_high = 0.0;  // range shown; equal: all there is
  std::vector<Band> bands = {};
  bool breaks = false;  // lines end at a NaN instead of going on behind it
};

struct Table {
  std::vector<std::string> columns;
  std::vector<std::vector<std::string>> rows;  // each as long as columns
  std::string caption = {};
  std::vector<int> text_columns = {};  // left-aligned, wrapping
};

struct Card {
  std::string label;
  std::string value;
  std::string note = {};
};

// A plot of a hand's width that nothing moves in: for hundreds of them on one page.
struct Miniature {
  std::string title;
  std::string link = {};  // of the title, relative to the page
  std::string text;       // below the plot
  bool warning = false;   // stands out
  std::string y_label;    // with unit
  std::vector<Series> series;
};

class Page {
 public:
  Page(std::string title, std::string subtitle);

  void Lead(std::string_view text);  // the sentence that a reader with one minute reads
  void Heading(std::string_view text);
  void Subheading(std::string_view text);
  void Paragraph(std::string_view text);
  void Note(std::string_view text, bool warning = false);
  void Code(std::string_view text);
  void Cards(const std::vector<Card>& cards);
  void AddTable(const Table& table);
  void AddPlot(const Plot& plot);
  // Side by side as the width allows, each at least `min_width_px` wide.
  void AddPlots(const std::vector<Plot>& plots, int min_width_px = 440);
  // A grid of them with one legend, that of the first.
  void AddMiniatures(const std::vector<Miniature>& miniatures);

  std::string Html() const;

 private:
  void AppendFigure(const Plot& plot);

  std::string title_;
  std::string subtitle_;
  std::string body_;
  int plots_ = 0;
};

std::string EscapeHtml(std::string_view text);
// Short for people: 3 significant digits unless told, no exponent between 1e-4 and 1e6.
std::string FormatNumber(double value, int digits = 3);

}  // namespace rg::report
