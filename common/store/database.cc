#include "common/store/database.h"

#include <SQLiteCpp/SQLiteCpp.h>
#include <fcntl.h>
#include <sqlite3.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <filesystem>
#include <mutex>
#include <sstream>
#include <stop_token>
#include <thread>
#include <unordered_map>
#include <utility>

#include "common/store/schema.h"
#include "common/store/writer_lock.h"

namespace rg::store {
namespace {

constexpr size_t kKeptStatements = 256;

StatusCode CodeOf(int extended) {
  switch (extended & 0xff) {
    case SQLITE_BUSY:
    case SQLITE_LOCKED:
      return StatusCode::kUnavailable;
    case SQLITE_FULL:
    case SQLITE_NOMEM:
    case SQLITE_TOOBIG:
      return StatusCode::kResourceExhausted;
    case SQLITE_CORRUPT:
    case SQLITE_NOTADB:
      return StatusCode::kDataLoss;
    case SQLITE_IOERR:
      if (extended == SQLITE_IOERR_SHMSIZE) return StatusCode::kResourceExhausted;  // of the shared index
      return extended == SQLITE_IOERR_SHORT_READ || extended == SQLITE_IOERR_DATA ? StatusCode::kDataLoss
                                                                                  : StatusCode::kInternal;
    case SQLITE_READONLY:
      return StatusCode::kFailedPrecondition;
    case SQLITE_PERM:
    case SQLITE_AUTH:
      return StatusCode::kPermissionDenied;
    case SQLITE_CANTOPEN:
      return StatusCode::kFailedPrecondition;
    case SQLITE_CONSTRAINT:
      return extended == SQLITE_CONSTRAINT_UNIQUE || extended == SQLITE_CONSTRAINT_PRIMARYKEY ||
                     extended == SQLITE_CONSTRAINT_ROWID
                 ? StatusCode::kAlreadyExists
                 : StatusCode::kInvalid;
    default:
      return StatusCode::kInternal;
  }
}

Status FromException(const std::string& path, const SQLite::Exception& e) {
  return Status(CodeOf(e.getExtendedErrorCode()), path + ": " + e.what());
}

bool IsRead(std::string_view sql) {
  const size_t start = sql.find_first_not_of(" \t\n");
  if (start == std::string_view::npos) return true;
  const std::string_view word = sql.substr(start, 6);
  return word == "SELECT" || word == "PRAGMA" || word == "EXPLAI" || word.substr(0, 4) == "WITH";
}

bool IsMemory(const DatabaseOptions& options) { return options.path == ":memory:"; }

void SyncFolderOf(const std::string& path) {
  const std::filesystem::path folder = std::filesystem::path(path).parent_path();
  const int fd = ::open(folder.empty() ? "." : folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (fd < 0) return;
  ::fsync(fd);
  ::close(fd);
}

}  // namespace

struct Statement::Impl {
  Impl(SQLite::Database& database, std::string text)
      : sql(std::move(text)), read(IsRead(sql)), statement(database, sql) {}
  std::string sql;
  bool read;
  SQLite::Statement statement;
  Status bind_error;
};

struct Database::Impl {
  DatabaseOptions options;
  WriterLock lock;
  std::unique_ptr<SQLite::Database> database;
  std::unordered_map<std::string, std::vector<std::unique_ptr<Statement::Impl>>> idle;
  size_t idle_count = 0;
  int depth = 0;  // of open transactions
  Status lost;    // why the open transaction was rolled back under us
  WriteHook hook;
  std::string identity;

