#include "services/report/assets.h"

#define RG_EMBED(symbol, path)                        \
  asm(".section .rodata\n"                            \
      ".global rg_asset_" #symbol                     \
      "\n"                                            \
      ".global rg_asset_" #symbol                     \
      "_end\n"                                        \
      "rg_asset_" #symbol ":\n.incbin \"" path        \
      "\"\n"                                          \
      "rg_asset_" #symbol "_end:\n.byte 0\n.text\n"); \
  extern "C" const char rg_asset_##symbol[];          \
  extern "C" const char rg_asset_##symbol##_end[]

RG_EMBED(dygraphs_js, RG_DYGRAPHS_DIR "/dygraph.min.js");
RG_EMBED(dygraphs_css, RG_DYGRAPHS_DIR "/dygraph.min.css");
RG_EMBED(page_js, RG_REPORT_DIR "/page.js");
RG_EMBED(page_css, RG_REPORT_DIR "/page.css");

namespace rg::report {
namespace {

std::string_view Asset(const char* begin, const char* end) {
  const std::string_view whole(begin, static_cast<size_t>(end - begin));
  return whole.substr(0, whole.rfind("//# sourceMappingURL"));
}

}  // namespace

std::string_view DygraphsScript() { return Asset(rg_asset_dygraphs_js, rg_asset_dygraphs_js_end); }
std::string_view DygraphsStyle() {
  const std::string_view css(rg_asset_dygraphs_css,
                             static_cast<size_t>(rg_asset_dygraphs_css_end - rg_asset_dygraphs_css));
  return css.substr(0, css.find("/*# sourceMappingURL"));
}
std::string_view PageScript() { return Asset(rg_asset_page_js, rg_asset_page_js_end); }
std::string_view PageStyle() { return Asset(rg_asset_page_css, rg_asset_page_css_end); }

}  // namespace rg::report
