#include "coordinator/server/artifact_desk.h"

#include <algorithm>
#include <nlohmann/json.hpp>

#include "coordinator/store/job_store.h"

namespace rg::coordinator {
namespace {

namespace pb = realitygrad::v1;
using Json = nlohmann::json;
using transport::Is;
using transport::MakeReply;
using transport::Sender;
using transport::Unpack;

constexpr int64_t kDefaultPiece = 1 << 20;
constexpr int64_t kLargestPiece = 4 << 20;
constexpr int64_t kIdleUploadNs = 300'000'000'000;
constexpr size_t kMaxUploads = 256;
constexpr size_t kMaxUploadId = 256;

store::ArtifactSpec SpecOf(const pb::ArtifactInfo& info) {
  store::ArtifactSpec spec;
  spec.kind = info.kind();
  spec.version = std::max(1, static_cast<int>(info.version()));
  if (!info.metadata_json().empty()) spec.metadata_json = info.metadata_json();
  for (const std::string& parent : info.parents()) {
    if (parent != info.sha256()) spec.parents.push_back(parent);
  }
  spec.job_id = info.job_id();
  spec.task_id = info.task_id();
  return spec;
}

bool AddsNothing(const store::ArtifactInfo& stored, const store::ArtifactSpec& spec) {
  return stored.kind == spec.kind && (spec.job_id.empty() || stored.job_id == spec.job_id) &&
         std::all_of(spec.parents.begin(), spec.parents.end(), [&](const std::string& parent) {
           return std::find(stored.parents.begin(), stored.parents.end(), parent) != stored.parents.end();
         });
}

Result<pb::ShowArtifactReply> Show(store::ArtifactStore& artifacts, const pb::ShowArtifactRequest& request) {
  RG_ASSIGN_OR_RETURN(const std::string sha256, artifacts.Resolve(request.sha256()));
  RG_ASSIGN_OR_RETURN(const auto info, artifacts.Info(sha256));
  pb::ShowArtifactReply reply;
  *reply.mutable_info() = ToProto(info);
  return reply;
}

Result<pb::ListArtifactsReply> List(store::ArtifactStore& artifacts,
                                    const pb::ListArtifactsRequest& request) {
  store::ArtifactFilter filter;
  filter.kind = request.kind();
  filter.job_id = request.job_id();
  constexpr uint32_t kPage = 1000, kLongestPage = 10'000;
  filter.limit = static_cast<int>(request.limit() == 0 ? kPage : std::min(request.limit(), kLongestPage)) + 1;
  filter.before_sha256 = request.before_sha256();
  if (!filter.before_sha256.empty()) RG_RETURN_IF_ERROR(artifacts.Info(filter.before_sha256).status());
  RG_ASSIGN_OR_RETURN(const auto found, artifacts.List(filter));
  pb::ListArtifactsReply reply;
  for (const auto& info : found) {
    if (reply.artifacts_size() + 1 == filter.limit) return reply.set_more(true), reply;
    *reply.add_artifacts() = ToProto(info);
  }
  return reply;
}

Result<pb::ArtifactLineageReply> Lineage(store::ArtifactStore& artifacts,
                                         const pb::ArtifactLineageRequest& request) {
  RG_ASSIGN_OR_RETURN(const std::string sha256, artifacts.Resolve(request.sha256()));
  store::LineageOptions options;
  options.ancestors = request.ancestors();
  options.descendants = request.descendants();
  RG_ASSIGN_OR_RETURN(const auto lineage, artifacts.TraceLineage(sha256, options));
  pb::ArtifactLineageReply reply;
  for (const auto& node : lineage.nodes) *reply.add_nodes() = ToProto(node);
  for (const auto& edge : lineage.edges) {
    auto* out = reply.add_edges();
    out->set_parent(edge.parent);
    out->set_child(edge.child);
  }
  return reply;
}

Result<pb::VerifyArtifactsReply> Verify(store::ArtifactStore& artifacts,
                                        const pb::VerifyArtifactsRequest& request,
                                        const std::function<bool()>& stop) {
  RG_ASSIGN_OR_RETURN(const auto report,
                      artifacts.Verify({request.sha256().begin(), request.sha256().end()}, stop));
  pb::VerifyArtifactsReply reply;
  reply.set_checked(static_cast<uint64_t>(report.checked));
  reply.set_bytes(static_cast<uint64_t>(report.bytes));
  for (const auto& damage : report.damaged) {
    auto* out = reply.add_damaged();
    out->set_sha256(damage.sha256);
    out->set_kind(damage.kind);
    out->set_what(damage.what);
  }
  return reply;
}

Result<pb::GcArtifactsReply> Gc(store::ArtifactStore& artifacts, const pb::GcArtifactsRequest& request,
                                int64_t wall_ns) {
  constexpr int64_t kMaxBytes = 256 << 20, kMaxListed = 20'000, kMaxRemoved = 2'000;
  if (request.older_than_ns() < 0 || request.forget_ended_ns() < 0)
    return InvalidError("an age below zero");
  store::GcOptions options;
  options.older_than_ns = request.older_than_ns();
  options.dry_run = request.dry_run();
  options.max_bytes = options.dry_run ? 0 : kMaxBytes;
  options.max_count = options.dry_run ? kMaxListed : kMaxRemoved;
  const int64_t forget_ns = request.forget_ended_ns();
  options.references = JobStore::ArtifactReferences(forget_ns > 0 ? wall_ns - forget_ns : 0);
  options.references.push_back(store::ParameterStore::kReferences);
  RG_ASSIGN_OR_RETURN(const auto report, artifacts.Gc(options));
  pb::GcArtifactsReply reply;
  for (const auto& info : report.removed) *reply.add_removed() = ToProto(info);
  reply.set_bytes(static_cast<uint64_t>(report.bytes));
  reply.set_more(report.more);
  return reply;
}

Result<pb::PinArtifactReply> Pin(store::ArtifactStore& artifacts, const pb::PinArtifactRequest& request) {
  RG_ASSIGN_OR_RETURN(const std::string sha256, artifacts.Resolve(request.sha256()));
  RG_RETURN_IF_ERROR(request.unpin() ? artifacts.Unpin(sha256, request.owner())
                                     : artifacts.Pin(sha256, request.owner()));
  return pb::PinArtifactReply();
}

Result<pb::ListRobotsReply> Robots(store::ParameterStore& parameters, const pb::ListRobotsRequest&) {
  RG_ASSIGN_OR_RETURN(const auto robots, parameters.Robots());
  pb::ListRobotsReply reply;
  for (const std::string& robot : robots) reply.add_robots(robot);
  return reply;
}

Result<pb::ParameterHistoryReply> History(store::ParameterStore& parameters,
                                          const pb::ParameterHistoryRequest& request) {
  RG_ASSIGN_OR_RETURN(const auto versions,
                      parameters.History(request.robot(), static_cast<int>(request.limit())));
  pb::ParameterHistoryReply reply;
  for (const auto& version : versions) *reply.add_versions() = ToProto(version);
  RG_ASSIGN_OR_RETURN(const int current, parameters.Current(request.robot()));
  reply.set_current(static_cast<uint32_t>(current));
  return reply;
}

Result<pb::PromoteParametersReply> Promote(store::ParameterStore& parameters,
                                           const pb::PromoteParametersRequest& request) {
  RG_RETURN_IF_ERROR(parameters.Promote(request.robot(), static_cast<int>(request.version())));
  RG_ASSIGN_OR_RETURN(const int current, parameters.Current(request.robot()));
  pb::PromoteParametersReply reply;
  reply.set_current(static_cast<uint32_t>(current));
  return reply;
}

Result<pb::ShowParametersReply> ShowParameters(store::ParameterStore& parameters,
                                               const pb::ShowParametersRequest& request) {
  int number = static_cast<int>(request.version());
  if (request.current()) {
    RG_ASSIGN_OR_RETURN(number, parameters.Current(request.robot()));
    if (number == 0) return NotFoundError("parameters of " + request.robot() + ": none is current");
  }
  RG_ASSIGN_OR_RETURN(const auto version, parameters.Show(request.robot(), number));
  pb::ShowParametersReply reply;
  *reply.mutable_version() = ToProto(version);
  return reply;
}

Result<pb::DiffParametersReply> Diff(store::ParameterStore& parameters,
                                     const pb::DiffParametersRequest& request) {
  RG_ASSIGN_OR_RETURN(const auto diff,
                      parameters.Diff(request.robot(), static_cast<int>(request.from_version()),
                                      static_cast<int>(request.to_version())));
  pb::DiffParametersReply reply;
  *reply.mutable_from() = ToProto(diff.from);
  *reply.mutable_to() = ToProto(diff.to);
  for (const auto& row : diff.rows) {
    auto* out = reply.add_rows();
    out->set_name(row.name);
    if (row.from) out->set_from(*row.from);
    if (row.to) out->set_to(*row.to);
    if (row.sigmas) out->set_sigmas(*row.sigmas);
  }
  return reply;
}

// Unpacks, calls, and packs the reply or the error.
template <class Body, class Store, class Function>
transport::Message Serve(const Sender& self, const transport::Message& request, Store& store,
                         Function function) {
  auto body = Unpack<Body>(request);
  if (!body.ok()) return MakeErrorReply(self, request, body.status());
  auto reply = function(store, *body);
  if (!reply.ok()) return MakeErrorReply(self, request, reply.status());
  return MakeReply(self, request, *reply);
}

transport::Message OrError(const Sender& self, const transport::Message& request,
                           Result<transport::Message> reply) {
  return reply.ok() ? *std::move(reply) : MakeErrorReply(self, request, reply.status());
}

}  // namespace

bool ArtifactDesk::Writes(const transport::Message& request) {
  return Is<pb::PutArtifactRequest>(request) || Is<pb::GcArtifactsRequest>(request) ||
         Is<pb::PinArtifactRequest>(request) || Is<pb::PromoteParametersRequest>(request);
}

std::optional<transport::Message> ArtifactDesk::Answer(const Sender& self,
                                                       const transport::Message& request) {
  if (Is<pb::PutArtifactRequest>(request)) return OrError(self, request, Put(self, request));
  if (Is<pb::GetArtifactRequest>(request)) return OrError(self, request, Get(self, request));
  if (Is<pb::ShowArtifactRequest>(request)) {
    return Serve<pb::ShowArtifactRequest>(self, request, *artifacts_, Show);
  }
  if (Is<pb::ListArtifactsRequest>(request)) {
    return Serve<pb::ListArtifactsRequest>(self, request, *artifacts_, List);
  }
  if (Is<pb::ArtifactLineageRequest>(request)) {
    return Serve<pb::ArtifactLineageRequest>(self, request, *artifacts_, Lineage);
  }
  if (Is<pb::VerifyArtifactsRequest>(request)) {
    return Serve<pb::VerifyArtifactsRequest>(
        self, request, *artifacts_,
        [this](auto& artifacts, const auto& body) { return Verify(artifacts, body, stop_); });
  }
  if (Is<pb::GcArtifactsRequest>(request))
    return Serve<pb::GcArtifactsRequest>(
        self, request, *artifacts_,
        [this](auto& artifacts, const auto& body) { return Gc(artifacts, body, clock_->WallNanos()); });
  if (Is<pb::PinArtifactRequest>(request))
    return Serve<pb::PinArtifactRequest>(self, request, *artifacts_, Pin);
  if (Is<pb::ListRobotsRequest>(request))
    return Serve<pb::ListRobotsRequest>(self, request, *parameters_, Robots);
  if (Is<pb::ParameterHistoryRequest>(request)) {
    return Serve<pb::ParameterHistoryRequest>(self, request, *parameters_, History);
  }
  if (Is<pb::ShowParametersRequest>(request)) {
    return Serve<pb::ShowParametersRequest>(self, request, *parameters_, ShowParameters);
  }
  if (Is<pb::PromoteParametersRequest>(request)) {
    return Serve<pb::PromoteParametersRequest>(self, request, *parameters_, Promote);
  }
  if (Is<pb::DiffParametersRequest>(request)) {
    return Serve<pb::DiffParametersRequest>(self, request, *parameters_, Diff);
  }
  return std::nullopt;
}

Result<transport::Message> ArtifactDesk::Put(const Sender& self, const transport::Message& request) {
  RG_ASSIGN_OR_RETURN(const auto body, Unpack<pb::PutArtifactRequest>(request));
  // Whoever comes with the same key goes on with it; without keys, everybody on this machine is one.
  const std::string key = request.credentials.name + "/" + body.upload_id();
  pb::PutArtifactReply reply;
  if (body.has_info() && (body.offset() == 0 || body.last())) {  // it may be here already
    RG_RETURN_IF_ERROR(store::CheckSha256Text(body.info().sha256()));
    auto stored = artifacts_->Info(body.info().sha256());
    const bool is_output =
        request.credentials.role != pb::ROLE_OPERATOR;  // of a task: bytes are what matters
    if (stored.ok() &&
        (AddsNothing(*stored, SpecOf(body.info())) || (is_output && stored->kind != body.info().kind()))) {
      if (const auto upload = uploads_.find(key); upload != uploads_.end()) {
        upload->second.writer.Abandon();
        uploads_.erase(upload);
      }
      reply.set_committed(true);
      reply.set_existed(true);
      reply.set_next_offset(static_cast<uint64_t>(stored->size_bytes));
      return MakeReply(self, request, reply);
    }
  }
  auto upload = uploads_.find(key);
  if (upload == uploads_.end()) {
    if (uploads_.size() >= kMaxUploads) return ResourceExhaustedError("too many uploads at once");
    if (body.upload_id().size() > kMaxUploadId) return InvalidError("the upload's id is too long");
    RG_ASSIGN_OR_RETURN(auto writer, artifacts_->ResumePut(key));
    upload = uploads_.emplace(key, Upload{std::move(writer), 0}).first;
  }
  upload->second.last_ns = clock_->SteadyNanos();
  const auto have = static_cast<uint64_t>(upload->second.writer.size_bytes());
  if (body.offset() == have) {
    const Status appended = upload->second.writer.Append(request.attachment);
    if (!appended.ok()) return uploads_.erase(upload), appended;
  } else if (!(body.last() && body.offset() + request.attachment.size() == have)) {
    reply.set_next_offset(have);
    return MakeReply(self, request, reply);
  }
  reply.set_next_offset(static_cast<uint64_t>(upload->second.writer.size_bytes()));
  if (body.last()) {
    auto put = upload->second.writer.Commit(SpecOf(body.info()), body.info().sha256());
    uploads_.erase(upload);
    if (!put.ok()) return put.status();
    reply.set_committed(true);
    reply.set_existed(put->existed);
  }
  return MakeReply(self, request, reply);
}

Result<transport::Message> ArtifactDesk::Get(const Sender& self, const transport::Message& request) {
  RG_ASSIGN_OR_RETURN(const auto body, Unpack<pb::GetArtifactRequest>(request));
  RG_ASSIGN_OR_RETURN(const auto info, artifacts_->Info(body.sha256()));
  const int64_t limit = body.limit_bytes() == 0
                            ? kDefaultPiece
                            : std::min<int64_t>(static_cast<int64_t>(body.limit_bytes()), kLargestPiece);
  const auto offset = static_cast<int64_t>(body.offset());
  if (offset > info.size_bytes) {
    return InvalidError("artefact " + info.sha256 + ": offset " + std::to_string(offset) +
                        " is past its end at " + std::to_string(info.size_bytes));
  }
  RG_ASSIGN_OR_RETURN(std::string bytes, artifacts_->GetRange(info.sha256, offset, limit));
  pb::GetArtifactReply reply;
  reply.set_offset(body.offset());
  reply.set_size_bytes(static_cast<uint64_t>(info.size_bytes));
  if (body.offset() == 0) *reply.mutable_info() = ToProto(info);
  transport::Message message = MakeReply(self, request, reply);
  message.attachment = std::move(bytes);
  return message;
}

void ArtifactDesk::DropIdleUploads() {
  const int64_t oldest = clock_->SteadyNanos() - kIdleUploadNs;
  std::erase_if(uploads_, [&](const auto& entry) { return entry.second.last_ns < oldest; });
}

pb::ArtifactInfo ToProto(const store::ArtifactInfo& info) {
  pb::ArtifactInfo out;
  out.set_sha256(info.sha256);
  out.set_kind(info.kind);
  out.set_version(static_cast<uint32_t>(info.version));
  out.set_size_bytes(static_cast<uint64_t>(info.size_bytes));
  out.set_created_ns(info.created_ns);
  out.set_metadata_json(info.metadata_json);
  for (const std::string& parent : info.parents) out.add_parents(parent);
  out.set_job_id(info.job_id);
  out.set_task_id(info.task_id);
  for (const std::string& pin : info.pins) out.add_pins(pin);
  return out;
}

pb::ParameterVersion ToProto(const store::ParameterVersion& version) {
  pb::ParameterVersion out;
  out.set_id(version.id);
  out.set_robot(version.robot);
  out.set_version(static_cast<uint32_t>(version.version));
  out.set_parent_version(static_cast<uint32_t>(version.parent_version));
  out.set_source(static_cast<pb::ParameterSource>(version.source));
  out.set_recording_sha256(version.recording_sha256);
  if (version.residual_before) out.set_residual_before(*version.residual_before);
  if (version.residual_after) out.set_residual_after(*version.residual_after);
  for (const auto& value : version.values) {
    auto* to = out.add_values();
    to->set_name(value.name);
    to->set_value(value.value);
    if (value.stddev) to->set_stddev(*value.stddev);
  }
  out.set_created_ns(version.created_ns);
  out.set_job_id(version.job_id);
  out.set_note(version.note);
  out.set_model_sha256(version.model_sha256);
  out.set_rollout(version.rollout);
  out.set_held_back(version.held_back);
  return out;
}

Result<store::ParameterVersion> ParseParameterMetadata(const std::string& metadata_json) {
  const Json json = Json::parse(metadata_json, nullptr, false);
  if (!json.is_object()) return InvalidError("metadata is no JSON object");
  const auto text = [&](const char* field) {
    const auto found = json.find(field);
    return found != json.end() && found->is_string() ? found->get<std::string>() : std::string();
  };
  const auto number = [&](const char* field) -> std::optional<double> {
    const auto found = json.find(field);
    return found != json.end() && found->is_number() ? std::optional<double>(found->get<double>())
                                                     : std::nullopt;
  };
  store::ParameterVersion version;
  version.robot = text("robot");
  if (version.robot.empty()) return InvalidError("metadata of parameters: field 'robot' is missing");
  RG_ASSIGN_OR_RETURN(version.source, store::ParseParameterSource(text("source")));
  if (!json.contains("values")) return InvalidError("metadata of parameters: field 'values' is missing");
  RG_ASSIGN_OR_RETURN(version.values, store::ParseParameterValues(json["values"].dump()));
  version.residual_before = number("residual_before");
  version.residual_after = number("residual_after");
  const double parent = number("parent_version").value_or(0.0);
  constexpr double kMaxVersion = 1e9;
  if (!(parent >= 0.0 && parent <= kMaxVersion)) {
    return InvalidError("metadata of parameters: parent_version " + std::to_string(parent) + " is none");
  }
  version.parent_version = static_cast<int>(parent);
  version.recording_sha256 = text("recording");
  version.model_sha256 = text("model");
  version.note = text("note");
  version.rollout = text("rollout");
  const auto held_back = json.find("held_back");
  version.held_back = held_back != json.end() && held_back->is_boolean() && held_back->get<bool>();
  return version;
}

}  // namespace rg::coordinator
