#include "common/store/artifact_store.h"

#include <sodium.h>

#include <algorithm>
#include <nlohmann/json.hpp>

#include "common/base/ids.h"
#include "common/store/artifact_rows.h"

namespace rg::store {
namespace {

// Frozen. artifact.id is the id its upload was given; chunk k of it is row id * 2^20 + k.
constexpr std::string_view kArtifactsVersion1 = R"sql(
CREATE TABLE artifact_upload (
  id INTEGER PRIMARY KEY AUTOINCREMENT,
  token TEXT NOT NULL);
CREATE TABLE artifact (
  id INTEGER PRIMARY KEY,
  sha256 TEXT NOT NULL UNIQUE CHECK (length(sha256) = 64),
  kind TEXT NOT NULL,
  version INTEGER NOT NULL CHECK (version >= 1),
  size_bytes INTEGER NOT NULL CHECK (size_bytes >= 0),
  chunks INTEGER NOT NULL CHECK (chunks >= 0),
  created_ns INTEGER NOT NULL,
  touched_ns INTEGER NOT NULL,
  metadata_json TEXT NOT NULL,
  job_id TEXT NOT NULL,
  task_id TEXT NOT NULL);
CREATE INDEX artifact_by_kind ON artifact (kind, id);
CREATE TABLE artifact_chunk (
  id INTEGER PRIMARY KEY,
  checksum BLOB NOT NULL CHECK (length(checksum) = 16),
  bytes BLOB NOT NULL);
CREATE TABLE artifact_parent (
  child INTEGER NOT NULL REFERENCES artifact (id),
  parent INTEGER NOT NULL REFERENCES artifact (id),
  PRIMARY KEY (child, parent)) WITHOUT ROWID;
CREATE INDEX artifact_child ON artifact_parent (parent, child);
CREATE TABLE artifact_producer (
  artifact INTEGER NOT NULL REFERENCES artifact (id),
  job_id TEXT NOT NULL,
  task_id TEXT NOT NULL,
  produced_ns INTEGER NOT NULL,
  PRIMARY KEY (artifact, job_id, task_id)) WITHOUT ROWID;
CREATE INDEX artifact_by_job ON artifact_producer (job_id, artifact);
CREATE TABLE artifact_pin (
  artifact INTEGER NOT NULL REFERENCES artifact (id),
  owner TEXT NOT NULL,
  PRIMARY KEY (artifact, owner)) WITHOUT ROWID;
CREATE INDEX artifact_pin_by_owner ON artifact_pin (owner, artifact);
)sql";

// Uploads that may be taken up: how far they are, always at the end of a chunk, and their hash so far.
constexpr std::string_view kArtifactsVersion2 = R"sql(
ALTER TABLE artifact_upload ADD COLUMN name TEXT NOT NULL DEFAULT '';
ALTER TABLE artifact_upload ADD COLUMN size_bytes INTEGER NOT NULL DEFAULT 0;
ALTER TABLE artifact_upload ADD COLUMN chunks INTEGER NOT NULL DEFAULT 0;
ALTER TABLE artifact_upload ADD COLUMN hash_state BLOB;
ALTER TABLE artifact_upload ADD COLUMN touched_ns INTEGER NOT NULL DEFAULT 0;
CREATE UNIQUE INDEX artifact_upload_by_name ON artifact_upload (name) WHERE name <> '';
)sql";

Status CheckKind(const std::string& kind) {
  const auto allowed = [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '_' || c == '-' || c == '.';
  };
  if (!kind.empty() && kind.size() <= 64 && std::all_of(kind.begin(), kind.end(), allowed))
    return Status::Ok();
  return InvalidError("artefact kind \"" + kind + "\": must be 1 to 64 of a-z, 0-9, '_', '-', '.'");
}

Status CheckSpec(const ArtifactSpec& spec) {
  RG_RETURN_IF_ERROR(CheckKind(spec.kind));
  if (spec.version < 1)
    return InvalidError("artefact version " + std::to_string(spec.version) + ": must be >= 1");
  for (const std::string& parent : spec.parents)
    RG_RETURN_IF_ERROR(CheckSha256Text(parent).WithPrefix("parent"));
  if (spec.metadata_json == "{}") return Status::Ok();
  const auto metadata = nlohmann::json::parse(spec.metadata_json, nullptr, /*allow_exceptions=*/false);
  return metadata.is_object() ? Status::Ok() : InvalidError("artefact metadata: not a JSON object");
}

}  // namespace

