#include "waypost/errors.hpp"

namespace waypost {

std::string_view name_of(Code code) noexcept {
  switch (code) {
    case Code::cancelled: return "CANCELLED";
    case Code::unknown: return "UNKNOWN";
    case Code::invalid_argument: return "INVALID_ARGUMENT";
    case Code::deadline_exceeded: return "DEADLINE_EXCEEDED";
    case Code::not_found: return "NOT_FOUND";
    case Code::already_exists: return "ALREADY_EXISTS";
    case Code::permission_denied: return "PERMISSION_DENIED";
    case Code::resource_exhausted: return "RESOURCE_EXHAUSTED";
    case Code::failed_precondition: return "FAILED_PRECONDITION";
    case Code::aborted: return "ABORTED";
    case Code::out_of_range: return "OUT_OF_RANGE";
    case Code::unimplemented: return "UNIMPLEMENTED";
    case Code::internal: return "INTERNAL";
    case Code::unavailable: return "UNAVAILABLE";
    case Code::data_loss: return "DATA_LOSS";
    case Code::unauthenticated: return "UNAUTHENTICATED";
  }
  return "UNKNOWN";
}

void ServerError::raise() const {
  switch (code_) {
    case Code::invalid_argument: throw InvalidArgument(code_, what(), retry_after_);
    case Code::not_found: throw NotFound(code_, what(), retry_after_);
    case Code::already_exists: throw AlreadyExists(code_, what(), retry_after_);
    case Code::failed_precondition: throw FailedPrecondition(code_, what(), retry_after_);
    case Code::aborted: throw Aborted(code_, what(), retry_after_);
    case Code::resource_exhausted: throw ResourceExhausted(code_, what(), retry_after_);
    case Code::unavailable: throw Unavailable(code_, what(), retry_after_);
    case Code::unauthenticated: throw Unauthenticated(code_, what(), retry_after_);
    case Code::permission_denied: throw PermissionDenied(code_, what(), retry_after_);
    case Code::cancelled:
    case Code::unknown:
    case Code::deadline_exceeded:
    case Code::out_of_range:
    case Code::unimplemented:
    case Code::internal:
    case Code::data_loss: break;
  }
  throw ServerError(code_, what(), retry_after_);
}

}  // namespace waypost
