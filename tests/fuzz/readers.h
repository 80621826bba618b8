// Readers of files from outside, as functions of bytes. RG_CHECKs what holds for any bytes: an error is one line.
#pragma once

#include <functional>
#include <string>
#include <string_view>
#include <vector>

namespace rg::fuzz {

struct Reader {
  std::string name;  // of the corpus' folder
  std::function<void(std::string_view bytes)> read;
};

const std::vector<Reader>& Readers();
const Reader& ReaderNamed(const std::string& name);

}  // namespace rg::fuzz
