// What an endpoint's address allows. Internal.
#pragma once

#include <string>

#include "common/base/status.h"

namespace rg::transport {

enum class EndpointKind {
  kLocal,     // ipc, inproc: guarded by the file system or the process
  kLoopback,  // tcp on this host only
  kPublic,    // tcp that other hosts may reach
};

// kInvalid: not tcp://address:port, ipc://path or inproc://name.
Result<EndpointKind> ClassifyEndpoint(const std::string& endpoint);
// Refuses an unencrypted socket anywhere but on local endpoints (and loopback, where allowed).
Status CheckEncryption(const std::string& endpoint, bool encrypted, bool allow_plain_loopback);
// For binding ipc://path: makes the folder, and refuses a path that another process listens on
// (libzmq would take it over silently).
Status PrepareIpcPath(const std::string& endpoint);

}  // namespace rg::transport
