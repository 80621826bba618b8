// SHA-256's compression function on whole blocks, with the processor's own instructions. Internal to
// hash.cc.
#pragma once

#include <cstddef>
#include <cstdint>

namespace rg::internal {

// Whether this processor has them (x86 SHA extensions).
bool HasSha256Instructions();

// Advances `state` (8 words of FIPS 180-4) over `blocks` blocks of 64 bytes. Needs
// HasSha256Instructions().
void Sha256Blocks(uint32_t* state, const unsigned char* data, size_t blocks);

}  // namespace rg::internal
