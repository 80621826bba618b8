// Recordings on this disk that the store may not have yet.
//
//   <folder>/active/<id>.rec       being recorded (recorder.h), or left by a crash
//   <folder>/ready/<id>.tar        finished bundles, waiting to be delivered
//
// A bundle becomes ready by one rename, so it is there whole or not at all. It leaves when a delivery
// returned ok. Delivery is at least once: after a crash between the delivery and the removal the same
// id is delivered again with the same bytes; the receiver, which addresses artefacts by their hash and
// answers kAlreadyExists or ok, keeps one. One process uses a folder at a time (a lock file holds that).
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "common/base/status.h"

namespace rg::robot_agent {

class Spool {
 public:
  // Makes the folders and takes the lock. kFailedPrecondition: another process has it.
  static Result<std::unique_ptr<Spool>> Open(const std::string& folder);
  ~Spool();

  const std::string& folder() const { return folder_; }
  std::string ActivePath(const std::string& id) const;
  std::string ReadyPath(const std::string& id) const;

  // The bundle is durable when this returns ok; the active file of that id is removed. Idempotent.
  Status Commit(const std::string& id, const std::string& bundle);

  // Ids, sorted.
  std::vector<std::string> Ready() const;
  std::vector<std::string> Active() const;

  // Called for each ready bundle. kOk or kAlreadyExists: it leaves the spool. kUnavailable: nobody is
  // there to take any, all stay. Anything else: it stays, and Deliver goes on with the next one. Returns
  // how many left.
  using Deliverer = std::function<Status(const std::string& id, const std::string& bundle)>;
  int Deliver(const Deliverer& deliver);
  // The bundle reached its receiver by another way (as the output of a task).
  Status Delivered(const std::string& id);

  // What a dead process left in active/ becomes ready: `finish` makes the bundle of a raw recording
  // file. A file that cannot be read at all is moved to <folder>/broken/. Returns the ids made ready.
  using Finisher = std::function<Result<std::string>(const std::string& path)>;
  std::vector<std::string> Salvage(const Finisher& finish);

 private:
  Spool(std::string folder, int lock) : folder_(std::move(folder)), lock_(lock) {}

  const std::string folder_;
  const int lock_;
};

}  // namespace rg::robot_agent
