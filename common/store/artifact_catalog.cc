// The reading half of the artefact store: rows, bytes, lineage, verification, garbage collection.
#include <algorithm>
#include <deque>
#include <set>

#include "common/store/artifact_rows.h"
#include "common/store/artifact_store.h"

namespace rg::store {
namespace {

constexpr std::string_view kArtifactColumns =
    "SELECT a.id, a.sha256, a.kind, a.version, a.size_bytes, a.chunks, a.created_ns, a.metadata_json,"
    " a.job_id, a.task_id FROM artifact a ";

template <class Row>
Row ReadRow(const Statement& query) {
  Row row;
  row.id = query.Int(0);
  row.chunks = query.Int(5);
  row.info.sha256 = query.Text(1);
  row.info.kind = query.Text(2);
  row.info.version = static_cast<int>(query.Int(3));
  row.info.size_bytes = query.Int(4);
  row.info.created_ns = query.Int(6);
  row.info.metadata_json = query.Text(7);
  row.info.job_id = query.Text(8);
  row.info.task_id = query.Text(9);
  return row;
}

std::string ChunkName(int64_t chunk, int64_t chunks) {
  return "chunk " + std::to_string(chunk) + " of " + std::to_string(chunks);
}

Status ReadTexts(Database* database, std::string_view sql, int64_t id, std::vector<std::string>* out) {
  RG_ASSIGN_OR_RETURN(Statement query, database->Prepare(sql));
  query.Bind(1, id);
  return ForEachRow(&query, [&] { out->push_back(query.Text(0)); });
}

}  // namespace

// ---- rows ----

Status ArtifactStore::FillLists(Row* row) {
  RG_RETURN_IF_ERROR(ReadTexts(database_,
                               "SELECT p.sha256 FROM artifact_parent l JOIN artifact p ON p.id = l.parent"
                               " WHERE l.child = ? ORDER BY p.id",
                               row->id, &row->info.parents));
  return ReadTexts(database_, "SELECT owner FROM artifact_pin WHERE artifact = ? ORDER BY owner", row->id,
                   &row->info.pins);
}

Result<ArtifactStore::Row> ArtifactStore::Find(const std::string& sha256) {
  RG_RETURN_IF_ERROR(CheckSha256Text(sha256));
  Row row;
  {
    RG_ASSIGN_OR_RETURN(Statement query,
                        database_->Prepare(std::string(kArtifactColumns) + "WHERE a.sha256 = ?"));
    query.Bind(1, sha256);
    RG_ASSIGN_OR_RETURN(const bool found, query.Step());
    if (!found) return NotFoundError("artefact " + sha256 + ": not in the store");
    row = ReadRow<Row>(query);
  }
  RG_RETURN_IF_ERROR(FillLists(&row));
  return row;
}

Result<ArtifactStore::Row> ArtifactStore::FindById(int64_t id) {
  Row row;
  {
    RG_ASSIGN_OR_RETURN(Statement query,
                        database_->Prepare(std::string(kArtifactColumns) + "WHERE a.id = ?"));
    query.Bind(1, id);
    RG_ASSIGN_OR_RETURN(const bool found, query.Step());
    if (!found) return NotFoundError("artefact row " + std::to_string(id) + ": not in the store");
    row = ReadRow<Row>(query);
  }
  RG_RETURN_IF_ERROR(FillLists(&row));
  return row;
}

bool ArtifactStore::Contains(const std::string& sha256) {
  auto query = database_->Prepare("SELECT 1 FROM artifact WHERE sha256 = ?");
  if (!query.ok()) return false;
  query->Bind(1, sha256);
  const auto row = query->Step();
  return row.ok() && *row;
}

Result<ArtifactInfo> ArtifactStore::Info(const std::string& sha256) {
  RG_ASSIGN_OR_RETURN(Row row, Find(sha256));
  return std::move(row.info);
}

Result<std::string> ArtifactStore::Resolve(std::string_view beginning) {
  const auto hex = [](char c) { return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f'); };
  if (beginning.size() < 6 || beginning.size() > 64 || !std::all_of(beginning.begin(), beginning.end(), hex))
    return InvalidError("\"" + std::string(beginning.substr(0, 80)) +
                        "\": not the beginning of a hash (6 to 64 hexadecimal digits)");
  std::vector<std::string> matches;
  RG_ASSIGN_OR_RETURN(
      Statement query,
      database_->Prepare("SELECT sha256 FROM artifact WHERE sha256 >= ? AND sha256 < ? LIMIT 2"));
  query.Bind(1, beginning).Bind(2, std::string(beginning) + "g");
  RG_RETURN_IF_ERROR(ForEachRow(&query, [&] { matches.push_back(query.Text(0)); }));
  if (matches.empty()) return NotFoundError("artefact " + std::string(beginning) + ": not in the store");
  if (matches.size() > 1)
    return InvalidError("artefact " + std::string(beginning) + ": several begin with this; give more digits");
  return matches.front();
}

Result<std::vector<ArtifactInfo>> ArtifactStore::List(const ArtifactFilter& filter) {
  std::vector<Row> rows;
  {
    RG_ASSIGN_OR_RETURN(
        Statement query,
        database_->Prepare(std::string(kArtifactColumns) +
                           "WHERE (?1 = '' OR a.kind = ?1) AND (?2 = '' OR a.id IN"
                           " (SELECT artifact FROM artifact_producer WHERE job_id = ?2))"
                           " AND (?4 = '' OR a.id < (SELECT id FROM artifact WHERE sha256 = ?4))"
                           " ORDER BY a.id DESC LIMIT ?3"));
    query.Bind(1, filter.kind).Bind(2, filter.job_id).Bind(3, filter.limit > 0 ? filter.limit : -1);
    query.Bind(4, filter.before_sha256);
    RG_RETURN_IF_ERROR(ForEachRow(&query, [&] { rows.push_back(ReadRow<Row>(query)); }));
  }
  std::vector<ArtifactInfo> infos;
  infos.reserve(rows.size());
  for (Row& row : rows) {
    RG_RETURN_IF_ERROR(FillLists(&row));
    infos.push_back(std::move(row.info));
  }
  return infos;
}

Result<ArtifactStore::Totals> ArtifactStore::CountAll() {
  RG_ASSIGN_OR_RETURN(Statement query,
                      database_->Prepare("SELECT count(*), coalesce(sum(size_bytes), 0) FROM artifact"));
  RG_ASSIGN_OR_RETURN(const bool row, query.Step());
  RG_CHECK(row);
  return Totals{query.Int(0), query.Int(1)};
}

// ---- bytes ----

Result<std::string> ArtifactStore::ReadChunk(const ArtifactInfo& info, int64_t id, int64_t chunk) {
  const std::string where =
      "artefact " + info.sha256 + " (" + info.kind + "): chunk " + std::to_string(chunk);
  RG_ASSIGN_OR_RETURN(Statement query,
                      database_->Prepare("SELECT bytes, checksum FROM artifact_chunk WHERE id = ?"));
  query.Bind(1, ChunkId(id, chunk));
  const auto found = query.Step();
  if (!found.ok()) return found.status().WithPrefix(where);
  if (!*found) return DataLossError(where + " is missing");
  std::string bytes(query.Blob(0));
  if (ChunkChecksum(bytes) != query.Blob(1)) return DataLossError(where + " does not match its checksum");
  return bytes;
}

Result<ArtifactReader> ArtifactStore::OpenReader(const std::string& sha256) {
  RG_ASSIGN_OR_RETURN(Row row, Find(sha256));
  return ArtifactReader(this, std::move(row.info), row.id);
}

Result<std::string> ArtifactReader::Next() {
  if (offset_ == info_.size_bytes && next_chunk_ > 0) return std::string();
  std::string bytes;
  if (info_.size_bytes > 0) {
    RG_ASSIGN_OR_RETURN(bytes, store_->ReadChunk(info_, id_, next_chunk_));
    hash_.Update(bytes);
  }
  ++next_chunk_;
  offset_ += static_cast<int64_t>(bytes.size());
  if (offset_ > info_.size_bytes)
    return DataLossError("artefact " + info_.sha256 + ": its chunks are longer than its size");
  if (offset_ == info_.size_bytes && hash_.FinishHex() != info_.sha256)
    return DataLossError("artefact " + info_.sha256 + " (" + info_.kind +
                         "): its bytes do not match its hash");
  return bytes;
}

Result<std::string> ArtifactStore::Get(const std::string& sha256) {
  RG_ASSIGN_OR_RETURN(ArtifactReader reader, OpenReader(sha256));
  std::string all;
  all.reserve(static_cast<size_t>(reader.info().size_bytes));
  while (true) {
    RG_ASSIGN_OR_RETURN(const std::string piece, reader.Next());
    if (piece.empty()) return all;
    all += piece;
  }
}

Result<std::string> ArtifactStore::GetRange(const std::string& sha256, int64_t offset, int64_t limit) {
  RG_ASSIGN_OR_RETURN(const Row row, Find(sha256));
  if (offset < 0 || limit < 0 || offset > row.info.size_bytes)
    return InvalidError("artefact " + sha256 + ": no bytes from " + std::to_string(offset) +
                        " on, its size is " + std::to_string(row.info.size_bytes));
  const int64_t end = offset + std::min(limit, row.info.size_bytes - offset);
  if (end == offset) return std::string();
  // All chunks but the last are of one size, which is the first one's whatever the options were then.
  int64_t chunk_bytes = 0;
  {
    RG_ASSIGN_OR_RETURN(Statement query,
                        database_->Prepare("SELECT length(bytes) FROM artifact_chunk WHERE id = ?"));
    query.Bind(1, ChunkId(row.id, 0));
    RG_ASSIGN_OR_RETURN(const bool found, query.Step());
    if (found) chunk_bytes = query.Int(0);
  }
  if (chunk_bytes == 0) return DataLossError("artefact " + sha256 + ": chunk 0 is missing");
  std::string bytes;
  bytes.reserve(static_cast<size_t>(end - offset));
  for (int64_t chunk = offset / chunk_bytes; chunk * chunk_bytes < end; ++chunk) {
    RG_ASSIGN_OR_RETURN(const std::string piece, ReadChunk(row.info, row.id, chunk));
    const int64_t first = chunk * chunk_bytes;
    const int64_t from = std::max<int64_t>(offset - first, 0);
    const int64_t to = std::min<int64_t>(end - first, static_cast<int64_t>(piece.size()));
    if (to <= from)
      return DataLossError("artefact " + sha256 + ": chunk " + std::to_string(chunk) + " is too short");
    bytes.append(piece, static_cast<size_t>(from), static_cast<size_t>(to - from));
  }
  return bytes;
}

// ---- lineage ----

Result<std::vector<int64_t>> ArtifactStore::Neighbours(int64_t id, bool parents) {
  RG_ASSIGN_OR_RETURN(Statement query,
                      database_->Prepare(parents ? "SELECT parent FROM artifact_parent WHERE child = ?"
                                                 : "SELECT child FROM artifact_parent WHERE parent = ?"));
  query.Bind(1, id);
  std::vector<int64_t> ids;
  RG_RETURN_IF_ERROR(ForEachRow(&query, [&] { ids.push_back(query.Int(0)); }));
  return ids;
}

Result<Lineage> ArtifactStore::TraceLineage(const std::string& sha256, const LineageOptions& options) {
  RG_ASSIGN_OR_RETURN(const Row start, Find(sha256));
  std::set<int64_t> nodes{start.id};
  std::set<std::pair<int64_t, int64_t>> edges;  // parent, child
  for (const bool up : {true, false}) {
    if (!(up ? options.ancestors : options.descendants)) continue;
    std::set<int64_t> seen{start.id};
    std::deque<std::pair<int64_t, int>> frontier{{start.id, 0}};
    while (!frontier.empty()) {
      const auto [id, depth] = frontier.front();
      frontier.pop_front();
      if (options.max_depth > 0 && depth >= options.max_depth) continue;
      RG_ASSIGN_OR_RETURN(const std::vector<int64_t> next, Neighbours(id, up));
      for (const int64_t other : next) {
        edges.emplace(up ? other : id, up ? id : other);
        if (seen.insert(other).second) frontier.emplace_back(other, depth + 1);
      }
    }
    nodes.insert(seen.begin(), seen.end());
  }
  Lineage lineage;
  std::vector<std::pair<int64_t, std::string>> hash_of;
  for (const int64_t id : nodes) {
    RG_ASSIGN_OR_RETURN(Row row, FindById(id));
    hash_of.emplace_back(id, row.info.sha256);
    lineage.nodes.push_back(std::move(row.info));
  }
  const auto hash = [&](int64_t id) {
    return std::lower_bound(hash_of.begin(), hash_of.end(), std::pair(id, std::string()))->second;
  };
  for (const auto& [parent, child] : edges) lineage.edges.push_back({hash(parent), hash(child)});
  std::sort(lineage.edges.begin(), lineage.edges.end(), [](const auto& a, const auto& b) {
    return std::tie(a.parent, a.child) < std::tie(b.parent, b.child);
  });
  return lineage;
}

// ---- verification ----

Status ArtifactStore::VerifyRow(const Row& row, const std::function<bool()>& stop, VerifyReport* report) {
  const auto damaged = [&](std::string what) {
    if (!Contains(row.info.sha256)) return;  // removed meanwhile
    report->damaged.push_back({row.info.sha256, row.info.kind, std::move(what)});
  };
  Sha256 hash;
  int64_t size = 0;
  for (int64_t chunk = 0; chunk < row.chunks; ++chunk) {
    if (stop && stop()) return CancelledError("the check was broken off");
    const auto bytes = ReadChunk(row.info, row.id, chunk);
    if (!bytes.ok() && bytes.status().code() != StatusCode::kDataLoss) return bytes.status();
    if (!bytes.ok()) {
      const std::string& line = bytes.status().message();
      const size_t colon = line.find("chunk ");
      damaged(ChunkName(chunk, row.chunks) + " (from byte " + std::to_string(size) +
              "): " + (colon == std::string::npos ? line : line.substr(line.find(' ', colon + 6) + 1)));
      return Status::Ok();
    }
    hash.Update(*bytes);
    size += static_cast<int64_t>(bytes->size());
  }
  report->bytes += size;
  if (size != row.info.size_bytes)
    damaged("it has " + std::to_string(size) + " bytes, its row says " + std::to_string(row.info.size_bytes));
  else if (hash.FinishHex() != row.info.sha256)
    damaged("its bytes do not match its hash");
  return Status::Ok();
}

Result<VerifyReport> ArtifactStore::Verify(const std::vector<std::string>& sha256s,
                                           const std::function<bool()>& stop) {
  VerifyReport report;
  std::vector<int64_t> ids;
  if (sha256s.empty()) {
    RG_ASSIGN_OR_RETURN(Statement query, database_->Prepare("SELECT id FROM artifact ORDER BY id"));
    RG_RETURN_IF_ERROR(ForEachRow(&query, [&] { ids.push_back(query.Int(0)); }));
  }
  for (const std::string& sha256 : sha256s) {
    RG_ASSIGN_OR_RETURN(const Row row, Find(sha256));
    ids.push_back(row.id);
  }
  for (const int64_t id : ids) {
    const auto row = FindById(id);
    if (row.status().code() == StatusCode::kNotFound) continue;  // removed meanwhile
    RG_RETURN_IF_ERROR(row.status());
    ++report.checked;
    RG_RETURN_IF_ERROR(VerifyRow(*row, stop, &report));
  }
  return report;
}

// ---- pins and garbage collection ----

Status ArtifactStore::Pin(const std::string& sha256, const std::string& owner) {
  RG_ASSIGN_OR_RETURN(const Row row, Find(sha256));
  RG_ASSIGN_OR_RETURN(Statement insert,
                      database_->Prepare("INSERT INTO artifact_pin (artifact, owner) VALUES (?, ?)"
                                         " ON CONFLICT DO NOTHING"));
  insert.Bind(1, row.id).Bind(2, owner);
  return insert.Run();
}

Status ArtifactStore::Unpin(const std::string& sha256, const std::string& owner) {
  RG_ASSIGN_OR_RETURN(const Row row, Find(sha256));
  RG_ASSIGN_OR_RETURN(Statement remove,
                      database_->Prepare("DELETE FROM artifact_pin WHERE artifact = ? AND owner = ?"));
  remove.Bind(1, row.id).Bind(2, owner);
  return remove.Run();
}

Status ArtifactStore::UnpinAll(const std::string& owner) {
  RG_ASSIGN_OR_RETURN(Statement remove, database_->Prepare("DELETE FROM artifact_pin WHERE owner = ?"));
  remove.Bind(1, owner);
  return remove.Run();
}

Result<std::vector<int64_t>> ArtifactStore::CollectableIds(const GcOptions& options) {
  std::string referred = "SELECT ''";
  for (const std::string& select : options.references) referred += " UNION " + select;
  // Descendants mostly have higher ids: they go first, so that a part of the work leaves no gap.
  RG_ASSIGN_OR_RETURN(
      Statement query,
      database_->Prepare("WITH RECURSIVE referred (sha256) AS (" + referred +
                         "), kept (id) AS ("
                         "  SELECT artifact FROM artifact_pin"
                         "  UNION SELECT id FROM artifact WHERE touched_ns > ?"
                         "  UNION SELECT a.id FROM artifact a JOIN referred r ON r.sha256 = a.sha256"
                         "  UNION SELECT l.parent FROM artifact_parent l JOIN kept ON l.child = kept.id)"
                         " SELECT id FROM artifact WHERE id NOT IN kept ORDER BY id DESC"));
  query.Bind(1, clock_->WallNanos() - options.older_than_ns);
  std::vector<int64_t> ids;
  RG_RETURN_IF_ERROR(ForEachRow(&query, [&] { ids.push_back(query.Int(0)); }));
  return ids;
}

Status ArtifactStore::RemoveArtifact(int64_t id) {
  for (const std::string_view sql :
       {"DELETE FROM artifact_producer WHERE artifact = ?", "DELETE FROM artifact WHERE id = ?"}) {
    RG_ASSIGN_OR_RETURN(Statement remove, database_->Prepare(sql));
    remove.Bind(1, id);
    RG_RETURN_IF_ERROR(remove.Run());
  }
  return DropChunks(id);
}

Result<GcReport> ArtifactStore::Gc(const GcOptions& options) {
  GcReport report;
  RG_RETURN_IF_ERROR(database_->InTransaction([&]() -> Status {
    RG_ASSIGN_OR_RETURN(std::vector<int64_t> ids, CollectableIds(options));
    for (size_t i = 0; i < ids.size(); ++i) {
      RG_ASSIGN_OR_RETURN(Row row, FindById(ids[i]));
      report.bytes += row.info.size_bytes;
      report.removed.push_back(std::move(row.info));
      const bool full = (options.max_bytes > 0 && report.bytes >= options.max_bytes) ||
                        (options.max_count > 0 && static_cast<int64_t>(i) + 1 >= options.max_count);
      report.more = full && i + 1 < ids.size();
      if (full) ids.resize(i + 1);
    }
    if (options.dry_run) return Status::Ok();
    // All links first: whatever descends from a collectable artefact is collectable too.
    RG_ASSIGN_OR_RETURN(Statement unlink,
                        database_->Prepare("DELETE FROM artifact_parent WHERE child = ?1 OR parent = ?1"));
    for (const int64_t id : ids) {
      unlink.Bind(1, id);
      RG_RETURN_IF_ERROR(unlink.Run());
    }
    for (const int64_t id : ids) RG_RETURN_IF_ERROR(RemoveArtifact(id));
    return Status::Ok();
  }));
  if (!options.dry_run && !database_->in_transaction()) RG_RETURN_IF_ERROR(database_->ReleaseFreePages());
  return report;
}

}  // namespace rg::store
