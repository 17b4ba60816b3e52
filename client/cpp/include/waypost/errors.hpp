// What can go wrong. Every exception of this library is a `waypost::Error`, and `what()` says what to do.
#pragma once

#include <chrono>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>

namespace waypost {

// Anything that this library throws on purpose.
class Error : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

// An address, an option or a frame that no server would take, or a call at the wrong time.
class InvalidUse : public Error {
 public:
  using Error::Error;
};

// Nobody answered at the address, or the connection broke in the middle of a call.
class ServerUnreachable : public Error {
 public:
  using Error::Error;
};

// The server stayed away, or asked to send a frame again, for too long. Open the same session once it is
// back, and send again what is above its `last_committed_sequence()`.
class SessionLost : public Error {
 public:
  using Error::Error;
};

// The server came back without frames that it had acknowledged as durable.
class SessionRewound : public Error {
 public:
  using Error::Error;
};

// The server answered with something that the contract does not allow.
class ProtocolError : public Error {
 public:
  using Error::Error;
};

// The kinds of refusals, by the numbers that gRPC has for them.
enum class Code : int {
  cancelled = 1,
  unknown = 2,
  invalid_argument = 3,
  deadline_exceeded = 4,
  not_found = 5,
  already_exists = 6,
  permission_denied = 7,
  resource_exhausted = 8,
  failed_precondition = 9,
  aborted = 10,
  out_of_range = 11,
  unimplemented = 12,
  internal = 13,
  unavailable = 14,
  data_loss = 15,
  unauthenticated = 16,
};

// As the contract writes it: NOT_FOUND.
std::string_view name_of(Code code) noexcept;

// The server refused. `what()` is its own sentence: what is wrong and how to mend it.
class ServerError : public Error {
 public:
  using RetryAfter = std::optional<std::chrono::nanoseconds>;

  ServerError(Code code, const std::string& message, RetryAfter retry_after = std::nullopt)
      : Error(message), code_(code), retry_after_(retry_after) {}

  Code code() const noexcept { return code_; }
  // When the server asks to try again, if it said so.
  RetryAfter retry_after() const noexcept { return retry_after_; }
  // Throws this as the class of its code, such as `NotFound`.
  [[noreturn]] void raise() const;

 private:
  Code code_;
  RetryAfter retry_after_;
};

// The request is wrong in itself.
class InvalidArgument : public ServerError {
 public:
  using ServerError::ServerError;
};

// There is no such thing.
class NotFound : public ServerError {
 public:
  using ServerError::ServerError;
};

// There is one of that name already.
class AlreadyExists : public ServerError {
 public:
  using ServerError::ServerError;
};

// It does not fit with how things stand, as words of another vocabulary do not fit with a map.
class FailedPrecondition : public ServerError {
 public:
  using ServerError::ServerError;
};

// Another stream took the session over.
class Aborted : public ServerError {
 public:
  using ServerError::ServerError;
};

// There is more to do than the server has room for; see `retry_after()`.
class ResourceExhausted : public ServerError {
 public:
  using ServerError::ServerError;
};

// Not now, but a little later; see `retry_after()`.
class Unavailable : public ServerError {
 public:
  using ServerError::ServerError;
};

// The server wants a token, or another one.
class Unauthenticated : public ServerError {
 public:
  using ServerError::ServerError;
};

// The token does not allow it.
class PermissionDenied : public ServerError {
 public:
  using ServerError::ServerError;
};

}  // namespace waypost
