// A database in a folder of its own, gone with the test.
#pragma once

#include <gtest/gtest.h>

#include <filesystem>
#include <memory>
#include <string>

#include "common/base/clock.h"
#include "common/base/ids.h"
#include "common/store/artifact_store.h"
#include "common/store/database.h"
#include "common/store/parameter_store.h"

namespace rg::store {

class TempFolder {
 public:
  TempFolder() : path_(std::filesystem::temp_directory_path() / ("rg_store_" + RandomHex(8))) {
    std::filesystem::create_directories(path_);
  }
  ~TempFolder() { std::filesystem::remove_all(path_); }
  std::string operator/(const std::string& name) const { return (path_ / name).string(); }

 private:
  std::filesystem::path path_;
};

inline std::vector<Module> AllModules() { return {ArtifactStore::Schema(), ParameterStore::Schema()}; }

class StoreTest : public testing::Test {
 protected:
  void SetUp() override { Reopen(); }

  void Reopen(int64_t chunk_bytes = 1000) {
    Close();
    auto opened = Database::Open({.path = folder_ / "store.db"}, AllModules());
    ASSERT_TRUE(opened.ok()) << opened.status().ToString();
    database_ = std::move(*opened);
    auto store = ArtifactStore::Open(database_.get(), &clock_,
                                     {.chunk_bytes = chunk_bytes, .max_artifact_bytes = 1 << 20});
    ASSERT_TRUE(store.ok()) << store.status().ToString();
    store_ = std::move(*store);
  }
  void Close() {
    store_.reset();
    database_.reset();
  }
  std::string PutOk(std::string_view bytes, const ArtifactSpec& spec) {
    auto put = store_->Put(bytes, spec);
    EXPECT_TRUE(put.ok()) << put.status().ToString();
    return put.ok() ? put->sha256 : "";
  }
  int64_t Count(const std::string& table) {
    auto query = database_->Prepare("SELECT count(*) FROM " + table);
    EXPECT_TRUE(query.ok() && *query->Step());
    return query->Int(0);
  }

  TempFolder folder_;
  FakeClock clock_;
  std::unique_ptr<Database> database_;
  std::unique_ptr<ArtifactStore> store_;
};

// `size` bytes that differ by `seed`.
inline std::string SomeBytes(size_t size, uint64_t seed = 1) {
  std::string bytes(size, '\0');
  uint64_t x = seed * 0x9E3779B97F4A7C15ull + 1;
  for (char& c : bytes) {
    x = x * 6364136223846793005ull + 1442695040888963407ull;
    c = static_cast<char>(x >> 56);
  }
  return bytes;
}

}  // namespace rg::store