  Status CurrentError() const {
    const int code = database->getExtendedErrorCode();
    return Status(CodeOf(code), options.path + ": " + database->getErrorMsg());
  }
  // SQLite rolls a transaction back by itself on some errors (disk full): nothing may be written in
  // what its owner still takes for a transaction.
  bool TransactionIsLost() const { return depth > 0 && sqlite3_get_autocommit(database->getHandle()) != 0; }
  Status AllowWrite(std::string_view sql) {
    if (TransactionIsLost())
      return Status(lost.code(), options.path + ": the transaction was rolled back: " + lost.message());
    return hook ? hook(WriteKind::kStatement, sql) : Status::Ok();
  }
  Status Note(Status error) {
    if (TransactionIsLost() && lost.ok()) lost = error;
    return error;
  }
  // Without hook, bookkeeping or Status: for BEGIN, SAVEPOINT, ROLLBACK.
  Status Raw(const std::string& sql) {
    try {
      database->exec(sql);
      return Status::Ok();
    } catch (const SQLite::Exception& e) {
      return FromException(options.path, e);
    }
  }
};

// ---- Statement ----

Statement::Statement(Database* database, std::unique_ptr<Impl> impl)
    : database_(database), impl_(std::move(impl)) {}
Statement::Statement(Statement&&) noexcept = default;

Statement& Statement::operator=(Statement&& other) noexcept {
  std::swap(database_, other.database_);
  std::swap(impl_, other.impl_);
  return *this;
}

Statement::~Statement() {
  if (!impl_) return;
  Reset();
  Database::Impl& owner = database_->impl();
  if (owner.idle_count >= kKeptStatements) return;
  ++owner.idle_count;
  auto& slot = owner.idle[impl_->sql];
  slot.push_back(std::move(impl_));
}

namespace {
template <class Fn>
void Guarded(Status* error, const std::string& sql, int index, Fn bind) {
  try {
    bind();
  } catch (const SQLite::Exception& e) {
    if (error->ok())
      *error = InternalError("parameter " + std::to_string(index) + " of \"" + sql + "\": " + e.what());
  }
}
}  // namespace

Statement& Statement::Bind(int index, int64_t value) {
  Guarded(&impl_->bind_error, impl_->sql, index, [&] { impl_->statement.bind(index, value); });
  return *this;
}
Statement& Statement::Bind(int index, double value) {
  Guarded(&impl_->bind_error, impl_->sql, index, [&] { impl_->statement.bind(index, value); });
  return *this;
}
Statement& Statement::Bind(int index, std::string_view text) {
  Guarded(&impl_->bind_error, impl_->sql, index, [&] { impl_->statement.bind(index, std::string(text)); });
  return *this;
}
Statement& Statement::BindBlob(int index, std::string_view bytes) {
  Guarded(&impl_->bind_error, impl_->sql, index, [&] {
    // A null pointer would be bound as NULL, not as an empty blob.
    impl_->statement.bindNoCopy(index, bytes.data() ? bytes.data() : "", static_cast<int>(bytes.size()));
  });
  return *this;
}
Statement& Statement::BindNull(int index) {
  Guarded(&impl_->bind_error, impl_->sql, index, [&] { impl_->statement.bind(index); });
  return *this;
}

Result<bool> Statement::Step() {
  Database::Impl& owner = database_->impl();
  if (!impl_->bind_error.ok()) return impl_->bind_error;
  if (!impl_->read) RG_RETURN_IF_ERROR(owner.AllowWrite(impl_->sql));
  const int code = impl_->statement.tryExecuteStep();
  if (code == SQLITE_ROW) return true;
  if (code == SQLITE_DONE) return false;
  return owner.Note(owner.CurrentError());
}

Status Statement::Run() {
  Status outcome;
  while (true) {
    auto row = Step();
    if (!row.ok()) outcome = row.status();
    if (!row.ok() || !*row) break;
  }
  Reset();
  return outcome;
}

void Statement::Reset() {
  impl_->statement.tryReset();
  impl_->bind_error = Status::Ok();
  try {
    impl_->statement.clearBindings();
  } catch (const SQLite::Exception&) {
    // sqlite3_clear_bindings has no failure to report; the wrapper's signature has.
  }
}

bool Statement::IsNull(int column) const { return impl_->statement.isColumnNull(column); }
int64_t Statement::Int(int column) const { return impl_->statement.getColumn(column).getInt64(); }
double Statement::Real(int column) const { return impl_->statement.getColumn(column).getDouble(); }
std::string Statement::Text(int column) const { return impl_->statement.getColumn(column).getString(); }
std::string_view Statement::Blob(int column) const {
  const SQLite::Column value = impl_->statement.getColumn(column);
  const void* data = value.getBlob();
  return data ? std::string_view(static_cast<const char*>(data), static_cast<size_t>(value.getBytes()))
              : std::string_view("", 0);
}

// ---- Transaction ----

Transaction::Transaction(Transaction&& other) noexcept
    : database_(std::exchange(other.database_, nullptr)), depth_(other.depth_) {}

Transaction::~Transaction() { Rollback(); }

Status Transaction::Commit() {
  RG_CHECK(database_ != nullptr) << "this transaction has ended";
  Database::Impl& owner = database_->impl();
  RG_CHECK(owner.depth == depth_) << "an inner transaction is still open";
  const bool outermost = depth_ == 1;
  Status outcome = owner.TransactionIsLost() ? owner.lost : Status::Ok();
  if (outcome.ok() && outermost && owner.hook) outcome = owner.hook(WriteKind::kCommit, "COMMIT");
  if (outcome.ok()) outcome = owner.Raw(outermost ? "COMMIT" : "RELEASE rg_" + std::to_string(depth_));
  if (!outcome.ok()) {
    Rollback();
    return outcome;
  }
  --owner.depth;
  database_ = nullptr;
  return Status::Ok();
}

void Transaction::Rollback() {
  if (database_ == nullptr) return;
  Database::Impl& owner = std::exchange(database_, nullptr)->impl();
  RG_CHECK(owner.depth == depth_) << "an inner transaction is still open";
  if (!owner.TransactionIsLost()) {
    const std::string name = "rg_" + std::to_string(depth_);
    // A failed rollback leaves the transaction lost, which AllowWrite and Commit report.
    (void)owner.Raw(depth_ == 1 ? "ROLLBACK" : "ROLLBACK TO " + name + "; RELEASE " + name);
  }
  if (--owner.depth == 0) owner.lost = Status::Ok();
}

// ---- Database ----

Database::Database(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
Database::~Database() { impl_->idle.clear(); }

namespace {

Status PrepareFolder(const DatabaseOptions& options) {
  const std::filesystem::path folder = std::filesystem::path(options.path).parent_path();
  if (folder.empty()) return Status::Ok();
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) return FailedPreconditionError(folder.string() + ": cannot be made: " + error.message());
  return Status::Ok();
}

Status SetUpConnection(Database* database, const DatabaseOptions& options) {
  RG_RETURN_IF_ERROR(
      database->Execute("PRAGMA foreign_keys = ON; PRAGMA temp_store = MEMORY;"
                        "PRAGMA cache_size = -32768; PRAGMA secure_delete = OFF"));
  if (options.read_only) return Status::Ok();
  // Takes effect on a new file only, before its first table.
  RG_RETURN_IF_ERROR(database->Execute("PRAGMA auto_vacuum = INCREMENTAL"));
  if (!IsMemory(options)) {
    RG_ASSIGN_OR_RETURN(Statement mode, database->Prepare("PRAGMA journal_mode = WAL"));
    RG_ASSIGN_OR_RETURN(const bool row, mode.Step());
    if (!row || mode.Text(0) != "wal")
      return FailedPreconditionError(options.path +
                                     ": this file system cannot hold a write-ahead log (a network share?); "
                                     "put the database on a local disk");
  }
  return database->Execute(std::string("PRAGMA synchronous = ") + (options.durable ? "FULL" : "NORMAL") +
                           "; PRAGMA wal_autocheckpoint = 4000; PRAGMA journal_size_limit = 67108864");
}

// A copy beside the file before its tables are changed. One that is there already was made before an attempt
// that came to nothing.
Status BackUpBeforeMigration(Database* database, const std::vector<Module>& modules) {
  RG_ASSIGN_OR_RETURN(const std::string pending, PendingMigration(database, modules));
  if (pending.empty()) return Status::Ok();
  const std::string copy = database->path() + ".before-" + pending, part = copy + ".part";
  std::error_code error;
  if (std::filesystem::exists(copy, error)) return Status::Ok();
  std::filesystem::remove(part, error);
  const Status copied = database->BackupTo(part);
  if (copied.ok()) std::filesystem::rename(part, copy, error);
  if (copied.ok() && !error) {
    SyncFolderOf(copy);
    return Status::Ok();
  }
  const std::string why = copied.ok() ? error.message() : copied.message();
  std::filesystem::remove(part, error);
  return Status(copied.ok() ? StatusCode::kInternal : copied.code(),
                database->path() + ": no copy could be made before its tables are changed: " + why);
}

}  // namespace

Result<std::unique_ptr<Database>> Database::Open(const DatabaseOptions& options,
                                                 const std::vector<Module>& modules) {
  auto impl = std::make_unique<Impl>();
  impl->options = options;
  const bool on_disk = !IsMemory(options);
  const bool exists = on_disk && std::filesystem::exists(options.path);
  if (options.read_only && !exists) return NotFoundError(options.path + ": no such database");
  if (!options.read_only && on_disk) {
    RG_RETURN_IF_ERROR(PrepareFolder(options));
    RG_ASSIGN_OR_RETURN(impl->lock, WriterLock::Acquire(options.path, options.writer_wait_ms));
  }
  try {
    const int flags =
        options.read_only ? SQLite::OPEN_READONLY : SQLite::OPEN_READWRITE | SQLite::OPEN_CREATE;
    impl->database =
        std::make_unique<SQLite::Database>(options.path, flags, options.busy_timeout_ms, options.vfs);
  } catch (const SQLite::Exception& e) {
    return FromException(options.path, e);
  }
  sqlite3_extended_result_codes(impl->database->getHandle(), 1);
  std::unique_ptr<Database> database(new Database(std::move(impl)));
  RG_RETURN_IF_ERROR(SetUpConnection(database.get(), options));
  if (!options.read_only && options.copy_first && exists) RG_RETURN_IF_ERROR(BackUpBeforeMigration(database.get(), modules));
  if (options.read_only) {
    RG_RETURN_IF_ERROR(CheckSchema(database.get(), modules));
  } else {
    std::vector<Module> all = modules;
    all.push_back(OwnModule());
    RG_RETURN_IF_ERROR(MigrateAll(database.get(), all));
  }
  RG_ASSIGN_OR_RETURN(database->impl_->identity, IdentityOf(database.get(), !options.read_only));
  if (on_disk && !exists) SyncFolderOf(options.path);
  return database;
}

Result<Statement> Database::Prepare(std::string_view sql) {
  std::string text(sql);
  if (auto found = impl_->idle.find(text); found != impl_->idle.end() && !found->second.empty()) {
    auto statement = std::move(found->second.back());
    found->second.pop_back();
    --impl_->idle_count;
    return Statement(this, std::move(statement));
  }
  try {
    return Statement(this, std::make_unique<Statement::Impl>(*impl_->database, std::move(text)));
  } catch (const SQLite::Exception& e) {
    return FromException(impl_->options.path, e).WithPrefix("\"" + std::string(sql) + "\"");
  }
}

Status Database::Execute(std::string_view sql) {
  if (!IsRead(sql)) RG_RETURN_IF_ERROR(impl_->AllowWrite(sql));
  const Status done = impl_->Raw(std::string(sql));
  return done.ok() ? done : impl_->Note(done);
}

Result<Transaction> Database::Begin() {
  const int depth = impl_->depth + 1;
  if (impl_->TransactionIsLost())
    return Status(impl_->lost.code(), path() + ": the transaction was rolled back: " + impl_->lost.message());
  RG_RETURN_IF_ERROR(impl_->Raw(depth == 1 ? "BEGIN IMMEDIATE" : "SAVEPOINT rg_" + std::to_string(depth)));
  impl_->depth = depth;
  return Transaction(this, depth);
}

Status Database::InTransaction(const std::function<Status()>& body) {
  RG_ASSIGN_OR_RETURN(Transaction transaction, Begin());
  RG_RETURN_IF_ERROR(body());
  return transaction.Commit();
}

int64_t Database::last_insert_id() const { return impl_->database->getLastInsertRowid(); }
int Database::changes() const { return impl_->database->getChanges(); }
bool Database::in_transaction() const { return impl_->depth > 0; }
bool Database::read_only() const { return impl_->options.read_only; }
const std::string& Database::identity() const { return impl_->identity; }
const std::string& Database::path() const { return impl_->options.path; }
void Database::set_write_hook(WriteHook hook) { impl_->hook = std::move(hook); }

Result<int> Database::ModuleVersion(const std::string& module) {
  RG_ASSIGN_OR_RETURN(Statement query,
                      Prepare("SELECT coalesce(max(version), 0) FROM rg_migration WHERE module = ?"));
  query.Bind(1, module);
  RG_ASSIGN_OR_RETURN(const bool row, query.Step());
  return row ? static_cast<int>(query.Int(0)) : 0;
}

namespace {

// Interrupts what a connection does from a moment on, again and again: between two statements it has no effect. SQLite's
// progress handler would do, but is not asked within a check of pages.
class Alarm {
 public:
  Alarm(sqlite3* connection, double after_s)
      : rang_(after_s <= 0.0), thread_([this, connection, after_s](const std::stop_token& stop) {
          std::mutex mutex;
          std::unique_lock lock(mutex);
          std::condition_variable_any wait;
          const auto pause = [&](double s) { wait.wait_for(lock, stop, std::chrono::duration<double>(s), [] { return false; }); };
          for (pause(after_s); !stop.stop_requested(); pause(0.01)) {
            rang_ = true;
            sqlite3_interrupt(connection);
          }
        }) {}
  bool rang() const { return rang_; }

