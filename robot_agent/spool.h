// Recordings on this disk, and which rollouts have begun.
//
//   <folder>/begun.txt             one line per rollout that began, before its first torque; never forgotten. One
//                                  that then did not begin has a second line
//   <folder>/active/<id>.rec       being recorded (recorder.h), or left by a crash
//   <folder>/ready/<id>.tar        finished bundles, waiting to be delivered; <id>+not-begun-<k> of attempts that came
//                                  to nothing
//   <folder>/sent/<id>.tar         delivered ones, the newest few, for a task that asks for its result again
//
// A bundle becomes ready by one rename, so it is there whole or not at all. It leaves when a delivery
// returned ok. Delivery is at least once: after a crash between the delivery and the removal the same
// id is delivered again with the same bytes; the receiver, which addresses artefacts by their hash and
// answers kAlreadyExists or ok, keeps one. One process at a time runs rollouts (a lock file holds that), one
// at a time delivers (another): a delivery never keeps a rollout waiting.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "common/base/status.h"

namespace rg::robot_agent {

// Where recordings are unless a flag says otherwise: in the user's state folder, whatever the working directory.
std::string DefaultSpoolFolder();

class Spool {
 public:
  // Makes the folders and takes the lock of those who run rollouts. kFailedPrecondition: another process has
  // it, and kept it for wait_s.
  static Result<std::unique_ptr<Spool>> Open(const std::string& folder, double wait_s = 0.0);
  // The same for delivering: Deliver, Ready, Delivered.
  static Result<std::unique_ptr<Spool>> OpenToDeliver(const std::string& folder);
  ~Spool();

  const std::string& folder() const { return folder_; }
  std::string ActivePath(const std::string& id) const;
  std::string ReadyPath(const std::string& id) const;

  // The bundle is durable when this returns ok; the active file of that id is removed. Idempotent.
  Status Commit(const std::string& id, const std::string& bundle);

  // At most once: durable when it returns ok, and only then may the rollout begin.
  Status MarkBegun(const std::string& id, const std::string& now);
  // It was marked, and the process that marked it knows that the arm got no torque of it: the recording of the attempt
  // becomes ready under a name of its own, and the rollout may begin later. Where this cannot be written it counts as
  // begun.
  Status CommitNotBegun(const std::string& id, const std::string& bundle);
  // The line of a rollout that has begun, at any time and in any process.
  std::optional<std::string> Begun(const std::string& id) const;
  // Where a finished bundle is, delivered or not.
  std::optional<std::string> FinishedPath(const std::string& id) const;
  // kResourceExhausted with what there is and what to do, if the disk has less than this left.
  Status CheckRoom(double megabytes) const;

  // Ids, sorted.
  std::vector<std::string> Ready() const;
  std::vector<std::string> Active() const;

  // Called for each ready bundle, the oldest first. kOk or kAlreadyExists: it leaves the spool. kUnavailable:
  // nobody is there to take any, all stay. Anything else: it stays, and Deliver goes on with the next one.
  // Returns how many left.
  using Deliverer = std::function<Status(const std::string& id, const std::string& bundle)>;
  int Deliver(const Deliverer& deliver, double least_age_s = 0.0);
  // The bundle has reached its receiver: it goes to sent/, of which the newest kKeptSent stay.
  static constexpr size_t kKeptSent = 32;
  Status Delivered(const std::string& id);

  // What a dead process left in active/ becomes ready: `finish` makes the bundle of a raw recording
  // file. A file that cannot be read at all is moved to <folder>/broken/. Returns the ids made ready.
  using Finisher = std::function<Result<std::string>(const std::string& path)>;
  std::vector<std::string> Salvage(const Finisher& finish);

 private:
  Status AppendToBegun(const std::string& text) const;
  static Result<std::unique_ptr<Spool>> OpenWith(const std::string& folder, const char* lock_name,
                                                 double wait_s);
  void PruneSent() const;
  Spool(std::string folder, int lock) : folder_(std::move(folder)), lock_(lock) {}

  const std::string folder_;
  const int lock_;
};

}  // namespace rg::robot_agent
