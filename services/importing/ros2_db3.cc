#include "services/importing/ros2_db3.h"

#include <sqlite3.h>
#include <zstd.h>

#include <cstring>
#include <map>
#include <memory>

#include "services/importing/decompress.h"

namespace rg::importing {
namespace {

constexpr std::string_view kSqliteMagic("SQLite format 3\0", 16);
// Virtual machine instructions in which a row must come: far more than a plain table takes.
constexpr int kMaxInstructionsPerRow = 50'000'000;
constexpr int kMaxBlobBytes = 256 << 20;
constexpr uint64_t kRowsPerProgress = 4096;

using Database = std::unique_ptr<sqlite3, decltype(&sqlite3_close)>;
using Statement = std::unique_ptr<sqlite3_stmt, decltype(&sqlite3_finalize)>;

std::string_view Blob(sqlite3_stmt* statement, int column) {
  const void* data = sqlite3_column_blob(statement, column);
  const int size = sqlite3_column_bytes(statement, column);
  return data == nullptr ? std::string_view()
                         : std::string_view(static_cast<const char*>(data), static_cast<size_t>(size));
}

class Db3Reader {
 public:
  Db3Reader(sqlite3* database, const std::string& source, bool compressed, uint64_t file_bytes, LogSink& sink,
            const ReadLimits& limits)
      : database_(database),
        source_(source),
        compressed_(compressed),
        sink_(sink),
        topics_(sink, limits),
        decompressor_(limits, file_bytes) {}

  Status Read() {
    Harden();
    RG_RETURN_IF_ERROR(RequireTable("topics"));
    RG_RETURN_IF_ERROR(RequireTable("messages"));
    RG_RETURN_IF_ERROR(ReadDefinitions());
    RG_RETURN_IF_ERROR(ReadTopics());
    return ReadMessages();
  }

 private:
  void Harden() {
    sqlite3_db_config(database_, SQLITE_DBCONFIG_DEFENSIVE, 1, nullptr);
    sqlite3_db_config(database_, SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0, nullptr);
    sqlite3_limit(database_, SQLITE_LIMIT_LENGTH, kMaxBlobBytes);
    sqlite3_hard_heap_limit64(512 << 20);
    sqlite3_progress_handler(database_, kMaxInstructionsPerRow, &StopIfNoRowCame, this);
  }

  static int StopIfNoRowCame(void* self) {
    auto* reader = static_cast<Db3Reader*>(self);
    const bool stop = reader->rows_ == reader->rows_at_last_look_;
    reader->rows_at_last_look_ = reader->rows_;
    return stop ? 1 : 0;
  }

  int Step(const Statement& statement) {
    ++rows_;
    return sqlite3_step(statement.get());
  }

  Status Error() const {
    const int code = sqlite3_errcode(database_);
    if (code == SQLITE_INTERRUPT) return DataLossError(source_ + ": its tables are not rosbag2's");
    return DataLossError(source_ + ": " + sqlite3_errmsg(database_));
  }

  Result<Statement> Prepare(const char* sql) const {
    sqlite3_stmt* raw = nullptr;
    const int code = sqlite3_prepare_v2(database_, sql, -1, &raw, nullptr);
    Statement statement(raw, &sqlite3_finalize);
    if (code != SQLITE_OK || raw == nullptr) return Error();
    return statement;
  }

  // A table and no view: reading a view may run for ever.
  Result<bool> HasTable(const char* name) const {
    RG_ASSIGN_OR_RETURN(
        const Statement statement,
        Prepare("SELECT 1 FROM sqlite_master WHERE name = ? AND type = 'table' AND sql NOT LIKE "
                "'%VIRTUAL%'"));
    sqlite3_bind_text(statement.get(), 1, name, -1, SQLITE_STATIC);
    const int code = sqlite3_step(statement.get());
    if (code != SQLITE_ROW && code != SQLITE_DONE) return Error();
    return code == SQLITE_ROW;
  }

  Status RequireTable(const char* name) const {
    RG_ASSIGN_OR_RETURN(const bool there, HasTable(name));
    if (there) return Status::Ok();
    return InvalidError(source_ + ": an SQLite file without a table '" + name + "': not a ROS 2 bag");
  }

