// Artefacts over a request client, piece by piece. Used by the client and by the workers. Those that begin
// with a file, or end in one, hold one piece of it in memory, and go on where they were after a kill of
// either side.
#pragma once

#include <string>
#include <string_view>

#include "common/base/status.h"
#include "common/transport/request_client.h"
#include "realitygrad/v1/artifact.pb.h"

namespace rg::coordinator {

// All bytes, checked against the hash (kDataLoss).
Result<std::string> FetchArtifact(transport::RequestClient& requests, const std::string& sha256);
// Into a file, which appears whole, checked and synced, or not at all; its folder is made. What has come is
// in PATH.part meanwhile, where the next call for this path goes on. The size.
Result<uint64_t> FetchArtifactToFile(transport::RequestClient& requests, const std::string& sha256,
                                     const std::string& path);
// `info` carries sha256, size, kind, metadata and parents of `bytes`. Returns when it is durable. Goes on
// where the coordinator says: with what it has of the same artefact from the same key.
Status UploadArtifact(transport::RequestClient& requests, std::string_view bytes,
                      const realitygrad::v1::ArtifactInfo& info);
// The same from a file, which must not change meanwhile (kDataLoss if it did).
Status UploadArtifactFile(transport::RequestClient& requests, const std::string& path,
                          const realitygrad::v1::ArtifactInfo& info);
// Of a file's bytes, read piece by piece; its size goes to `size`.
Result<std::string> Sha256OfFile(const std::string& path, uint64_t* size);

}  // namespace rg::coordinator
