#include "coordinator/web/web_server.h"

#include <sys/socket.h>

#include <CLI/CLI.hpp>
#include <atomic>
#include <charconv>
#include <nlohmann/json.hpp>
#include <thread>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/log.h"
#include "coordinator/web/assets.h"
#include "coordinator/web/feed.h"
#include "coordinator/web/feed_json.h"
#include "coordinator/web/gate.h"
#include "coordinator/web/http_door.h"
#include "coordinator/web/metrics.h"

namespace rg::coordinator::web {
namespace {

constexpr char kDefaultAddress[] = "127.0.0.1:7342";

constexpr char kPagePolicy[] =
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "connect-src 'self'; frame-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'";
// What a worker wrote runs in a world of its own: it reads nothing of the page and reaches no network.
constexpr char kFilePolicy[] =
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data:; "
    "font-src data:; frame-ancestors 'self'";

constexpr char kLogin[] =
    "<!doctype html><meta charset=utf-8><meta name=viewport content=\"width=device-width, initial-scale=1\">"
    "<meta name=color-scheme content=\"light dark\"><title>RealityGrad</title>"
    "<body style=\"font:16px system-ui,sans-serif;max-width:28em;margin:12vh auto;padding:0 "
    "1em\"><h1>RealityGrad</h1>"
    "<form method=post action=/login><p><label>The coordinator's token (--web-token names its file)<br>"
    "<input name=token type=password autocomplete=current-password autofocus "
    "style=\"font:inherit;width:100%\">"
    "</label></p><p><button style=\"font:inherit\">Look</button></p></form>";

int CodeOf(const Status& status) {
  switch (status.code()) {
    case StatusCode::kInvalid:
      return 400;
    case StatusCode::kNotFound:
      return 404;
    case StatusCode::kResourceExhausted:
      return 413;
    case StatusCode::kUnavailable:
    case StatusCode::kDeadlineExceeded:
      return 503;
    default:
      return 500;
  }
}

void GiveError(const Status& status, httplib::Response& response) {
  response.status = CodeOf(status);
  response.set_content(Dump({{"error", status.message()}}), "application/json");
}

// A whole number of the query; `otherwise` where there is none.
Result<int64_t> Whole(const httplib::Request& request, const char* name, int64_t otherwise) {
  if (!request.has_param(name)) return otherwise;
  const std::string text = request.get_param_value(name);
  int64_t value = 0;
  const auto [rest, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (error != std::errc() || rest != text.data() + text.size() || value < 0)
    return InvalidError(std::string(name) + " must be a whole number");
  return value;
}

std::string Word(const httplib::Request& request, const char* name) {
  return request.has_param(name) ? request.get_param_value(name) : "";
}

Credentials CredentialsOf(const httplib::Request& request) {
  return {request.get_header_value("Host"), request.get_header_value("Authorization"),
          request.get_header_value("Cookie")};
}

}  // namespace

std::string EndpointFromHere(const std::string& endpoint) {
  for (const char* any : {"tcp://0.0.0.0:", "tcp://*:", "tcp://[::]:"}) {
    if (endpoint.rfind(any, 0) == 0)
      return "tcp://127.0.0.1:" + endpoint.substr(std::string_view(any).size());
  }
  return endpoint;
}

ClientOptions ViewerOf(const std::string& endpoint, const std::optional<transport::KeyPair>& key,
                       const std::string& server_key) {
  ClientOptions options;
  options.address = EndpointFromHere(endpoint);
  options.key = key;
  options.server_public_key = server_key;
  options.read_only = true;
  options.name = "web-page";
  options.connect_timeout_ms = 3'000;
  options.attempt_timeout_ms = 3'000;
  options.attempts = 1;
  return options;
}

void AddWebFlags(CLI::App& app, WebFlags& flags) {
  app.add_option(
         "--web", flags.listen,
         "ADDRESS:PORT of the web page, /metrics and /healthz, or off (default: 127.0.0.1:7342 where it "
         "listens on tcp); an address that others reach needs --web-token")
      ->envname("REALITYGRAD_WEB")
      ->group("Web page");
  app.add_option("--web-token", flags.token_path,
                 "file with the token that the page asks for; made if it is not there")
      ->envname("REALITYGRAD_WEB_TOKEN")
      ->group("Web page");
  app.add_option("--web-address-file", flags.address_file, "where to write the page's URL as it was bound")
      ->group("Web page");
}

struct WebServer::Impl {
  Impl(ListenAddress address, std::string token, ClientOptions viewer,
       std::function<std::string()> more_status)
      : address(address),
        gate(address, std::move(token)),
        feed(std::move(viewer), &RealClock(), std::move(more_status)) {}

  // A GET whose answer is a JSON value of the feed.
  template <class Ask>
  void Serve(const char* path, const Ask& ask) {
    http.Get(path, [ask](const httplib::Request& request, httplib::Response& response) {
      const Result<std::string> answer = ask(request);
      if (!answer.ok()) return GiveError(answer.status(), response);
      response.set_content(*answer, "application/json");
    });
  }

