// Messages as a hostile or broken peer might send them, from a seed.
#pragma once

#include <string>

#include "common/base/rng.h"
#include "common/transport/envelope.h"
#include "google/protobuf/message.h"

namespace rg::testing {

// Half of the fields, with values that may make sense, or not.
void Fill(google::protobuf::Message* message, Rng& rng, int depth);

// Some bytes changed, left out or put in; the end cut off.
std::string Mutate(std::string bytes, Rng& rng);

// Any request or a worker's message, with fields that may make sense, or not; now and then its bytes are
// mutated, its type is unknown, another role is claimed, or it has an attachment, rarely one of 2 MiB.
transport::Message HostileMessage(transport::pb::Role role, Rng& rng);

}  // namespace rg::testing
