// The token that goes with every call.
#pragma once

#include <grpcpp/support/client_interceptor.h>

#include <memory>
#include <string>
#include <vector>

namespace waypost {

// Interceptors that add `authorization: Bearer SECRET`; gRPC's own call credentials refuse to without TLS. Throws
// InvalidUse if the secret has characters that no header can have.
std::vector<std::unique_ptr<grpc::experimental::ClientInterceptorFactoryInterface>> bearer(const std::string& secret);

}  // namespace waypost