  void SetUp();
  void AddApi();
  void AddFiles();
  void AddProbes();
  httplib::Server::HandlerResponse Admit(const httplib::Request& request, httplib::Response& response);

  ListenAddress address;
  Gate gate;
  Feed feed;
  HttpDoor http;
  std::thread thread;
  std::atomic<bool> over = false;
  int port = 0;
  std::string address_file;
};

httplib::Server::HandlerResponse WebServer::Impl::Admit(const httplib::Request& request,
                                                        httplib::Response& response) {
  using Handled = httplib::Server::HandlerResponse;
  response.set_header("X-Content-Type-Options", "nosniff");
  response.set_header("Referrer-Policy", "no-referrer");
  response.set_header("Cache-Control", "no-store");
  if (request.path == "/healthz" || request.path == "/readyz") return Handled::Unhandled;
  // What is not a question is refused by its own handler, which has read it to its end before.
  if (request.method != "GET" && request.method != "HEAD") return Handled::Unhandled;
  if (gate.Admits(CredentialsOf(request))) return Handled::Unhandled;
  response.status = gate.needs_token() ? 401 : 403;
  if (response.status == 401) response.set_header("WWW-Authenticate", "Bearer");
  const bool wants_page = gate.needs_token() && request.path == "/";
  response.set_header("Content-Security-Policy", kPagePolicy);
  response.set_content(wants_page ? kLogin : "a token is needed, or this name is not this machine's\n",
                       wants_page ? "text/html; charset=utf-8" : "text/plain");
  return Handled::Handled;
}

void WebServer::Impl::AddApi() {
  using Request = httplib::Request;
  Serve("/api/status", [this](const Request&) { return feed.Status(); });
  Serve("/api/jobs", [this](const Request& r) -> Result<std::string> {
    RG_ASSIGN_OR_RETURN(const int64_t of, Whole(r, "of", 0));
    RG_ASSIGN_OR_RETURN(const int64_t before, Whole(r, "before", 0));
    return feed.Jobs(Word(r, "state"), of, before);
  });
  Serve("/api/job", [this](const Request& r) -> Result<std::string> {
    RG_ASSIGN_OR_RETURN(const int64_t id, Whole(r, "id", 0));
    return feed.Job(id);
  });
  Serve("/api/logs", [this](const Request& r) -> Result<std::string> {
    RG_ASSIGN_OR_RETURN(const int64_t job, Whole(r, "job", 0));
    RG_ASSIGN_OR_RETURN(const int64_t after, Whole(r, "after", 0));
    return feed.Logs(job, static_cast<uint64_t>(after));
  });
  Serve("/api/events", [this](const Request& r) -> Result<std::string> {
    RG_ASSIGN_OR_RETURN(const int64_t job, Whole(r, "job", 0));
    return feed.Events(job);
  });
  Serve("/api/workers", [this](const Request&) { return feed.Workers(); });
  Serve("/api/robots", [this](const Request&) { return feed.Robots(); });
  Serve("/api/history", [this](const Request& r) { return feed.History(Word(r, "robot")); });
  Serve("/api/values", [this](const Request& r) { return feed.Values(Word(r, "robot")); });
  Serve("/api/diagnoses", [this](const Request&) { return feed.Diagnoses(); });
  Serve("/api/artifacts", [this](const Request& r) { return feed.Artifacts(Word(r, "kind")); });
  Serve("/api/artifact", [this](const Request& r) { return feed.Artifact(Word(r, "sha256")); });
  // For KEDA's scaler "metrics-api".
  Serve("/api/demand", [this](const Request&) -> Result<std::string> {
    RG_ASSIGN_OR_RETURN(const auto status, feed.CoordinatorStatus());
    return Dump({{"slots_wanted", SlotsWanted(status)}});
  });
}

void WebServer::Impl::AddFiles() {
  http.Get(
      R"(/artifact/([0-9a-f]{6,64}))", [this](const httplib::Request& request, httplib::Response& response) {
        const auto file = feed.Bytes(request.matches[1]);
        if (!file.ok()) return GiveError(file.status(), response);
        response.set_header("Content-Security-Policy", kFilePolicy);
        const bool is_page = file->kind == "report" && file->bytes.rfind("<!doctype html", 0) == 0;
        const bool is_json = !is_page && (file->bytes.rfind('{', 0) == 0 || file->bytes.rfind('[', 0) == 0) &&
                             nlohmann::json::accept(file->bytes);
        if (!is_page && !is_json)
          response.set_header("Content-Disposition",
                              "attachment; filename=\"" + request.matches[1].str().substr(0, 12) + "\"");
        response.set_content(file->bytes, is_page   ? "text/html; charset=utf-8"
                                          : is_json ? "application/json"
                                                    : "application/octet-stream");
      });
  if (gate.needs_token()) {
    http.Post("/login", [this](const httplib::Request& request, httplib::Response& response) {
      if (gate.IsToken(Word(request, "token"))) response.set_header("Set-Cookie", gate.Cookie());
      response.set_redirect("/", 303);
    });
  }
  const auto refuse = [](const httplib::Request&, httplib::Response& response) {
    response.status = 405;
    response.set_content("the page only reads\n", "text/plain");
  };
  http.Post(".*", refuse).Put(".*", refuse).Patch(".*", refuse).Delete(".*", refuse).Options(".*", refuse);
  http.Get("/[a-z_]*\\.?[a-z]*", [](const httplib::Request& request, httplib::Response& response) {
    const Asset* asset = FindAsset(request.path);
    if (asset == nullptr)
      return response.status = 404, response.set_content("there is no such page\n", "text/plain");
    response.set_header("Content-Security-Policy", kPagePolicy);
    response.set_content(asset->bytes.data(), asset->bytes.size(), std::string(asset->type).c_str());
  });
}

void WebServer::Impl::AddProbes() {
  http.Get("/metrics", [this](const httplib::Request&, httplib::Response& response) {
    const auto status = feed.CoordinatorStatus();
    if (!status.ok()) return GiveError(status.status(), response);
    const auto workers = feed.WorkerInfos();
    if (!workers.ok()) return GiveError(workers.status(), response);
    const double uptime_s = 1e-9 * static_cast<double>(RealClock().WallNanos() - status->started_ns());
    response.set_content(MetricsText(*status, uptime_s, feed.MoreStatus(), *workers),
                         "text/plain; version=0.0.4; charset=utf-8");
  });
  // Whether all is well, and whether it answers: on a full disk only the first is not so.
  for (const bool is_ready : {false, true}) {
    http.Get(is_ready ? "/readyz" : "/healthz", [this, is_ready](const httplib::Request&, httplib::Response& response) {
      const auto status = feed.CoordinatorStatus();
      const std::string trouble = status.ok() ? status->trouble() : "the coordinator does not answer";
      response.status = trouble.empty() || (is_ready && status.ok()) ? 200 : 503;
      response.set_content((trouble.empty() ? "ok" : trouble) + "\n", "text/plain");
    });
  }
}

void WebServer::Impl::SetUp() {
  // Not the library's own options: with SO_REUSEPORT two coordinators would share a port without a word.
  http.set_socket_options([](int socket) {
    const int yes = 1;
    setsockopt(socket, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
  });
  constexpr size_t kMaxBodyBytes = 4096;
  http.set_payload_max_length(kMaxBodyBytes);
  http.set_pre_routing_handler(
      [this](const auto& request, auto& response) { return Admit(request, response); });
  http.set_exception_handler([](const auto&, httplib::Response& response, std::exception_ptr) {
    response.status = 500;
    response.set_content("this request broke something\n", "text/plain");
  });
  AddProbes();
  AddApi();
  AddFiles();
}

Result<std::unique_ptr<WebServer>> WebServer::Bind(const WebFlags& flags, const ClientOptions& viewer,
                                                   std::function<std::string()> more_status) {
  const bool by_default = flags.listen.empty();
  if (flags.listen == "off" || (by_default && viewer.address.rfind("tcp://", 0) != 0))
    return std::unique_ptr<WebServer>();
  RG_ASSIGN_OR_RETURN(const ListenAddress address,
                      ParseListenAddress(by_default ? kDefaultAddress : flags.listen));
  if (!address.loopback && flags.token_path.empty())
    return InvalidError("--web " + flags.listen +
                        ": others reach this address; --web-token FILE says who may look");
  std::string token;
  if (!flags.token_path.empty()) {
    RG_ASSIGN_OR_RETURN(token, LoadOrMakeToken(flags.token_path));
  }
  auto impl = std::make_unique<Impl>(address, std::move(token), viewer, std::move(more_status));
  impl->SetUp();
  impl->port = address.port == 0 ? impl->http.bind_to_any_port(address.host)
               : impl->http.bind_to_port(address.host, address.port) ? address.port
                                                                     : -1;
  if (impl->port <= 0) {
    const std::string what =
        "--web: the web page cannot listen on " + address.host + ":" + std::to_string(address.port);
    if (!by_default) return UnavailableError(what);
    spdlog::warn("{}; it is left out (--web chooses another)", what);
    return std::unique_ptr<WebServer>();
  }
  impl->address_file = flags.address_file;
  return std::unique_ptr<WebServer>(new WebServer(std::move(impl)));
}

Status WebServer::Start() {
  impl_->thread =
      std::thread([server = impl_.get()] { server->http.listen_after_bind(), server->over = true; });
  if (!impl_->address_file.empty())
    RG_RETURN_IF_ERROR(WriteFileAtomically(impl_->address_file, url() + "\n"));
  spdlog::info("web page at {}", url());
  return Status::Ok();
}

WebServer::WebServer(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}

WebServer::~WebServer() {
  if (!impl_->thread.joinable()) return;
  // stop() only works once the loop has begun.
  while (!impl_->http.is_running() && !impl_->over) std::this_thread::yield();
  impl_->http.stop();
  impl_->thread.join();
}

std::string WebServer::url() const {
  const bool v6 = impl_->address.host.find(':') != std::string::npos;
  return "http://" + (v6 ? "[" + impl_->address.host + "]" : impl_->address.host) + ":" +
         std::to_string(impl_->port);
}

}  // namespace rg::coordinator::web
