// Keys for encrypted sockets (CurveZMQ): pairs, the files they live in, and the list of who may come.
//
// A key folder, by default ~/.config/realitygrad/keys:
//   coordinator.key   secret, mode 0600          coordinator.pub   public half
//   worker-a.key      ...                        worker-a.pub
//   allowed_keys      one line per peer: <role> <public key> <name> [robots]   ('#' starts a comment line)
// The role belongs to the key: what a peer says of itself counts for nothing on such a socket. So does the
// right to have robots moved ("robots"; for operators): without it a key submits no rollouts.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

#include "common/base/status.h"
#include "common/transport/envelope.h"

namespace rg::transport {

// 32 bytes each, as 40 characters of Z85.
struct KeyPair {
  std::string public_key;
  std::string secret_key;
};

// A pair together with what it is for.
struct NamedKey {
  std::string name;
  pb::Role role = pb::ROLE_UNSPECIFIED;
  KeyPair keys;
};

// Who may connect. Copyable; lookups are by public key.
class AllowList {
 public:
  struct Entry {
    pb::Role role = pb::ROLE_UNSPECIFIED;
    std::string name;
    bool robots = false;
    bool operator==(const Entry&) const = default;
  };

  // kInvalid: not a Z85 key, no role, empty name or one with spaces. kAlreadyExists: the key is there.
  Status Add(const std::string& public_key, pb::Role role, const std::string& name, bool robots = false);
  bool Remove(const std::string& public_key);
  const Entry* Find(const std::string& public_key) const;  // null: unknown
  size_t size() const { return entries_.size(); }

  struct Row {
    std::string public_key;
    Entry entry;
  };
  std::vector<Row> Rows() const;  // by role, then name

  // The lines of an allowed_keys file. Errors name `source`, line and field.
  static Result<AllowList> Parse(std::string_view text, const std::string& source);
  std::string Format() const;

 private:
  std::unordered_map<std::string, Entry> entries_;
};

KeyPair GenerateKeyPair();
// Ok if `text` is a public or secret key in Z85.
Status CheckKeyText(std::string_view text);

// Makes `folder`/<name>.key (0600) and .pub. kAlreadyExists unless `overwrite`.
Result<NamedKey> GenerateKeyFiles(const std::string& folder, const std::string& name, pb::Role role,
                                  bool overwrite = false);
// kPermissionDenied if others than the owner may read the file.
Result<NamedKey> LoadKeyFile(const std::string& path);
// The public half from a .pub (or .key) file, without the secret.
Result<NamedKey> LoadPublicKeyFile(const std::string& path);
// Every .key and .pub of a folder, public halves only, by name.
Result<std::vector<NamedKey>> ListKeys(const std::string& folder);

// An absent allowed_keys file is an empty list: nobody may come.
Result<AllowList> LoadAllowList(const std::string& path);
// Adds to, or removes from, an allowed_keys file (written whole, atomically). A key that is there already
// is given the right to robots, or loses it.
Status AllowKey(const std::string& path, const std::string& public_key, pb::Role role,
                const std::string& name, bool robots = false);
Status RevokeKey(const std::string& path, const std::string& name_or_public_key);

// An allowed_keys file that may change while a server runs: ask now and then.
class AllowListFile {
 public:
  explicit AllowListFile(std::string path) : path_(std::move(path)) {}
  // The list, if the file is another one than at the last call (the first call always gives it, empty
  // if there is no file); nothing if it is the same. A file that does not parse is an error and leaves
  // the list in force as it was.
  Result<std::optional<AllowList>> Changed();

 private:
  std::string path_;
  std::string last_;  // its text at the last call
  bool asked_ = false;
};

// $REALITYGRAD_KEYS, or $XDG_CONFIG_HOME/realitygrad/keys, or ~/.config/realitygrad/keys.
std::string DefaultKeyFolder();

}  // namespace rg::transport
