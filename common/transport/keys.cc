#include "common/transport/keys.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>
#include <zmq.h>

#include <algorithm>
#include <cctype>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <map>
#include <sstream>

#include "common/base/file.h"
#include "common/base/ids.h"

namespace rg::transport {
namespace {

constexpr size_t kKeyTextLength = 40;

bool IsName(std::string_view name) {
  const auto allowed = [](unsigned char c) { return std::isalnum(c) || c == '-' || c == '_' || c == '.'; };
  return !name.empty() && name.size() <= 64 && name.front() != '.' &&
         std::all_of(name.begin(), name.end(), allowed);
}

Status CheckName(std::string_view name) {
  if (IsName(name)) return Status::Ok();
  return InvalidError("key name \"" + std::string(name.substr(0, 80)) +
                      "\": must be 1 to 64 letters, digits, '-', '_', '.'");
}

// "field value" per line; '#' starts a comment line.
Result<NamedKey> ParseKeyFile(const std::string& path, bool want_secret) {
  RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  std::map<std::string, std::string> fields;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    std::istringstream words(line);
    std::string field, value;
    if (words >> field && field[0] != '#' && words >> value) fields[field] = value;
  }
  NamedKey key;
  key.name = fields["name"];
  key.keys.public_key = fields["public"];
  RG_RETURN_IF_ERROR(CheckName(key.name).WithPrefix(path + ": field name"));
  auto role = ParseRole(fields["role"]);
  if (!role.ok()) return role.status().WithPrefix(path + ": field role");
  key.role = *role;
  RG_RETURN_IF_ERROR(CheckKeyText(key.keys.public_key).WithPrefix(path + ": field public"));
  if (!want_secret) return key;
  key.keys.secret_key = fields["secret"];
  RG_RETURN_IF_ERROR(CheckKeyText(key.keys.secret_key).WithPrefix(path + ": field secret"));
  char derived[kKeyTextLength + 1];
  if (zmq_curve_public(derived, key.keys.secret_key.c_str()) != 0 || key.keys.public_key != derived)
    return InvalidError(path + ": the secret key does not belong to the public key");
  return key;
}

std::string KeyFileText(const NamedKey& key, bool with_secret) {
  std::string text = with_secret ? "# RealityGrad key. Secret: never copy it to another host.\n"
                                 : "# RealityGrad public key: give it to those who shall know this peer.\n";
  text += "name " + key.name + "\nrole " + std::string(RoleName(key.role)) + "\npublic " +
          key.keys.public_key + "\n";
  if (with_secret) text += "secret " + key.keys.secret_key + "\n";
  return text;
}

// Made with its mode, so that it is never readable by others, not even for a moment.
Status WriteSecretFile(const std::string& path, const std::string& text) {
  const std::string temp = path + ".tmp." + RandomHex(4);
  const int fd = ::open(temp.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0600);
  if (fd < 0) return InternalError(temp + ": cannot create: " + std::strerror(errno));
  const bool written =
      ::write(fd, text.data(), text.size()) == static_cast<ssize_t>(text.size()) && ::fsync(fd) == 0;
  const int error = errno;
  ::close(fd);
  if (written && ::rename(temp.c_str(), path.c_str()) == 0) return Status::Ok();
  ::unlink(temp.c_str());
  return InternalError(path + ": cannot write: " + std::strerror(error));
}

}  // namespace

// ---- AllowList ----

Status AllowList::Add(const std::string& public_key, pb::Role role, const std::string& name, bool robots) {
  RG_RETURN_IF_ERROR(CheckKeyText(public_key));
  RG_RETURN_IF_ERROR(CheckName(name));
  if (RoleName(role) == "unknown") return InvalidError("key of \"" + name + "\": no role");
  if (robots && role != pb::ROLE_OPERATOR)
    return InvalidError("key of \"" + name + "\": the right to robots is an operator's, not a " +
                        std::string(RoleName(role)) + "'s");
  if (!entries_.emplace(public_key, Entry{role, name, robots}).second)
    return AlreadyExistsError("public key " + public_key + ": already allowed, as \"" +
                              entries_[public_key].name + "\"");
  return Status::Ok();
}

bool AllowList::Remove(const std::string& public_key) { return entries_.erase(public_key) > 0; }

const AllowList::Entry* AllowList::Find(const std::string& public_key) const {
  const auto found = entries_.find(public_key);
  return found == entries_.end() ? nullptr : &found->second;
}

std::vector<AllowList::Row> AllowList::Rows() const {
  std::vector<Row> rows;
  for (const auto& [key, entry] : entries_) rows.push_back({key, entry});
  std::sort(rows.begin(), rows.end(), [](const Row& a, const Row& b) {
    return std::tie(a.entry.role, a.entry.name, a.public_key) <
           std::tie(b.entry.role, b.entry.name, b.public_key);
  });
  return rows;
}

Result<AllowList> AllowList::Parse(std::string_view text, const std::string& source) {
  AllowList list;
  std::istringstream lines{std::string(text)};
  int number = 0;
  for (std::string line; std::getline(lines, line);) {
    const std::string where = source + ": line " + std::to_string(++number);
    std::istringstream words(line);
    std::string role_name, key, name, right, rest;
    if (!(words >> role_name) || role_name[0] == '#') continue;
    const bool complete = static_cast<bool>(words >> key >> name);
    if (!complete || (words >> right && (right != "robots" || words >> rest)))
      return InvalidError(where + ": must be <role> <public key> <name> [robots]");
    auto role = ParseRole(role_name);
    if (!role.ok()) return role.status().WithPrefix(where);
    RG_RETURN_IF_ERROR(list.Add(key, *role, name, !right.empty()).WithPrefix(where));
  }
  return list;
}

