// What the units of the artefact store share about its rows. Internal.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "common/base/status.h"
#include "common/store/database.h"

namespace rg::store {

// Frozen: part of the schema.
inline constexpr int64_t kMaxChunks = int64_t{1} << 20;
inline int64_t ChunkId(int64_t artifact, int64_t chunk) { return artifact * kMaxChunks + chunk; }
// 16 bytes of BLAKE2b: names the damaged chunk; the artefact's hash is the authority.
std::string ChunkChecksum(std::string_view bytes);

template <class Fn>
Status ForEachRow(Statement* query, Fn row) {
  while (true) {
    RG_ASSIGN_OR_RETURN(const bool more, query->Step());
    if (!more) return Status::Ok();
    row();
  }
}

}  // namespace rg::store
