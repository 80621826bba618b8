// A message's primitives one after another. After the first that is not there, ok() is false and every
// answer is 0 or empty. Internal to the decoder.
#pragma once

#include <cstdint>
#include <memory>
#include <string_view>

#include "services/importing/log.h"
#include "services/importing/message_definition.h"

namespace rg::importing {

class FieldSource {
 public:
  virtual ~FieldSource() = default;
  virtual double Number(Primitive primitive) = 0;
  virtual int64_t TimeNs() = 0;  // ROS 1's primitive
  virtual uint32_t Count() = 0;  // of a list or a text
  virtual std::string_view Text() = 0;
  virtual void Skip(Primitive primitive, uint64_t count) = 0;  // numbers only
  virtual uint64_t remaining() const = 0;
  bool ok() const { return ok_; }
  void Fail() { ok_ = false; }

 private:
  bool ok_ = true;
};

// Bytes of a number; 0 for texts and messages.
uint32_t SizeOf(Primitive primitive);

// Null: the encoding is not known, or the bytes are not in it.
std::unique_ptr<FieldSource> MakeFieldSource(Encoding encoding, std::string_view bytes);

}  // namespace rg::importing
