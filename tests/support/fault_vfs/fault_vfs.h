// A file layer under SQLite that fails: at a chosen write, or as a power cut does.
//
// Every change SQLite makes to a file (write, truncate, sync) is counted as one operation. What was
// not synced when the power goes may be on the disk or not, in any order, sector by sector; what was
// synced is. Syncs are not passed on to the real disk, so that a cut costs a millisecond.
//
//   FaultVfs vfs;
//   Database::Open({.path = path, .vfs = vfs.name()}, ...);
//   vfs.CutPowerAt(17);            // the 17th operation from now, and all after it, fail
//   ... until vfs.power_is_off(); close the database
//   vfs.LeaveWhatTheDiskHolds(&rng);  // the files are now as a restarted machine finds them
//
// For one database connection at a time, from one thread. Must outlive the connection.
#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "common/base/rng.h"

namespace rg::testing_support {

class FaultVfs {
 public:
  FaultVfs();
  ~FaultVfs();
  FaultVfs(const FaultVfs&) = delete;
  FaultVfs& operator=(const FaultVfs&) = delete;

  const std::string& name() const;
  // Operations so far.
  int64_t operations() const;
  // The nth operation from now (1: the next) fails with an SQLite result code (SQLITE_FULL,
  // SQLITE_IOERR_WRITE, ...), and `count - 1` after it. Then the disk is well again.
  void FailAt(int64_t nth, int code, int64_t count = 1);
  void CutPowerAt(int64_t nth);
  bool power_is_off() const;
  // Rewrites every file seen: synced content, and of each unsynced 512-byte sector the old or the new
  // one by a coin of `rng`. Power is on again.
  void LeaveWhatTheDiskHolds(Rng* rng);

  struct Impl;

 private:
  std::unique_ptr<Impl> impl_;
};

}  // namespace rg::testing_support
