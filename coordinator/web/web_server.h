// The web page of a coordinator: read-only, over HTTP, from threads of its own. It knows no more than a
// viewer: what it shows comes over the coordinator's own socket (feed.h), so that nothing it does holds up
// the coordinator's thread. Also /metrics (Prometheus), /healthz, /readyz, and /api/demand for scalers.
#pragma once

#include <functional>
#include <memory>
#include <string>

#include "common/base/status.h"
#include "common/transport/keys.h"
#include "coordinator/client/client.h"

namespace CLI {
class App;
}

namespace rg::coordinator::web {

struct WebFlags {
  std::string listen = kDefault;  // ADDRESS:PORT, or "off"
  std::string token_path, address_file;
  // Where the coordinator listens on tcp: on 127.0.0.1:7342, if nobody else does.
  static constexpr char kDefault[] = "";
};

void AddWebFlags(CLI::App& app, WebFlags& flags);

class WebServer {
 public:
  // Takes its address; answers nobody yet. Null if the flags want none. `viewer`: how it asks the coordinator
  // (ViewerOf). `more_status`: what else the status shows, a JSON object. kInvalid: the flags make no sense (an
  // address that others reach, without a token); kUnavailable: the address is not to be had.
  static Result<std::unique_ptr<WebServer>> Bind(const WebFlags& flags, const ClientOptions& viewer,
                                                 std::function<std::string()> more_status = {});
  // From now on it answers. Once.
  Status Start();
  ~WebServer();  // answers what is under way, then stops

  std::string url() const;

 private:
  struct Impl;
  explicit WebServer(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

// For what stands beside the coordinator that listens on `endpoint`. `key` and `server_key`: a viewer's key
// for an encrypted endpoint, and the coordinator's public one; none without.
ClientOptions ViewerOf(const std::string& endpoint, const std::optional<transport::KeyPair>& key,
                       const std::string& server_key);

// Where this machine reaches what listens on `endpoint`: tcp://0.0.0.0:7341 -> tcp://127.0.0.1:7341.
std::string EndpointFromHere(const std::string& endpoint);

}  // namespace rg::coordinator::web
