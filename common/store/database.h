// SQLite as this project uses it: WAL, synchronous FULL, foreign keys on, one writing process, a
// schema made of modules with versions, and a Status instead of exceptions.
//
// One thread owns a Database and everything made from it. What a committed transaction wrote is on
// the disk when Commit returns. fsync is what costs (2-4 ms), not rows: callers batch many changes
// in one Transaction (group commit) and answer their peers after it.
//
// Errors: kUnavailable (another process writes, or holds the lock for too long), kResourceExhausted
// (disk full), kDataLoss (the file is damaged), kFailedPrecondition (schema newer than the program,
// read-only), kAlreadyExists (UNIQUE), kInvalid (other constraints), kInternal (the rest).
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "common/base/status.h"

namespace rg::store {

// One step of a module's schema. Released steps are frozen: never edit one, append the next.
struct Migration {
  int version = 0;       // 1, 2, 3, ... without gaps
  std::string_view sql;  // one or more statements
};

// The tables of one part of the program ("artifacts", "parameters", "coordinator"). Modules migrate
// independently, in the order given to Open; table names must not clash.
struct Module {
  std::string name;
  std::vector<Migration> migrations;
};

struct DatabaseOptions {
  std::string path;            // ":memory:" for tests; folders are made
  bool read_only = false;      // no migrations; the schema must be there and not newer
  int busy_timeout_ms = 5000;  // for locks of readers and checkpoints
  int writer_wait_ms = 0;      // how long to wait for another writing process to go away
  bool copy_first = true;      // of an older one, before its tables are changed
  bool durable = true;         // false: synchronous NORMAL, for caches that may lose the last second
  std::string vfs;             // name of an SQLite VFS: the seam for fault tests
};

// What a failing write looks like to tests: called with the kind of each change before it is made.
// A non-Ok answer is returned to the caller instead of writing.
enum class WriteKind { kStatement, kCommit };
using WriteHook = std::function<Status(WriteKind, std::string_view sql)>;

class Database;

// A prepared statement. Parameters are numbered from 1, columns from 0. Errors of Bind (no such
// parameter) show in the Step that follows. The statement is kept by the Database for its text:
// preparing it again is a lookup.
class Statement {
 public:
  Statement(Statement&&) noexcept;
  Statement& operator=(Statement&&) noexcept;
  ~Statement();  // resets and hands the statement back

  Statement& Bind(int index, int64_t value);
  Statement& Bind(int index, int value) { return Bind(index, static_cast<int64_t>(value)); }
  Statement& Bind(int index, double value);
  Statement& Bind(int index, std::string_view text);  // copied
  Statement& Bind(int index, const char* text) { return Bind(index, std::string_view(text)); }
  Statement& BindBlob(int index, std::string_view bytes);  // not copied: must live until Step returned
  Statement& BindNull(int index);

  // True: a row is there. False: done.
  Result<bool> Step();
  // Steps to the end, then resets and forgets all parameters: ready for the next Bind.
  Status Run();
  void Reset();

  bool IsNull(int column) const;
  int64_t Int(int column) const;
  double Real(int column) const;
  std::string Text(int column) const;
  std::string_view Blob(int column) const;  // valid until the next Step or Reset

  struct Impl;
  Statement(Database* database, std::unique_ptr<Impl> impl);

 private:
  Database* database_ = nullptr;
  std::unique_ptr<Impl> impl_;
};

// BEGIN IMMEDIATE … COMMIT; inside another one, a savepoint of it. Rolled back if not committed.
class Transaction {
 public:
  Transaction(Transaction&& other) noexcept;
  Transaction& operator=(Transaction&&) = delete;
  ~Transaction();
  // Outermost: everything is on the disk when this returns Ok; otherwise nothing was changed.
  Status Commit();
  void Rollback();

 private:
  friend class Database;
  Transaction(Database* database, int depth) : database_(database), depth_(depth) {}
  Database* database_;
  int depth_;  // 1: outermost
};

class Database {
 public:
  static Result<std::unique_ptr<Database>> Open(const DatabaseOptions& options,
                                                const std::vector<Module>& modules);
  ~Database();
  Database(const Database&) = delete;
  Database& operator=(const Database&) = delete;

  Result<Statement> Prepare(std::string_view sql);
  Status Execute(std::string_view sql);  // one or more statements without parameters
  Result<Transaction> Begin();
  // `body` inside a transaction: committed if it returns Ok, else rolled back.
  Status InTransaction(const std::function<Status()>& body);

  int64_t last_insert_id() const;
  int changes() const;  // rows changed by the last statement
  bool in_transaction() const;
  bool read_only() const;
  const std::string& path() const;
  // Random, of this database alone: minted when it is made, and when a copy of it (BackupTo, a restored backup) is
  // first opened for writing. Empty: a copy, or an older one, that nobody has written to.
  const std::string& identity() const;
  // Installed version of a module; 0: absent.
  Result<int> ModuleVersion(const std::string& module);
  // SQLite's own check of all pages and indexes: one line for each thing that is wrong, at most so many.
  Result<std::vector<std::string>> Problems(int most);
  // The same; kDataLoss with the first of them.
  Status CheckIntegrity();
  // A quicker check, of the pages, table after table, artefacts last, for at most so many seconds. False: that was not
  // enough for all of it. kDataLoss with the first thing that is wrong.
  Result<bool> QuickCheck(double most_s);
  // Moves the WAL into the database file and truncates it.
  Status Checkpoint();
  // Gives up to `pages` freed pages back to the file system (0: all). The file is shorter when the
  // write-ahead log was moved into it (Checkpoint).
  Status ReleaseFreePages(int pages = 0);
  Result<int64_t> FreePages();
  // As much of the WAL into the file as can be done without waiting for anybody.
  Status CheckpointPassively();
  // A consistent copy of the whole database at `path`, while it is in use; on the disk when it returns. It has no
  // identity: it becomes a database of its own.
  Status BackupTo(const std::string& path);

  void set_write_hook(WriteHook hook);

  struct Impl;
  Impl& impl() { return *impl_; }

 private:
  friend class Statement;
  friend class Transaction;
  explicit Database(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace rg::store
