// The files of the page, taken into the program when it is built.
#pragma once

#include <string_view>

namespace rg::coordinator::web {

struct Asset {
  std::string_view path, type, bytes;  // "/app.js", its media type
};

// Null: there is no such file.
const Asset* FindAsset(std::string_view path);

}  // namespace rg::coordinator::web
