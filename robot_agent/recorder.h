// A rollout on its way to disk while it happens.
//
// The control thread hands Samples to a lock-free ring; the recorder's thread appends them to one
// file, each record with its own checksum, and syncs it at a fixed cadence. What a crash can lose:
//  - the process is killed (kill -9): the samples of the last poll_s (20 ms by default);
//  - the power goes: the samples since the last sync, at most sync_s + poll_s (0.22 s by default),
//    as far as the disk keeps what fsync promised.
// ReadRawRecording reads every intact record of such a file; a torn last one is left out and counted.
//
// File: records of {magic 'RGRC', type u32, length u32, CRC-32C u32 of type+length+payload, payload},
// little-endian. Types: 1 metadata (JSON, the first record), 2 sample, 3 end (JSON). A sample is
// tick i64, time_ns i64, stamp_ns i64, sequence u64, flags u64, then q, v, effort, command, sent
// (n doubles each). Frozen: add types, never change these.
#pragma once

#include <atomic>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "common/base/status.h"
#include "robot_agent/drivers/driver.h"
#include "robot_agent/spsc_ring.h"

namespace rg::robot_agent {

struct Sample {
  static constexpr uint64_t kNewState = 1;   // the state was not seen by an earlier tick
  static constexpr uint64_t kStopping = 2;   // zero added torque: the rollout has ended
  static constexpr uint64_t kSaturated = 4;  // the command was limited

  int64_t tick = 0;
  int64_t time_ns = 0;   // the command was sent, since the rollout's start
  int64_t stamp_ns = 0;  // the state was measured, since the rollout's start
  uint64_t sequence = 0;
  uint64_t flags = 0;
  JointArray q{}, v{}, effort{};
  JointArray command{};  // the whole torque asked of the drive, gravity included
  JointArray sent{};     // what the arm was handed: without g(q) if its base adds it
};

struct RecorderOptions {
  double poll_s = 0.02;
  double sync_s = 0.2;
  size_t ring_capacity = 1024;  // samples; at 25 Hz forty seconds of a stuck disk
  // Disk space that is taken before the rollout begins, so that a disk that fills up meanwhile does not cut
  // it off; 0: none. Too little is kResourceExhausted at Start.
  uint64_t reserve_bytes = 0;
};

class Recorder {
 public:
  // Creates the file (which must not exist) with the metadata record synced, and starts the thread.
  static Result<std::unique_ptr<Recorder>> Start(const std::string& path, const std::string& metadata_json,
                                                 int joints, const RecorderOptions& options);
  ~Recorder();  // stops the thread; without Finish the file stays as after a crash

  // Control thread: no allocation, no lock, no system call. A full ring makes ok() false for good.
  void Record(const Sample& sample);
  // False once a sample was dropped or a write failed: the rollout must stop.
  bool ok() const { return ok_.load(std::memory_order_relaxed); }

  // Of one sample on disk.
  static uint64_t SampleBytes(int joints);

  // Drains, appends the end record, syncs, closes. The error is the first write that failed.
  Status Finish(const std::string& end_json);

 private:
  Recorder(int file, int joints, const RecorderOptions& options);
  void Run();
  void Drain();
  void Append(uint32_t type, const std::string& payload);
  void Sync();
  void StopThread();

  const int file_, joints_;
  const RecorderOptions options_;
  SpscRing<Sample> ring_;
  std::string scratch_;
  std::atomic<bool> ok_{true};
  std::mutex stop_mutex_;  // between StopThread and Run, never in Record
  std::condition_variable stop_signal_;
  bool stop_ = false;
  Status failure_;  // recorder thread, read after it ended
  std::thread thread_;
};

struct RawRecording {
  std::string metadata_json;
  std::vector<Sample> samples;
  std::optional<std::string> end_json;  // absent: the recorder died
  size_t torn_bytes = 0;                // at the end of the file, unreadable
};

// kDataLoss if not even the metadata can be read.
Result<RawRecording> ReadRawRecording(const std::string& path);

}  // namespace rg::robot_agent
