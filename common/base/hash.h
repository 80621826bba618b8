// SHA-256 (libsodium): the address of every artefact.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <string_view>

namespace rg {

class Sha256 {
 public:
  Sha256();
  void Update(std::string_view bytes);
  // 64 lower-case hexadecimal digits. The object is spent afterwards.
  std::string FinishHex();
  // What it has come to so far, to go on in another process of the same build; false: `saved` is no such
  // state.
  std::string Save() const;
  bool Restore(std::string_view saved);

 private:
  alignas(8) std::array<unsigned char, 128> state_;
};

std::string Sha256Hex(std::string_view bytes);

}  // namespace rg
