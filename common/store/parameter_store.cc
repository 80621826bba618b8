#include "common/store/parameter_store.h"

#include <cmath>
#include <nlohmann/json.hpp>
#include <unordered_map>
#include <unordered_set>

#include "common/store/artifact_rows.h"

namespace rg::store {
namespace {

// Frozen.
constexpr std::string_view kParametersVersion1 = R"sql(
CREATE TABLE parameter_version (
  id INTEGER PRIMARY KEY AUTOINCREMENT,
  robot TEXT NOT NULL,
  version INTEGER NOT NULL,
  parent_version INTEGER NOT NULL,
  source INTEGER NOT NULL,
  recording_sha256 TEXT NOT NULL,
  model_sha256 TEXT NOT NULL,
  residual_before REAL,
  residual_after REAL,
  values_json TEXT NOT NULL,
  created_ns INTEGER NOT NULL,
  job_id TEXT NOT NULL,
  note TEXT NOT NULL,
  idempotency_key TEXT UNIQUE,
  UNIQUE (robot, version));
)sql";

// Frozen. A robot's current version, where somebody has chosen one; else the latest is current.
constexpr std::string_view kParametersVersion2 = R"sql(
CREATE TABLE parameter_current (
  robot TEXT PRIMARY KEY,
  version INTEGER NOT NULL,
  promoted_ns INTEGER NOT NULL,
  FOREIGN KEY (robot, version) REFERENCES parameter_version (robot, version)) WITHOUT ROWID;
)sql";

// Frozen. How the rollout ended that a version comes from, and whether it therefore is current only where it was chosen.
constexpr std::string_view kParametersVersion3 = R"sql(
ALTER TABLE parameter_version ADD COLUMN rollout TEXT NOT NULL DEFAULT '';
ALTER TABLE parameter_version ADD COLUMN held_back INTEGER NOT NULL DEFAULT 0;
)sql";

constexpr std::string_view kParameterColumns =
    "SELECT id, robot, version, parent_version, source, recording_sha256, model_sha256, residual_before,"
    " residual_after, created_ns, job_id, note, values_json, rollout, held_back FROM parameter_version ";

std::optional<double> OptionalReal(const Statement& row, int column) {
  if (row.IsNull(column)) return std::nullopt;
  return row.Real(column);
}

ParameterVersion ReadHead(const Statement& row) {
  ParameterVersion v;
  v.id = row.Int(0);
  v.robot = row.Text(1);
  v.version = static_cast<int>(row.Int(2));
  v.parent_version = static_cast<int>(row.Int(3));
  v.source = static_cast<ParameterSource>(row.Int(4));
  v.recording_sha256 = row.Text(5);
  v.model_sha256 = row.Text(6);
  v.residual_before = OptionalReal(row, 7);
  v.residual_after = OptionalReal(row, 8);
  v.created_ns = row.Int(9);
  v.job_id = row.Text(10);
  v.note = row.Text(11);
  v.rollout = row.Text(13);
  v.held_back = row.Int(14) != 0;
  return v;
}

Result<ParameterVersion> ReadOne(Statement* query, const std::string& missing) {
  RG_ASSIGN_OR_RETURN(const bool found, query->Step());
  if (!found) return NotFoundError(missing);
  ParameterVersion version = ReadHead(*query);
  auto values = ParseParameterValues(query->Text(12));
  if (!values.ok())
    return DataLossError("parameters of " + version.robot + ", version " + std::to_string(version.version) +
                         ": " + values.status().message());
  version.values = std::move(*values);
  return version;
}

void BindOptional(Statement* statement, int index, const std::optional<double>& value) {
  if (value)
    statement->Bind(index, *value);
  else
    statement->BindNull(index);
}

Status CheckValue(const ParameterValue& value) {
  if (value.name.empty()) return InvalidError("a parameter without a name");
  if (!std::isfinite(value.value)) return InvalidError("parameter " + value.name + ": not a finite number");
  if (value.stddev && !(std::isfinite(*value.stddev) && *value.stddev >= 0.0))
    return InvalidError("parameter " + value.name + ": standard deviation is not a finite number >= 0");
  return Status::Ok();
}

Status PinArtifact(Database* database, const std::string& sha256, const std::string& owner,
                   const char* what) {
  if (sha256.empty()) return Status::Ok();
  RG_ASSIGN_OR_RETURN(
      Statement insert,
      database->Prepare("INSERT INTO artifact_pin (artifact, owner)"
                        " SELECT id, ? FROM artifact WHERE sha256 = ? ON CONFLICT DO NOTHING"));
  insert.Bind(1, owner).Bind(2, sha256);
  RG_RETURN_IF_ERROR(insert.Run());
  RG_ASSIGN_OR_RETURN(Statement query, database->Prepare("SELECT 1 FROM artifact WHERE sha256 = ?"));
  query.Bind(1, sha256);
  RG_ASSIGN_OR_RETURN(const bool found, query.Step());
  return found ? Status::Ok() : NotFoundError(std::string(what) + " " + sha256 + ": not in the store");
}

}  // namespace

