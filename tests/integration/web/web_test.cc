// The coordinator's web page: over real HTTP, and as a browser shows it.
#include <gtest/gtest.h>
#include <arpa/inet.h>
#include <httplib.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <thread>

#include "common/base/clock.h"
#include "common/base/file.h"
#include "common/base/ids.h"
#include "common/transport/keys.h"
#include "tests/support/browser/browser.h"
#include "tests/support/service/processes.h"

namespace rg::testing {
namespace {

using nlohmann::json;
constexpr double kPatience = 60.0;

std::string NewFolder() {
  const std::string folder = "/tmp/rg-web-" + RandomHex(6);
  std::filesystem::create_directories(folder);
  return folder;
}

// A service whose page listens on a free port.
class WebPage : public ::testing::Test {
 protected:
  explicit WebPage(const std::string& listen = "127.0.0.1:0", std::vector<std::string> more = {})
      : folder_(NewFolder()), service_(400, Flags(listen, std::move(more))) {}
  ~WebPage() override { std::filesystem::remove_all(folder_); }

  std::vector<std::string> Flags(const std::string& listen, std::vector<std::string> more) {
    for (std::string& word : more) {
      if (word == "TOKEN") word = folder_ + "/token";
    }
    more.insert(more.end(), {"--web", listen, "--web-address-file", folder_ + "/url"});
    return more;
  }
  int port() const {
    const std::string url = *ReadFile(folder_ + "/url");
    return std::stoi(url.substr(url.rfind(':') + 1));
  }
  std::string url() const { return "http://127.0.0.1:" + std::to_string(port()); }
  httplib::Client Http() const {
    httplib::Client http("127.0.0.1", port());
    http.set_read_timeout(30);
    return http;
  }
  json Ask(const std::string& path) {
    auto reply = Http().Get(path.c_str());
    EXPECT_TRUE(reply && reply->status == 200) << path << ": " << (reply ? reply->body : "no reply");
    return reply ? json::parse(reply->body, nullptr, false) : json();
  }
  int64_t Submit(const std::string& name, int tasks, double seconds) {
    pb::JobSpec job;
    job.set_kind("iteration");
    job.set_name(name);
    for (int i = 0; i < tasks; ++i)
      AddTask(&job, "shard-" + std::to_string(i), "sleep", json{{"seconds", seconds}}.dump())
          ->set_stage("trajectories");
    AddTask(&job, "policy", "echo", R"({"text": "x"})")->add_after("shard-0");
    return *service_.client().Submit(job);
  }

