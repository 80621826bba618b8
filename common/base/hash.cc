#include "common/base/hash.h"

#include <sodium.h>

#include <cstring>

#include "common/base/check.h"
#include "common/base/sha256_blocks.h"

namespace rg {

static_assert(sizeof(crypto_hash_sha256_state) <= 128);

Sha256::Sha256() {
  RG_CHECK(sodium_init() >= 0);
  crypto_hash_sha256_init(reinterpret_cast<crypto_hash_sha256_state*>(state_.data()));
}

// libsodium does the ends of a message, the processor's instructions (five times as fast) the whole
// blocks between; both work on libsodium's public state: words, count of bits, partial block.
void Sha256::Update(std::string_view bytes) {
  auto* state = reinterpret_cast<crypto_hash_sha256_state*>(state_.data());
  const auto* data = reinterpret_cast<const unsigned char*>(bytes.data());
  size_t left = bytes.size();
  if (internal::HasSha256Instructions() && left >= 128) {
    const size_t buffered = (state->count >> 3) % 64;
    const size_t head = buffered == 0 ? 0 : 64 - buffered;
    crypto_hash_sha256_update(state, data, head);
    const size_t blocks = (left - head) / 64;
    internal::Sha256Blocks(state->state, data + head, blocks);
    state->count += static_cast<uint64_t>(blocks) * 512;
    data += head + blocks * 64;
    left -= head + blocks * 64;
  }
  crypto_hash_sha256_update(state, data, left);
}

std::string Sha256::FinishHex() {
  unsigned char digest[crypto_hash_sha256_BYTES];
  crypto_hash_sha256_final(reinterpret_cast<crypto_hash_sha256_state*>(state_.data()), digest);
  char hex[2 * crypto_hash_sha256_BYTES + 1];
  sodium_bin2hex(hex, sizeof hex, digest, sizeof digest);
  return hex;
}

std::string Sha256::Save() const {
  return std::string(reinterpret_cast<const char*>(state_.data()), sizeof(crypto_hash_sha256_state));
}

bool Sha256::Restore(std::string_view saved) {
  if (saved.size() != sizeof(crypto_hash_sha256_state)) return false;
  std::memcpy(state_.data(), saved.data(), saved.size());
  return true;
}

std::string Sha256Hex(std::string_view bytes) {
  Sha256 hash;
  hash.Update(bytes);
  return hash.FinishHex();
}

}  // namespace rg
