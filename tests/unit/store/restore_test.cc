#include "common/store/restore.h"

#include <gmock/gmock.h>

#include <set>

#include "common/base/file.h"
#include "tests/unit/store/store_fixture.h"

namespace rg::store {
namespace {

using testing::HasSubstr;

class RestoreTest : public StoreTest {
 protected:
  Status Restore(const std::string& backup, bool overwrite = false) {
    return RestoreDatabase({backup, folder_ / "store.db", overwrite}, AllModules());
  }
};

TEST_F(RestoreTest, GivesBackWhatWasThereWhenTheBackupWasMade) {
  const std::string before = PutOk(SomeBytes(50'000), {.kind = "data"});
  ASSERT_TRUE(database_->BackupTo(folder_ / "backup.db").ok());
  const std::string after = PutOk("later", {.kind = "data"});
  EXPECT_EQ(Restore(folder_ / "backup.db", true).code(), StatusCode::kUnavailable) << "it is being written";
  Close();
  EXPECT_THAT(Restore(folder_ / "backup.db").message(), HasSubstr("--overwrite moves it aside"));
  ASSERT_TRUE(Restore(folder_ / "backup.db", true).ok());
  Reopen();
  EXPECT_EQ(*store_->Get(before), SomeBytes(50'000));
  EXPECT_FALSE(store_->Contains(after));
  PutOk("it can be written", {.kind = "data"});
  EXPECT_TRUE(database_->CheckIntegrity().ok());
  const auto old = Database::Open({.path = folder_ / "store.db.before-restore"}, AllModules());
  ASSERT_TRUE(old.ok()) << old.status().ToString();
  EXPECT_TRUE((*ArtifactStore::Open(old->get(), &clock_))->Contains(after)) << "nothing is thrown away";
}

TEST_F(RestoreTest, ThroughALinkItMeetsTheWriterAndMovesTheDatabaseNotTheLink) {
  const std::string before = PutOk(SomeBytes(5'000), {.kind = "data"});
  ASSERT_TRUE(database_->BackupTo(folder_ / "backup.db").ok());
  const std::string link = folder_ / "link.db";
  std::filesystem::create_symlink("store.db", link);
  EXPECT_EQ(RestoreDatabase({folder_ / "backup.db", link, true}, AllModules()).code(), StatusCode::kUnavailable);
  Close();
  ASSERT_TRUE(RestoreDatabase({folder_ / "backup.db", link, true}, AllModules()).ok());
  EXPECT_TRUE(std::filesystem::is_symlink(link));
  EXPECT_TRUE(std::filesystem::exists(folder_ / "store.db.before-restore"));
  Reopen();
  EXPECT_TRUE(store_->Contains(before));
  Close();
  std::filesystem::remove(folder_ / "store.db");
  EXPECT_TRUE(RestoreDatabase({folder_ / "backup.db", link, false}, AllModules()).ok()) << "a link to nothing";
  EXPECT_TRUE(std::filesystem::exists(folder_ / "store.db"));
}

TEST_F(RestoreTest, EachRestoreIsAnotherDatabase) {
  ASSERT_TRUE(database_->BackupTo(folder_ / "backup.db").ok());
  std::set<std::string> identities = {database_->identity()};
  for (int turn = 0; turn < 2; ++turn) {
    Close();
    std::filesystem::remove(folder_ / "store.db.before-restore");
    ASSERT_TRUE(Restore(folder_ / "backup.db", true).ok());
    Reopen();
    EXPECT_EQ(database_->identity().size(), 32u);
    EXPECT_TRUE(identities.insert(database_->identity()).second);
  }
}

TEST_F(RestoreTest, ABackupOfANewerProgramChangesNothing) {
  ASSERT_TRUE(database_->BackupTo(folder_ / "backup.db").ok());
  const std::string identity = database_->identity();
  Close();
  {
    auto newer = AllModules();
    newer[0].migrations.push_back({static_cast<int>(newer[0].migrations.size()) + 1, "CREATE TABLE of_tomorrow (id INTEGER)"});
    ASSERT_TRUE(Database::Open({.path = folder_ / "backup.db"}, newer).ok());
  }
  const Status refused = Restore(folder_ / "backup.db", true);
  EXPECT_EQ(refused.code(), StatusCode::kFailedPrecondition);
  EXPECT_THAT(refused.message(), HasSubstr("use a newer realitygrad"));
  Reopen();
  EXPECT_EQ(database_->identity(), identity);
}

TEST_F(RestoreTest, ADamagedOrForeignBackupChangesNothing) {
  const std::string sha = PutOk(SomeBytes(300'000), {.kind = "data"});
  ASSERT_TRUE(database_->BackupTo(folder_ / "backup.db").ok());
  Close();
  std::string bytes = *ReadFile(folder_ / "backup.db");
  for (size_t i = 8192; i < 3 * 8192; ++i) bytes[i] = static_cast<char>(~bytes[i]);
  ASSERT_TRUE(WriteFileAtomically(folder_ / "damaged.db", bytes).ok());
  ASSERT_TRUE(WriteFileAtomically(folder_ / "foreign.db", "not a database").ok());
  for (const char* name : {"damaged.db", "foreign.db", "missing.db", "store.db"}) {
    const Status refused = Restore(folder_ / name, true);
    EXPECT_FALSE(refused.ok()) << name;
    EXPECT_THAT(refused.message(), HasSubstr(name));
  }
  Reopen();
  EXPECT_EQ(*store_->Get(sha), SomeBytes(300'000));
  EXPECT_FALSE(std::filesystem::exists(folder_ / "store.db.before-restore"));
}

}  // namespace
}  // namespace rg::store
