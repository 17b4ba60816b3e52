#include "bearer.hpp"

#include <algorithm>
#include <utility>

#include "waypost/errors.hpp"

namespace waypost {
namespace {

using grpc::experimental::ClientInterceptorFactoryInterface;
using grpc::experimental::InterceptionHookPoints;
using grpc::experimental::Interceptor;
using grpc::experimental::InterceptorBatchMethods;

class BearerInterceptor final : public Interceptor {
 public:
  explicit BearerInterceptor(std::string header) : header_(std::move(header)) {}

  void Intercept(InterceptorBatchMethods* methods) override {
    if (methods->QueryInterceptionHookPoint(InterceptionHookPoints::PRE_SEND_INITIAL_METADATA)) {
      methods->GetSendInitialMetadata()->emplace("authorization", header_);
    }
    methods->Proceed();
  }

 private:
  std::string header_;
};

class BearerFactory final : public ClientInterceptorFactoryInterface {
 public:
  explicit BearerFactory(std::string header) : header_(std::move(header)) {}

  // gRPC owns what it is given.
  Interceptor* CreateClientInterceptor(grpc::experimental::ClientRpcInfo*) override {
    return std::make_unique<BearerInterceptor>(header_).release();
  }

 private:
  std::string header_;
};

// Secrets are often read from a file, with the end of its line.
std::string trimmed(const std::string& text) {
  constexpr const char* blanks = " \t\r\n";
  const std::size_t begin = text.find_first_not_of(blanks);
  if (begin == std::string::npos) return {};
  return text.substr(begin, text.find_last_not_of(blanks) - begin + 1);
}

}  // namespace

std::vector<std::unique_ptr<ClientInterceptorFactoryInterface>> bearer(const std::string& secret) {
  const std::string token = trimmed(secret);
  const bool printable = std::all_of(token.begin(), token.end(), [](unsigned char c) { return c >= 0x20 && c < 0x7f; });
  if (!printable) throw InvalidUse("the token has characters that no token has; copy it again");
  std::vector<std::unique_ptr<ClientInterceptorFactoryInterface>> factories;
  factories.push_back(std::make_unique<BearerFactory>("Bearer " + token));
  return factories;
}

}  // namespace waypost
