// Outcome of an operation on untrusted data or on the outside world.
//
// Status is a value: a code that tells a caller what to do (retry by code: unavailable -> the same
// call; aborted -> a new attempt; invalid -> never) and one clear line for a person, which names
// file, row, field, value and limit where there are any. Result<T> is a Status or a T.
// Numerical outcomes are results of their own (a summary), bugs are RG_CHECKs; neither is a Status.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <utility>

#include "common/base/check.h"

namespace rg {

enum class StatusCode {
  kOk = 0,
  kInvalid = 1,  // the input is wrong; never retry
  kNotFound = 2,
  kAlreadyExists = 3,
  kFailedPrecondition = 4,  // the system is not in the state this needs
  kUnavailable = 5,         // a peer is away; retry the same call
  kAborted = 6,             // lost a race or a lease; retry as a new attempt
  kDeadlineExceeded = 7,
  kCancelled = 8,
  kDataLoss = 9,            // bytes do not match their hash, a file is truncated
  kResourceExhausted = 10,  // disk full, size limit
  kPermissionDenied = 11,
  kInternal = 12,
};

std::string_view StatusCodeName(StatusCode code);

class [[nodiscard]] Status {
 public:
  Status() = default;
  Status(StatusCode code, std::string message) : code_(code), message_(std::move(message)) {}
  static Status Ok() { return {}; }

  bool ok() const { return code_ == StatusCode::kOk; }
  StatusCode code() const { return code_; }
  const std::string& message() const { return message_; }
  // "invalid: rec_000.csv: row 12, column position.elbow: NaN"
  std::string ToString() const;
  // The same code with `prefix` and ": " before the message; Ok stays Ok.
  Status WithPrefix(std::string_view prefix) const;

 private:
  StatusCode code_ = StatusCode::kOk;
  std::string message_;
};

Status InvalidError(std::string message);
Status NotFoundError(std::string message);
Status AlreadyExistsError(std::string message);
Status FailedPreconditionError(std::string message);
Status UnavailableError(std::string message);
Status AbortedError(std::string message);
Status DeadlineExceededError(std::string message);
Status CancelledError(std::string message);
Status DataLossError(std::string message);
Status ResourceExhaustedError(std::string message);
Status PermissionDeniedError(std::string message);
Status InternalError(std::string message);

template <class T>
class [[nodiscard]] Result {
 public:
  Result(T value) : value_(std::move(value)) {}         // NOLINT: implicit by design
  Result(Status status) : status_(std::move(status)) {  // NOLINT: implicit by design
    RG_CHECK(!status_.ok()) << "Result built from an Ok status without a value";
  }

  bool ok() const { return value_.has_value(); }
  const Status& status() const { return status_; }
  const T& value() const& {
    RG_CHECK(ok()) << status_.ToString();
    return *value_;
  }
  T& value() & {
    RG_CHECK(ok()) << status_.ToString();
    return *value_;
  }
  T&& value() && {
    RG_CHECK(ok()) << status_.ToString();
    return std::move(*value_);
  }
  const T& operator*() const& { return value(); }
  T& operator*() & { return value(); }
  T&& operator*() && { return std::move(*this).value(); }
  const T* operator->() const { return &value(); }
  T* operator->() { return &value(); }

 private:
  Status status_;
  std::optional<T> value_;
};

#define RG_CONCAT_INNER(a, b) a##b
#define RG_CONCAT(a, b) RG_CONCAT_INNER(a, b)

#define RG_RETURN_IF_ERROR(expr)             \
  do {                                       \
    ::rg::Status rg_status_ = (expr);        \
    if (!rg_status_.ok()) return rg_status_; \
  } while (0)

// RG_ASSIGN_OR_RETURN(auto model, LoadModel(path));
#define RG_ASSIGN_OR_RETURN(lhs, expr) RG_ASSIGN_OR_RETURN_INNER(RG_CONCAT(rg_result_, __LINE__), lhs, expr)
#define RG_ASSIGN_OR_RETURN_INNER(result, lhs, expr) \
  auto result = (expr);                              \
  if (!result.ok()) return result.status();          \
  lhs = std::move(result).value()

}  // namespace rg