std::string_view ParameterSourceName(ParameterSource source) {
  switch (source) {
    case ParameterSource::kNominal:
      return "nominal";
    case ParameterSource::kIdentified:
      return "identified";
    case ParameterSource::kImported:
      return "imported";
  }
  return "unknown";
}

Result<ParameterSource> ParseParameterSource(std::string_view name) {
  for (const ParameterSource source :
       {ParameterSource::kNominal, ParameterSource::kIdentified, ParameterSource::kImported})
    if (name == ParameterSourceName(source)) return source;
  return InvalidError("parameter source \"" + std::string(name) + "\": nominal, identified or imported");
}

std::string FormatParameterValues(const std::vector<ParameterValue>& values) {
  auto rows = nlohmann::ordered_json::array();
  for (const ParameterValue& value : values) {
    nlohmann::ordered_json row{{"name", value.name}, {"value", value.value}};
    if (value.stddev) row["stddev"] = *value.stddev;
    rows.push_back(std::move(row));
  }
  return rows.dump(-1, ' ', false, nlohmann::ordered_json::error_handler_t::replace);
}

Result<std::vector<ParameterValue>> ParseParameterValues(std::string_view json) {
  const auto rows = nlohmann::json::parse(json, nullptr, /*allow_exceptions=*/false);
  if (!rows.is_array()) return InvalidError("parameter values: not a JSON array");
  std::vector<ParameterValue> values;
  for (const auto& row : rows) {
    const std::string where = "parameter value " + std::to_string(values.size());
    if (!row.is_object() || !row.contains("name") || !row["name"].is_string())
      return InvalidError(where + ": no \"name\"");
    if (!row.contains("value") || !row["value"].is_number()) return InvalidError(where + ": no \"value\"");
    ParameterValue value{row["name"].get<std::string>(), row["value"].get<double>(), std::nullopt};
    if (row.contains("stddev")) {
      if (!row["stddev"].is_number()) return InvalidError(where + ": \"stddev\" is not a number");
      value.stddev = row["stddev"].get<double>();
    }
    values.push_back(std::move(value));
  }
  return values;
}

Module ParameterStore::Schema() {
  return {"parameters", {{1, kParametersVersion1}, {2, kParametersVersion2}, {3, kParametersVersion3}}};
}

Status ParameterStore::CheckNew(const ParameterVersion& version) {
  if (version.robot.empty()) return InvalidError("parameter version without a robot's name");
  if (version.values.empty()) return InvalidError("parameters of " + version.robot + ": no values");
  std::unordered_set<std::string_view> names;
  for (const ParameterValue& value : version.values) {
    RG_RETURN_IF_ERROR(CheckValue(value).WithPrefix("parameters of " + version.robot));
    if (!names.insert(value.name).second)
      return InvalidError("parameters of " + version.robot + ": " + value.name + " is there twice");
  }
  for (const auto& residual : {version.residual_before, version.residual_after})
    if (residual && !std::isfinite(*residual))
      return InvalidError("parameters of " + version.robot + ": residual is not a finite number");
  if (version.parent_version == 0) return Status::Ok();
  const auto parent = Show(version.robot, version.parent_version);
  return parent.ok() ? Status::Ok() : parent.status().WithPrefix("parent");
}

Result<ParameterVersion> ParameterStore::Add(const ParameterVersion& version, const std::string& key) {
  ParameterVersion added = version;
  RG_RETURN_IF_ERROR(database_->InTransaction([&]() -> Status {
    if (!key.empty()) {
      RG_ASSIGN_OR_RETURN(Statement query,
                          database_->Prepare(std::string(kParameterColumns) + "WHERE idempotency_key = ?"));
      query.Bind(1, key);
      auto earlier = ReadOne(&query, "");
      if (!earlier.ok() && earlier.status().code() != StatusCode::kNotFound) return earlier.status();
      if (earlier.ok()) {
        added = std::move(*earlier);
        return Status::Ok();
      }
    }
    RG_RETURN_IF_ERROR(CheckNew(version));
    {
      RG_ASSIGN_OR_RETURN(
          Statement query,
          database_->Prepare("SELECT coalesce(max(version), 0) + 1 FROM parameter_version WHERE robot = ?"));
      query.Bind(1, version.robot);
      RG_ASSIGN_OR_RETURN(const bool row, query.Step());
      RG_CHECK(row);
      added.version = static_cast<int>(query.Int(0));
    }
    added.created_ns = clock_->WallNanos();
    const std::string owner = "parameters:" + added.robot + "/" + std::to_string(added.version);
    RG_RETURN_IF_ERROR(PinArtifact(database_, added.recording_sha256, owner, "recording"));
    RG_RETURN_IF_ERROR(PinArtifact(database_, added.model_sha256, owner, "model"));
    RG_ASSIGN_OR_RETURN(
        Statement insert,
        database_->Prepare("INSERT INTO parameter_version (robot, version, parent_version, source,"
                           " recording_sha256, model_sha256, residual_before, residual_after, values_json,"
                           " created_ns, job_id, note, idempotency_key, rollout, held_back)"
                           " VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"));
    insert.Bind(1, added.robot).Bind(2, added.version).Bind(3, added.parent_version);
    insert.Bind(4, static_cast<int>(added.source))
        .Bind(5, added.recording_sha256)
        .Bind(6, added.model_sha256);
    BindOptional(&insert, 7, added.residual_before);
    BindOptional(&insert, 8, added.residual_after);
    insert.Bind(9, FormatParameterValues(added.values)).Bind(10, added.created_ns);
    insert.Bind(11, added.job_id).Bind(12, added.note);
    if (key.empty())
      insert.BindNull(13);
    else
      insert.Bind(13, key);
    insert.Bind(14, added.rollout).Bind(15, added.held_back ? 1 : 0);
    RG_RETURN_IF_ERROR(insert.Run());
    added.id = database_->last_insert_id();
    return Status::Ok();
  }));
  return added;
}