  // Newer files hold the definitions of their types.
  Status ReadDefinitions() {
    RG_ASSIGN_OR_RETURN(const bool there, HasTable("message_definitions"));
    if (!there) return Status::Ok();
    auto statement =
        Prepare("SELECT topic_type, encoding, encoded_message_definition FROM message_definitions");
    if (!statement.ok()) return Status::Ok();  // another layout: known types are read all the same
    while (Step(*statement) == SQLITE_ROW) {
      if (Blob(statement->get(), 1) != "ros2msg") continue;
      definitions_[PlainTypeName(Blob(statement->get(), 0))] = Blob(statement->get(), 2);
    }
    return Status::Ok();
  }

  Status ReadTopics() {
    RG_ASSIGN_OR_RETURN(const Statement statement,
                        Prepare("SELECT id, name, type, serialization_format FROM topics ORDER BY id"));
    int code = SQLITE_DONE;
    while ((code = Step(statement)) == SQLITE_ROW) {
      Topic topic;
      topic.name = Blob(statement.get(), 1);
      topic.type = PlainTypeName(Blob(statement.get(), 2));
      topic.encoding_name = Blob(statement.get(), 3);
      topic.encoding = topic.encoding_name == "cdr" ? Encoding::kCdr : Encoding::kUnknown;
      const auto definition = definitions_.find(topic.type);
      if (definition != definitions_.end()) topic.definition = definition->second;
      const auto number = topics_.Add(topic);
      if (!number.ok()) return number.status().WithPrefix(source_);
      topic_of_[sqlite3_column_int64(statement.get(), 0)] = *number;
    }
    return code == SQLITE_DONE ? Status::Ok() : Error();
  }

  Status ReadMessages() {
    RG_ASSIGN_OR_RETURN(const uint64_t total, CountMessages());
    RG_ASSIGN_OR_RETURN(const Statement statement, Prepare("SELECT topic_id, timestamp, data FROM messages"));
    uint64_t done = 0;
    int code = SQLITE_DONE;
    while ((code = Step(statement)) == SQLITE_ROW) {
      const auto topic = topic_of_.find(sqlite3_column_int64(statement.get(), 0));
      if (topic == topic_of_.end()) {
        return DataLossError(source_ + ": messages: row " + std::to_string(done + 1) + ": topic_id " +
                             std::to_string(sqlite3_column_int64(statement.get(), 0)) + " is not in topics");
      }
      std::string_view bytes = Blob(statement.get(), 2);
      if (compressed_) {
        RG_ASSIGN_OR_RETURN(bytes, Unpacked(bytes, done + 1));
      }
      RG_RETURN_IF_ERROR(sink_.OnMessage({topic->second, sqlite3_column_int64(statement.get(), 1), bytes}));
      if (++done % kRowsPerProgress == 0) sink_.OnProgress(done, total);
    }
    if (code == SQLITE_DONE) return Status::Ok();
    if (done == 0 || code != SQLITE_CORRUPT) return Error();
    sink_.OnNote(source_ + ": damaged after message " + std::to_string(done) + ": read up to there");
    return Status::Ok();
  }

  Result<uint64_t> CountMessages() const {
    RG_ASSIGN_OR_RETURN(const Statement statement, Prepare("SELECT max(rowid) FROM messages"));
    if (sqlite3_step(statement.get()) != SQLITE_ROW) return Error();
    return static_cast<uint64_t>(sqlite3_column_int64(statement.get(), 0));
  }

  Result<std::string_view> Unpacked(std::string_view bytes, uint64_t row) {
    const unsigned long long size = ZSTD_getFrameContentSize(bytes.data(), bytes.size());
    const auto error = [&](const Status& why) {
      return why.WithPrefix(source_ + ": messages: row " + std::to_string(row));
    };
    if (size == ZSTD_CONTENTSIZE_ERROR || size == ZSTD_CONTENTSIZE_UNKNOWN)
      return error(DataLossError("is not a zstd frame, as metadata.yaml says"));
    const auto message = decompressor_.Run(Compression::kZstd, bytes, size, false);
    if (!message.ok()) return error(message.status());
    return message->bytes;
  }

