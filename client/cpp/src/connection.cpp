#include "connection.hpp"

#include <grpcpp/create_channel.h>
#include <grpcpp/security/credentials.h>
#include <grpcpp/support/channel_arguments.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <optional>

#include "address.hpp"
#include "bearer.hpp"
#include "waypost/errors.hpp"

namespace waypost {
namespace {

constexpr const char* default_address = "http://127.0.0.1:7600";
constexpr const char* begin_certificate = "-----BEGIN CERTIFICATE-----";
// A page of places is the longest answer: 100 places with 100 frames each, about 2 MiB.
constexpr int max_answer_bytes = 16 << 20;
// A peer that vanished without a word is noticed after twice this.
constexpr int keep_alive_ms = 10'000;
// The channel's own delays, up to two minutes, would outlast the patience of streams.
constexpr int first_connect_delay_ms = 100;
constexpr int longest_connect_delay_ms = 1'000;

// An empty variable counts as unset.
std::optional<std::string> variable(const char* name) {
  const char* value = std::getenv(name);
  if (value == nullptr || *value == '\0') return std::nullopt;
  return value;
}

template <class Value>
std::optional<Value> or_variable(const std::optional<Value>& given, const char* name) {
  if (given) return given;
  if (const auto found = variable(name)) return Value(*found);
  return std::nullopt;
}

std::string read_pem(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  std::string pem{std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
  if (!in) throw InvalidUse("cannot read " + file.string() + "; give a file of PEM that this user may read");
  return pem;
}

struct Certificates {
  std::optional<std::filesystem::path> ca;
  std::optional<std::filesystem::path> certificate;
  std::optional<std::filesystem::path> key;

  bool any() const { return ca || certificate; }
};

Certificates certificates_of(const ClientOptions& options) {
  Certificates found{or_variable(options.ca_file, "WAYPOST_CA"),
                     or_variable(options.client_certificate_file, "WAYPOST_CLIENT_CERT"),
                     or_variable(options.client_key_file, "WAYPOST_CLIENT_KEY")};
  if (found.certificate.has_value() != found.key.has_value()) {
    throw InvalidUse("a certificate and its key go together; give both client_certificate_file and client_key_file");
  }
  return found;
}

std::shared_ptr<grpc::ChannelCredentials> credentials(const Certificates& certificates) {
  grpc::SslCredentialsOptions tls;
  if (certificates.ca) {
    tls.pem_root_certs = read_pem(*certificates.ca);
    if (tls.pem_root_certs.find(begin_certificate) == std::string::npos) {
      throw InvalidUse("the authority's certificate (ca_file) is not in PEM; it must have a part that begins with " +
                       std::string(begin_certificate));
    }
  }
  if (certificates.certificate) {
    tls.pem_cert_chain = read_pem(*certificates.certificate);
    tls.pem_private_key = read_pem(*certificates.key);
  }
  return grpc::SslCredentials(tls);
}

grpc::ChannelArguments arguments(std::chrono::milliseconds connect_timeout) {
  grpc::ChannelArguments arguments;
  arguments.SetMaxReceiveMessageSize(max_answer_bytes);
  arguments.SetUserAgentPrefix("waypost-cpp");
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIME_MS, keep_alive_ms);
  arguments.SetInt(GRPC_ARG_KEEPALIVE_TIMEOUT_MS, keep_alive_ms);
  arguments.SetInt(GRPC_ARG_INITIAL_RECONNECT_BACKOFF_MS, first_connect_delay_ms);
  arguments.SetInt(GRPC_ARG_MAX_RECONNECT_BACKOFF_MS, longest_connect_delay_ms);
  // This one is the time that a connection may take.
  arguments.SetInt(GRPC_ARG_MIN_RECONNECT_BACKOFF_MS, static_cast<int>(connect_timeout.count()));
  // A new client tries at once, whatever delay another one of this process is waiting for.
  arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
  return arguments;
}

std::shared_ptr<grpc::Channel> open_channel(const ClientOptions& options, const std::string& address) {
  const auto [target, scheme] = parse_address(address);
  const Certificates certificates = certificates_of(options);
  if (scheme == Scheme::http && certificates.any()) {
    throw InvalidUse("certificates are given, but " + address + " is not encrypted; write https:// or leave them out");
  }
  const bool encrypted = scheme == Scheme::https || certificates.any();
  auto let_in = encrypted ? credentials(certificates) : grpc::InsecureChannelCredentials();
  std::vector<std::unique_ptr<grpc::experimental::ClientInterceptorFactoryInterface>> interceptors;
  if (const auto token = or_variable(options.token, "WAYPOST_TOKEN")) interceptors = bearer(*token);
  return grpc::experimental::CreateCustomChannelWithInterceptors(target, let_in, arguments(options.connect_timeout),
                                                                 std::move(interceptors));
}

}  // namespace

Connection::Connection(const ClientOptions& options)
    : address_(or_variable(options.address, "WAYPOST_SERVER").value_or(default_address)),
      connect_timeout_(options.connect_timeout),
      call_timeout_(options.call_timeout) {
  if (connect_timeout_.count() <= 0 || call_timeout_.count() <= 0) {
    throw InvalidUse("connect_timeout and call_timeout must be above 0");
  }
  channel_ = open_channel(options, address_);
}

std::string map_name(const std::string& map) { return map.rfind("maps/", 0) == 0 ? map : "maps/" + map; }

std::string last_part(const std::string& name) { return name.substr(name.rfind('/') + 1); }

}  // namespace waypost
