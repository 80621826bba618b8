#include "services/importing/decompress.h"

#include <bzlib.h>
#include <lz4frame.h>
#include <zstd.h>

#include <algorithm>

namespace rg::importing {
namespace {

struct Outcome {
  uint64_t written = 0;
  bool damaged = false;  // the input is not what the library understands
};

Outcome RunLz4(std::string_view input, char* out, uint64_t size) {
  LZ4F_dctx* raw = nullptr;
  if (LZ4F_isError(LZ4F_createDecompressionContext(&raw, LZ4F_VERSION))) return {0, true};
  const std::unique_ptr<LZ4F_dctx, decltype(&LZ4F_freeDecompressionContext)> context(
      raw, &LZ4F_freeDecompressionContext);
  Outcome outcome;
  while (true) {
    size_t produced = size - outcome.written, consumed = input.size();
    const size_t hint =
        LZ4F_decompress(context.get(), out + outcome.written, &produced, input.data(), &consumed, nullptr);
    if (LZ4F_isError(hint)) return {outcome.written, true};
    outcome.written += produced;
    input.remove_prefix(consumed);
    if (hint == 0 || (produced == 0 && consumed == 0)) return outcome;
  }
}

Outcome RunZstd(std::string_view input, char* out, uint64_t size) {
  const std::unique_ptr<ZSTD_DStream, decltype(&ZSTD_freeDStream)> stream(ZSTD_createDStream(),
                                                                          &ZSTD_freeDStream);
  if (stream == nullptr) return {0, true};
  ZSTD_DCtx_setParameter(stream.get(), ZSTD_d_windowLogMax, 27);  // 128 MB
  ZSTD_inBuffer from{input.data(), input.size(), 0};
  ZSTD_outBuffer to{out, size, 0};
  while (true) {
    const size_t in_before = from.pos, out_before = to.pos;
    const size_t hint = ZSTD_decompressStream(stream.get(), &to, &from);
    if (ZSTD_isError(hint)) return {to.pos, true};
    if (hint == 0 && from.pos == from.size) return {to.pos, false};
    if (from.pos == in_before && to.pos == out_before) return {to.pos, false};
  }
}

Outcome RunBz2(std::string_view input, char* out, uint64_t size) {
  bz_stream stream{};
  if (BZ2_bzDecompressInit(&stream, 0, 0) != BZ_OK) return {0, true};
  const std::unique_ptr<bz_stream, decltype(&BZ2_bzDecompressEnd)> end(&stream, &BZ2_bzDecompressEnd);
  Outcome outcome;
  while (true) {  // its counters have 32 bits
    const auto in = static_cast<unsigned>(std::min<uint64_t>(input.size(), 1u << 30));
    const auto room = static_cast<unsigned>(std::min<uint64_t>(size - outcome.written, 1u << 30));
    stream.next_in = const_cast<char*>(input.data());
    stream.avail_in = in;
    stream.next_out = out + outcome.written;
    stream.avail_out = room;
    const int code = BZ2_bzDecompress(&stream);
    outcome.written += room - stream.avail_out;
    input.remove_prefix(in - stream.avail_in);
    if (code == BZ_STREAM_END) return outcome;
    if (code != BZ_OK) return {outcome.written, true};
    if (stream.avail_in == in && stream.avail_out == room) return outcome;
  }
}

}  // namespace

Result<Compression> ParseCompression(std::string_view name) {
  if (name.empty() || name == "none") return Compression::kNone;
  if (name == "lz4") return Compression::kLz4;
  if (name == "zstd") return Compression::kZstd;
  if (name == "bz2") return Compression::kBz2;
  return InvalidError("compression " + Shown(name) + " is not known (none, lz4, zstd, bz2)");
}

Decompressor::Decompressor(const ReadLimits& limits, uint64_t file_bytes)
    : limits_(limits), total_left_(limits.max_total_bytes + limits.max_expansion * file_bytes) {}

Result<Decompressed> Decompressor::Run(Compression compression, std::string_view input, uint64_t size,
                                       bool may_be_cut) {
  if (compression == Compression::kNone) {
    if (input.size() > size || (input.size() < size && !may_be_cut)) {
      return DataLossError("says " + std::to_string(size) + " bytes and has " + std::to_string(input.size()));
    }
    return Decompressed{input, input.size() == size};
  }
  if (size > limits_.max_chunk_bytes || size > total_left_) {
    return ResourceExhaustedError("would be " + std::to_string(size) +
                                  " bytes when decompressed, more than " +
                                  std::to_string(std::min(limits_.max_chunk_bytes, total_left_)));
  }
  total_left_ -= size;
  if (size > capacity_) {
    buffer_ = std::make_unique_for_overwrite<char[]>(size);
    capacity_ = size;
  }
  const Outcome outcome = compression == Compression::kLz4    ? RunLz4(input, buffer_.get(), size)
                          : compression == Compression::kZstd ? RunZstd(input, buffer_.get(), size)
                                                              : RunBz2(input, buffer_.get(), size);
  const bool whole = outcome.written == size && !outcome.damaged;
  if (!whole && !may_be_cut) {
    return DataLossError("cannot be decompressed: " + std::to_string(outcome.written) + " of " +
                         std::to_string(size) + " bytes are readable");
  }
  return Decompressed{std::string_view(buffer_.get(), outcome.written), whole};
}

}  // namespace rg::importing
