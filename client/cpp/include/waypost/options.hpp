// Where a server is, how to be let in, and how long to wait for it.
#pragma once

#include <chrono>
#include <filesystem>
#include <optional>
#include <string>

namespace waypost {

// A server's address, with the token and the certificates for it. What is left out comes from the environment, by
// the names that the command line has; an empty variable counts as unset.
struct ClientOptions {
  // HOST:PORT, http://HOST:PORT or https://HOST:PORT. WAYPOST_SERVER, otherwise http://127.0.0.1:7600.
  std::optional<std::string> address;
  // Secret of a token. WAYPOST_TOKEN, otherwise none.
  std::optional<std::string> token;
  // The authority that issued the server's certificate (PEM). WAYPOST_CA, otherwise those that the system trusts.
  std::optional<std::filesystem::path> ca_file;
  // A certificate and its key, for servers that require one (PEM). WAYPOST_CLIENT_CERT and WAYPOST_CLIENT_KEY.
  std::optional<std::filesystem::path> client_certificate_file;
  std::optional<std::filesystem::path> client_key_file;
  // How long a connection may take.
  std::chrono::milliseconds connect_timeout{5'000};
  // How long a call may take that is no stream.
  std::chrono::milliseconds call_timeout{60'000};

  ClientOptions() = default;
  // An address alone. Not explicit: where neither token nor certificates are needed, it is all there is to say.
  ClientOptions(std::string of_server) : address(std::move(of_server)) {}
  ClientOptions(const char* of_server) : address(of_server) {}
};

// How a broken stream is mended: after delays that double. Each is shortened at random by up to half, so that robots
// do not all come back at once.
struct Reconnection {
  std::chrono::milliseconds first_delay{100};
  std::chrono::milliseconds longest_delay{5'000};
  // Time without progress after which the stream is given up.
  std::chrono::milliseconds give_up_after{60'000};
};

}  // namespace waypost
