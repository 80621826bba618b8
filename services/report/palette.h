// Okabe & Ito's palette, readable with colour-blind eyes and on light or dark paper.
#pragma once

namespace rg::report {

inline constexpr const char* kPalette[] = {"#0072B2", "#D55E00", "#009E73", "#CC79A7",
                                           "#E69F00", "#56B4E9", "#8a8f98"};
inline constexpr int kPaletteSize = 7;

}  // namespace rg::report
