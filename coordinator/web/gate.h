// Who may see the page. Pure, no I/O but for the token's file.
//
// On a loopback address, without a token: whoever is on this machine, asking for this machine by name (a page
// of another site that has its name resolve to 127.0.0.1 asks under its own name and is refused). Anywhere
// else: who has the token, as a bearer ("Authorization: Bearer TOKEN") or in the cookie that the login sets.
#pragma once

#include <string>

#include "common/base/status.h"

namespace rg::coordinator::web {

struct ListenAddress {
  std::string host;  // numeric, without brackets
  int port = 0;      // 0: any free one
  bool loopback = false;
};

// "127.0.0.1:7342", "[::1]:0", "0.0.0.0:7342", "localhost:7342". kInvalid otherwise.
Result<ListenAddress> ParseListenAddress(const std::string& text);

// The token in `path`; made (256 random bits, mode 0600) if there is no such file. kPermissionDenied if
// others than the owner may read it, kInvalid if it is shorter than 16 characters.
Result<std::string> LoadOrMakeToken(const std::string& path);

struct Credentials {
  std::string host;           // the header "Host"
  std::string authorization;  // the header "Authorization"
  std::string cookie;         // the header "Cookie"
};

class Gate {
 public:
  // `token` empty: none is needed.
  Gate(ListenAddress address, std::string token) : address_(std::move(address)), token_(std::move(token)) {}
  bool needs_token() const { return !token_.empty(); }
  bool Admits(const Credentials& who) const;
  bool IsToken(const std::string& text) const;  // in constant time
  // The value of "Set-Cookie" after a login.
  std::string Cookie() const;

 private:
  ListenAddress address_;
  std::string token_;
};

}  // namespace rg::coordinator::web
