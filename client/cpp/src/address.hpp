// Addresses of servers.
#pragma once

#include <string>

namespace waypost {

enum class Scheme { unsaid, http, https };

// Host and port as gRPC wants them.
struct Address {
  std::string target;
  Scheme scheme;
};

// Reads HOST:PORT, http://HOST:PORT or https://HOST:PORT. Throws InvalidUse if it is none of them.
Address parse_address(const std::string& address);

}  // namespace waypost
