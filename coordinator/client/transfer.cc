#include "coordinator/client/transfer.h"

#include <algorithm>

#include "common/base/hash.h"
#include "common/base/ids.h"

namespace rg::coordinator {
namespace {

namespace pb = realitygrad::v1;

constexpr size_t kPieceBytes = 1 << 20;

}  // namespace

Result<std::string> FetchArtifact(transport::RequestClient& requests, const std::string& sha256) {
  std::string bytes;
  uint64_t total = 1;
  pb::GetArtifactRequest request;
  request.set_sha256(sha256);
  request.set_limit_bytes(kPieceBytes);
  do {
    request.set_offset(bytes.size());
    RG_ASSIGN_OR_RETURN(const auto message, requests.Call(transport::MakeRequest(requests.self(), request)));
    RG_ASSIGN_OR_RETURN(const auto reply, transport::Unpack<pb::GetArtifactReply>(message));
    total = reply.size_bytes();
    if (reply.offset() != bytes.size() || (message.attachment.empty() && bytes.size() < total)) {
      return DataLossError("artefact " + sha256 + ": a piece at " + std::to_string(bytes.size()) +
                           " did not come");
    }
    bytes += message.attachment;
  } while (bytes.size() < total);
  if (Sha256Hex(bytes) != sha256)
    return DataLossError("artefact " + sha256 + ": the bytes do not match the hash");
  return bytes;
}

Status UploadArtifact(transport::RequestClient& requests, std::string_view bytes,
                      const pb::ArtifactInfo& info) {
  const std::string upload_id = RandomHex(8);
  constexpr int kMaxRestarts = 5;
  int restarts = 0;
  uint64_t offset = 0;
  while (true) {
    pb::PutArtifactRequest request;
    request.set_upload_id(upload_id);
    request.set_offset(offset);
    const std::string_view piece = bytes.substr(offset, kPieceBytes);
    request.set_last(offset + piece.size() == bytes.size());
    if (offset == 0 || request.last()) *request.mutable_info() = info;
    transport::Message message = transport::MakeRequest(requests.self(), request);
    message.attachment.assign(piece);
    RG_ASSIGN_OR_RETURN(const auto answer, requests.Call(std::move(message)));
    RG_ASSIGN_OR_RETURN(const auto reply, transport::Unpack<pb::PutArtifactReply>(answer));
    if (reply.committed()) return Status::Ok();
    if (reply.next_offset() > bytes.size()) return InternalError("coordinator asks for bytes past the end");
    if (reply.next_offset() <= offset && ++restarts > kMaxRestarts) {
      return UnavailableError("upload of " + info.sha256() + " does not get on");
    }
    offset = reply.next_offset();
  }
}

}  // namespace rg::coordinator
