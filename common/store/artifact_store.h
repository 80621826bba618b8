// Artefacts: every product of a job, addressed by the SHA-256 of its bytes, in the database itself.
//
// An artefact exists when its row is committed, and its row is only ever written together with all
// of its bytes. An upload that was not committed (its process was killed) is invisible and is swept
// at the next Open. Putting the same bytes again is harmless: the artefact stays as it is, new
// parents, pins and producers are added to it.
//
// All calls join the Database's open transaction if there is one: a caller that commits a task's
// result and its artefacts does it in one.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/clock.h"
#include "common/base/hash.h"
#include "common/base/status.h"
#include "common/store/database.h"

namespace rg::store {

struct ArtifactInfo {
  std::string sha256;  // 64 lower-case hexadecimal digits
  std::string kind;    // lower case, digits, '_', '-', '.'; 1..64 characters
  int version = 1;     // of the kind's own format, >= 1
  int64_t size_bytes = 0;
  int64_t created_ns = 0;  // wall time of the first put
  std::string metadata_json = "{}";
  std::vector<std::string> parents;
  std::string job_id;  // of the first production; may be empty
  std::string task_id;
  std::vector<std::string> pins;
};

// What a caller says of the bytes it puts.
struct ArtifactSpec {
  std::string kind;
  int version = 1;
  std::string metadata_json = "{}";  // an object
  std::vector<std::string> parents;  // must exist
  std::string job_id;
  std::string task_id;
};

struct PutResult {
  std::string sha256;
  bool existed = false;  // the bytes were there already
};

struct ArtifactFilter {
  std::string kind;                // empty: any
  std::string job_id;              // empty: any; otherwise produced by it, first or again
  int limit = 0;                   // 0: all
  std::string before_sha256 = {};  // only what is older than this one; empty: from the newest
};

struct LineageOptions {
  bool ancestors = true;
  bool descendants = true;
  int max_depth = 0;  // 0: to the end
};

struct Lineage {
  struct Edge {
    std::string parent;
    std::string child;
    bool operator==(const Edge&) const = default;
  };
  std::vector<ArtifactInfo> nodes;  // the artefact asked for is one; oldest first
  std::vector<Edge> edges;          // sorted by (parent, child)
};

struct Damage {
  std::string sha256;
  std::string kind;
  std::string what;  // "chunk 3 of 7 (bytes 3145728..4194303) does not match its checksum"
};

struct VerifyReport {
  int64_t checked = 0;
  int64_t bytes = 0;
  std::vector<Damage> damaged;
};

struct GcOptions {
  int64_t older_than_ns = 0;  // age since the last put of the same bytes; younger artefacts stay
  bool dry_run = false;
  // Who else refers to artefacts: SELECTs of one column of hashes from other modules' tables
  // (ParameterStore::kReferences). What they name stays.
  std::vector<std::string> references = {};
  // One call removes (or lists) at most about so many bytes and artefacts; 0: all.
  int64_t max_bytes = 0;
  int64_t max_count = 0;
};

struct GcReport {
  std::vector<ArtifactInfo> removed;  // or would be (dry_run)
  int64_t bytes = 0;
  bool more = false;  // there are others: a limit was reached
};

class ArtifactStore;

// A streaming put. Append and Commit join an open transaction or make their own. Abandoned when
// destroyed uncommitted, but for one with a name (ArtifactStore::ResumePut): what of that is durable waits
// for whoever goes on.
class ArtifactWriter {
 public:
  ArtifactWriter(ArtifactWriter&&) noexcept = default;
  ArtifactWriter& operator=(ArtifactWriter&&) = delete;
  ~ArtifactWriter();

  // kResourceExhausted: over ArtifactStoreOptions::max_artifact_bytes, or the disk is full.
  Status Append(std::string_view bytes);
  // kDataLoss if `expected_sha256` is given and is not the hash of what was appended (nothing is
  // kept); kNotFound: a parent does not exist; kFailedPrecondition: the bytes exist as another kind.
  Result<PutResult> Commit(const ArtifactSpec& spec, std::string_view expected_sha256 = {});
  void Abandon();
  int64_t size_bytes() const { return size_bytes_; }
  const std::string& name() const { return name_; }

 private:
  friend class ArtifactStore;
  ArtifactWriter(ArtifactStore* store, int64_t id, std::string token, std::string name = {})
      : store_(store), id_(id), token_(std::move(token)), name_(std::move(name)) {}
  Status SaveProgress();

  // Moves with the writer: the moved-from one owns nothing.
  struct Owner {
    ArtifactStore* store = nullptr;
    Owner(ArtifactStore* s) : store(s) {}  // NOLINT
    Owner(Owner&& o) noexcept : store(o.store) { o.store = nullptr; }
  };
  Owner store_;
  int64_t id_;
  std::string token_;  // tells this upload from a later one that got the same id after a rollback
  std::string name_;   // empty: nobody can take it up
  int64_t next_chunk_ = 0;
  int64_t size_bytes_ = 0;
  std::string pending_;  // less than a chunk
  Sha256 hash_;
};

// Reads an artefact piece by piece; every chunk is checked against its checksum, and the whole
// against its hash when the last byte is read.
class ArtifactReader {
 public:
  // Up to a chunk; empty at the end. kDataLoss names the artefact and the chunk.
  Result<std::string> Next();
  const ArtifactInfo& info() const { return info_; }

