#include "address.hpp"

#include <algorithm>
#include <cctype>
#include <string_view>

#include "waypost/errors.hpp"

namespace waypost {
namespace {

[[noreturn]] void refuse(const std::string& address, std::string_view reason) {
  throw InvalidUse("`" + address + "` is not the address of a server (" + std::string(reason) +
                   "); write it as HOST:PORT, http://HOST:PORT or https://HOST:PORT");
}

Scheme scheme_of(const std::string& address, std::string_view scheme) {
  if (scheme == "http") return Scheme::http;
  if (scheme == "https") return Scheme::https;
  refuse(address, "the scheme `" + std::string(scheme) + "` is not served");
}

// Where the port begins; npos if there is none. In brackets, colons are part of an address of IPv6.
std::size_t port_begin(std::string_view authority) {
  const std::size_t colon = authority.rfind(':');
  const std::size_t bracket = authority.rfind(']');
  return bracket != std::string_view::npos && colon < bracket ? std::string_view::npos : colon;
}

bool is_port(std::string_view port) {
  const bool digits = std::all_of(port.begin(), port.end(), [](unsigned char c) { return std::isdigit(c) != 0; });
  return !port.empty() && port.size() <= 5 && digits && std::stoi(std::string(port)) <= 65'535;
}

}  // namespace

Address parse_address(const std::string& address) {
  std::string_view rest = address;
  Scheme scheme = Scheme::unsaid;
  if (const std::size_t separator = rest.find("://"); separator != std::string_view::npos) {
    scheme = scheme_of(address, rest.substr(0, separator));
    rest.remove_prefix(separator + 3);
  }
  if (!rest.empty() && rest.back() == '/') rest.remove_suffix(1);
  if (rest.find_first_of("/?#@") != std::string_view::npos) refuse(address, "it has more than a host and a port");
  const bool blank = std::any_of(rest.begin(), rest.end(), [](unsigned char c) { return std::isspace(c) != 0; });
  const std::size_t colon = port_begin(rest);
  const std::string host(rest.substr(0, colon));
  if (blank || host.empty()) refuse(address, "it names no host");
  if (host.find(':') != std::string::npos && host.front() != '[') refuse(address, "IPv6 is written in brackets");
  if (colon == std::string_view::npos) {
    if (scheme == Scheme::unsaid) refuse(address, "it lacks a port");
    return {host + (scheme == Scheme::http ? ":80" : ":443"), scheme};
  }
  if (!is_port(rest.substr(colon + 1))) refuse(address, "its port is no number from 0 to 65535");
  return {std::string(rest), scheme};
}

}  // namespace waypost
