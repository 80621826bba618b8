#include "robot_agent/spool.h"

#include <gtest/gtest.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <map>

#include "common/base/file.h"
#include "common/base/ids.h"

namespace rg::robot_agent {
namespace {

class SpoolFolder : public testing::Test {
 protected:
  SpoolFolder() : folder_((std::filesystem::temp_directory_path() / ("rg-spool-" + RandomHex(6))).string()) {}
  ~SpoolFolder() override { std::filesystem::remove_all(folder_); }
  std::string folder_;
};

TEST_F(SpoolFolder, WhatCannotBeDeliveredStaysAndIsDeliveredLaterOnce) {
  auto spool = Spool::Open(folder_).value();
  ASSERT_TRUE(spool->Commit("one", "1").ok());
  ASSERT_TRUE(spool->Commit("two", "2").ok());
  int asked = 0;
  EXPECT_EQ(spool->Deliver([&](auto&, auto&) { return ++asked, UnavailableError("away"); }), 0);
  EXPECT_EQ(asked, 1);
  EXPECT_EQ(spool->Ready().size(), 2u);
  std::map<std::string, int> got;
  const auto take = [&](const std::string& id, const std::string& bytes) {
    ++got[id + bytes];
    return Status::Ok();
  };
  EXPECT_EQ(spool->Deliver(take), 2);
  EXPECT_EQ(spool->Deliver(take), 0);
  EXPECT_EQ(got, (std::map<std::string, int>{{"one1", 1}, {"two2", 1}}));
}

TEST_F(SpoolFolder, AReceiverThatHasItAlreadyEndsTheRedelivery) {
  auto spool = Spool::Open(folder_).value();
  ASSERT_TRUE(spool->Commit("one", "1").ok());
  EXPECT_EQ(spool->Deliver([](auto&, auto&) { return AlreadyExistsError("have it"); }), 1);
  EXPECT_TRUE(spool->Ready().empty());
}

TEST_F(SpoolFolder, OneRefusedBundleDoesNotBlockTheOthers) {
  auto spool = Spool::Open(folder_).value();
  ASSERT_TRUE(spool->Commit("bad", "1").ok());
  ASSERT_TRUE(spool->Commit("good", "2").ok());
  const auto picky = [](const std::string& id, auto&) {
    return id == "bad" ? InvalidError("no") : Status::Ok();
  };
  EXPECT_EQ(spool->Deliver(picky), 1);
  EXPECT_EQ(spool->Ready(), std::vector<std::string>{"bad"});
}

TEST_F(SpoolFolder, LeftoversOfADeadProcessBecomeReady) {
  auto spool = Spool::Open(folder_).value();
  ASSERT_TRUE(WriteFileAtomically(spool->ActivePath("dead"), "raw").ok());
  ASSERT_TRUE(WriteFileAtomically(spool->ActivePath("junk"), "?").ok());
  const auto finish = [](const std::string& path) -> Result<std::string> {
    if (ReadFile(path).value() == "?") return DataLossError("unreadable");
    return std::string("bundle");
  };
  EXPECT_EQ(spool->Salvage(finish), std::vector<std::string>{"dead"});
  EXPECT_EQ(ReadFile(spool->ReadyPath("dead")).value(), "bundle");
  EXPECT_TRUE(spool->Active().empty());
  EXPECT_TRUE(std::filesystem::exists(folder_ + "/broken/junk.rec"));
}

TEST_F(SpoolFolder, DeliversInTheOrderOfTimeNotOfNames) {
  auto spool = Spool::Open(folder_).value();
  for (const char* id : {"c", "a", "b"}) {
    ASSERT_TRUE(spool->Commit(id, "x").ok());
    // Files of one millisecond have an order too.
    static int64_t later = 0;
    std::filesystem::last_write_time(
        spool->ReadyPath(id), std::filesystem::file_time_type::clock::now() + std::chrono::seconds(++later));
  }
  std::string order;
  EXPECT_EQ(spool->Deliver([&](const std::string& id, auto&) { return order += id, Status::Ok(); }), 3);
  EXPECT_EQ(order, "cab");
}

TEST_F(SpoolFolder, DeliveredBundlesAreThereForAWhileAndThenPruned) {
  auto spool = Spool::Open(folder_).value();
  const int count = static_cast<int>(Spool::kKeptSent) + 3;
  for (int k = 0; k < count; ++k) {
    const std::string id = "r" + std::to_string(k);
    ASSERT_TRUE(spool->Commit(id, "x").ok());
    std::filesystem::last_write_time(spool->ReadyPath(id),
                                     std::filesystem::file_time_type::clock::now() + std::chrono::seconds(k));
  }
  EXPECT_EQ(spool->Deliver([](auto&, auto&) { return Status::Ok(); }), count);
  EXPECT_TRUE(spool->Ready().empty());
  EXPECT_FALSE(spool->FinishedPath("r2").has_value());
  ASSERT_TRUE(spool->FinishedPath("r3").has_value());
  EXPECT_EQ(ReadFile(*spool->FinishedPath("r3")).value(), "x");
}

TEST_F(SpoolFolder, WhatHasBegunIsRememberedForGoodAlsoAfterATornLine) {
  auto spool = Spool::Open(folder_).value();
  EXPECT_FALSE(spool->Begun("one").has_value());
  ASSERT_TRUE(spool->MarkBegun("one", "2026-01-01").ok());
  EXPECT_EQ(spool->Begun("one").value(), "one 2026-01-01");
  EXPECT_FALSE(spool->Begun("on").has_value());
  spool.reset();
  std::ofstream(folder_ + "/begun.txt", std::ios::app) << "tw";  // the power went
  spool = Spool::Open(folder_).value();
  EXPECT_FALSE(spool->Begun("two").has_value());
  ASSERT_TRUE(spool->MarkBegun("three", "2026-01-02").ok());
  EXPECT_TRUE(spool->Begun("one").has_value());
  EXPECT_EQ(spool->Begun("three").value(), "three 2026-01-02");
}

TEST_F(SpoolFolder, WhatWasMarkedAndDidNotBeginMayBeginLater) {
  auto spool = Spool::Open(folder_).value();
  ASSERT_TRUE(spool->MarkBegun("one", "2026-01-01").ok());
  ASSERT_TRUE(spool->MarkBegun("one-more", "2026-01-01").ok());
  ASSERT_TRUE(spool->CommitNotBegun("one", "why it did not").ok());
  ASSERT_TRUE(spool->CommitNotBegun("one", "why it did not again").ok());
  EXPECT_EQ(spool->Ready(), (std::vector<std::string>{"one+not-begun-1", "one+not-begun-2"}));
  EXPECT_FALSE(spool->FinishedPath("one").has_value());
  EXPECT_FALSE(spool->Begun("one").has_value());
  EXPECT_TRUE(spool->Begun("one-more").has_value());
  ASSERT_TRUE(spool->MarkBegun("one", "2026-01-02").ok());
  spool = nullptr;
  EXPECT_EQ(Spool::Open(folder_).value()->Begun("one").value(), "one 2026-01-02");
}

TEST_F(SpoolFolder, ADiskWithoutRoomIsSaidSo) {
  auto spool = Spool::Open(folder_).value();
  EXPECT_TRUE(spool->CheckRoom(0.0).ok());
  const Status full = spool->CheckRoom(1e12);
  EXPECT_EQ(full.code(), StatusCode::kResourceExhausted);
  EXPECT_NE(full.message().find("a rollout needs"), std::string::npos) << full.message();
}

TEST_F(SpoolFolder, WhoDeliversKeepsNobodyFromRunningARollout) {
  auto delivering = Spool::OpenToDeliver(folder_).value();
  EXPECT_EQ(Spool::OpenToDeliver(folder_).status().code(), StatusCode::kFailedPrecondition);
  EXPECT_TRUE(Spool::Open(folder_).ok());
}

TEST_F(SpoolFolder, OneProcessAtATime) {
  auto spool = Spool::Open(folder_).value();
  EXPECT_EQ(Spool::Open(folder_).status().code(), StatusCode::kFailedPrecondition);
  spool.reset();
  EXPECT_TRUE(Spool::Open(folder_).ok());
}

}  // namespace
}  // namespace rg::robot_agent
