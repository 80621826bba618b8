// Little-endian bytes with a name and a version in front and a SHA-256 behind: the frame of this
// folder's files.
#pragma once

#include <bit>
#include <cstdint>
#include <cstring>
#include <string>
#include <string_view>
#include <type_traits>

#include "common/base/hash.h"
#include "common/base/status.h"

namespace rg::policy {

static_assert(std::endian::native == std::endian::little, "files are little-endian");

class ByteWriter {
 public:
  // `format` is the whole first line of the file, for example "realitygrad.policy/1".
  explicit ByteWriter(std::string_view format) : bytes_(std::string(format) + "\n") {}

  template <class T>
  void Put(T value) {
    static_assert(std::is_arithmetic_v<T>);
    Raw(&value, sizeof value);
  }
  void Text(std::string_view text) {
    Put(static_cast<uint32_t>(text.size()));
    bytes_.append(text);
  }
  template <class T>
  void Array(const T* values, uint64_t count) {
    static_assert(std::is_arithmetic_v<T>);
    Put(count);
    Raw(values, count * sizeof(T));
  }
  // Appends the hash of all before it; the object is spent.
  std::string Finish() {
    bytes_ += Sha256Hex(bytes_);
    return std::move(bytes_);
  }

 private:
  void Raw(const void* from, uint64_t size) { bytes_.append(static_cast<const char*>(from), size); }

  std::string bytes_;
};

class ByteReader {
 public:
  // Checks format and hash before anything is read.
  static Result<ByteReader> Open(std::string_view bytes, std::string_view format, const std::string& source) {
    constexpr size_t kHash = 64;
    const size_t line = bytes.substr(0, 64).find('\n');
    const size_t slash = format.rfind('/');
    if (line == std::string_view::npos || bytes.substr(0, slash + 1) != format.substr(0, slash + 1)) {
      return InvalidError(source + ": not a file of the kind " + std::string(format));
    }
    if (bytes.substr(0, line) != format) {
      return InvalidError(source + ": version '" + std::string(bytes.substr(0, line)) +
                          "' is not known, this program reads " + std::string(format));
    }
    if (bytes.size() < line + 1 + kHash) return DataLossError(source + ": truncated");
    const std::string_view body = bytes.substr(0, bytes.size() - kHash);
    if (Sha256Hex(body) != bytes.substr(body.size())) {
      return DataLossError(source + ": the checksum does not match: truncated or changed");
    }
    return ByteReader(body.substr(line + 1), source);
  }

  template <class T>
  Status Get(T* value) {
    static_assert(std::is_arithmetic_v<T>);
    if (rest_.size() < sizeof(T)) return Short();
    std::memcpy(value, rest_.data(), sizeof(T));
    rest_.remove_prefix(sizeof(T));
    return Status::Ok();
  }
  Status Text(std::string* text) {
    uint32_t size = 0;
    RG_RETURN_IF_ERROR(Get(&size));
    if (rest_.size() < size) return Short();
    *text = std::string(rest_.substr(0, size));
    rest_.remove_prefix(size);
    return Status::Ok();
  }
  // Container: resize() and data() of arithmetic values.
  template <class Container>
  Status Array(Container* values) {
    using T = std::remove_reference_t<decltype(*values->data())>;
    uint64_t count = 0;
    RG_RETURN_IF_ERROR(Get(&count));
    if (rest_.size() / sizeof(T) < count) return Short();
    values->resize(count);
    if (count > 0) std::memcpy(values->data(), rest_.data(), count * sizeof(T));
    rest_.remove_prefix(count * sizeof(T));
    return Status::Ok();
  }
  Status ExpectEnd() const {
    return rest_.empty() ? Status::Ok() : InvalidError(source_ + ": more bytes than expected");
  }

 private:
  ByteReader(std::string_view rest, std::string source) : rest_(rest), source_(std::move(source)) {}
  Status Short() const { return InvalidError(source_ + ": fewer bytes than its sizes say"); }

  std::string_view rest_;
  std::string source_;
};

}  // namespace rg::policy