  const std::string folder_;
  Service service_;
};

TEST_F(WebPage, ItsFilesAreServedAndNeedNothingFromElsewhere) {
  auto http = Http();
  const auto page = http.Get("/");
  ASSERT_TRUE(page);
  EXPECT_EQ(page->status, 200);
  EXPECT_NE(page->get_header_value("Content-Security-Policy").find("default-src 'none'"), std::string::npos);
  EXPECT_EQ(page->body.find("http://"), page->body.find("http://www.w3.org/2000/svg")) << "only a name space";
  EXPECT_EQ(page->body.find("https://"), std::string::npos);
  for (const char* file :
       {"/app.js", "/views.js", "/results.js", "/plots.js", "/style.css", "/dygraph.js", "/dygraph.css"}) {
    const auto reply = http.Get(file);
    ASSERT_TRUE(reply) << file;
    EXPECT_EQ(reply->status, 200) << file;
    EXPECT_GT(reply->body.size(), 400u) << file;
  }
  EXPECT_EQ(http.Get("/nothing.js")->status, 404);
  EXPECT_EQ(http.Get("/../../etc/passwd")->status, 404);
}

TEST_F(WebPage, ItOnlyReads) {
  auto http = Http();
  for (const char* path : {"/", "/api/jobs", "/login"}) {
    EXPECT_EQ(http.Post(path, "x", "text/plain")->status, 405) << path;
    EXPECT_EQ(http.Delete(path)->status, 405) << path;
  }
}

TEST_F(WebPage, WrongQuestionsAreRefusedInWords) {
  auto http = Http();
  EXPECT_EQ(http.Get("/api/job?id=99")->status, 404);
  EXPECT_EQ(http.Get("/api/job?id=-1")->status, 400);
  EXPECT_EQ(http.Get("/api/job?id=1x")->status, 400);
  EXPECT_EQ(http.Get("/api/jobs?state=asleep")->status, 400);
  EXPECT_EQ(http.Get("/api/artifact?sha256=zz")->status, 400);
  EXPECT_EQ(http.Get("/artifact/abcdef0123")->status, 404);
  EXPECT_NE(json::parse(http.Get("/api/job?id=99")->body)["error"].get<std::string>().find("99"),
            std::string::npos);
}

TEST_F(WebPage, ANameThatOnlyResolvesToThisMachineIsRefused) {
  auto http = Http();
  EXPECT_EQ(http.Get("/api/jobs", {{"Host", "evil.example:80"}})->status, 403);
  EXPECT_EQ(http.Get("/api/jobs", {{"Host", "127.evil.com"}})->status, 403);
  EXPECT_EQ(http.Get("/api/jobs", {{"Host", "localhost"}})->status, 200);
}

TEST_F(WebPage, MetricsTellTheDemand) {
  Submit("many", 3, 0.0);
  auto http = Http();
  EXPECT_EQ(http.Get("/healthz")->body, "ok\n");
  const std::string metrics = http.Get("/metrics")->body;
  for (const char* line :
       {"# TYPE realitygrad_worker_slots_wanted gauge", "\nrealitygrad_worker_slots_wanted 3\n",
        "\nrealitygrad_tasks_ready 3\n", "\nrealitygrad_tasks_waiting 1\n", "\nrealitygrad_workers 0\n",
        "realitygrad_demand_tasks_ready{kind=\"sleep\",tags=\"\"} 3\n",
        "\nrealitygrad_jobs_submitted_total 1\n"}) {
    EXPECT_NE(metrics.find(line), std::string::npos) << line << "\n" << metrics;
  }
  EXPECT_EQ(Ask("/api/demand")["slots_wanted"], 3);
}

// Connections that send a byte now and then, and what they heard in the end.
class SlowClients {
 public:
  SlowClients(int port, int count) {
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_port = htons(static_cast<uint16_t>(port));
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    for (int i = 0; i < count; ++i) {
      sockets_.push_back(socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
      EXPECT_EQ(connect(sockets_.back(), reinterpret_cast<sockaddr*>(&to), sizeof to), 0);
    }
    writer_ = std::thread([this] {
      for (size_t at = 0; !stop_; ++at) {
        const char byte = at < 4 ? "GET "[at] : 'x';
        for (const int s : sockets_) [[maybe_unused]] const ssize_t sent = send(s, &byte, 1, MSG_NOSIGNAL);
        std::this_thread::sleep_for(std::chrono::milliseconds(200));
      }
    });
  }
  ~SlowClients() {
    stop_ = true;
    writer_.join();
    for (const int s : sockets_) close(s);
  }
  // Waits for it.
  std::string Heard(size_t client) {
    std::string heard(100, 0);
    const ssize_t n = recv(sockets_[client], heard.data(), heard.size(), 0);
    heard.resize(n > 0 ? static_cast<size_t>(n) : 0);
    return heard;
  }

 private:
  std::vector<int> sockets_;
  std::atomic<bool> stop_ = false;
  std::thread writer_;
};

TEST_F(WebPage, SlowClientsHoldUpNobodyAndAreShownOut) {
  SlowClients slow(port(), 60);
  for (const char* path : {"/healthz", "/readyz", "/metrics", "/", "/api/jobs"}) {
    const auto reply = Http().Get(path);
    ASSERT_TRUE(reply) << path;
    EXPECT_EQ(reply->status, 200) << path;
  }
  EXPECT_EQ(slow.Heard(59).rfind("HTTP/1.1 408", 0), 0u) << "a byte now and then is no request";
}

TEST_F(WebPage, TheOldestOfTooManyThatHaveNotAskedYetGoes) {
  SlowClients slow(port(), 100);
  EXPECT_EQ(slow.Heard(0).rfind("HTTP/1.1 408", 0), 0u);
  EXPECT_EQ(Http().Get("/healthz")->status, 200);
}

// However many look: the coordinator hears a few questions a second.
TEST_F(WebPage, ManyReadersAreFewQuestions) {
  Submit("many", 20, 0.0);
  const double before = service_.Counter("messages_received_total"), start = RealClock().SteadySeconds();
  std::atomic<int> answered = 0;
  std::vector<std::thread> readers;
  for (int i = 0; i < 8; ++i) {
    readers.emplace_back([&] {
      for (int n = 0; n < 40; ++n) {
        for (const char* path : {"/api/jobs", "/api/job?id=1", "/api/status", "/healthz"}) {
          const auto reply = Http().Get(path);
          answered += reply && reply->status == 200;
        }
      }
    });
  }
  for (std::thread& reader : readers) reader.join();
  const double seconds = RealClock().SteadySeconds() - start;
  EXPECT_EQ(answered, 1280);
  // Five questions at the most for the four answers, each at most twice a second.
  EXPECT_LE(service_.Counter("messages_received_total") - before, 5 * (2 * seconds + 1) + 2)
      << seconds << " s";
}

class WebPageForOthers : public WebPage {
 protected:
  WebPageForOthers() : WebPage("0.0.0.0:0", {"--web-token", "TOKEN"}) {}
};

TEST_F(WebPageForOthers, AsksForTheToken) {
  std::string token = *ReadFile(folder_ + "/token");
  token.pop_back();
  struct stat info {};
  ASSERT_EQ(stat((folder_ + "/token").c_str(), &info), 0);
  EXPECT_EQ(info.st_mode & 0777, 0600u);
  auto http = Http();
  EXPECT_EQ(http.Get("/healthz")->status, 200);
  for (const char* path : {"/", "/app.js", "/metrics", "/api/jobs"})
    EXPECT_EQ(http.Get(path)->status, 401) << path;
  EXPECT_EQ(http.Get("/metrics", {{"Authorization", "Bearer " + token}})->status, 200);
  EXPECT_EQ(http.Get("/metrics", {{"Authorization", "Bearer " + token + "0"}})->status, 401);
  EXPECT_FALSE(
      http.Post("/login", "token=wrong", "application/x-www-form-urlencoded")->has_header("Set-Cookie"));
  const auto login = http.Post("/login", "token=" + token, "application/x-www-form-urlencoded");
  EXPECT_EQ(login->status, 303);
  const std::string cookie = login->get_header_value("Set-Cookie");
  EXPECT_NE(cookie.find("HttpOnly"), std::string::npos);
  EXPECT_EQ(http.Get("/api/jobs", {{"Cookie", "a=b; " + cookie.substr(0, cookie.find(';'))}})->status, 200);
  EXPECT_EQ(service_.Logs().find(token), std::string::npos) << "secrets are in no log";
}

TEST(WebPageFlags, AnAddressThatOthersReachNeedsAToken) {
  const std::string folder = NewFolder();
  const auto run = [&](std::vector<std::string> more) {
    std::vector<std::string> arguments = {BinFolder() + "/realitygrad-coordinator", "--listen",
                                          "ipc://" + folder + "/s", "--db", folder + "/a.db"};
    arguments.insert(arguments.end(), more.begin(), more.end());
    return Process(arguments, folder + "/log").WaitForExit(kPatience);
  };
  EXPECT_EQ(run({"--web", "0.0.0.0:0"}), 2);
  EXPECT_EQ(run({"--web", "example.com:80"}), 2);
  EXPECT_EQ(run({"--web", "7342"}), 2);
  ASSERT_TRUE(WriteFileAtomically(folder + "/open", "a-token-that-all-may-read\n").ok());
  chmod((folder + "/open").c_str(), 0644);
  EXPECT_EQ(run({"--web", "0.0.0.0:0", "--web-token", folder + "/open"}), 1);
  EXPECT_NE(ReadFile(folder + "/log")->find("chmod 600"), std::string::npos) << *ReadFile(folder + "/log");
  std::filesystem::remove_all(folder);
}

TEST(WebPageFlags, ThePageOfAnEncryptedCoordinatorComesInByAKeyOfItsOwn) {
  const std::string folder = NewFolder();
  ASSERT_TRUE(transport::GenerateKeyFiles(folder, "coordinator", pb::ROLE_COORDINATOR).ok());
  ASSERT_TRUE(WriteFileAtomically(folder + "/allowed_keys", "").ok());
  Process coordinator(
      {BinFolder() + "/realitygrad-coordinator", "--listen", "tcp://127.0.0.1:0", "--db", folder + "/a.db",
       "--key", folder + "/coordinator.key", "--allowed-keys", folder + "/allowed_keys", "--web",
       "127.0.0.1:0", "--web-address-file", folder + "/url", "--address-file", folder + "/address"},
      folder + "/log");
  const double end = RealClock().SteadySeconds() + kPatience;
  while (!std::filesystem::exists(folder + "/address") && RealClock().SteadySeconds() < end)
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  const std::string url = *ReadFile(folder + "/url");
  httplib::Client http("127.0.0.1", std::stoi(url.substr(url.rfind(':') + 1)));
  http.set_read_timeout(30);
  auto reply = http.Get("/api/status");
  ASSERT_TRUE(reply);
  EXPECT_EQ(reply->status, 200) << reply->body;
  // Still, when the list has changed.
  const auto other = transport::GenerateKeyPair();
  ASSERT_TRUE(
      transport::AllowKey(folder + "/allowed_keys", other.public_key, pb::ROLE_VIEWER, "someone").ok());
  std::this_thread::sleep_for(std::chrono::milliseconds(1500));
  EXPECT_EQ(http.Get("/healthz")->status, 200);
  std::filesystem::remove_all(folder);
}

// --- as a browser shows it

class InABrowser : public WebPage {
 protected:
  void SetUp() override {
    if (Browser::Program().empty()) GTEST_SKIP() << "Chromium is not installed (package chromium)";
    browser_ = std::make_unique<Browser>(folder_);
    browser_->SetScreen(1280, 900, false);
  }
  // To look at: RG_SCREENSHOTS names a folder.
  void Picture(const std::string& name) {
    const char* folder = std::getenv("RG_SCREENSHOTS");
    if (folder != nullptr) browser_->Screenshot(std::string(folder) + "/" + name + ".png");
  }
  // Nothing of it, nor of the tabs, is beyond the edge.
  bool FitsTheScreen() {
    return browser_->Evaluate(
               "document.documentElement.scrollWidth <= window.innerWidth && "
               "[...document.querySelectorAll('nav a')].every(a => a.getBoundingClientRect().right <= window.innerWidth)") ==
           true;
  }
  void Show(const std::string& view) { browser_->Evaluate("location.hash = '#/" + view + "'"); }
  std::string Complaints() const {
    std::string all;
    for (const std::string& one : browser_->complaints()) all += one + "\n";
    return all;
  }
  std::unique_ptr<Browser> browser_;
};

TEST_F(InABrowser, AJobMovesFromSubmittedToDone) {
  browser_->Open(url());
  ASSERT_TRUE(browser_->WaitFor("document.querySelector('#link.live')", kPatience)) << service_.Logs();
  // Long enough for a page that asks once a second to see it run.
  const int64_t id = Submit("<img src=x onerror=alert(1)>", 4, 2.0);
  const std::string row = "[data-job=\"" + std::to_string(id) + "\"]";
  ASSERT_TRUE(browser_->WaitFor("document.querySelector('" + row + " .badge.queued')", kPatience));
  EXPECT_NE(browser_->Text(row).find("<img src=x"), std::string::npos) << "names are text";
  Picture("jobs-queued");
  Show("job/" + std::to_string(id));
  ASSERT_TRUE(browser_->WaitFor("document.querySelector('[data-stage=trajectories]')", kPatience));
  service_.StartWorker("worker-1", 2);
  ASSERT_TRUE(browser_->WaitFor("document.querySelector('#view .badge.running')", kPatience));
  ASSERT_TRUE(browser_->WaitFor(
      "document.querySelector('[data-task=shard-0] .badge.leased, [data-task=shard-0] .badge.succeeded')",
      kPatience));
  Picture("job-running");
  ASSERT_TRUE(browser_->WaitFor("document.querySelector('#view .tools .badge.succeeded')", kPatience));
  EXPECT_NE(browser_->Text("[data-stage=trajectories]").find("4/4"), std::string::npos);
  Show("jobs");
  EXPECT_TRUE(browser_->WaitFor("document.querySelector('" + row + " .badge.succeeded')", kPatience));
  Show("workers");
  EXPECT_TRUE(browser_->WaitFor("document.querySelector('[data-worker=worker-1]')", kPatience));
  EXPECT_EQ(Complaints(), "");
}

TEST_F(InABrowser, ParametersDiagnosesAndLineageOnAPhoneAndInTheDark) {
  service_.StartWorker("worker-1");
  std::string newest;
  for (const double value : {1.0, 1.4, 1.5}) {
    pb::JobSpec job;
    AddTask(&job, "p", "parameters", json{{"robot", "mico2"}, {"value", value}}.dump());
    const auto id = service_.client().Submit(job);
    const auto end = service_.client().WaitForJob(*id, kPatience);
    ASSERT_TRUE(end.ok());
    newest = service_.client().GetJob(*id)->tasks(0).outputs(0).sha256();
  }
  pb::ArtifactInfo info;
  info.set_kind("diagnosis");
  info.add_parents(newest);
  const std::string diagnosis =
      *service_.client().PutArtifact(json{{"format", "realitygrad.diagnosis/1"},
                                          {"verdict", "unmodelled_physics"},
                                          {"findings",
                                           {{{"effect", "coulomb_friction"},
                                             {"statement", "Joint 2 sticks."},
                                             {"joints", {"j2"}},
                                             {"confidence", 0.93}}}},
                                          {"fit", {{"holdout", {{"before_rms", 0.2}, {"after_rms", 0.05}}}}}}
                                         .dump(),
                                     info);
  info.set_kind("report");
  const std::string report = *service_.client().PutArtifact(
      "<!doctype html><html><body><h1 id=r>Report</h1><script>document.getElementById('r').textContent = "
      "'Report ran';"
      "fetch('/api/jobs').then(() => document.title = 'reached');</script></body></html>",
      info);

  browser_->Open(url());
  const auto see_all = [&](const std::string& where) {
    Show("parameters");
    EXPECT_TRUE(
        browser_->WaitFor("document.querySelectorAll('#parameter-plots figure[data-drawn]').length > 0 && "
                          "document.querySelector('[data-version=\"3\"]')",
                          kPatience));
    EXPECT_TRUE(browser_->WaitFor("document.querySelector('#parameter-plots canvas')", kPatience));
    Picture("parameters-" + where);
    EXPECT_TRUE(FitsTheScreen()) << where;
    Show("diagnoses");
    EXPECT_TRUE(browser_->WaitFor("document.querySelector('[data-diagnosis]')", kPatience));
    EXPECT_NE(browser_->Text("[data-diagnosis]").find("Joint 2 sticks."), std::string::npos);
    Picture("diagnoses-" + where);
    EXPECT_TRUE(FitsTheScreen()) << where;
    Show("artifact/" + newest);
    EXPECT_TRUE(browser_->WaitFor("document.querySelectorAll('#lineage rect').length >= 3", kPatience));
    Picture("lineage-" + where);
    EXPECT_TRUE(FitsTheScreen()) << where;
    Show("artifacts");
    EXPECT_TRUE(browser_->WaitFor("document.querySelector('#artifacts td')", kPatience));
    Picture("artifacts-" + where);
    EXPECT_TRUE(FitsTheScreen()) << where;
    Show("jobs");
    EXPECT_TRUE(browser_->WaitFor("document.querySelector('[data-job=\"3\"]')", kPatience));
    Picture("jobs-" + where);
    EXPECT_TRUE(FitsTheScreen()) << where;
    Show("job/3");
    EXPECT_TRUE(browser_->WaitFor("document.querySelector('[data-stage]')", kPatience));
    Picture("job-" + where);
    EXPECT_TRUE(FitsTheScreen()) << where;
  };
  const auto paper = [&] {
    return browser_->Evaluate("getComputedStyle(document.body).backgroundColor").get<std::string>();
  };
  see_all("light");
  EXPECT_EQ(paper(), "rgb(255, 255, 255)");
  browser_->SetScreen(390, 800, true);
  see_all("phone-dark");
  EXPECT_EQ(paper(), "rgb(18, 23, 30)");
  EXPECT_EQ(Complaints(), "");

  // A report is somebody else's page: it runs, and reaches nothing of this one.
  browser_->Open(url() + "/artifact/" + report);
  EXPECT_TRUE(
      browser_->WaitFor("document.body && document.body.innerText.includes('Report ran')", kPatience));
  EXPECT_NE(browser_->Evaluate("document.title"), "reached");
  EXPECT_EQ(browser_->Evaluate("window.origin"), "null");
}

}  // namespace
}  // namespace rg::testing