Status CheckSha256Text(std::string_view text) {
  const auto hex = [](char c) { return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f'); };
  if (text.size() == 64 && std::all_of(text.begin(), text.end(), hex)) return Status::Ok();
  return InvalidError("\"" + std::string(text.substr(0, 80)) + "\": not a SHA-256 (64 hexadecimal digits)");
}

std::string ChunkChecksum(std::string_view bytes) {
  std::string sum(16, '\0');
  crypto_generichash(reinterpret_cast<unsigned char*>(sum.data()), sum.size(),
                     reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size(), nullptr, 0);
  return sum;
}

Module ArtifactStore::Schema() { return {"artifacts", {{1, kArtifactsVersion1}, {2, kArtifactsVersion2}}}; }

Result<std::unique_ptr<ArtifactStore>> ArtifactStore::Open(Database* database, const Clock* clock,
                                                           ArtifactStoreOptions options) {
  RG_CHECK(options.chunk_bytes >= 1 && options.chunk_bytes <= (64 << 20));
  RG_CHECK(sodium_init() >= 0);
  std::unique_ptr<ArtifactStore> store(new ArtifactStore(database, clock, options));
  if (!database->read_only()) RG_RETURN_IF_ERROR(store->SweepUploads(true));
  return store;
}

Status ArtifactStore::SweepUploads(bool all) {
  std::vector<int64_t> remains;
  {
    RG_ASSIGN_OR_RETURN(Statement query,
                        database_->Prepare("SELECT id FROM artifact_upload WHERE touched_ns < ?1"
                                           " AND name <> '' OR ?2 AND (name = '' OR chunks = 0)"));
    query.Bind(1, clock_->WallNanos() - options_.keep_uploads_ns).Bind(2, all ? 1 : 0);
    RG_RETURN_IF_ERROR(ForEachRow(&query, [&] { remains.push_back(query.Int(0)); }));
  }
  if (remains.empty()) return Status::Ok();
  return database_->InTransaction([&]() -> Status {
    for (const int64_t id : remains) {
      RG_RETURN_IF_ERROR(DropChunks(id));
      RG_ASSIGN_OR_RETURN(Statement drop, database_->Prepare("DELETE FROM artifact_upload WHERE id = ?"));
      drop.Bind(1, id);
      RG_RETURN_IF_ERROR(drop.Run());
    }
    return Status::Ok();
  });
}

// ---- uploads ----

// Above every artefact and every upload. Only one process writes, and only in a transaction.
Result<int64_t> ArtifactStore::NextId() {
  RG_ASSIGN_OR_RETURN(Statement query,
                      database_->Prepare("SELECT 1 + max((SELECT coalesce(max(id), 0) FROM artifact),"
                                         " (SELECT coalesce(max(id), 0) FROM artifact_upload))"));
  RG_ASSIGN_OR_RETURN(const bool row, query.Step());
  RG_CHECK(row);
  return query.Int(0);
}

Result<ArtifactWriter> ArtifactStore::BeginPut() {
  const std::string token = RandomHex(8);
  int64_t id = 0;
  RG_RETURN_IF_ERROR(database_->InTransaction([&]() -> Status {
    RG_ASSIGN_OR_RETURN(id, NextId());
    RG_ASSIGN_OR_RETURN(Statement insert,
                        database_->Prepare("INSERT INTO artifact_upload (id, token) VALUES (?, ?)"));
    insert.Bind(1, id).Bind(2, token);
    return insert.Run();
  }));
  return ArtifactWriter(this, id, token);
}

Result<ArtifactWriter> ArtifactStore::ResumePut(const std::string& name) {
  {
    RG_ASSIGN_OR_RETURN(Statement query,
                        database_->Prepare("SELECT id, token, size_bytes, chunks, hash_state FROM "
                                           "artifact_upload WHERE name = ?"));
    query.Bind(1, name);
    RG_ASSIGN_OR_RETURN(const bool found, query.Step());
    if (found) {
      ArtifactWriter writer(this, query.Int(0), query.Text(1), name);
      writer.size_bytes_ = query.Int(2);
      writer.next_chunk_ = query.Int(3);
      const bool is_ours = writer.next_chunk_ == 0 || writer.hash_.Restore(query.Blob(4));
      query.Reset();
      if (is_ours) {
        RG_RETURN_IF_ERROR(DropChunks(writer.id_, writer.next_chunk_));  // written after the last save
        return writer;
      }
      writer.Abandon();  // of another build
    }
  }
  RG_ASSIGN_OR_RETURN(ArtifactWriter writer, BeginPut());
  RG_ASSIGN_OR_RETURN(Statement note,
                      database_->Prepare("UPDATE artifact_upload SET name = ?, touched_ns = ? WHERE id = ?"));
  note.Bind(1, name).Bind(2, clock_->WallNanos()).Bind(3, writer.id_);
  RG_RETURN_IF_ERROR(note.Run());
  writer.name_ = name;
  return writer;
}

Status ArtifactStore::CheckUpload(int64_t id, const std::string& token) {
  RG_ASSIGN_OR_RETURN(Statement query,
                      database_->Prepare("SELECT 1 FROM artifact_upload WHERE id = ? AND token = ?"));
  query.Bind(1, id).Bind(2, token);
  RG_ASSIGN_OR_RETURN(const bool row, query.Step());
  return row ? Status::Ok()
             : AbortedError("upload " + std::to_string(id) + ": gone with the transaction that began it");
}

Status ArtifactStore::WriteChunk(int64_t id, int64_t chunk, std::string_view bytes) {
  if (chunk >= kMaxChunks)
    return ResourceExhaustedError("artefact of more than " + std::to_string(kMaxChunks) + " chunks");
  RG_ASSIGN_OR_RETURN(
      Statement insert,
      database_->Prepare("INSERT INTO artifact_chunk (id, checksum, bytes) VALUES (?, ?, ?)"));
  const std::string checksum = ChunkChecksum(bytes);
  insert.Bind(1, ChunkId(id, chunk)).BindBlob(2, checksum).BindBlob(3, bytes);
  return insert.Run();
}

Status ArtifactStore::DropChunks(int64_t id, int64_t from) {
  RG_ASSIGN_OR_RETURN(Statement drop,
                      database_->Prepare("DELETE FROM artifact_chunk WHERE id >= ? AND id < ?"));
  drop.Bind(1, ChunkId(id, from)).Bind(2, ChunkId(id + 1, 0));
  return drop.Run();
}

Status ArtifactStore::DropUpload(int64_t id, const std::string& token) {
  return database_->InTransaction([&]() -> Status {
    RG_ASSIGN_OR_RETURN(Statement drop,
                        database_->Prepare("DELETE FROM artifact_upload WHERE id = ? AND token = ?"));
    drop.Bind(1, id).Bind(2, token);
    RG_RETURN_IF_ERROR(drop.Run());
    return database_->changes() == 1 ? DropChunks(id) : Status::Ok();
  });
}

// Pieces appended inside a transaction that was rolled back later are gone: such an upload must not
// become an artefact.
Status ArtifactStore::CheckChunks(int64_t id, int64_t chunks, int64_t size) {
  RG_ASSIGN_OR_RETURN(
      Statement query,
      database_->Prepare("SELECT count(*), coalesce(sum(length(bytes)), 0) FROM artifact_chunk"
                         " WHERE id >= ? AND id < ?"));
  query.Bind(1, ChunkId(id, 0)).Bind(2, ChunkId(id + 1, 0));
  RG_ASSIGN_OR_RETURN(const bool row, query.Step());
  if (row && query.Int(0) == chunks && query.Int(1) == size) return Status::Ok();
  return AbortedError("upload " + std::to_string(id) + ": a part of it was rolled back");
}

Result<PutResult> ArtifactStore::Put(std::string_view bytes, const ArtifactSpec& spec) {
  RG_RETURN_IF_ERROR(CheckSpec(spec));
  if (static_cast<int64_t>(bytes.size()) > options_.max_artifact_bytes)
    return ResourceExhaustedError("artefact of " + std::to_string(bytes.size()) + " bytes: the limit is " +
                                  std::to_string(options_.max_artifact_bytes));
  PutResult result{Sha256Hex(bytes), false};
  RG_RETURN_IF_ERROR(database_->InTransaction([&]() -> Status {
    RG_ASSIGN_OR_RETURN(result.existed, NoteExisting(result.sha256, spec));
    if (result.existed) return Status::Ok();
    RG_ASSIGN_OR_RETURN(const int64_t id, NextId());
    int64_t chunk = 0;
    for (size_t at = 0; at < bytes.size(); at += options_.chunk_bytes)
      RG_RETURN_IF_ERROR(WriteChunk(id, chunk++, bytes.substr(at, options_.chunk_bytes)));
    return InsertArtifact(id, chunk, static_cast<int64_t>(bytes.size()), result.sha256, spec);
  }));
  return result;
}

// Turns an upload into an artefact: the only place where an artefact's row is written.
Status ArtifactStore::InsertArtifact(int64_t id, int64_t chunks, int64_t size, const std::string& sha256,
                                     const ArtifactSpec& spec) {
  RG_ASSIGN_OR_RETURN(
      Statement insert,
      database_->Prepare("INSERT INTO artifact (id, sha256, kind, version, size_bytes, chunks,"
                         " created_ns, touched_ns, metadata_json, job_id, task_id)"
                         " VALUES (?, ?, ?, ?, ?, ?, ?7, ?7, ?, ?, ?)"));
  insert.Bind(1, id).Bind(2, sha256).Bind(3, spec.kind).Bind(4, spec.version).Bind(5, size).Bind(6, chunks);
  insert.Bind(7, clock_->WallNanos()).Bind(8, spec.metadata_json).Bind(9, spec.job_id).Bind(10, spec.task_id);
  RG_RETURN_IF_ERROR(insert.Run());
  return AddLinks(id, sha256, spec);
}

Result<bool> ArtifactStore::NoteExisting(const std::string& sha256, const ArtifactSpec& spec) {
  int64_t id = 0;
  {
    RG_ASSIGN_OR_RETURN(Statement query,
                        database_->Prepare("SELECT id, kind FROM artifact WHERE sha256 = ?"));
    query.Bind(1, sha256);
    RG_ASSIGN_OR_RETURN(const bool found, query.Step());
    if (!found) return false;
    id = query.Int(0);
    if (query.Text(1) != spec.kind)
      return FailedPreconditionError("artefact " + sha256 + ": these bytes are there already as kind \"" +
                                     query.Text(1) + "\", not \"" + spec.kind + "\"");
  }
  RG_ASSIGN_OR_RETURN(Statement touch, database_->Prepare("UPDATE artifact SET touched_ns = ? WHERE id = ?"));
  touch.Bind(1, clock_->WallNanos()).Bind(2, id);
  RG_RETURN_IF_ERROR(touch.Run());
  RG_RETURN_IF_ERROR(AddLinks(id, sha256, spec));
  return true;
}

Status ArtifactStore::AddLinks(int64_t id, const std::string& sha256, const ArtifactSpec& spec) {
  for (const std::string& parent : spec.parents) {
    if (parent == sha256) continue;  // a task that returned its input unchanged
    RG_ASSIGN_OR_RETURN(
        Statement insert,
        database_->Prepare("INSERT INTO artifact_parent (child, parent)"
                           " SELECT ?, id FROM artifact WHERE sha256 = ? ON CONFLICT DO NOTHING"));
    insert.Bind(1, id).Bind(2, parent);
    RG_RETURN_IF_ERROR(insert.Run());
    if (database_->changes() == 0 && !Contains(parent))
      return NotFoundError("artefact " + sha256 + ": its parent " + parent + " is not in the store");
  }
  if (spec.job_id.empty()) return Status::Ok();
  RG_ASSIGN_OR_RETURN(
      Statement insert,
      database_->Prepare("INSERT INTO artifact_producer (artifact, job_id, task_id, produced_ns)"
                         " VALUES (?, ?, ?, ?) ON CONFLICT DO NOTHING"));
  insert.Bind(1, id).Bind(2, spec.job_id).Bind(3, spec.task_id).Bind(4, clock_->WallNanos());
  return insert.Run();
}

// ---- ArtifactWriter ----

ArtifactWriter::~ArtifactWriter() {
  if (name_.empty()) Abandon();
}

// Only at the end of a chunk: what is pending would be lost with this process.
Status ArtifactWriter::SaveProgress() {
  if (name_.empty() || !pending_.empty()) return Status::Ok();
  RG_ASSIGN_OR_RETURN(Statement save, store_.store->database_->Prepare(
                                          "UPDATE artifact_upload SET size_bytes = ?, chunks = ?, "
                                          "hash_state = ?, touched_ns = ? WHERE id = ?"));
  const std::string state = hash_.Save();
  save.Bind(1, size_bytes_).Bind(2, next_chunk_).BindBlob(3, state);
  save.Bind(4, store_.store->clock_->WallNanos()).Bind(5, id_);
  return save.Run();
}

void ArtifactWriter::Abandon() {
  if (ArtifactStore* store = std::exchange(store_.store, nullptr)) {
    // A failure leaves invisible rows, which the next Open sweeps.
    (void)store->DropUpload(id_, token_);
  }
}

Status ArtifactWriter::Append(std::string_view bytes) {
  if (store_.store == nullptr) return AbortedError("artefact: this upload has ended");
  ArtifactStore& store = *store_.store;
  if (size_bytes_ + static_cast<int64_t>(bytes.size()) > store.options_.max_artifact_bytes)
    return ResourceExhaustedError("artefact of " + std::to_string(size_bytes_ + bytes.size()) +
                                  " bytes or more: the limit is " +
                                  std::to_string(store.options_.max_artifact_bytes));
  hash_.Update(bytes);
  size_bytes_ += static_cast<int64_t>(bytes.size());
  pending_.append(bytes);
  const size_t chunk_bytes = static_cast<size_t>(store.options_.chunk_bytes);
  if (pending_.size() < chunk_bytes) return Status::Ok();
  const Status written = store.database_->InTransaction([&]() -> Status {
    RG_RETURN_IF_ERROR(store.CheckUpload(id_, token_));
    size_t at = 0;
    for (; pending_.size() - at >= chunk_bytes; at += chunk_bytes)
      RG_RETURN_IF_ERROR(
          store.WriteChunk(id_, next_chunk_++, std::string_view(pending_).substr(at, chunk_bytes)));
    pending_.erase(0, at);
    return SaveProgress();
  });
  if (!written.ok()) Abandon();
  return written;
}

Result<PutResult> ArtifactWriter::Commit(const ArtifactSpec& spec, std::string_view expected_sha256) {
  if (store_.store == nullptr) return AbortedError("artefact: this upload has ended");
  ArtifactStore& store = *store_.store;
  PutResult result{hash_.FinishHex(), false};
  const Status outcome = store.database_->InTransaction([&]() -> Status {
    RG_RETURN_IF_ERROR(CheckSpec(spec));
    if (!expected_sha256.empty() && expected_sha256 != result.sha256)
      return DataLossError("artefact " + std::string(expected_sha256.substr(0, 64)) + ": the " +
                           std::to_string(size_bytes_) + " bytes received have hash " + result.sha256);
    RG_RETURN_IF_ERROR(store.CheckUpload(id_, token_));
    RG_ASSIGN_OR_RETURN(result.existed, store.NoteExisting(result.sha256, spec));
    if (result.existed) return store.DropUpload(id_, token_);
    if (!pending_.empty()) RG_RETURN_IF_ERROR(store.WriteChunk(id_, next_chunk_++, pending_));
    RG_RETURN_IF_ERROR(store.CheckChunks(id_, next_chunk_, size_bytes_));
    RG_ASSIGN_OR_RETURN(Statement done, store.database_->Prepare("DELETE FROM artifact_upload WHERE id = ?"));
    done.Bind(1, id_);
    RG_RETURN_IF_ERROR(done.Run());
    return store.InsertArtifact(id_, next_chunk_, size_bytes_, result.sha256, spec);
  });
  if (!outcome.ok()) {
    Abandon();
    return outcome;
  }
  store_.store = nullptr;
  return result;
}

}  // namespace rg::store
