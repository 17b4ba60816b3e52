#include "last_command.hpp"

#include <algorithm>
#include <chrono>

namespace waypost {
namespace {

// Longer ones are none that a server gives: a command must not outlive its server by hours.
constexpr std::chrono::seconds longest_validity{60};

}  // namespace

void LastCommand::set(const v1::VelocityCommand& command, Clock::time_point arrived) {
  const auto valid = std::min<std::chrono::nanoseconds>(std::chrono::nanoseconds(command.valid_ns()), longest_validity);
  command_ = Valid{{command.forward_m_s(), command.turn_rad_s()}, command.number(), arrived + valid};
}

Command LastCommand::obey(Clock::time_point now) {
  if (!command_ || now >= command_->until) return {};
  obeyed_ = command_->number;
  return command_->command;
}

}  // namespace waypost
