// The last command from the server, and how long it is valid.
#pragma once

#include <cstdint>
#include <optional>

#include "backoff.hpp"
#include "waypost/navigation.hpp"

namespace waypost {

// Until the first command, and after the last one lapsed, it is a stop.
class LastCommand {
 public:
  // Keeps a command. It is valid since it arrived, however late this is called.
  void set(const v1::VelocityCommand& command, Clock::time_point arrived);
  // From now on, a stop.
  void forget() { command_.reset(); }
  // The command if it is still valid, which then counts as obeyed; otherwise a stop.
  Command obey(Clock::time_point now);
  // Number of the last one that the application read.
  std::optional<std::uint64_t> obeyed() const { return obeyed_; }

 private:
  struct Valid {
    Command command;
    std::uint64_t number;
    Clock::time_point until;
  };
  std::optional<Valid> command_;
  std::optional<std::uint64_t> obeyed_;
};

}  // namespace waypost
