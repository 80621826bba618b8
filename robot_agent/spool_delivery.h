// The way of recordings from the spool to the store, beside the tasks that made them: what a crash or an
// absent coordinator left behind. Delivered at least once, kept once (the store addresses by hash).
#pragma once

#include <functional>
#include <string>

#include "common/base/status.h"

namespace rg::robot_agent {

class Spool;

// Makes bundles of what a dead process left in the spool; how many.
int SalvageRecordings(Spool& spool);

// Finishes what a dead process left, unless a rollout is running, and hands every bundle that waits to
// `deliver` with its metadata, the oldest first. Returns how many were taken; kFailedPrecondition: somebody
// else delivers.
using BundleDeliverer =
    std::function<Status(const std::string& id, const std::string& bundle, const std::string& metadata_json)>;
Result<int> DeliverSpool(const std::string& spool_folder, const BundleDeliverer& deliver,
                         double least_age_s = 0.0);

}  // namespace rg::robot_agent
