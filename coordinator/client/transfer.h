// Artefacts over a request client, piece by piece. Used by the client and by the workers.
#pragma once

#include <string>
#include <string_view>

#include "common/base/status.h"
#include "common/transport/request_client.h"
#include "realitygrad/v1/artifact.pb.h"

namespace rg::coordinator {

// All bytes, checked against the hash (kDataLoss).
Result<std::string> FetchArtifact(transport::RequestClient& requests, const std::string& sha256);
// `info` carries sha256, kind, metadata and parents of `bytes`. Returns when it is durable. Goes on
// where the coordinator says; a restart of the coordinator starts it anew.
Status UploadArtifact(transport::RequestClient& requests, std::string_view bytes,
                      const realitygrad::v1::ArtifactInfo& info);

}  // namespace rg::coordinator