  sqlite3* database_;
  const std::string& source_;
  bool compressed_;
  LogSink& sink_;
  TopicTable topics_;
  Decompressor decompressor_;
  uint64_t rows_ = 0, rows_at_last_look_ = ~uint64_t{0};
  std::map<std::string, std::string> definitions_;
  std::map<int64_t, size_t> topic_of_;
};

std::string AsUri(const std::string& path) {
  std::string uri = "file:";
  for (const char c : path) {
    if (c == '?' || c == '#' || c == '%') {
      char escaped[4];
      std::snprintf(escaped, sizeof escaped, "%%%02X", static_cast<unsigned>(c));
      uri += escaped;
    } else {
      uri += c;
    }
  }
  return uri;
}

Result<Database> Open(const std::string& uri, const std::string& source) {
  sqlite3* raw = nullptr;
  const int code = sqlite3_open_v2(uri.c_str(), &raw, SQLITE_OPEN_READONLY | SQLITE_OPEN_URI, nullptr);
  Database database(raw, &sqlite3_close);
  if (code != SQLITE_OK) return InvalidError(source + ": " + sqlite3_errstr(code));
  // The file is touched by the first statement only.
  if (sqlite3_exec(raw, "SELECT 1 FROM sqlite_master", nullptr, nullptr, nullptr) != SQLITE_OK)
    return DataLossError(source + ": " + sqlite3_errmsg(raw));
  return database;
}

uint64_t FileBytes(sqlite3* database) {
  sqlite3_int64 pages = 0, page_size = 0;
  const auto number = [&](const char* sql) {
    sqlite3_int64 value = 0;
    sqlite3_stmt* raw = nullptr;
    if (sqlite3_prepare_v2(database, sql, -1, &raw, nullptr) == SQLITE_OK && sqlite3_step(raw) == SQLITE_ROW)
      value = sqlite3_column_int64(raw, 0);
    sqlite3_finalize(raw);
    return value;
  };
  pages = number("PRAGMA page_count");
  page_size = number("PRAGMA page_size");
  return static_cast<uint64_t>(pages * page_size);
}

}  // namespace

bool LooksLikeSqlite(std::string_view bytes) { return bytes.substr(0, kSqliteMagic.size()) == kSqliteMagic; }

Status ReadDb3(const std::string& path, bool compressed, LogSink& sink, const ReadLimits& limits) {
  auto database = Open(AsUri(path), path);
  // A file left in WAL mode in a folder that cannot be written.
  if (!database.ok()) database = Open(AsUri(path) + "?immutable=1", path);
  if (!database.ok()) return database.status();
  return Db3Reader(database->get(), path, compressed, FileBytes(database->get()), sink, limits).Read();
}

Status ReadDb3Bytes(std::string_view bytes, const std::string& source_name, bool compressed, LogSink& sink,
                    const ReadLimits& limits) {
  if (!LooksLikeSqlite(bytes) || bytes.size() < 100)
    return InvalidError(source_name + ": is not an SQLite file");
  RG_ASSIGN_OR_RETURN(const Database database, Open("file::memory:", source_name));
  auto* copy = static_cast<unsigned char*>(sqlite3_malloc64(bytes.size()));
  if (copy == nullptr) return ResourceExhaustedError(source_name + ": no memory");
  std::memcpy(copy, bytes.data(), bytes.size());
  copy[18] = copy[19] = 1;  // a database in memory has no WAL
  const auto size = static_cast<sqlite3_int64>(bytes.size());
  if (sqlite3_deserialize(database.get(), "main", copy, size, size,
                          SQLITE_DESERIALIZE_FREEONCLOSE | SQLITE_DESERIALIZE_READONLY) != SQLITE_OK) {
    return DataLossError(source_name + ": " + sqlite3_errmsg(database.get()));
  }
  return Db3Reader(database.get(), source_name, compressed, bytes.size(), sink, limits).Read();
}

}  // namespace rg::importing
