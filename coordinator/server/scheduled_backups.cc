#include "coordinator/server/scheduled_backups.h"

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <ctime>
#include <filesystem>

#include "common/base/clock.h"
#include "common/base/log.h"
#include "common/store/artifact_store.h"
#include "common/store/database.h"
#include "common/store/parameter_store.h"
#include "coordinator/store/schema.h"

namespace rg::coordinator {
namespace {

namespace fs = std::filesystem;

fs::path FolderOf(const BackupOptions& options) { return fs::absolute(options.database).parent_path() / "backups"; }
std::string StemOf(const BackupOptions& options) { return fs::path(options.database).stem().string() + "-"; }

std::string Stamp(int64_t wall_ns) {
  const std::time_t seconds = wall_ns / 1'000'000'000;
  std::tm utc{};
  gmtime_r(&seconds, &utc);
  char text[32];
  std::strftime(text, sizeof text, "%Y%m%dT%H%M%SZ", &utc);
  return text;
}

// When the backup of this path was made, by its name; 0: it is none of ours.
int64_t MadeAt(const BackupOptions& options, const std::string& path) {
  const std::string name = fs::path(path).filename().string(), stem = StemOf(options);
  std::tm utc{};
  if (name.rfind(stem, 0) != 0) return 0;
  const char* rest = strptime(name.c_str() + stem.size(), "%Y%m%dT%H%M%SZ", &utc);
  if (rest == nullptr || std::string(rest) != ".db") return 0;
  return int64_t{timegm(&utc)} * 1'000'000'000;
}

Result<std::unique_ptr<store::Database>> OpenToRead(const std::string& path) {
  store::DatabaseOptions options;
  options.path = path;
  options.read_only = true;
  return store::Database::Open(options, {store::ArtifactStore::Schema(), store::ParameterStore::Schema(), CoordinatorSchema()});
}

Status CopyAndCheck(const std::string& database, const std::string& copy) {
  RG_ASSIGN_OR_RETURN(const auto from, OpenToRead(database));
  RG_RETURN_IF_ERROR(from->BackupTo(copy));
  RG_ASSIGN_OR_RETURN(const auto made, OpenToRead(copy));
  constexpr double kAsLongAsItTakes = 1e9;
  return made->QuickCheck(kAsLongAsItTakes).status();
}

}  // namespace

Result<double> ParseInterval(const std::string& text) {
  if (text.empty() || text == "0") return 0.0;
  double amount = 0.0;
  char unit = 0, rest = 0;
  const std::string units = "smhd";
  constexpr double kSeconds[] = {1.0, 60.0, 3600.0, 86400.0};
  if (std::sscanf(text.c_str(), "%lf%c%c", &amount, &unit, &rest) == 2 && amount > 0.0 && amount < 1e8 &&
      units.find(unit) != std::string::npos)
    return amount * kSeconds[units.find(unit)];
  return InvalidError("'" + text + "' is no interval such as 90s, 15m, 24h or 7d");
}

std::vector<std::string> ScheduledBackups::List(const BackupOptions& options) {
  std::vector<std::string> paths;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(FolderOf(options), error)) {
    if (MadeAt(options, entry.path().string()) != 0) paths.push_back(entry.path().string());
  }
  std::sort(paths.begin(), paths.end());
  return paths;
}

Result<std::string> ScheduledBackups::MakeOne(const BackupOptions& options, int64_t wall_ns) {
  std::error_code error;
  fs::create_directories(FolderOf(options), error);
  if (error) return UnavailableError(FolderOf(options).string() + ": " + error.message());
  const std::string path = (FolderOf(options) / (StemOf(options) + Stamp(wall_ns) + ".db")).string();
  const std::string part = path + ".part";
  fs::remove(part, error);
  const Status made = CopyAndCheck(options.database, part);
  if (made.ok()) fs::rename(part, path, error);
  if (!made.ok() || error) {
    const Status why = made.ok() ? InternalError(path + ": " + error.message()) : made;
    fs::remove(part, error);
    return why;
  }
  const std::vector<std::string> all = List(options);
  for (size_t i = 0; i + static_cast<size_t>(options.keep) < all.size(); ++i) fs::remove(all[i], error);
  return path;
}

ScheduledBackups::ScheduledBackups(const BackupOptions& options) : options_(options) {
  if (options_.every_s > 0.0) thread_ = std::thread([this] { Work(); });
}

ScheduledBackups::~ScheduledBackups() {
  {
    const std::lock_guard lock(mutex_);
    stop_ = true;
  }
  wake_.notify_all();
  if (thread_.joinable()) thread_.join();
}

void ScheduledBackups::Work() {
  constexpr double kAgainS = 600.0;  // after one that failed
  constexpr double kLookS = 60.0;    // the clock on the wall may be set
  int64_t not_before_ns = 0;
  std::unique_lock lock(mutex_);
  while (!stop_) {
    const auto all = List(options_);
    const int64_t last_ns = all.empty() ? 0 : MadeAt(options_, all.back());
    const int64_t now_ns = RealClock().WallNanos();
    const int64_t due_ns = std::max(last_ns + static_cast<int64_t>(1e9 * options_.every_s), not_before_ns);
    if (now_ns < due_ns) {
      wake_.wait_for(lock, std::chrono::duration<double>(std::min(kLookS, 1e-9 * static_cast<double>(due_ns - now_ns))));
      continue;
    }
    lock.unlock();
    const auto made = MakeOne(options_, now_ns);
    if (made.ok()) spdlog::info("backup {}, checked", *made);
    if (!made.ok()) spdlog::error("no backup was made: {}", made.status().ToString());
    not_before_ns = made.ok() ? 0 : now_ns + static_cast<int64_t>(1e9 * kAgainS);
    lock.lock();
  }
}

}  // namespace rg::coordinator
