#include "common/base/ids.h"

#include <sodium.h>

#include <vector>

#include "common/base/check.h"

namespace rg {

std::string RandomHex(int bytes) {
  RG_CHECK(bytes > 0);
  RG_CHECK(sodium_init() >= 0);
  std::vector<unsigned char> raw(bytes);
  randombytes_buf(raw.data(), raw.size());
  std::string hex(2 * raw.size() + 1, '\0');
  sodium_bin2hex(hex.data(), hex.size(), raw.data(), raw.size());
  hex.pop_back();
  return hex;
}

}  // namespace rg