Result<std::vector<std::string>> ParameterStore::Robots() {
  RG_ASSIGN_OR_RETURN(Statement query,
                      database_->Prepare("SELECT DISTINCT robot FROM parameter_version ORDER BY robot"));
  std::vector<std::string> robots;
  RG_RETURN_IF_ERROR(ForEachRow(&query, [&] { robots.push_back(query.Text(0)); }));
  return robots;
}

Result<std::vector<ParameterVersion>> ParameterStore::History(const std::string& robot, int limit) {
  RG_ASSIGN_OR_RETURN(Statement query, database_->Prepare(std::string(kParameterColumns) +
                                                          "WHERE robot = ? ORDER BY version DESC LIMIT ?"));
  query.Bind(1, robot).Bind(2, limit > 0 ? limit : -1);
  std::vector<ParameterVersion> versions;
  RG_RETURN_IF_ERROR(ForEachRow(&query, [&] { versions.push_back(ReadHead(query)); }));
  return versions;
}

Result<ParameterVersion> ParameterStore::Show(const std::string& robot, int version) {
  RG_ASSIGN_OR_RETURN(Statement query,
                      database_->Prepare(std::string(kParameterColumns) +
                                         "WHERE robot = ?1 AND version = CASE ?2 WHEN 0"
                                         " THEN (SELECT max(version) FROM parameter_version WHERE robot = ?1)"
                                         " ELSE ?2 END"));
  query.Bind(1, robot).Bind(2, version);
  return ReadOne(&query, "parameters of " + robot +
                             (version == 0 ? ": none" : ": no version " + std::to_string(version)));
}

Status ParameterStore::Promote(const std::string& robot, int version) {
  return database_->InTransaction([&]() -> Status {
    RG_RETURN_IF_ERROR(Show(robot, version).status());
    RG_ASSIGN_OR_RETURN(
        Statement statement,
        database_->Prepare(
            version == 0 ? "DELETE FROM parameter_current WHERE robot = ?1"
                         : "INSERT INTO parameter_current (robot, version, promoted_ns) VALUES (?1, ?2, ?3)"
                           " ON CONFLICT (robot) DO UPDATE SET version = ?2, promoted_ns = ?3"));
    statement.Bind(1, robot);
    if (version != 0) statement.Bind(2, version).Bind(3, clock_->WallNanos());
    return statement.Run();
  });
}

Result<int> ParameterStore::Current(const std::string& robot) {
  RG_ASSIGN_OR_RETURN(
      Statement query,
      database_->Prepare("SELECT coalesce((SELECT version FROM parameter_current WHERE robot = ?1),"
                         " (SELECT max(version) FROM parameter_version WHERE robot = ?1 AND held_back = 0), 0)"));
  query.Bind(1, robot);
  RG_RETURN_IF_ERROR(query.Step().status());
  return static_cast<int>(query.Int(0));
}

Result<ParameterDiff> ParameterStore::Diff(const std::string& robot, int from_version, int to_version) {
  RG_ASSIGN_OR_RETURN(const ParameterVersion from, Show(robot, from_version));
  RG_ASSIGN_OR_RETURN(const ParameterVersion to, Show(robot, to_version));
  return DiffParameters(from, to);
}

ParameterDiff DiffParameters(const ParameterVersion& from, const ParameterVersion& to) {
  ParameterDiff diff{from, to, {}};
  std::unordered_map<std::string_view, const ParameterValue*> old;
  for (const ParameterValue& value : from.values) old.emplace(value.name, &value);
  for (const ParameterValue& value : to.values) {
    const auto found = old.find(value.name);
    if (found == old.end()) {
      diff.rows.push_back({value.name, std::nullopt, value.value, std::nullopt});
      continue;
    }
    const ParameterValue& before = *found->second;
    old.erase(found);
    if (before.value == value.value) continue;
    const double spread = std::hypot(before.stddev.value_or(0.0), value.stddev.value_or(0.0));
    std::optional<double> sigmas;
    if (spread > 0.0) sigmas = std::abs(value.value - before.value) / spread;
    diff.rows.push_back({value.name, before.value, value.value, sigmas});
  }
  for (const ParameterValue& value : from.values)
    if (old.count(value.name)) diff.rows.push_back({value.name, value.value, std::nullopt, std::nullopt});
  return diff;
}

}  // namespace rg::store
