// A disk that is full, or fails, at each single write of a scenario.
#include <gmock/gmock.h>
#include <sqlite3.h>
#include <sys/mount.h>
#include <unistd.h>

#include "common/base/rng.h"
#include "tests/support/fault_vfs/fault_vfs.h"
#include "tests/unit/store/store_fixture.h"

namespace rg::store {
namespace {

using testing_support::FaultVfs;

// A few puts and a collection; the first error ends it.
Status Scenario(Database* database, ArtifactStore* store, ParameterStore* parameters) {
  RG_ASSIGN_OR_RETURN(const PutResult first, store->Put(SomeBytes(5000, 1), {.kind = "data"}));
  RG_ASSIGN_OR_RETURN(ArtifactWriter writer, store->BeginPut());
  for (int i = 0; i < 5; ++i) RG_RETURN_IF_ERROR(writer.Append(SomeBytes(3000, i + 10)));
  RG_ASSIGN_OR_RETURN(const PutResult second, writer.Commit({.kind = "policy", .parents = {first.sha256}}));
  ParameterVersion version{.robot = "r", .recording_sha256 = first.sha256, .values = {{"a", 1.0, {}}}};
  RG_RETURN_IF_ERROR(parameters->Add(version, "key").status());
  RG_RETURN_IF_ERROR(store->Gc({}).status());
  return database->Checkpoint();
}

struct Opened {
  Opened(const std::string& path, const std::string& vfs) {
    auto opened = Database::Open({.path = path, .vfs = vfs}, AllModules());
    EXPECT_TRUE(opened.ok()) << opened.status().ToString();
    database = std::move(*opened);
    auto made = ArtifactStore::Open(database.get(), &clock, {.chunk_bytes = 2000});
    EXPECT_TRUE(made.ok()) << made.status().ToString();
    store = std::move(*made);
    parameters = std::make_unique<ParameterStore>(database.get(), &clock);
  }
  FakeClock clock;
  std::unique_ptr<Database> database;
  std::unique_ptr<ArtifactStore> store;
  std::unique_ptr<ParameterStore> parameters;
};

void CheckSound(Opened* opened, const std::string& where) {
  EXPECT_TRUE(opened->database->CheckIntegrity().ok()) << where;
  EXPECT_THAT(opened->store->Verify()->damaged, testing::IsEmpty()) << where;
  EXPECT_FALSE(opened->database->in_transaction()) << where;
}

class DiskFailureTest : public testing::TestWithParam<std::pair<int, StatusCode>> {};

TEST_P(DiskFailureTest, EachSingleFailureIsReportedAndDoesNoHarm) {
  const auto [code, expected] = GetParam();
  int64_t operations = 0;
  {
    TempFolder folder;
    FaultVfs vfs;
    Opened opened(folder / "store.db", vfs.name());
    const int64_t before = vfs.operations();
    ASSERT_TRUE(Scenario(opened.database.get(), opened.store.get(), opened.parameters.get()).ok());
    operations = vfs.operations() - before;
  }
  ASSERT_GT(operations, 20);
  int reported = 0;
  for (int64_t nth = 1; nth <= operations; ++nth) {
    const std::string where = "operation " + std::to_string(nth) + " of " + std::to_string(operations);
    TempFolder folder;
    FaultVfs vfs;
    {
      Opened opened(folder / "store.db", vfs.name());
      vfs.FailAt(nth, code);
      const Status outcome = Scenario(opened.database.get(), opened.store.get(), opened.parameters.get());
      if (!outcome.ok()) {
        ++reported;
        EXPECT_EQ(outcome.code(), expected) << where << ": " << outcome.ToString();
      }
      CheckSound(&opened, where);
      // The disk is well again: the same connection goes on, and a repeat of everything succeeds.
      const Status again = Scenario(opened.database.get(), opened.store.get(), opened.parameters.get());
      EXPECT_TRUE(again.ok()) << where << ": " << again.ToString();
      EXPECT_EQ(opened.parameters->History("r")->size(), 1u) << where;
    }
    FaultVfs well;  // as quick as the other, and never fails
    Opened reopened(folder / "store.db", well.name());
    CheckSound(&reopened, where + ", reopened");
    EXPECT_EQ(*reopened.store->Get(Sha256Hex(SomeBytes(5000, 1))), SomeBytes(5000, 1)) << where;
  }
  EXPECT_GT(reported, operations / 2) << "most failures must be visible to the caller";
}

INSTANTIATE_TEST_SUITE_P(Codes, DiskFailureTest,
                         testing::Values(std::pair(SQLITE_FULL, StatusCode::kResourceExhausted),
                                         std::pair(SQLITE_IOERR_WRITE, StatusCode::kInternal)),
                         [](const auto& info) {
                           return info.index == 0 ? std::string("Full") : std::string("IoError");
                         });

TEST(DiskFull, ARealFullDiskIsReportedAndSurvived) {
  TempFolder folder;
  const std::string mount = folder / "small";
  std::filesystem::create_directories(mount);
  if (::mount("tmpfs", mount.c_str(), "tmpfs", 0, "size=1m") != 0)
    GTEST_SKIP() << "cannot mount a small disk here";
  {
    Opened opened(mount + "/store.db", "");
    Status full;
    std::vector<std::string> stored;
    for (int i = 0; i < 1000 && full.ok(); ++i) {
      auto put = opened.store->Put(SomeBytes(20'000, i), {.kind = "data"});
      full = put.status();
      if (put.ok()) stored.push_back(put->sha256);
    }
    EXPECT_EQ(full.code(), StatusCode::kResourceExhausted) << full.ToString();
    EXPECT_GT(stored.size(), 5u);
    for (const std::string& sha : stored) EXPECT_TRUE(opened.store->Get(sha).ok());
    CheckSound(&opened, "full");
  }
  ::umount2(mount.c_str(), MNT_DETACH);  // a writer's lock keeps its file open (writer_lock.cc)
}

}  // namespace
}  // namespace rg::store
