#include "tests/support/browser/browser.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <thread>

#include "common/base/check.h"
#include "common/base/clock.h"

namespace rg::testing {
namespace {

using nlohmann::json;
constexpr int kPatienceMs = 60'000;

std::string FromBase64(const std::string& text) {
  const std::string alphabet = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  uint32_t bits = 0;
  int count = 0;
  for (const char c : text) {
    const size_t value = alphabet.find(c);
    if (value == std::string::npos) break;
    bits = bits << 6 | static_cast<uint32_t>(value);
    count += 6;
    if (count >= 8) out.push_back(static_cast<char>(bits >> (count -= 8) & 0xFF));
  }
  return out;
}

}  // namespace

std::string Browser::Program() {
  for (const char* path : {"/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"}) {
    if (access(path, X_OK) == 0) return path;
  }
  return {};
}

Browser::Browser(const std::string& folder) {
  int to[2], from[2];
  RG_CHECK(pipe2(to, O_CLOEXEC) == 0 && pipe2(from, O_CLOEXEC) == 0) << "pipe";
  const std::string program = Program(), profile = "--user-data-dir=" + folder + "/profile";
  const std::string log = folder + "/chromium.log";
  pid_ = fork();
  RG_CHECK(pid_ >= 0) << "fork";
  if (pid_ == 0) {
    setpgid(0, 0);
    const int read_end = fcntl(to[0], F_DUPFD, 10), write_end = fcntl(from[1], F_DUPFD, 10);
    dup2(read_end, 3), dup2(write_end, 4);  // where it looks for the pipe
    const int file = open(log.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0644);
    dup2(file, STDOUT_FILENO), dup2(file, STDERR_FILENO);
    execl(program.c_str(), program.c_str(), "--headless=new", "--no-sandbox", "--disable-gpu",
          "--disable-dev-shm-usage", "--remote-debugging-pipe", "--no-first-run",
          "--disable-background-networking", "--disable-extensions", "--disable-component-update",
          "--mute-audio", "--hide-scrollbars", profile.c_str(), "about:blank", static_cast<char*>(nullptr));
    _exit(127);
  }
  close(to[0]), close(from[1]);
  to_ = to[1], from_ = from[0];
  const json target = Call("Target.createTarget", {{"url", "about:blank"}}, false);
  session_ = Call("Target.attachToTarget", {{"targetId", target["targetId"]}, {"flatten", true}},
                  false)["sessionId"];
  for (const char* domain : {"Page.enable", "Runtime.enable", "Log.enable"}) Call(domain, json::object());
}

Browser::~Browser() {
  close(to_), close(from_);
  kill(-pid_, SIGKILL);
  waitpid(pid_, nullptr, 0);
}

json Browser::Receive() {
  while (true) {
    const size_t end = buffer_.find('\0');
    if (end != std::string::npos) {
      const std::string text = buffer_.substr(0, end);
      buffer_.erase(0, end + 1);
      return json::parse(text);
    }
    pollfd ready = {from_, POLLIN, 0};
    RG_CHECK(poll(&ready, 1, kPatienceMs) > 0) << "the browser says nothing";
    char piece[65536];
    const ssize_t n = read(from_, piece, sizeof piece);
    RG_CHECK(n > 0) << "the browser is gone";
    buffer_.append(piece, static_cast<size_t>(n));
  }
}

void Browser::Note(const json& event) {
  const std::string method = event.value("method", "");
  const json& p = event.contains("params") ? event["params"] : event;
  if (method == "Runtime.exceptionThrown") complaints_.push_back(p["exceptionDetails"].dump());
  if (method == "Runtime.consoleAPICalled" && p["type"] == "error") complaints_.push_back(p["args"].dump());
  if (method == "Log.entryAdded" && p["entry"]["level"] == "error") complaints_.push_back(p["entry"].dump());
}

json Browser::Call(const std::string& method, json parameters, bool of_page) {
  json request = {{"id", ++last_}, {"method", method}, {"params", std::move(parameters)}};
  if (of_page) request["sessionId"] = session_;
  const std::string text = request.dump() + '\0';
  RG_CHECK(write(to_, text.data(), text.size()) == static_cast<ssize_t>(text.size()))
      << "the browser is gone";
  while (true) {
    const json message = Receive();
    if (message.value("id", 0) == last_) {
      RG_CHECK(message.contains("result")) << method + ": " + message.dump();
      return message["result"];
    }
    Note(message);
  }
}

void Browser::SetScreen(int width, int height, bool dark) {
  Call("Emulation.setDeviceMetricsOverride",
       {{"width", width}, {"height", height}, {"deviceScaleFactor", 1}, {"mobile", width < 600}});
  Call("Emulation.setEmulatedMedia",
       {{"features", json::array({{{"name", "prefers-color-scheme"}, {"value", dark ? "dark" : "light"}}})}});
}

void Browser::Open(const std::string& url) { Call("Page.navigate", {{"url", url}}); }

json Browser::Evaluate(const std::string& expression) {
  const json reply =
      Call("Runtime.evaluate", {{"expression", expression}, {"returnByValue", true}, {"awaitPromise", true}});
  if (reply.contains("exceptionDetails") || !reply["result"].contains("value")) return nullptr;
  return reply["result"]["value"];
}

bool Browser::WaitFor(const std::string& expression, double timeout_s) {
  const double end = RealClock().SteadySeconds() + timeout_s;
  while (Evaluate("!!(" + expression + ")") != true) {
    if (RealClock().SteadySeconds() > end) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }
  return true;
}

std::string Browser::Text(const std::string& selector) {
  const json text = Evaluate("(document.querySelector(" + json(selector).dump() + ")||{}).innerText");
  return text.is_string() ? text.get<std::string>() : "";
}

void Browser::Screenshot(const std::string& path) {
  const std::string data = Call("Page.captureScreenshot", {{"format", "png"}})["data"];
  std::ofstream(path, std::ios::binary) << FromBase64(data);
}

}  // namespace rg::testing
