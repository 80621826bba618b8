#include "coordinator/web/assets.h"

#define RG_EMBED(symbol, path)                      \
  asm(".section .rodata\n"                          \
      ".global rg_web_" #symbol                     \
      "\n"                                          \
      ".global rg_web_" #symbol                     \
      "_end\n"                                      \
      "rg_web_" #symbol ":\n.incbin \"" path        \
      "\"\n"                                        \
      "rg_web_" #symbol "_end:\n.byte 0\n.text\n"); \
  extern "C" const char rg_web_##symbol[];          \
  extern "C" const char rg_web_##symbol##_end[]

RG_EMBED(index, RG_PAGE_DIR "/index.html");
RG_EMBED(style, RG_PAGE_DIR "/style.css");
RG_EMBED(app, RG_PAGE_DIR "/app.js");
RG_EMBED(views, RG_PAGE_DIR "/views.js");
RG_EMBED(results, RG_PAGE_DIR "/results.js");
RG_EMBED(plots, RG_PAGE_DIR "/plots.js");
RG_EMBED(dygraph_js, RG_DYGRAPHS_DIR "/dygraph.min.js");
RG_EMBED(dygraph_css, RG_DYGRAPHS_DIR "/dygraph.min.css");

namespace rg::coordinator::web {
namespace {

// Without the comment that names a source map, which a browser's tools would ask for.
std::string_view Text(const char* begin, const char* end, std::string_view map_comment = {}) {
  const std::string_view whole(begin, static_cast<size_t>(end - begin));
  return map_comment.empty() ? whole : whole.substr(0, whole.rfind(map_comment));
}

constexpr std::string_view kScript = "text/javascript; charset=utf-8", kStyle = "text/css; charset=utf-8";

}  // namespace

const Asset* FindAsset(std::string_view path) {
  static const Asset assets[] = {
      {"/", "text/html; charset=utf-8", Text(rg_web_index, rg_web_index_end)},
      {"/style.css", kStyle, Text(rg_web_style, rg_web_style_end)},
      {"/app.js", kScript, Text(rg_web_app, rg_web_app_end)},
      {"/views.js", kScript, Text(rg_web_views, rg_web_views_end)},
      {"/results.js", kScript, Text(rg_web_results, rg_web_results_end)},
      {"/plots.js", kScript, Text(rg_web_plots, rg_web_plots_end)},
      {"/dygraph.js", kScript, Text(rg_web_dygraph_js, rg_web_dygraph_js_end, "//# sourceMappingURL")},
      {"/dygraph.css", kStyle, Text(rg_web_dygraph_css, rg_web_dygraph_css_end, "/*# sourceMappingURL")}};
  for (const Asset& asset : assets) {
    if (asset.path == path) return &asset;
  }
  return nullptr;
}

}  // namespace rg::coordinator::web
