#include "backoff.hpp"

#include <algorithm>

#include "waypost/errors.hpp"

namespace waypost {

std::uint64_t random_seed() {
  std::random_device device;
  return std::uint64_t{device()} << 32 | device();
}

Backoff::Backoff(Reconnection settings, std::uint64_t seed)
    : settings_(settings), jitter_(seed), delay_(settings.first_delay) {
  if (settings.first_delay.count() <= 0 || settings.longest_delay.count() <= 0 || settings.give_up_after.count() < 0) {
    throw InvalidUse("the delays of a reconnection must be above 0, and give_up_after 0 or more");
  }
}

std::optional<Clock::duration> Backoff::next_delay(Clock::time_point now) {
  if (!trouble_since_) trouble_since_ = now;
  const Clock::duration left = settings_.give_up_after - (now - *trouble_since_);
  if (left <= Clock::duration::zero()) return std::nullopt;
  const Clock::duration full = std::min<Clock::duration>(delay_, settings_.longest_delay);
  delay_ = 2 * full;
  const double part = std::uniform_real_distribution<double>(0.5, 1.0)(jitter_);
  return std::min(std::chrono::duration_cast<Clock::duration>(part * full), left);
}

void Backoff::progress() {
  delay_ = settings_.first_delay;
  trouble_since_.reset();
}

std::chrono::seconds Backoff::waited(Clock::time_point now) const {
  if (!trouble_since_) return std::chrono::seconds{0};
  return std::chrono::duration_cast<std::chrono::seconds>(now - *trouble_since_);
}

}  // namespace waypost
