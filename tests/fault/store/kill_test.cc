// kill -9 of a process that writes to the store, at random moments.
#include <gmock/gmock.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <set>
#include <thread>

#include "common/base/rng.h"
#include "tests/unit/store/store_fixture.h"

namespace rg::store {
namespace {

constexpr int64_t kChunk = 4096;

struct StoreOnDisk {
  std::unique_ptr<Database> database;
  std::unique_ptr<ArtifactStore> store;
};

Result<StoreOnDisk> OpenStore(const std::string& path) {
  StoreOnDisk opened;
  RG_ASSIGN_OR_RETURN(opened.database, Database::Open({.path = path, .writer_wait_ms = 5000}, AllModules()));
  RG_ASSIGN_OR_RETURN(opened.store,
                      ArtifactStore::Open(opened.database.get(), &RealClock(), {.chunk_bytes = kChunk}));
  return opened;
}

// Puts for ever: streamed, at once, and grouped; tells the hash of each committed one through `fd`.
[[noreturn]] void PutForEver(const std::string& path, uint64_t seed, int fd) {
  auto opened = OpenStore(path);
  if (!opened.ok()) ::_exit(10);
  Rng rng(seed);
  std::string parent;
  const auto tell = [&](const std::string& sha) {
    if (::write(fd, sha.data(), 64) != 64) ::_exit(11);
  };
  for (uint64_t i = 0;; ++i) {
    const std::string bytes = SomeBytes(rng.Index(20 * kChunk), seed * 1'000'003 + i);
    ArtifactSpec spec{.kind = "data", .job_id = "job"};
    if (!parent.empty()) spec.parents = {parent};
    if (i % 3 == 0) {
      auto writer = opened->store->BeginPut();
      for (size_t at = 0; at < bytes.size(); at += 5000)
        if (!writer->Append(std::string_view(bytes).substr(at, 5000)).ok()) ::_exit(12);
      auto put = writer->Commit(spec);
      if (!put.ok()) ::_exit(13);
      tell(parent = put->sha256);
    } else if (i % 3 == 1) {
      auto put = opened->store->Put(bytes, spec);
      if (!put.ok()) ::_exit(14);
      tell(parent = put->sha256);
    } else {
      auto transaction = opened->database->Begin();
      std::vector<std::string> group;
      for (int k = 0; k < 5; ++k)
        group.push_back(opened->store->Put(SomeBytes(100, rng.Next()), spec)->sha256);
      if (!transaction->Commit().ok()) ::_exit(15);
      for (const std::string& sha : group) tell(sha);
    }
  }
}

std::set<std::string> KillWhileWriting(const std::string& path, uint64_t seed, int after_ms) {
  int fds[2];
  EXPECT_EQ(::pipe(fds), 0);
  const pid_t child = ::fork();
  EXPECT_GE(child, 0);
  if (child == 0) {
    ::close(fds[0]);
    PutForEver(path, seed, fds[1]);
  }
  ::close(fds[1]);
  std::this_thread::sleep_for(std::chrono::milliseconds(after_ms));
  ::kill(child, SIGKILL);
  int status = 0;
  ::waitpid(child, &status, 0);
  EXPECT_TRUE(WIFSIGNALED(status)) << "the child ended by itself: " << WEXITSTATUS(status);
  std::set<std::string> acknowledged;
  char sha[64];
  while (::read(fds[0], sha, 64) == 64) acknowledged.insert(std::string(sha, 64));
  ::close(fds[0]);
  return acknowledged;
}

TEST(StoreKill, NoHalfArtifactAndNoLostAcknowledgement) {
  TempFolder folder;
  Rng rng(20);
  std::set<std::string> acknowledged;
  int64_t swept_rounds = 0;
  for (int round = 0; round < 12; ++round) {
    const auto more = KillWhileWriting(folder / "store.db", round, 30 + static_cast<int>(rng.Index(120)));
    acknowledged.insert(more.begin(), more.end());
    {
      auto reader = Database::Open({.path = folder / "store.db", .read_only = true}, AllModules());
      if (reader.ok()) {
        auto left = (*reader)->Prepare("SELECT count(*) FROM artifact_upload");
        ASSERT_TRUE(left.ok() && *left->Step());
        swept_rounds += left->Int(0) > 0;
      }
    }
    auto opened = OpenStore(folder / "store.db");
    ASSERT_TRUE(opened.ok()) << opened.status().ToString();
    for (const std::string& sha : more) ASSERT_TRUE(opened->store->Contains(sha)) << "round " << round;
    const auto report = opened->store->Verify();
    ASSERT_TRUE(report.ok()) << report.status().ToString();
    EXPECT_THAT(report->damaged, testing::IsEmpty());
    EXPECT_TRUE(opened->database->CheckIntegrity().ok());
    auto strays = opened->database->Prepare(
        "SELECT (SELECT count(*) FROM artifact_upload), (SELECT count(*) FROM artifact_chunk WHERE id / "
        "1048576"
        " NOT IN (SELECT id FROM artifact))");
    ASSERT_TRUE(*strays->Step());
    EXPECT_EQ(strays->Int(0), 0);
    EXPECT_EQ(strays->Int(1), 0) << "bytes without an artefact";
  }
  EXPECT_GT(acknowledged.size(), 20u) << "the children hardly wrote: the test proves nothing";
  EXPECT_GT(swept_rounds, 0) << "no kill hit an upload: the test proves nothing";
}

}  // namespace
}  // namespace rg::store
