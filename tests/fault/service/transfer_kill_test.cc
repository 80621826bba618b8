// Artefacts on their way while a side is killed: they arrive whole, and what had come is not sent again.
#include <gtest/gtest.h>

#include <signal.h>

#include <algorithm>
#include <filesystem>
#include <thread>

#include "common/base/file.h"
#include "common/base/hash.h"
#include "common/base/rng.h"
#include "tests/support/service/cuts.h"
#include "tests/support/service/processes.h"

namespace rg::testing {
namespace {

constexpr size_t kBytes = 40 << 20, kPiece = 4 << 20;

std::string SomeBytes(size_t size) {
  Rng rng(3);
  std::string bytes(size, '\0');
  for (size_t i = 0; i + 8 <= size; i += 8) {
    const uint64_t word = rng.Next();
    std::copy_n(reinterpret_cast<const char*>(&word), 8, bytes.data() + i);
  }
  return bytes;
}

pb::ArtifactInfo Blob() {
  pb::ArtifactInfo info;
  info.set_kind("blob");
  return info;
}

TEST(TransferKill, AnUploadGoesOnWhereTheKilledCoordinatorHadIt) {
  RG_NEEDS_PRELOADING();
  Service service;
  const std::string bytes = SomeBytes(kBytes), path = service.folder() + "/there";
  ASSERT_TRUE(WriteFileAtomically(path, bytes).ok());
  service.KillCoordinator();
  {
    const UnderShim shim(service.folder() + "/service.db", "after_sync:14", false);
    service.StartCoordinator();
  }
  Result<std::string> put = UnavailableError("not tried");
  std::thread upload([&] { put = service.NewClient()->PutArtifactFile(path, Blob()); });
  const int ended = service.coordinator().WaitForExit(60.0);
  service.StartCoordinator();
  upload.join();
  EXPECT_EQ(ended, 128 + SIGKILL) << "the coordinator was to be killed in the middle";
  ASSERT_TRUE(put.ok()) << put.status().ToString() << service.Logs();
  EXPECT_EQ(*put, Sha256Hex(bytes));
  const double sent = service.Counter("messages_received_total");
  EXPECT_LT(sent, static_cast<double>(kBytes / kPiece)) << "what was durable was not sent again";
  const auto report = service.client().VerifyArtifacts({*put});
  ASSERT_TRUE(report.ok());
  EXPECT_EQ(report->damaged_size(), 0);
  const std::string back = service.folder() + "/back";
  ASSERT_TRUE(service.client().GetArtifactFile(*put, back).ok());
  EXPECT_EQ(Sha256Hex(*ReadFile(back)), *put);
}

TEST(TransferKill, ADownloadTakesUpWhatAKilledOneLeft) {
  Service service;
  const std::string bytes = SomeBytes(kBytes), path = service.folder() + "/back";
  const auto sha256 = service.client().PutArtifact(bytes, Blob());
  ASSERT_TRUE(sha256.ok()) << sha256.status().ToString();
  ASSERT_TRUE(WriteFileAtomically(path + ".part", bytes.substr(0, 7 * kPiece + 1234)).ok());
  const double before = service.Counter("messages_received_total");
  const auto size = service.client().GetArtifactFile(*sha256, path);
  ASSERT_TRUE(size.ok()) << size.status().ToString();
  EXPECT_EQ(*size, kBytes);
  EXPECT_LE(service.Counter("messages_received_total") - before, 3.0 + 1.0) << "the rest only";
  EXPECT_TRUE(*ReadFile(path) == bytes);
  EXPECT_FALSE(std::filesystem::exists(path + ".part"));
}

TEST(TransferKill, WhatAnotherDownloadLeftIsFetchedAnew) {
  Service service;
  const std::string bytes = SomeBytes(kPiece + 17), path = service.folder() + "/back";
  const auto sha256 = service.client().PutArtifact(bytes, Blob());
  ASSERT_TRUE(sha256.ok()) << sha256.status().ToString();
  ASSERT_TRUE(WriteFileAtomically(path + ".part", "bytes of something else").ok());
  ASSERT_TRUE(service.client().GetArtifactFile(*sha256, path).ok());
  EXPECT_TRUE(*ReadFile(path) == bytes);
}

}  // namespace
}  // namespace rg::testing
