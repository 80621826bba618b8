#include "robot_agent/recorder.h"

#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>

#include "common/base/file.h"
#include "common/base/ids.h"

namespace rg::robot_agent {
namespace {

class RecorderFile : public testing::Test {
 protected:
  RecorderFile() : folder_(std::filesystem::temp_directory_path() / ("rg-rec-" + RandomHex(6))) {}
  ~RecorderFile() override { std::filesystem::remove_all(folder_); }
  std::string Path() const { return (folder_ / "a" / "x.rec").string(); }

  static Sample Numbered(int k) {
    Sample sample;
    sample.tick = k;
    sample.stamp_ns = 40'000'000LL * k;
    sample.q[0] = k;
    sample.sent[1] = -k;
    return sample;
  }

  std::filesystem::path folder_;
};

TEST_F(RecorderFile, WhatIsRecordedIsReadBack) {
  auto recorder = Recorder::Start(Path(), "{\"a\":1}", 2, {}).value();
  for (int k = 0; k < 200; ++k) recorder->Record(Numbered(k));
  ASSERT_TRUE(recorder->Finish("{\"end_reason\":\"completed\"}").ok());
  const RawRecording raw = ReadRawRecording(Path()).value();
  EXPECT_EQ(raw.metadata_json, "{\"a\":1}");
  EXPECT_EQ(raw.end_json, "{\"end_reason\":\"completed\"}");
  ASSERT_EQ(raw.samples.size(), 200u);
  EXPECT_EQ(raw.samples[199].q[0], 199.0);
  EXPECT_EQ(raw.samples[199].sent[1], -199.0);
  EXPECT_EQ(raw.samples[199].stamp_ns, 199 * 40'000'000LL);
  EXPECT_EQ(raw.torn_bytes, 0u);
}

TEST_F(RecorderFile, AnyTornTailLeavesTheRecordsBeforeIt) {
  auto recorder = Recorder::Start(Path(), "{}", 2, {}).value();
  for (int k = 0; k < 5; ++k) recorder->Record(Numbered(k));
  ASSERT_TRUE(recorder->Finish("{}").ok());
  size_t fewest = 5;
  for (size_t size = std::filesystem::file_size(Path()) - 1; size >= 18; --size) {
    std::filesystem::resize_file(Path(), size);
    const auto raw = ReadRawRecording(Path());
    ASSERT_TRUE(raw.ok());
    EXPECT_FALSE(raw->end_json.has_value());
    EXPECT_LE(raw->samples.size(), fewest);
    fewest = raw->samples.size();
  }
  EXPECT_EQ(fewest, 0u);
}

TEST_F(RecorderFile, AFlippedBitEndsTheReadableParts) {
  auto recorder = Recorder::Start(Path(), "{}", 2, {}).value();
  for (int k = 0; k < 5; ++k) recorder->Record(Numbered(k));
  ASSERT_TRUE(recorder->Finish("{}").ok());
  std::string bytes = ReadFile(Path()).value();
  bytes[bytes.size() / 2] ^= 1;
  ASSERT_TRUE(WriteFileAtomically(Path(), bytes).ok());
  const RawRecording raw = ReadRawRecording(Path()).value();
  EXPECT_LT(raw.samples.size(), 5u);
  EXPECT_GT(raw.torn_bytes, 0u);
  bytes[3] ^= 1;
  ASSERT_TRUE(WriteFileAtomically(Path(), bytes).ok());
  EXPECT_EQ(ReadRawRecording(Path()).status().code(), StatusCode::kDataLoss);
}

TEST_F(RecorderFile, AFullRingIsAFailureAndNeverAWait) {
  auto recorder = Recorder::Start(Path(), "{}", 2, {.poll_s = 10.0, .ring_capacity = 8}).value();
  for (int k = 0; k < 8; ++k) recorder->Record(Numbered(k));
  EXPECT_TRUE(recorder->ok());
  recorder->Record(Numbered(8));
  EXPECT_FALSE(recorder->ok());
}

TEST_F(RecorderFile, AnExistingFileIsNotOverwritten) {
  { auto recorder = Recorder::Start(Path(), "{}", 2, {}).value(); }
  EXPECT_FALSE(Recorder::Start(Path(), "{}", 2, {}).ok());
}

// A real process records a sample each 5 ms and is killed without warning.
TEST_F(RecorderFile, KillMinusNineLosesAtMostTheStatedTime) {
  int progress[2];
  ASSERT_EQ(pipe(progress), 0);
  const pid_t child = fork();
  if (child == 0) {
    auto recorder = Recorder::Start(Path(), "{}", 2, {.poll_s = 0.02}).value();
    for (int k = 0;; ++k) {
      recorder->Record(Numbered(k));
      if (write(progress[1], &k, sizeof k) != sizeof k) _exit(1);
      usleep(5000);
    }
  }
  int k = -1;
  while (k < 100) ASSERT_EQ(read(progress[0], &k, sizeof k), static_cast<ssize_t>(sizeof k));
  kill(child, SIGKILL);
  waitpid(child, nullptr, 0);
  close(progress[1]);
  while (read(progress[0], &k, sizeof k) == static_cast<ssize_t>(sizeof k)) {
  }
  close(progress[0]);
  const RawRecording raw = ReadRawRecording(Path()).value();
  EXPECT_FALSE(raw.end_json.has_value());
  // 20 ms of samples are 4; a loaded machine may let the recorder's thread wait longer.
  EXPECT_GE(static_cast<int>(raw.samples.size()), k - 40);
  for (size_t i = 0; i < raw.samples.size(); ++i) EXPECT_EQ(raw.samples[i].tick, static_cast<int64_t>(i));
}

}  // namespace
}  // namespace rg::robot_agent