 private:
  std::atomic<bool> rang_;
  std::jthread thread_;
};

// Of a check or a query, one row or several. "ok" is nothing wrong, and three stars a heading.
Result<std::vector<std::string>> LinesOf(Database* database, const std::string& sql) {
  RG_ASSIGN_OR_RETURN(Statement rows, database->Prepare(sql));
  std::vector<std::string> lines;
  while (true) {
    RG_ASSIGN_OR_RETURN(const bool row, rows.Step());
    if (!row) return lines;
    std::istringstream text(rows.Text(0));
    for (std::string line; std::getline(text, line);)
      if (line != "ok" && line.rfind("***", 0) != 0) lines.push_back(line);
  }
}

}  // namespace

Result<std::vector<std::string>> Database::Problems(int most) {
  return LinesOf(this, "PRAGMA integrity_check(" + std::to_string(most) + ")");
}

Status Database::CheckIntegrity() {
  RG_ASSIGN_OR_RETURN(const auto problems, Problems(1));
  return problems.empty() ? Status::Ok() : DataLossError(path() + ": " + problems[0]);
}

Result<bool> Database::QuickCheck(double most_s) {
  RG_ASSIGN_OR_RETURN(const auto tables,
                      LinesOf(this, "SELECT name FROM sqlite_master WHERE type = 'table' "
                                    "ORDER BY name = 'artifact_chunk', name"));
  const Alarm alarm(impl_->database->getHandle(), most_s);
  for (const std::string& table : tables) {
    if (alarm.rang()) return false;
    const auto problems = LinesOf(this, "PRAGMA quick_check('" + table + "')");
    if (problems.ok() && !problems->empty()) return DataLossError(path() + ": " + problems->front());
    if (alarm.rang()) return false;
    RG_RETURN_IF_ERROR(problems.status());
  }
  return true;
}

Status Database::Checkpoint() {
  RG_ASSIGN_OR_RETURN(Statement checkpoint, Prepare("PRAGMA wal_checkpoint(TRUNCATE)"));
  RG_ASSIGN_OR_RETURN(const bool row, checkpoint.Step());
  if (row && checkpoint.Int(0) != 0) return UnavailableError(path() + ": a reader holds the write-ahead log");
  return Status::Ok();
}

Status Database::ReleaseFreePages(int pages) {
  RG_ASSIGN_OR_RETURN(Statement vacuum, Prepare("PRAGMA incremental_vacuum(" + std::to_string(pages) + ")"));
  return vacuum.Run();
}

Result<int64_t> Database::FreePages() {
  RG_ASSIGN_OR_RETURN(Statement count, Prepare("PRAGMA freelist_count"));
  RG_ASSIGN_OR_RETURN(const bool row, count.Step());
  return row ? count.Int(0) : 0;
}

Status Database::CheckpointPassively() {
  RG_ASSIGN_OR_RETURN(Statement checkpoint, Prepare("PRAGMA wal_checkpoint(PASSIVE)"));
  return checkpoint.Run();
}

namespace {
Status ForgetIdentity(const std::string& path, const std::string& vfs) {
  try {
    SQLite::Database copy(path, SQLite::OPEN_READWRITE, 0, vfs);
    if (copy.tableExists("rg_identity")) copy.exec("UPDATE rg_identity SET id = ''");
    return Status::Ok();
  } catch (const SQLite::Exception& e) {
    return FromException(path, e);
  }
}
}  // namespace

Status Database::BackupTo(const std::string& path) {
  if (std::filesystem::exists(path)) return AlreadyExistsError(path + ": is there already");
  RG_ASSIGN_OR_RETURN(Statement vacuum, Prepare("VACUUM INTO ?"));
  vacuum.Bind(1, path);
  RG_RETURN_IF_ERROR(vacuum.Run());
  RG_RETURN_IF_ERROR(ForgetIdentity(path, impl_->options.vfs));
  const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  const bool synced = fd >= 0 && ::fsync(fd) == 0;
  if (fd >= 0) ::close(fd);
  if (!synced) return InternalError(path + ": the copy could not be synced");
  SyncFolderOf(path);
  return Status::Ok();
}

}  // namespace rg::store
