// Sessions: frames of one robot, streamed into a map through broken connections.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <variant>

#include "waypost/errors.hpp"
#include "waypost/frame.hpp"
#include "waypost/options.hpp"
#include "waypost/v1/session.pb.h"

namespace waypost {

using FrameAnswer = v1::FrameAnswer;

// The server did not take a frame. Nothing has changed, and the stream goes on.
struct FrameRefused {
  std::uint64_t sequence;
  // What is wrong and how to mend it.
  ServerError error;
};

// What became of a frame: an answer, or the server's refusal.
class FrameOutcome {
 public:
  explicit FrameOutcome(FrameAnswer answer) : what_(std::move(answer)) {}
  explicit FrameOutcome(FrameRefused refusal) : what_(std::move(refusal)) {}

  std::uint64_t sequence() const;
  // The answer. Throws what the server refused the frame with, such as InvalidArgument.
  const FrameAnswer& answer() const;
  // Null if the frame was answered.
  const FrameRefused* refusal() const noexcept { return std::get_if<FrameRefused>(&what_); }

 private:
  std::variant<FrameAnswer, FrameRefused> what_;
};

// Which session to open, and how to keep it.
struct SessionOptions {
  // `{map}` or `maps/{map}`.
  std::string map = {};
  // Name of the session within the map; the server makes one up if it is empty. One that exists is resumed.
  std::string session_id = {};
  // SESSION_MODE_LOCALIZE reads the map and never changes it.
  v1::SessionMode mode = v1::SESSION_MODE_MAP;
  // How the robot sees; a session that is resumed keeps the camera that it began with.
  std::optional<v1::Camera> camera = std::nullopt;
  // `words_hash` of the model that the robot's words are of; needed to send words.
  std::string words_hash = {};
  // While localizing: names a run of the robot. A session that another run left starts again.
  std::string run_id = {};
  // How many frames may be without an outcome. They are kept in memory, and `post` waits for room.
  std::size_t window_frames = 8;
  Reconnection reconnection = {};
  // Called with what became of each frame, in the order of sending, in place of `receive`: by a thread of the
  // session's own, in which it must not wait for the session. What it throws ends the session.
  std::function<void(FrameOutcome)> on_outcome = {};
  // Called by the same thread with a sentence when the server was lost, and when it is back.
  std::function<void(const std::string&)> on_notice = {};
};

class SessionExchange;

// One run of one robot, being streamed into a map. Made by `Client::open_session`. Several threads may use it; frames
// have to come in the order of their numbers.
//
// Every frame gets exactly one outcome, in the order of sending, whatever happens to the connection: frames without an
// outcome are sent again, under the same numbers. When the session is over, every call throws why: a ServerError if
// the server ended it (Aborted when another stream took it over, NotFound when its map was deleted), SessionLost,
// SessionRewound.
class Session {
 public:
  explicit Session(std::unique_ptr<SessionExchange> exchange) noexcept;
  // Gives up frames that have no outcome yet; they may be durable all the same. `close` first waits for them.
  ~Session();
  Session(Session&&) noexcept;
  Session& operator=(Session&&) noexcept;

  // maps/{map}/sessions/{session}
  std::string name() const;
  // The session as the server opened it, with its model and that one's `words_hash`.
  v1::SessionOpened opened() const;
  // The last frame that is known to be durable; none in a new session. Send from the next one on.
  std::optional<std::uint64_t> last_committed_sequence() const;

  // Sends a frame and waits for its answer. Throws what the server refuses the frame with; the session goes on then.
  // Not between `post` and `receive`, and not with `on_outcome`.
  FrameAnswer send(Frame frame);

  // Sends a frame without waiting for its answer; waits only while the window is full.
  void post(Frame frame);
  // As `post`, but never waits: false if the window is full, and the frame is left as it was. For callbacks of a
  // camera.
  bool try_post(Frame&& frame);
  // The outcome of the next frame that was posted; none once the session is finished and every frame had its own.
  std::optional<FrameOutcome> receive();
  // As `receive`; also none if no outcome came in time.
  std::optional<FrameOutcome> receive_for(std::chrono::nanoseconds timeout);

  // Says that no more frames come. The outcomes of those that were posted still do.
  void finish();
  // Finishes and waits until every frame has its outcome.
  void close();

 private:
  std::unique_ptr<SessionExchange> exchange_;
};

}  // namespace waypost
