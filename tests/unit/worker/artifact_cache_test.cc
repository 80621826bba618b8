#include "worker/artifact_cache.h"

#include <gtest/gtest.h>

#include <filesystem>

#include "common/base/file.h"
#include "common/base/hash.h"
#include "common/base/ids.h"

namespace rg::worker {
namespace {

class ArtifactCacheTest : public ::testing::Test {
 protected:
  ArtifactCacheTest() : folder_("/tmp/rg-cache-" + RandomHex(6)) {}
  ~ArtifactCacheTest() override { std::filesystem::remove_all(folder_); }
  ArtifactCache Open(uint64_t limit) { return *ArtifactCache::Open(folder_, limit); }
  static std::string Bytes(char c, size_t size = 100) { return std::string(size, c); }
  std::string folder_, path_;
};

TEST_F(ArtifactCacheTest, KeepsWhatWasInsertedAlsoForTheNextProcess) {
  const std::string hash = Sha256Hex(Bytes('a'));
  ASSERT_TRUE(Open(1000).Insert(hash, Bytes('a')).ok());
  ArtifactCache next = Open(1000);
  ASSERT_TRUE(next.Find(hash, &path_));
  EXPECT_EQ(*ReadFile(path_), Bytes('a'));
  EXPECT_EQ(next.bytes(), 100u);
}

TEST_F(ArtifactCacheTest, RefusesBytesThatDoNotMatchTheirHash) {
  ArtifactCache cache = Open(1000);
  EXPECT_EQ(cache.Insert(Sha256Hex("x"), "y").status().code(), StatusCode::kDataLoss);
  EXPECT_FALSE(cache.Find(Sha256Hex("x"), &path_));
}

TEST_F(ArtifactCacheTest, EvictsWhatWasUsedLongestAgoButNothingThatIsHeld) {
  ArtifactCache cache = Open(250);
  const std::string a = Sha256Hex(Bytes('a')), b = Sha256Hex(Bytes('b')), c = Sha256Hex(Bytes('c')),
                    d = Sha256Hex(Bytes('d'));
  ASSERT_TRUE(cache.Insert(a, Bytes('a')).ok());
  ASSERT_TRUE(cache.Insert(b, Bytes('b')).ok());
  ASSERT_TRUE(cache.Find(a, &path_));
  ASSERT_TRUE(cache.Insert(c, Bytes('c')).ok());
  EXPECT_FALSE(cache.Find(b, &path_));
  EXPECT_TRUE(cache.Find(c, &path_));
  cache.Hold(a);
  ASSERT_TRUE(cache.Insert(d, Bytes('d')).ok());
  EXPECT_TRUE(cache.Find(a, &path_));
  EXPECT_FALSE(cache.Find(c, &path_));
  EXPECT_LE(cache.bytes(), 250u);
}

TEST_F(ArtifactCacheTest, AFileThatAnotherWorkerRemovedIsMissed) {
  ArtifactCache cache = Open(1000);
  const std::string a = Sha256Hex(Bytes('a'));
  ASSERT_TRUE(cache.Insert(a, Bytes('a')).ok());
  ASSERT_TRUE(cache.Find(a, &path_));
  std::filesystem::remove(path_);
  EXPECT_FALSE(cache.Find(a, &path_));
  EXPECT_EQ(cache.bytes(), 0u);
}

}  // namespace
}  // namespace rg::worker
