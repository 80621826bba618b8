// Reads little-endian numbers and counted bytes off an untrusted buffer: past its end nothing is read,
// the cursor fails and stays failed, and every later answer is 0 or empty.
#pragma once

#include <cstdint>
#include <cstring>
#include <string_view>

namespace rg::importing {

class ByteCursor {
 public:
  explicit ByteCursor(std::string_view bytes) : bytes_(bytes) {}

  template <class T>
  T Number() {
    T value{};
    const std::string_view raw = Bytes(sizeof(T));
    if (ok_) std::memcpy(&value, raw.data(), sizeof(T));  // every host of this project is little endian
    return value;
  }

  std::string_view Bytes(uint64_t count) {
    if (!ok_ || count > bytes_.size() - at_) {
      ok_ = false;
      return {};
    }
    const std::string_view some = bytes_.substr(at_, count);
    at_ += count;
    return some;
  }

  // Bytes that are preceded by their number.
  std::string_view Counted32() { return Bytes(Number<uint32_t>()); }
  std::string_view Counted64() { return Bytes(Number<uint64_t>()); }
  std::string_view Rest() { return Bytes(bytes_.size() - at_); }

  bool ok() const { return ok_; }
  bool at_end() const { return at_ == bytes_.size(); }
  uint64_t position() const { return at_; }
  uint64_t remaining() const { return bytes_.size() - at_; }

 private:
  std::string_view bytes_;
  uint64_t at_ = 0;
  bool ok_ = true;
};

}  // namespace rg::importing
