// A channel with what calls over it need to know.
#pragma once

#include <grpcpp/channel.h>

#include <chrono>
#include <memory>
#include <string>

#include "waypost/options.hpp"

namespace waypost {

// It mends itself for the next call when it broke.
class Connection {
 public:
  // Throws InvalidUse if address, token or certificates cannot be used.
  explicit Connection(const ClientOptions& options);

  const std::shared_ptr<grpc::Channel>& channel() const { return channel_; }
  const std::string& address() const { return address_; }
  std::chrono::milliseconds connect_timeout() const { return connect_timeout_; }
  std::chrono::milliseconds call_timeout() const { return call_timeout_; }

 private:
  std::string address_;
  std::chrono::milliseconds connect_timeout_;
  std::chrono::milliseconds call_timeout_;
  std::shared_ptr<grpc::Channel> channel_;
};

// `maps/hall` of `hall` or of itself.
std::string map_name(const std::string& map);

// The part of a resource's name that is its own: `monday` of `maps/hall/sessions/monday`.
std::string last_part(const std::string& name);

}  // namespace waypost
