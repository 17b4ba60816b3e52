#include "status.hpp"

#include <google/protobuf/duration.pb.h>
#include <google/protobuf/io/coded_stream.h>
#include <google/protobuf/wire_format_lite.h>

#include <array>
#include <chrono>
#include <string_view>

namespace waypost {
namespace {

constexpr std::string_view retry_info = "/google.rpc.RetryInfo";
// The only field of RetryInfo, `google.protobuf.Duration retry_delay`. Its generated code is not part of this library:
// programs that link another copy of it would not start.
constexpr int retry_delay_field = 1;

bool ends_with(std::string_view text, std::string_view end) {
  return text.size() >= end.size() && text.substr(text.size() - end.size()) == end;
}

std::optional<std::chrono::nanoseconds> parse_retry_info(const std::string& bytes) {
  using google::protobuf::internal::WireFormatLite;
  google::protobuf::io::CodedInputStream in(reinterpret_cast<const std::uint8_t*>(bytes.data()),
                                            static_cast<int>(bytes.size()));
  while (const std::uint32_t tag = in.ReadTag()) {
    if (WireFormatLite::GetTagFieldNumber(tag) != retry_delay_field) {
      if (!WireFormatLite::SkipField(&in, tag)) return std::nullopt;
      continue;
    }
    std::uint32_t length = 0;
    std::string encoded;
    google::protobuf::Duration delay;
    if (!in.ReadVarint32(&length) || !in.ReadString(&encoded, static_cast<int>(length)) ||
        !delay.ParseFromString(encoded)) {
      return std::nullopt;
    }
    return std::chrono::seconds(delay.seconds()) + std::chrono::nanoseconds(delay.nanos());
  }
  return std::nullopt;
}

Code code_of(int number) {
  const bool known = number >= static_cast<int>(Code::cancelled) && number <= static_cast<int>(Code::unauthenticated);
  return known ? static_cast<Code>(number) : Code::unknown;
}

}  // namespace

ServerError error_of(const google::rpc::Status& status) {
  ServerError::RetryAfter retry_after;
  for (const auto& detail : status.details()) {
    if (ends_with(detail.type_url(), retry_info)) retry_after = parse_retry_info(detail.value());
  }
  return ServerError(code_of(status.code()), status.message(), retry_after);
}

ServerError error_of(const grpc::Status& status) {
  google::rpc::Status detailed;
  ServerError::RetryAfter retry_after;
  if (!status.error_details().empty() && detailed.ParseFromString(status.error_details())) {
    retry_after = error_of(detailed).retry_after();
  }
  return ServerError(code_of(status.error_code()), status.error_message(), retry_after);
}

bool is_passing(const grpc::Status& status) {
  switch (status.error_code()) {
    case grpc::OK:
    case grpc::CANCELLED:
    case grpc::UNKNOWN:
    case grpc::DEADLINE_EXCEEDED:
    case grpc::RESOURCE_EXHAUSTED:
    case grpc::UNAVAILABLE: return !is_not_grpc(status);
    case grpc::INVALID_ARGUMENT:
    case grpc::NOT_FOUND:
    case grpc::ALREADY_EXISTS:
    case grpc::PERMISSION_DENIED:
    case grpc::FAILED_PRECONDITION:
    case grpc::ABORTED:
    case grpc::OUT_OF_RANGE:
    case grpc::UNIMPLEMENTED:
    case grpc::INTERNAL:
    case grpc::DATA_LOSS:
    case grpc::UNAUTHENTICATED:
    case grpc::DO_NOT_USE: break;
  }
  return false;
}

std::string reason_of(const grpc::Status& status) {
  if (status.ok()) return "it closed the stream";
  if (!status.error_message().empty()) return status.error_message();
  return std::string(name_of(code_of(status.error_code())));
}

void throw_stream_end(const grpc::Status& status, const std::string& address) {
  if (is_not_grpc(status)) throw ServerUnreachable(not_grpc(address));
  error_of(status).raise();
}

bool is_not_grpc(const grpc::Status& status) {
  // What gRPC says of a server that speaks HTTP alone.
  constexpr std::array<std::string_view, 2> said = {"Received http2 header with status",
                                                    "Trying to connect an http1.x server"};
  for (const std::string_view words : said) {
    if (status.error_message().find(words) != std::string::npos) return true;
  }
  return false;
}

std::string not_grpc(const std::string& address) {
  return "what answers at " + address +
         " does not speak gRPC; it may be the server's HTTP port, 7601 unless set otherwise: give the one for robots, "
         "7600 unless set otherwise";
}

}  // namespace waypost
