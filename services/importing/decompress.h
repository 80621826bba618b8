// Chunks of bags and MCAP files, decompressed within limits.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>

#include "common/base/status.h"
#include "services/importing/log.h"

namespace rg::importing {

enum class Compression { kNone, kLz4, kZstd, kBz2 };

// "" or "none", "lz4", "zstd", "bz2".
Result<Compression> ParseCompression(std::string_view name);

struct Decompressed {
  std::string_view bytes;  // valid until the next Run
  bool whole = true;       // false: the input ended too early, `bytes` is what could be had
};

// Keeps its memory from chunk to chunk. One per file: it holds the file to ReadLimits.
class Decompressor {
 public:
  Decompressor(const ReadLimits& limits, uint64_t file_bytes);
  // `size`: what the container says the result has. A cut input (`may_be_cut`) gives what is there; any
  // other difference is kDataLoss. kResourceExhausted: over the limits.
  Result<Decompressed> Run(Compression compression, std::string_view input, uint64_t size, bool may_be_cut);

 private:
  ReadLimits limits_;
  uint64_t total_left_;
  std::unique_ptr<char[]> buffer_;
  uint64_t capacity_ = 0;
};

}  // namespace rg::importing
