// When to try again, and when to give up.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <random>

#include "waypost/options.hpp"

namespace waypost {

using Clock = std::chrono::steady_clock;

// Opening a large map takes a server seconds.
inline constexpr std::chrono::seconds opening_timeout{30};

// A random number, different in each call.
std::uint64_t random_seed();

// Time and delays since the last progress.
class Backoff {
 public:
  explicit Backoff(Reconnection settings, std::uint64_t seed = random_seed());

  // The delay before the next attempt; none if it is time to give up. The last attempt falls on that moment.
  std::optional<Clock::duration> next_delay(Clock::time_point now);
  // The server did what was asked: the next failure starts over with the first delay.
  void progress();
  // Whether there was a failure since the last progress.
  bool is_in_trouble() const { return trouble_since_.has_value(); }
  // Time since the first failure without progress afterwards, as a message says it.
  std::chrono::seconds waited(Clock::time_point now) const;

 private:
  Reconnection settings_;
  std::mt19937_64 jitter_;
  Clock::duration delay_;
  std::optional<Clock::time_point> trouble_since_;
};

}  // namespace waypost
