// Fits of a diagnosis as wire messages, exact to the bit.
#pragma once

#include <vector>

#include "realitygrad/v1/payloads.pb.h"
#include "services/diagnosis/search/fit_requests.h"

namespace rg::jobs {

realitygrad::v1::FitBatch BatchOf(const std::vector<diagnosis::FitRequest>& requests,
                                  const diagnosis::FitData& data);
// Error: an index or a shape that does not fit the recordings.
Result<diagnosis::FitRequest> RequestOf(const realitygrad::v1::FitBatch& batch, uint32_t index,
                                        const diagnosis::FitSetting& setting);

realitygrad::v1::FitReply ReplyOf(const diagnosis::FitResult& fit);
diagnosis::FitResult FitOf(const realitygrad::v1::FitReply& reply);

}  // namespace rg::jobs
