#include "services/rollouts/recording_bundle.h"

#include <cstdio>
#include <cstring>
#include <filesystem>
#include <nlohmann/json.hpp>

#include "common/base/file.h"
#include "common/base/ids.h"
#include "common/dynamics/dynamics.h"
#include "common/model/urdf_loader.h"
#include "services/rollouts/rollout_end.h"

namespace rg::rollouts {
namespace {

constexpr size_t kBlock = 512;

// Offsets of the ustar header, POSIX.1-1988.
struct TarHeader {
  char name[100], mode[8], uid[8], gid[8], size[12], mtime[12], checksum[8], type, link[100];
  char magic[6], version[2], user[32], group[32], major[8], minor[8], prefix[155], padding[12];
};
static_assert(sizeof(TarHeader) == kBlock);

unsigned Checksum(TarHeader header) {
  std::memset(header.checksum, ' ', sizeof header.checksum);
  unsigned sum = 0;
  const auto* bytes = reinterpret_cast<const unsigned char*>(&header);
  for (size_t i = 0; i < kBlock; ++i) sum += bytes[i];
  return sum;
}

bool PlainName(std::string_view name) {
  return !name.empty() && name.size() <= 99 && name != "." && name != ".." &&
         name.find('/') == std::string_view::npos && name.find('\0') == std::string_view::npos;
}

TarHeader MakeHeader(const std::string& name, size_t size) {
  TarHeader header{};
  std::memcpy(header.name, name.data(), name.size());
  std::memcpy(header.mode, "0000644", 8);
  std::memcpy(header.uid, "0000000", 8);
  std::memcpy(header.gid, "0000000", 8);
  std::memcpy(header.mtime, "00000000000", 12);
  std::snprintf(header.size, sizeof header.size, "%011zo", size);
  header.type = '0';
  std::memcpy(header.magic, "ustar", 6);
  std::memcpy(header.version, "00", 2);
  std::snprintf(header.checksum, sizeof header.checksum, "%06o", Checksum(header));
  header.checksum[7] = ' ';
  return header;
}

bool ParseOctal(const char* text, size_t length, size_t* value) {
  *value = 0;
  size_t i = 0;
  for (; i < length && text[i] >= '0' && text[i] <= '7'; ++i) *value = *value * 8 + (text[i] - '0');
  return i > 0 && (i == length || text[i] == '\0' || text[i] == ' ');
}

// `at` is moved behind the entry; ok with an empty name: the end of the archive.
Status ReadEntry(std::string_view bytes, size_t* at, std::string* name, std::string* content) {
  const std::string where = "recording bundle, byte " + std::to_string(*at) + ": ";
  name->clear();
  if (bytes.size() - *at < kBlock) return DataLossError(where + "truncated");
  TarHeader header;
  std::memcpy(&header, bytes.data() + *at, kBlock);
  if (header.name[0] == '\0') return Status::Ok();
  size_t checksum = 0, size = 0;
  if (!ParseOctal(header.checksum, sizeof header.checksum, &checksum) || checksum != Checksum(header))
    return DataLossError(where + "the header's checksum does not match");
  if (!ParseOctal(header.size, sizeof header.size, &size)) return DataLossError(where + "no size");
  name->assign(header.name, strnlen(header.name, sizeof header.name));
  if (header.type != '0' || header.prefix[0] != '\0' || !PlainName(*name))
    return DataLossError(where + "\"" + *name + "\" is not a plain file");
  const size_t padded = (size + kBlock - 1) / kBlock * kBlock;
  if (bytes.size() - *at - kBlock < padded) return DataLossError(where + *name + " is truncated");
  content->assign(bytes.substr(*at + kBlock, size));
  *at += kBlock + padded;
  return Status::Ok();
}

}  // namespace

std::string PackBundle(const Bundle& bundle) {
  std::string out;
  for (const auto& [name, content] : bundle) {
    RG_CHECK(PlainName(name)) << name;
    const TarHeader header = MakeHeader(name, content.size());
    out.append(reinterpret_cast<const char*>(&header), kBlock);
    out += content;
    out.append((kBlock - content.size() % kBlock) % kBlock, '\0');
  }
  out.append(2 * kBlock, '\0');
  return out;
}

Result<Bundle> UnpackBundle(std::string_view bytes) {
  Bundle bundle;
  size_t at = 0;
  while (true) {
    std::string name, content;
    RG_RETURN_IF_ERROR(ReadEntry(bytes, &at, &name, &content));
    if (name.empty()) return bundle;
    if (!bundle.emplace(name, std::move(content)).second)
      return DataLossError("recording bundle: " + name + " is there twice");
  }
}

Status ExtractBundle(std::string_view bytes, const std::string& folder) {
  RG_ASSIGN_OR_RETURN(const Bundle bundle, UnpackBundle(bytes));
  for (const auto& [name, content] : bundle)
    RG_RETURN_IF_ERROR(WriteFileAtomically((std::filesystem::path(folder) / name).string(), content));
  return Status::Ok();
}

Status CheckRows(std::string_view bytes, int least) {
  RG_ASSIGN_OR_RETURN(const Bundle bundle, UnpackBundle(bytes));
  const auto file = bundle.find("rollout.json");
  const auto rollout = file == bundle.end() ? nlohmann::json() : nlohmann::json::parse(file->second, nullptr, false);
  if (!rollout.is_object() || !rollout.contains("rows") || !rollout["rows"].is_number_integer()) return Status::Ok();
  const int rows = rollout["rows"].get<int>();
  if (rows >= least) return Status::Ok();
  return FailedPreconditionError("the rollout was " + HowItEnded(rollout).text + " and left " + std::to_string(rows) +
                                 (rows == 1 ? " row" : " rows") + ", nothing can be identified from fewer than " +
                                 std::to_string(least));
}

namespace {

// Names of files as the bundle has them: where it was unpacked to tells nobody anything.
std::string WithoutFolder(std::string text, const std::string& folder) {
  const std::string prefix = folder + "/";
  for (size_t at; (at = text.find(prefix)) != std::string::npos;) text.erase(at, prefix.size());
  return text;
}

}  // namespace

Result<recordings::RecordingSet> LoadBundle(std::string_view bytes) {
  RG_RETURN_IF_ERROR(CheckRows(bytes, 2));
  namespace fs = std::filesystem;
  const fs::path folder = fs::temp_directory_path() / ("realitygrad-" + RandomHex(8));
  const Status extracted = ExtractBundle(bytes, folder.string());
  auto set =
      extracted.ok() ? recordings::LoadSet(folder.string()) : Result<recordings::RecordingSet>(extracted);
  std::error_code ignored;
  fs::remove_all(folder, ignored);
  if (!set.ok()) return Status(set.status().code(), WithoutFolder(set.status().message(), folder.string()));
  set->urdf_path = WithoutFolder(set->urdf_path, folder.string());
  for (std::string& warning : set->warnings) warning = WithoutFolder(warning, folder.string());
  return set;
}

namespace {

// A command is held to the next row, so gravity is taken between the two.
void AddGravity(const dynamics::Mechanism& mechanism, recordings::Recording* recording) {
  dynamics::Workspace workspace;
  Eigen::VectorXd gravity(recording->n());
  for (int k = 0; k < recording->rows(); ++k) {
    Eigen::VectorXd q = recording->q.col(k);
    if (k + 1 < recording->rows()) q = 0.5 * (q + recording->q.col(k + 1));
    dynamics::GravityTorque(mechanism, workspace, q, gravity);
    recording->effort_command.col(k) += gravity;
  }
}

}  // namespace

Result<recordings::RecordingSet> LoadBundleOfWholeTorques(std::string_view bytes) {
  RG_ASSIGN_OR_RETURN(recordings::RecordingSet set, LoadBundle(bytes));
  if (!set.effort_excludes_gravity) return set;
  model::LoadOptions options;
  options.joints = set.joints;
  options.locked = set.locked;
  RG_ASSIGN_OR_RETURN(const model::RobotModel model, model::ParseUrdf(set.urdf_text, "robot.urdf", options));
  dynamics::Mechanism mechanism(model);
  mechanism.SetGravity(set.gravity);
  for (auto& recording : set.recordings) {
    if (recording.n() != model.num_joints() || !recording.has_effort_command())
      return InvalidError(recording.name + ": needs an effort_command of every joint of the model");
    AddGravity(mechanism, &recording);
  }
  set.effort_excludes_gravity = false;
  return set;
}

}  // namespace rg::rollouts