std::string AllowList::Format() const {
  std::string text = "# Who may connect: <role> <public key> <name> [robots]\n";
  for (const Row& row : Rows())
    text += std::string(RoleName(row.entry.role)) + " " + row.public_key + " " + row.entry.name +
            (row.entry.robots ? " robots\n" : "\n");
  return text;
}

// ---- keys and files ----

KeyPair GenerateKeyPair() {
  char public_key[kKeyTextLength + 1], secret_key[kKeyTextLength + 1];
  RG_CHECK(zmq_curve_keypair(public_key, secret_key) == 0) << "libzmq was built without CURVE";
  return {public_key, secret_key};
}

Status CheckKeyText(std::string_view text) {
  uint8_t bytes[32];
  if (text.size() == kKeyTextLength && zmq_z85_decode(bytes, std::string(text).c_str()) != nullptr)
    return Status::Ok();
  return InvalidError("not a key (40 characters of Z85)");
}

Result<NamedKey> GenerateKeyFiles(const std::string& folder, const std::string& name, pb::Role role,
                                  bool overwrite) {
  RG_RETURN_IF_ERROR(CheckName(name));
  if (RoleName(role) == "unknown") return InvalidError("key \"" + name + "\": no role");
  const std::string path = (std::filesystem::path(folder) / name).string();
  if (!overwrite && std::filesystem::exists(path + ".key"))
    return AlreadyExistsError(
        path + ".key: is there already; whoever knows its public half would no longer know us");
  std::error_code error;
  if (std::filesystem::create_directories(folder, error)) ::chmod(folder.c_str(), 0700);
  const NamedKey key{name, role, GenerateKeyPair()};
  RG_RETURN_IF_ERROR(WriteSecretFile(path + ".key", KeyFileText(key, true)));
  RG_RETURN_IF_ERROR(WriteFileAtomically(path + ".pub", KeyFileText(key, false)));
  return key;
}

Result<NamedKey> LoadKeyFile(const std::string& path) {
  struct stat info {};
  if (::stat(path.c_str(), &info) == 0 && (info.st_mode & 0077) != 0)
    return PermissionDeniedError(path + ": others may read this secret; chmod 600 it");
  return ParseKeyFile(path, /*want_secret=*/true);
}

Result<NamedKey> LoadPublicKeyFile(const std::string& path) {
  return ParseKeyFile(path, /*want_secret=*/false);
}

Result<std::vector<NamedKey>> ListKeys(const std::string& folder) {
  std::map<std::string, NamedKey> by_name;
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator(folder, error)) {
    if (entry.path().extension() != ".pub" && entry.path().extension() != ".key") continue;
    RG_ASSIGN_OR_RETURN(NamedKey key, LoadPublicKeyFile(entry.path().string()));
    by_name.emplace(key.name, std::move(key));
  }
  if (error && error != std::errc::no_such_file_or_directory)
    return InternalError(folder + ": " + error.message());
  std::vector<NamedKey> keys;
  for (auto& [name, key] : by_name) keys.push_back(std::move(key));
  return keys;
}

Result<AllowList> LoadAllowList(const std::string& path) {
  if (!std::filesystem::exists(path)) return AllowList();
  RG_ASSIGN_OR_RETURN(const std::string text, ReadFile(path));
  return AllowList::Parse(text, path);
}

Status AllowKey(const std::string& path, const std::string& public_key, pb::Role role,
                const std::string& name, bool robots) {
  RG_ASSIGN_OR_RETURN(AllowList list, LoadAllowList(path));
  const AllowList::Entry* known = list.Find(public_key);
  if (known != nullptr && known->role == role && known->name == name && known->robots != robots)
    list.Remove(public_key);
  for (const AllowList::Row& row : list.Rows())
    if (row.entry.name == name && row.public_key != public_key)
      return AlreadyExistsError(path + ": another key is allowed as \"" + name + "\"; revoke it first");
  RG_RETURN_IF_ERROR(list.Add(public_key, role, name, robots).WithPrefix(path));
  return WriteFileAtomically(path, list.Format());
}

Status RevokeKey(const std::string& path, const std::string& name_or_public_key) {
  RG_ASSIGN_OR_RETURN(AllowList list, LoadAllowList(path));
  bool removed = false;
  for (const AllowList::Row& row : list.Rows())
    if (row.entry.name == name_or_public_key || row.public_key == name_or_public_key)
      removed |= list.Remove(row.public_key);
  if (!removed) return NotFoundError(path + ": \"" + name_or_public_key + "\" is not on the list");
  return WriteFileAtomically(path, list.Format());
}

Result<std::optional<AllowList>> AllowListFile::Changed() {
  std::string text;
  if (std::filesystem::exists(path_)) {
    RG_ASSIGN_OR_RETURN(text, ReadFile(path_));
  }
  if (asked_ && text == last_) return std::optional<AllowList>();
  asked_ = true;
  last_ = text;
  RG_ASSIGN_OR_RETURN(AllowList list, AllowList::Parse(text, path_));
  return std::optional<AllowList>(std::move(list));
}

std::string DefaultKeyFolder() {
  const auto variable = [](const char* name) {
    return std::string(std::getenv(name) ? std::getenv(name) : "");
  };
  if (const std::string chosen = variable("REALITYGRAD_KEYS"); !chosen.empty()) return chosen;
  if (const std::string config = variable("XDG_CONFIG_HOME"); !config.empty())
    return config + "/realitygrad/keys";
  return variable("HOME") + "/.config/realitygrad/keys";
}

}  // namespace rg::transport
