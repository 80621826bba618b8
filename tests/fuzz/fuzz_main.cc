// One program for each reader: RG_FUZZ_READER is its name.
#include <cstddef>
#include <cstdint>

#include "tests/fuzz/readers.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  static const rg::fuzz::Reader& reader = rg::fuzz::ReaderNamed(RG_FUZZ_READER);
  reader.read({reinterpret_cast<const char*>(data), size});
  return 0;
}
