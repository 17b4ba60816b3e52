// Statuses, of calls and in messages, as errors.
#pragma once

#include <grpcpp/support/status.h>

#include <string>

#include "google/rpc/status.pb.h"
#include "waypost/errors.hpp"

namespace waypost {

// The error of a status that came as a message.
ServerError error_of(const google::rpc::Status& status);

// The error of a status that the server ended a call with.
ServerError error_of(const grpc::Status& status);

// Whether another attempt may help after a stream ended so. OK and UNKNOWN stand for a stream that was cut off.
bool is_passing(const grpc::Status& status);

// Why a stream ended, in words.
std::string reason_of(const grpc::Status& status);

// Throws what a stream ended with that no other attempt helps against.
[[noreturn]] void throw_stream_end(const grpc::Status& status, const std::string& address);

// Whether what answered does not speak gRPC.
bool is_not_grpc(const grpc::Status& status);

// What to say then.
std::string not_grpc(const std::string& address);

}  // namespace waypost
