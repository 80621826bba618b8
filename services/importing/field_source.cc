#include "services/importing/field_source.h"

#include <fastcdr/Cdr.h>
#include <fastcdr/FastBuffer.h>
#include <fastcdr/exceptions/Exception.h>

#include "services/importing/byte_cursor.h"

namespace rg::importing {
namespace {

// Calls `read` with a value of the primitive's type and gives the value read.
template <class Read>
double NumberBy(Primitive primitive, Read&& read) {
  const auto as = [&](auto value) {
    read(value);
    return static_cast<double>(value);
  };
  switch (primitive) {
    case Primitive::kInt8:
      return as(int8_t{});
    case Primitive::kUint8:
      return as(uint8_t{});
    case Primitive::kInt16:
      return as(int16_t{});
    case Primitive::kUint16:
      return as(uint16_t{});
    case Primitive::kInt32:
      return as(int32_t{});
    case Primitive::kUint32:
      return as(uint32_t{});
    case Primitive::kInt64:
      return as(int64_t{});
    case Primitive::kUint64:
      return as(uint64_t{});
    case Primitive::kFloat32:
      return as(float{});
    case Primitive::kFloat64:
      return as(double{});
    default:
      return 0.0;
  }
}

class Ros1Source final : public FieldSource {
 public:
  explicit Ros1Source(std::string_view bytes) : cursor_(bytes) {}

  double Number(Primitive primitive) override {
    if (primitive == Primitive::kTime || primitive == Primitive::kDuration)
      return static_cast<double>(TimeNs()) * 1e-9;
    const double number = NumberBy(
        primitive, [&](auto& value) { value = cursor_.Number<std::remove_reference_t<decltype(value)>>(); });
    if (!cursor_.ok()) Fail();
    return number;
  }
  int64_t TimeNs() override {
    const int64_t seconds = cursor_.Number<uint32_t>();
    const int64_t nanoseconds = cursor_.Number<uint32_t>();
    if (!cursor_.ok()) Fail();
    return seconds * 1'000'000'000 + nanoseconds;
  }
  uint32_t Count() override {
    const auto count = cursor_.Number<uint32_t>();
    if (!cursor_.ok()) Fail();
    return count;
  }
  std::string_view Text() override {
    const std::string_view text = cursor_.Counted32();
    if (!cursor_.ok()) Fail();
    return text;
  }
  void Skip(Primitive primitive, uint64_t count) override {
    cursor_.Bytes(count * SizeOf(primitive));
    if (!cursor_.ok()) Fail();
  }
  uint64_t remaining() const override { return cursor_.remaining(); }

 private:
  ByteCursor cursor_;
};

class CdrSource final : public FieldSource {
 public:
  explicit CdrSource(std::string_view bytes)
      // Fast CDR wants a buffer to write to as well; reading leaves it alone.
      : size_(bytes.size()),
        buffer_(const_cast<char*>(bytes.data()), bytes.size()),
        cdr_(buffer_, eprosima::fastcdr::Cdr::DEFAULT_ENDIAN, eprosima::fastcdr::Cdr::DDS_CDR) {
    Try([&] { cdr_.read_encapsulation(); });
  }

  double Number(Primitive primitive) override {
    if (primitive == Primitive::kTime || primitive == Primitive::kDuration)
      return static_cast<double>(TimeNs()) * 1e-9;
    return NumberBy(primitive, [&](auto& value) { Read(&value); });
  }
  int64_t TimeNs() override {
    int32_t seconds = 0;
    uint32_t nanoseconds = 0;
    Read(&seconds);
    Read(&nanoseconds);
    return int64_t{seconds} * 1'000'000'000 + nanoseconds;
  }
  uint32_t Count() override {
    uint32_t count = 0;
    Read(&count);
    return count;
  }
  std::string_view Text() override {
    const uint32_t length = Count();
    const char* start = cdr_.getCurrentPosition();
    // The last character is read, not jumped over: Fast CDR aligns what follows by the size it read last.
    if (!ok() || length > remaining() || (length > 1 && !cdr_.jump(length - 1))) {
      Fail();
      return {};
    }
    char last = 0;
    if (length > 0) Read(&last);
    const std::string_view text(start, length);
    return !text.empty() && text.back() == '\0' ? text.substr(0, text.size() - 1) : text;
  }
  void Skip(Primitive primitive, uint64_t count) override {
    if (count == 0) return;
    Number(primitive);  // aligns
    const uint64_t bytes = (count - 1) * SizeOf(primitive);
    if (!ok() || bytes > remaining() || (bytes > 0 && !cdr_.jump(bytes))) Fail();
  }
  uint64_t remaining() const override { return size_ - cdr_.getSerializedDataLength(); }

 private:
  template <class T>
  void Read(T* value) {
    Try([&] { cdr_.deserialize(*value); });
  }
  void Try(auto&& read) {
    if (!ok()) return;
    try {
      read();
    } catch (const eprosima::fastcdr::exception::Exception&) {
      Fail();
    }
  }

  size_t size_;
  eprosima::fastcdr::FastBuffer buffer_;
  eprosima::fastcdr::Cdr cdr_;
};

// Plain CDR, big or little endian; parameter lists and later versions are something else.
bool IsPlainCdr(std::string_view bytes) {
  return bytes.size() >= 4 && bytes[0] == 0 && (bytes[1] == 0 || bytes[1] == 1);
}

}  // namespace

uint32_t SizeOf(Primitive primitive) {
  switch (primitive) {
    case Primitive::kInt8:
    case Primitive::kUint8:
      return 1;
    case Primitive::kInt16:
    case Primitive::kUint16:
      return 2;
    case Primitive::kInt32:
    case Primitive::kUint32:
    case Primitive::kFloat32:
      return 4;
    case Primitive::kInt64:
    case Primitive::kUint64:
    case Primitive::kFloat64:
    case Primitive::kTime:
    case Primitive::kDuration:
      return 8;
    default:
      return 0;
  }
}

std::unique_ptr<FieldSource> MakeFieldSource(Encoding encoding, std::string_view bytes) {
  if (encoding == Encoding::kRos1) return std::make_unique<Ros1Source>(bytes);
  if (encoding == Encoding::kCdr && IsPlainCdr(bytes)) return std::make_unique<CdrSource>(bytes);
  return nullptr;
}

}  // namespace rg::importing
