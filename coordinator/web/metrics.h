// The coordinator's state for Prometheus, in its text format.
#pragma once

#include <string>
#include <vector>

#include "realitygrad/v1/control.pb.h"

namespace rg::coordinator::web {

// Slots that tasks of ordinary workers fill or would fill: ready or running, without what needs a robot or a
// tag. The one figure by which workers are added and taken away (KEDA, Slurm).
uint64_t SlotsWanted(const realitygrad::v1::StatusReply& status);

// `more_status`: as the page's status has it ({"autoscale": {…}}), or empty.
std::string MetricsText(const realitygrad::v1::StatusReply& status, double uptime_s,
                        const std::string& more_status = {}, const std::vector<realitygrad::v1::WorkerInfo>& workers = {});

}  // namespace rg::coordinator::web
