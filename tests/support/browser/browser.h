// A headless Chromium with one page, driven over its debugging pipe (the DevTools protocol on two file
// descriptors; no port is opened). Killed with all its children when the object goes.
#pragma once

#include <sys/types.h>

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace rg::testing {

class Browser {
 public:
  // Where it is installed; empty: it is not.
  static std::string Program();

  explicit Browser(const std::string& folder);  // its profile
  ~Browser();
  Browser(const Browser&) = delete;

  void SetScreen(int width, int height, bool dark);
  void Open(const std::string& url);
  // The value of a JavaScript expression; null where it threw.
  nlohmann::json Evaluate(const std::string& expression);
  bool WaitFor(const std::string& expression, double timeout_s = 30.0);
  std::string Text(const std::string& selector);  // empty: nothing there
  void Screenshot(const std::string& path);
  // What the page complained of so far: exceptions, console errors, refusals by its own policy.
  const std::vector<std::string>& complaints() const { return complaints_; }

 private:
  nlohmann::json Call(const std::string& method, nlohmann::json parameters, bool of_page = true);
  nlohmann::json Receive();
  void Note(const nlohmann::json& event);

  pid_t pid_ = -1;
  int to_ = -1, from_ = -1, last_ = 0;
  std::string session_, buffer_;
  std::vector<std::string> complaints_;
};

}  // namespace rg::testing
