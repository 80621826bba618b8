// What a long test has done, in the file that RG_PROGRESS names: a run that was broken off goes on with the next
// batch. Without the variable nothing is kept.
#pragma once

#include <cstdlib>
#include <fstream>
#include <map>
#include <optional>
#include <string>

namespace rg::testing {

// How often to do something: as the environment asks, else as often as normally.
inline int CountAsked(const char* variable, int normally) {
  const char* asked = std::getenv(variable);
  return asked != nullptr ? std::atoi(asked) : normally;
}

class BatchesDone {
 public:
  // `suite`: one word; several may share a file.
  explicit BatchesDone(const std::string& suite) : suite_(suite) {
    const char* file = std::getenv("RG_PROGRESS");
    if (file == nullptr) return;
    path_ = file;
    std::ifstream in(path_);
    int batch = 0;
    std::string of, what;
    while (in >> of >> batch && std::getline(in, what)) {
      (of == suite_ ? done_ : others_)[of + " " + std::to_string(batch)] = what;
    }
  }
  // What was noted of a batch that is done.
  std::optional<std::string> Find(int batch) const {
    const auto found = done_.find(Key(batch));
    return found == done_.end() ? std::nullopt : std::optional(found->second);
  }
  // `what`: one line.
  void Note(int batch, const std::string& what = "") {
    done_[Key(batch)] = " " + what;
    if (!path_.empty()) std::ofstream(path_, std::ios::app) << Key(batch) << " " << what << std::endl;
  }
  // All are: the next run begins anew.
  void Forget() {
    if (path_.empty()) return;
    std::ofstream out(path_, std::ios::trunc);
    for (const auto& [key, what] : others_) out << key << what << "\n";
  }

 private:
  std::string Key(int batch) const { return suite_ + " " + std::to_string(batch); }
  std::string suite_, path_;
  std::map<std::string, std::string> done_, others_;
};

}  // namespace rg::testing
