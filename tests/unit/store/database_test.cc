#include "common/store/database.h"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <fstream>
#include <thread>

#include "common/base/file.h"
#include "tests/unit/store/store_fixture.h"

namespace rg::store {
namespace {

using testing::HasSubstr;

constexpr std::string_view kFirst =
    "CREATE TABLE thing (id INTEGER PRIMARY KEY, name TEXT UNIQUE, size REAL, raw BLOB);";
constexpr std::string_view kSecond = "ALTER TABLE thing ADD COLUMN color TEXT NOT NULL DEFAULT 'red';";
const Module kThings1{"things", {{1, kFirst}}};
const Module kThings2{"things", {{1, kFirst}, {2, kSecond}}};
const Module kOther{
    "other", {{1, "CREATE TABLE other (id INTEGER PRIMARY KEY, thing INTEGER REFERENCES thing (id));"}}};

class DatabaseTest : public testing::Test {
 protected:
  std::string path() const { return folder_ / "sub/test.db"; }
  std::unique_ptr<Database> OpenOk(const std::vector<Module>& modules = {kThings1, kOther}) {
    auto opened = Database::Open({.path = path()}, modules);
    EXPECT_TRUE(opened.ok()) << opened.status().ToString();
    return opened.ok() ? std::move(*opened) : nullptr;
  }
  static int64_t Count(Database* database) {
    auto query = database->Prepare("SELECT count(*) FROM thing");
    EXPECT_TRUE(query.ok() && *query->Step());
    return query->Int(0);
  }
  static Status Insert(Database* database, const std::string& name) {
    RG_ASSIGN_OR_RETURN(Statement insert, database->Prepare("INSERT INTO thing (name) VALUES (?)"));
    insert.Bind(1, name);
    return insert.Run();
  }
  TempFolder folder_;
};

TEST_F(DatabaseTest, IsDurableAndStrict) {
  auto database = OpenOk();
  const auto pragma = [&](const std::string& name) {
    auto query = database->Prepare("PRAGMA " + name);
    EXPECT_TRUE(*query->Step());
    return query->Text(0);
  };
  EXPECT_EQ(pragma("journal_mode"), "wal");
  EXPECT_EQ(pragma("synchronous"), "2") << "FULL";
  EXPECT_EQ(pragma("foreign_keys"), "1");
  EXPECT_EQ(database->Execute("INSERT INTO other (thing) VALUES (99)").code(), StatusCode::kInvalid);
}

TEST_F(DatabaseTest, ValuesComeBackAsTheyWereBound) {
  auto database = OpenOk();
  const std::string raw("\0\1\xff", 3);
  auto insert = database->Prepare("INSERT INTO thing (id, name, size, raw) VALUES (?, ?, ?, ?)");
  insert->Bind(1, int64_t{1} << 60).Bind(2, "naïve").Bind(3, 0.1).BindBlob(4, raw);
  ASSERT_TRUE(insert->Run().ok());
  EXPECT_EQ(database->last_insert_id(), int64_t{1} << 60);
  insert->Bind(1, 2).BindNull(2).Bind(3, -1e300).BindBlob(4, {});
  ASSERT_TRUE(insert->Run().ok());
  auto query = database->Prepare("SELECT id, name, size, raw FROM thing ORDER BY id DESC");
  ASSERT_TRUE(*query->Step());
  EXPECT_EQ(query->Int(0), int64_t{1} << 60);
  EXPECT_EQ(query->Text(1), "naïve");
  EXPECT_EQ(query->Real(2), 0.1);
  EXPECT_EQ(query->Blob(3), raw);
  ASSERT_TRUE(*query->Step());
  EXPECT_TRUE(query->IsNull(1));
  EXPECT_FALSE(query->IsNull(3)) << "an empty blob is not NULL";
  EXPECT_EQ(query->Blob(3), "");
  EXPECT_FALSE(*query->Step());
}

TEST_F(DatabaseTest, ErrorsAreStatuses) {
  auto database = OpenOk();
  EXPECT_FALSE(database->Prepare("SELECT nonsense FROM nowhere").ok());
  EXPECT_FALSE(database->Execute("not sql").ok());
  ASSERT_TRUE(Insert(database.get(), "a").ok());
  EXPECT_EQ(Insert(database.get(), "a").code(), StatusCode::kAlreadyExists);
  auto query = database->Prepare("SELECT ?");
  query->Bind(7, 1);
  EXPECT_THAT(query->Step().status().message(), HasSubstr("parameter 7"));
}

TEST_F(DatabaseTest, TransactionsRollBackUnlessCommitted) {
  auto database = OpenOk();
  {
    auto transaction = database->Begin();
    ASSERT_TRUE(Insert(database.get(), "a").ok());
  }
  EXPECT_EQ(Count(database.get()), 0);
  EXPECT_FALSE(database
                   ->InTransaction([&]() -> Status {
                     RG_RETURN_IF_ERROR(Insert(database.get(), "a"));
                     return InvalidError("no");
                   })
                   .ok());
  EXPECT_EQ(Count(database.get()), 0);
  {
    auto outer = database->Begin();
    ASSERT_TRUE(Insert(database.get(), "a").ok());
    {
      auto inner = database->Begin();
      ASSERT_TRUE(Insert(database.get(), "b").ok());
    }
    {
      auto inner = database->Begin();
      ASSERT_TRUE(Insert(database.get(), "c").ok());
      ASSERT_TRUE(inner->Commit().ok());
    }
    EXPECT_TRUE(database->in_transaction());
    ASSERT_TRUE(outer->Commit().ok());
  }
  EXPECT_FALSE(database->in_transaction());
  EXPECT_EQ(Count(database.get()), 2);
}

TEST_F(DatabaseTest, MigratesModuleByModuleAndKeepsTheRows) {
  {
    auto database = OpenOk({kThings1});
    ASSERT_TRUE(Insert(database.get(), "old").ok());
    EXPECT_EQ(*database->ModuleVersion("things"), 1);
    EXPECT_EQ(*database->ModuleVersion("other"), 0);
  }
  auto database = OpenOk({kThings2, kOther});
  EXPECT_EQ(*database->ModuleVersion("things"), 2);
  EXPECT_EQ(*database->ModuleVersion("other"), 1);
  auto query = database->Prepare("SELECT name, color FROM thing");
  ASSERT_TRUE(*query->Step());
  EXPECT_EQ(query->Text(0), "old");
  EXPECT_EQ(query->Text(1), "red");
}

TEST_F(DatabaseTest, NewerSchemaIsRefusedAndLeftAsItIs) {
  OpenOk({kThings2}).reset();
  const auto older = Database::Open({.path = path()}, {kThings1, kOther});
  ASSERT_FALSE(older.ok());
  EXPECT_EQ(older.status().code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(older.status().message(), HasSubstr("module things has schema 2, this program knows up to 1"));
  EXPECT_THAT(older.status().message(), HasSubstr("use a newer realitygrad"));
  EXPECT_EQ(*OpenOk({kThings2})->ModuleVersion("other"), 0) << "nothing was migrated on the way";
}

TEST_F(DatabaseTest, EditedMigrationIsNoticed) {
  OpenOk({kThings1}).reset();
  const Module edited{"things", {{1, "CREATE TABLE thing (id INTEGER PRIMARY KEY, name TEXT);"}}};
  const auto opened = Database::Open({.path = path()}, {edited});
  EXPECT_EQ(opened.status().code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(opened.status().message(), HasSubstr("migration 1 is not the one"));
}

TEST_F(DatabaseTest, FailingMigrationChangesNothing) {
  OpenOk({kThings1}).reset();
  const Module bad{"things",
                   {{1, kFirst}, {2, "CREATE TABLE more (id INTEGER); CREATE TABLE thing (id INTEGER);"}}};
  const auto opened = Database::Open({.path = path()}, {bad});
  ASSERT_FALSE(opened.ok());
  EXPECT_THAT(opened.status().message(), HasSubstr("module things, migration 2"));
  auto database = OpenOk({kThings1});
  EXPECT_FALSE(database->Prepare("SELECT * FROM more").ok());
}

TEST_F(DatabaseTest, ForeignAndDamagedFilesAreRefused) {
  std::filesystem::create_directories(folder_ / "sub");
  std::ofstream(path()) << std::string(10000, 'x');
  EXPECT_EQ(Database::Open({.path = path()}, {kThings1}).status().code(), StatusCode::kDataLoss);
  EXPECT_FALSE(Database::Open({.path = folder_ / "sub"}, {kThings1}).ok()) << "a folder";
  EXPECT_EQ(Database::Open({.path = folder_ / "none.db", .read_only = true}, {kThings1}).status().code(),
            StatusCode::kNotFound);
}

TEST_F(DatabaseTest, SecondWriterIsToldWhoHoldsIt) {
  auto first = OpenOk();
  const auto second = Database::Open({.path = path()}, {kThings1, kOther});
  ASSERT_FALSE(second.ok());
  EXPECT_EQ(second.status().code(), StatusCode::kUnavailable);
  EXPECT_THAT(second.status().message(), HasSubstr("in use by process " + std::to_string(::getpid())));
}

TEST_F(DatabaseTest, AnyNameOfItMeetsItsWriter) {
  auto first = OpenOk();
  std::filesystem::create_symlink(path(), folder_ / "soft.db");
  std::filesystem::create_hard_link(path(), folder_ / "hard.db");
  for (const char* name : {"soft.db", "hard.db"}) {
    const auto second = Database::Open({.path = folder_ / name}, {kThings1, kOther});
    EXPECT_EQ(second.status().code(), StatusCode::kUnavailable) << name;
  }
  first.reset();
  const auto of_two_names = Database::Open({.path = path()}, {kThings1, kOther});
  EXPECT_EQ(of_two_names.status().code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(of_two_names.status().message(), HasSubstr("the file has 2 names (hard links)"));
  std::filesystem::remove(folder_ / "hard.db");
  EXPECT_TRUE(Database::Open({.path = folder_ / "soft.db"}, {kThings1, kOther}).ok());
}

// Without SQLite's own lock another process that reads it and leaves would take the write-ahead log away.
TEST_F(DatabaseTest, ARefusedSecondWriterLeavesTheLocksOfSQLiteAlone) {
  auto first = OpenOk();
  ASSERT_TRUE(Insert(first.get(), "a").ok());
  EXPECT_FALSE(Database::Open({.path = path()}, {kThings1, kOther}).ok());
  const pid_t child = ::fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    struct flock whole = {};
    whole.l_type = F_WRLCK;
    const int fd = ::open(path().c_str(), O_RDWR);
    ::_exit(::fcntl(fd, F_GETLK, &whole) == 0 && whole.l_pid == ::getppid() ? 0 : 1);
  }
  int status = 0;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0) << status;
}

TEST_F(DatabaseTest, SecondProcessIsRefusedOrWaitsItsTurn) {
  auto first = OpenOk();
  const pid_t child = ::fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    ::alarm(20);
    const auto refused = Database::Open({.path = path()}, {kThings1, kOther});
    if (refused.ok() || refused.status().code() != StatusCode::kUnavailable) ::_exit(1);
    auto waited = Database::Open({.path = path(), .writer_wait_ms = 15'000}, {kThings1, kOther});
    ::_exit(waited.ok() && Insert(waited->get(), "from the child").ok() ? 0 : 2);
  }
  std::this_thread::sleep_for(std::chrono::milliseconds(200));
  ASSERT_TRUE(Insert(first.get(), "from the parent").ok());
  first.reset();
  int status = 0;
  ASSERT_EQ(::waitpid(child, &status, 0), child);
  EXPECT_TRUE(WIFEXITED(status) && WEXITSTATUS(status) == 0) << status;
  EXPECT_EQ(Count(OpenOk().get()), 2);
}

TEST_F(DatabaseTest, ReadersSeeWhatIsCommittedWhileSomebodyWrites) {
  auto writer = OpenOk();
  ASSERT_TRUE(Insert(writer.get(), "a").ok());
  auto reader = Database::Open({.path = path(), .read_only = true}, {kThings1, kOther});
  ASSERT_TRUE(reader.ok()) << reader.status().ToString();
  auto transaction = writer->Begin();
  ASSERT_TRUE(Insert(writer.get(), "b").ok());
  EXPECT_EQ(Count(reader->get()), 1);
  ASSERT_TRUE(transaction->Commit().ok());
  EXPECT_EQ(Count(reader->get()), 2);
  EXPECT_EQ(Insert(reader->get(), "c").code(), StatusCode::kFailedPrecondition);
  EXPECT_FALSE(Database::Open({.path = path(), .read_only = true}, {kThings2}).ok()) << "needs a migration";
}

TEST_F(DatabaseTest, TheNthWriteCanBeMadeToFail) {
  auto database = OpenOk();
  int left = 3;
  database->set_write_hook([&](WriteKind, std::string_view) {
    return --left > 0 ? Status::Ok() : ResourceExhaustedError("no space, says the test");
  });
  ASSERT_TRUE(Insert(database.get(), "a").ok());
  const Status failed = database->InTransaction([&]() -> Status { return Insert(database.get(), "b"); });
  EXPECT_EQ(failed.code(), StatusCode::kResourceExhausted) << "at the commit";
  database->set_write_hook({});
  EXPECT_EQ(Count(database.get()), 1);
  ASSERT_TRUE(Insert(database.get(), "c").ok());
}

TEST_F(DatabaseTest, AFullDiskLosesTheTransactionAndNothingElse) {
  auto database = OpenOk();
  ASSERT_TRUE(Insert(database.get(), "before").ok());
  auto pages = database->Prepare("PRAGMA page_count");
  ASSERT_TRUE(*pages->Step());
  ASSERT_TRUE(database->Execute("PRAGMA max_page_count = " + std::to_string(pages->Int(0) + 5)).ok());
  pages->Reset();
  {
    auto transaction = database->Begin();
    Status written;
    for (int i = 0; i < 1000 && written.ok(); ++i)
      written = Insert(database.get(), std::string(1000, 'x') + std::to_string(i));
    EXPECT_EQ(written.code(), StatusCode::kResourceExhausted) << written.ToString();
    // Whatever SQLite did with the transaction, a caller that goes on cannot commit half of it.
    if (!Insert(database.get(), "after").ok()) {
      EXPECT_FALSE(transaction->Commit().ok());
    }
  }
  ASSERT_TRUE(database->Execute("PRAGMA max_page_count = 1000000").ok());
  EXPECT_EQ(Count(database.get()), 1);
  EXPECT_TRUE(Insert(database.get(), "after").ok());
  EXPECT_TRUE(database->CheckIntegrity().ok());
}

TEST_F(DatabaseTest, OverwrittenPagesAreFoundAndTold) {
  {
    auto database = OpenOk();
    for (int i = 0; i < 200; ++i) ASSERT_TRUE(Insert(database.get(), std::string(1000, 'x') + std::to_string(i)).ok());
    EXPECT_TRUE(*database->QuickCheck(1e6));
    EXPECT_FALSE(*database->QuickCheck(0.0)) << "no time for anything";
    EXPECT_TRUE(database->Problems(10)->empty());
  }
  std::string bytes = *ReadFile(path());
  for (size_t i = bytes.size() / 2; i < bytes.size(); ++i) bytes[i] = static_cast<char>(i);
  ASSERT_TRUE(WriteFileAtomically(path(), bytes).ok());
  auto database = OpenOk();
  ASSERT_NE(database, nullptr) << "its first pages are whole";
  const auto checked = database->QuickCheck(1e6);
  EXPECT_EQ(checked.status().code(), StatusCode::kDataLoss) << checked.status().ToString();
  EXPECT_THAT(checked.status().message(), HasSubstr(path() + ": "));
  EXPECT_THAT(checked.status().message(), testing::Not(HasSubstr("\n")));
  EXPECT_EQ(database->CheckIntegrity().code(), StatusCode::kDataLoss);
  EXPECT_GE(database->Problems(3)->size(), 3u);
}

TEST_F(DatabaseTest, BackupIsAWholeDatabase) {
  auto database = OpenOk();
  ASSERT_TRUE(Insert(database.get(), "a").ok());
  ASSERT_TRUE(database->BackupTo(folder_ / "copy.db").ok());
  EXPECT_EQ(database->BackupTo(folder_ / "copy.db").code(), StatusCode::kAlreadyExists);
  auto copy = Database::Open({.path = folder_ / "copy.db"}, {kThings1, kOther});
  ASSERT_TRUE(copy.ok()) << copy.status().ToString();
  EXPECT_EQ(Count(copy->get()), 1);
}

TEST_F(DatabaseTest, HasAnIdentityForGoodAndACopyHasAnother) {
  std::string first, copied;
  {
    auto database = OpenOk();
    first = database->identity();
    EXPECT_EQ(first.size(), 32u);
    ASSERT_TRUE(database->BackupTo(folder_ / "copy.db").ok());
  }
  EXPECT_EQ(OpenOk()->identity(), first);
  const auto open = [&](const char* name, bool read_only) {
    auto opened = Database::Open({.path = folder_ / name, .read_only = read_only}, {kThings1, kOther});
    EXPECT_TRUE(opened.ok()) << opened.status().ToString();
    return opened.ok() ? (*opened)->identity() : "";
  };
  EXPECT_EQ(open("sub/test.db", true), first);
  EXPECT_EQ(open("copy.db", true), "") << "nobody has written to it";
  copied = open("copy.db", false);
  EXPECT_EQ(copied.size(), 32u);
  EXPECT_NE(copied, first);
  EXPECT_EQ(open("copy.db", false), copied);
  EXPECT_NE(open("new.db", false), first);
}

TEST_F(DatabaseTest, OneFromBeforeThereWereIdentitiesGetsItsOwn) {
  ASSERT_TRUE(OpenOk()->Execute("DROP TABLE rg_identity; DELETE FROM rg_migration WHERE module = 'database'").ok());
  auto reader = Database::Open({.path = path(), .read_only = true}, {kThings1, kOther});
  ASSERT_TRUE(reader.ok()) << reader.status().ToString();
  EXPECT_EQ((*reader)->identity(), "");
  const std::string identity = OpenOk()->identity();
  EXPECT_EQ(identity.size(), 32u);
  EXPECT_EQ(OpenOk()->identity(), identity);
}

TEST_F(DatabaseTest, LivesInMemoryForTests) {
  auto database = Database::Open({.path = ":memory:"}, {kThings1, kOther});
  ASSERT_TRUE(database.ok()) << database.status().ToString();
  ASSERT_TRUE(Insert(database->get(), "a").ok());
  EXPECT_EQ(Count(database->get()), 1);
}

TEST_F(DatabaseTest, StatementsAreKeptAndReusedClean) {
  auto database = OpenOk();
  ASSERT_TRUE(Insert(database.get(), "a").ok());
  for (int i = 0; i < 3; ++i) {
    auto first = database->Prepare("SELECT name FROM thing WHERE name = ?");
    auto second = database->Prepare("SELECT name FROM thing WHERE name = ?");
    EXPECT_FALSE(*first->Step()) << "no parameter of an earlier use is left";
    first->Reset();
    first->Bind(1, "a");
    second->Bind(1, "b");
    EXPECT_TRUE(*first->Step());
    EXPECT_FALSE(*second->Step());
  }
}

}  // namespace
}  // namespace rg::store
