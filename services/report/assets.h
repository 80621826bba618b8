// Files that a page carries inside itself, taken into the program when it is built.
#pragma once

#include <string_view>

namespace rg::report {

std::string_view DygraphsScript();
std::string_view DygraphsStyle();
std::string_view PageScript();  // page.js: draws every plot of a page
std::string_view PageStyle();   // page.css

}  // namespace rg::report
