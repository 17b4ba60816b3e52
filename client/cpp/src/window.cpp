#include "window.hpp"

#include <algorithm>
#include <utility>

namespace waypost {
namespace {

FrameRefused too_long(std::uint64_t sequence, std::size_t length_bytes) {
  const std::string message = "the image has " + std::to_string(length_bytes) + " bytes, more than " +
                              std::to_string(max_image_bytes) + "; make it smaller or compress it harder";
  return {sequence, ServerError(Code::invalid_argument, message)};
}

}  // namespace

void Window::push(Request frame) {
  const std::uint64_t sequence = frame->frame().sequence();
  const std::size_t length_bytes = frame->frame().image().size();
  if (length_bytes <= max_image_bytes) {
    entries_.push_back({std::move(frame), Progress::waiting, std::nullopt});
  } else {
    entries_.push_back({std::move(frame), Progress::done, FrameOutcome(too_long(sequence, length_bytes))});
  }
}

Window::Request Window::next_to_send() {
  if (in_flight_limit_ && count(Progress::in_flight) >= *in_flight_limit_) return nullptr;
  for (Entry& entry : entries_) {
    if (entry.progress == Progress::postponed) return nullptr;
    if (entry.progress == Progress::waiting) {
      entry.progress = Progress::in_flight;
      return entry.frame;
    }
  }
  return nullptr;
}

std::optional<Window::Postponed> Window::settle(FrameOutcome outcome) {
  const std::uint64_t sequence = outcome.sequence();
  const auto entry = std::find_if(entries_.begin(), entries_.end(), [sequence](const Entry& candidate) {
    return candidate.progress == Progress::in_flight && candidate.frame->frame().sequence() == sequence;
  });
  if (entry == entries_.end()) {
    throw ProtocolError("the server answered frame " + std::to_string(sequence) +
                        ", which was not sent; use a server and a client of the same version");
  }
  if (const FrameRefused* refused = outcome.refusal()) {
    const Code code = refused->error.code();
    if (code == Code::unavailable || code == Code::resource_exhausted) {
      entry->progress = Progress::postponed;
      in_flight_limit_ = 1;
      return Postponed{refused->error.what(), refused->error.retry_after().value_or(std::chrono::nanoseconds{0})};
    }
  } else {
    last_acknowledged_ = std::max(last_acknowledged_.value_or(0), sequence);
    // Twice as many, up to any window.
    if (in_flight_limit_) in_flight_limit_ = std::min<std::size_t>(2 * *in_flight_limit_, std::size_t{1} << 32);
  }
  entry->progress = Progress::done;
  entry->outcome = std::move(outcome);
  return std::nullopt;
}

std::optional<FrameOutcome> Window::take_outcome() {
  if (entries_.empty() || !entries_.front().outcome) return std::nullopt;
  std::optional<FrameOutcome> outcome = std::move(entries_.front().outcome);
  entries_.pop_front();
  return outcome;
}

bool Window::only_postponed_left() const { return count(Progress::postponed) > 0 && count(Progress::in_flight) == 0; }

void Window::release_postponed() {
  for (Entry& entry : entries_) {
    if (entry.progress == Progress::postponed) entry.progress = Progress::waiting;
  }
}

void Window::send_again() {
  for (Entry& entry : entries_) {
    if (entry.progress != Progress::done) entry.progress = Progress::waiting;
  }
}

std::size_t Window::count(Progress progress) const {
  const auto found = std::count_if(entries_.begin(), entries_.end(),
                                   [progress](const Entry& entry) { return entry.progress == progress; });
  return static_cast<std::size_t>(found);
}

}  // namespace waypost
