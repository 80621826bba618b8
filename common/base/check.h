// RG_CHECK(condition) << "context";  A bug in this program, not bad input: prints file, line,
// condition and context to stderr and aborts. Always on, at public boundaries only.
#pragma once

#include <sstream>

namespace rg::internal {

class CheckFailure {
 public:
  CheckFailure(const char* file, int line, const char* condition);
  [[noreturn]] ~CheckFailure();
  std::ostream& stream() { return stream_; }

 private:
  std::ostringstream stream_;
};

}  // namespace rg::internal

#define RG_CHECK(condition) \
  if (condition)            \
    [[likely]];             \
  else                      \
    ::rg::internal::CheckFailure(__FILE__, __LINE__, #condition).stream()