 private:
  friend class ArtifactStore;
  ArtifactReader(ArtifactStore* store, ArtifactInfo info, int64_t id)
      : store_(store), info_(std::move(info)), id_(id) {}
  ArtifactStore* store_;
  ArtifactInfo info_;
  int64_t id_;
  int64_t next_chunk_ = 0;
  int64_t offset_ = 0;
  Sha256 hash_;
};

struct ArtifactStoreOptions {
  int64_t chunk_bytes = 1 << 20;                  // of one row; 1 .. 64 MiB
  int64_t max_artifact_bytes = int64_t{4} << 30;  // larger ones are refused
  // An upload with a name that nobody went on with for so long is swept at the next Open.
  int64_t keep_uploads_ns = 86'400'000'000'000;
};

class ArtifactStore {
 public:
  // The tables it needs: give it to Database::Open.
  static Module Schema();
  // One store per Database. Sweeps the remains of uploads that were never committed (not on a read-only
  // database). Both arguments must outlive the store.
  static Result<std::unique_ptr<ArtifactStore>> Open(Database* database, const Clock* clock,
                                                     ArtifactStoreOptions options = {});

  Result<PutResult> Put(std::string_view bytes, const ArtifactSpec& spec);
  Result<ArtifactWriter> BeginPut();
  // The upload of that name where it was when it was last durable, or a new one. One writer per name.
  Result<ArtifactWriter> ResumePut(const std::string& name);

  bool Contains(const std::string& sha256);
  Result<ArtifactInfo> Info(const std::string& sha256);
  // The full hash of a unique beginning of at least 6 digits. kNotFound; kInvalid: several match.
  Result<std::string> Resolve(std::string_view beginning);
  // All bytes, checked against the hash.
  Result<std::string> Get(const std::string& sha256);
  // Bytes [offset, offset + limit), fewer at the end; the chunks they come from are checked.
  Result<std::string> GetRange(const std::string& sha256, int64_t offset, int64_t limit);
  Result<ArtifactReader> OpenReader(const std::string& sha256);

  Result<std::vector<ArtifactInfo>> List(const ArtifactFilter& filter = {});  // newest first
  Result<Lineage> TraceLineage(const std::string& sha256, const LineageOptions& options = {});

  // Checks bytes, hashes and sizes of the given artefacts, or of all. Damage is a finding, not an error; so
  // is nothing that is removed meanwhile. kCancelled once `stop` says so (asked after every chunk).
  Result<VerifyReport> Verify(const std::vector<std::string>& sha256s = {},
                              const std::function<bool()>& stop = {});

  // A pinned artefact and all its ancestors survive Gc. `owner` is who wants it: "job:17", "user".
  Status Pin(const std::string& sha256, const std::string& owner);
  Status Unpin(const std::string& sha256, const std::string& owner);
  Status UnpinAll(const std::string& owner);
  // Removes artefacts that are old enough and that nothing kept descends from or refers to. Kept are:
  // pinned and young ones, those that GcOptions::references name, and the ancestors of all of these.
  // Outside of a transaction the file shrinks too (else: Database::ReleaseFreePages after the commit).
  Result<GcReport> Gc(const GcOptions& options);

  // Uploads that nobody goes on with any more. `all`: also those that cannot be taken up, for when no writer
  // is there (Open).
  Status SweepUploads(bool all = false);

  struct Totals {
    int64_t artifacts = 0;
    int64_t bytes = 0;
  };
  Result<Totals> CountAll();
  const ArtifactStoreOptions& options() const { return options_; }

 private:
  friend class ArtifactWriter;
  friend class ArtifactReader;
  ArtifactStore(Database* database, const Clock* clock, ArtifactStoreOptions options)
      : database_(database), clock_(clock), options_(options) {}

  struct Row {
    ArtifactInfo info;
    int64_t id = 0;
    int64_t chunks = 0;
  };

  // Uploads (artifact_store.cc).
  Result<int64_t> NextId();
  Status CheckUpload(int64_t id, const std::string& token);
  Status WriteChunk(int64_t id, int64_t chunk, std::string_view bytes);
  Status CheckChunks(int64_t id, int64_t chunks, int64_t size);
  Status DropUpload(int64_t id, const std::string& token);
  Status DropChunks(int64_t id, int64_t from = 0);
  Status InsertArtifact(int64_t id, int64_t chunks, int64_t size, const std::string& sha256,
                        const ArtifactSpec& spec);
  Result<bool> NoteExisting(const std::string& sha256, const ArtifactSpec& spec);
  Status AddLinks(int64_t id, const std::string& sha256, const ArtifactSpec& spec);
  // Rows (artifact_catalog.cc).
  Result<Row> Find(const std::string& sha256);
  Result<Row> FindById(int64_t id);
  Status FillLists(Row* row);
  Result<std::string> ReadChunk(const ArtifactInfo& info, int64_t id, int64_t chunk);
  Result<std::vector<int64_t>> Neighbours(int64_t id, bool parents);
  Result<std::vector<int64_t>> CollectableIds(const GcOptions& options);
  Status RemoveArtifact(int64_t id);
  Status VerifyRow(const Row& row, const std::function<bool()>& stop, VerifyReport* report);

  Database* database_;
  const Clock* clock_;
  ArtifactStoreOptions options_;
};

// kInvalid unless `text` is 64 lower-case hexadecimal digits.
Status CheckSha256Text(std::string_view text);

}  // namespace rg::store
