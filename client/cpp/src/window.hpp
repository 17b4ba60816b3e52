// The frames that have no outcome yet, in the order they were given.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>

#include "waypost/session.hpp"
#include "waypost/v1/session.pb.h"

namespace waypost {

// Every frame from when the application gives it until its outcome is given back.
class Window {
 public:
  using Request = std::shared_ptr<const v1::StreamRequest>;

  // The server asks to send a frame again.
  struct Postponed {
    std::string message;
    // Zero if the server named no time.
    std::chrono::nanoseconds delay;
  };

  // Adds a frame. An image that is too long for any server is refused here.
  void push(Request frame);
  // The next frame to send, which then counts as sent; null if there is none. No frame overtakes a postponed one: once
  // a higher number is committed, the server takes no lower one.
  Request next_to_send();
  // Records what the server said of a frame. Throws ProtocolError if no frame of that number is under way.
  std::optional<Postponed> settle(FrameOutcome outcome);
  // The outcome of the oldest frame, which then leaves the window.
  std::optional<FrameOutcome> take_outcome();

  // Whether all frames that were sent are settled, and some of them are to be sent again.
  bool only_postponed_left() const;
  // Postponed frames may go again.
  void release_postponed();
  // After a broken connection: every frame without an outcome is sent again, also those that were committed while their
  // answer was lost. They get the stored answer.
  void send_again();

  std::size_t size() const { return entries_.size(); }
  // The last frame that the server reported as durable.
  std::optional<std::uint64_t> last_acknowledged() const { return last_acknowledged_; }

 private:
  enum class Progress {
    // Not yet sent over this connection.
    waiting,
    in_flight,
    postponed,
    done,
  };
  struct Entry {
    Request frame;
    Progress progress;
    std::optional<FrameOutcome> outcome;
  };

  std::size_t count(Progress progress) const;

  std::deque<Entry> entries_;
  std::optional<std::uint64_t> last_acknowledged_;
  // Most frames in flight after the server has postponed one. Frames behind one that is postponed again would be
  // uploaded for nothing.
  std::optional<std::size_t> in_flight_limit_;
};

}  // namespace waypost
