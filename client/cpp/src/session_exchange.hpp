// What keeps a session going: connect, send, receive, and again.
#pragma once

#include <deque>
#include <exception>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

#include "backoff.hpp"
#include "connection.hpp"
#include "link.hpp"
#include "waypost/session.hpp"
#include "waypost/v1/session.grpc.pb.h"
#include "window.hpp"

namespace waypost {

// This side of a session. Its worker, a thread of its own, talks to the server; the application's threads talk to the
// worker. The monitor guards all but constants.
class SessionExchange {
 public:
  // Returns once the session is open; throws why it is not.
  SessionExchange(std::shared_ptr<const Connection> connection, SessionOptions options);
  // Ends the stream at once.
  ~SessionExchange();
  SessionExchange(const SessionExchange&) = delete;
  SessionExchange& operator=(const SessionExchange&) = delete;

  v1::SessionOpened opened() const;
  std::optional<std::uint64_t> last_committed_sequence() const;
  FrameAnswer send(Frame frame);
  void post(Frame frame);
  bool try_post(Frame&& frame);
  // None if no outcome came until then.
  std::optional<FrameOutcome> receive(std::optional<Clock::time_point> until);
  void finish();
  void close();

 private:
  using Lock = std::unique_lock<std::mutex>;
  using SessionLink = Link<v1::StreamRequest, v1::StreamResponse>;

  // The worker, with the lock held but for waits and the application's callbacks.
  void run();
  void work(Lock& lock);
  // Why the link ended if another attempt may help; none if all is done.
  std::optional<std::string> talk(Lock& lock);
  std::optional<std::string> connect(Lock& lock);
  std::optional<std::string> converse(Lock& lock);
  void on_opened(const v1::SessionOpened& opened, Lock& lock);
  void on_response(const v1::StreamResponse& response);
  void postpone(const Window::Postponed& postponed);
  // Whether the application was called, so that anything may have changed.
  bool deliver(Lock& lock);
  std::string why_ended(const grpc::Status& status);
  Clock::duration delay_or_give_up(const std::string& reason);
  void notice(Lock& lock, const std::string& sentence);
  bool is_finished() const { return finished_ && window_.size() == 0; }
  v1::OpenSession opening() const;

  // The application's side, with the lock held.
  void push(Frame frame);
  void check_running() const;
  void check_sequence(std::uint64_t sequence) const;
  bool has_room() const { return window_.size() < options_.window_frames; }

  const std::shared_ptr<const Connection> connection_;
  const SessionOptions options_;
  const std::unique_ptr<v1::SessionService::Stub> stub_;
  const std::shared_ptr<Monitor> monitor_ = std::make_shared<Monitor>();
  // Only one thread at a time waits for its own answer.
  std::mutex sending_;

  Window window_;
  Backoff backoff_;
  std::unique_ptr<SessionLink> link_;
  std::optional<v1::SessionOpened> opened_;
  std::deque<FrameOutcome> outcomes_;
  std::optional<std::uint64_t> last_sequence_;
  // When postponed frames may go again.
  std::optional<Clock::time_point> release_at_;
  // What the server said of a retry as it ended the stream.
  Clock::duration least_delay_{0};
  bool finished_ = false;
  bool aborting_ = false;
  bool ended_ = false;
  // Why it ended, if not well.
  std::exception_ptr error_;
  std::thread worker_;
};

}  // namespace waypost
