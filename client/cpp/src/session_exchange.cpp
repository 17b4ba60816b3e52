#include "session_exchange.hpp"

#include <algorithm>
#include <utility>

#include "status.hpp"

namespace waypost {
namespace {

// Time for the server to end the stream after the last answer.
constexpr std::chrono::seconds closing_timeout{2};

// Lets go of a lock while the application is called, whatever that throws.
class Unlocked {
 public:
  explicit Unlocked(std::unique_lock<std::mutex>& lock) : lock_(lock) { lock_.unlock(); }
  ~Unlocked() { lock_.lock(); }
  Unlocked(const Unlocked&) = delete;
  Unlocked& operator=(const Unlocked&) = delete;

 private:
  std::unique_lock<std::mutex>& lock_;
};

[[noreturn]] void throw_rewound(std::uint64_t acknowledged, const v1::SessionOpened& opened) {
  const std::string known = opened.has_last_committed_sequence()
                                ? "frame " + std::to_string(opened.last_committed_sequence())
                                : "no frame at all";
  throw SessionRewound("the server had acknowledged frame " + std::to_string(acknowledged) +
                       " of this session, but now knows it only up to " + known +
                       "; its data was replaced by older data: restore that, or start a new session");
}

}  // namespace

void SessionExchange::run() {
  Lock lock(monitor_->mutex);
  try {
    work(lock);
  } catch (...) {
    error_ = std::current_exception();
  }
  if (link_) link_->cancel(lock);
  link_.reset();
  ended_ = true;
  monitor_->changed.notify_all();
}

void SessionExchange::work(Lock& lock) {
  while (const std::optional<std::string> reason = talk(lock)) {
    if (link_) link_->cancel(lock);
    link_.reset();
    if (aborting_ || is_finished()) return;
    window_.send_again();
    release_at_.reset();
    if (!backoff_.is_in_trouble()) {
      notice(lock, "lost the server (" + *reason + "); trying again, " + std::to_string(window_.size()) +
                       " frames without an answer");
    }
    const auto until = Clock::now() + std::max(delay_or_give_up(*reason), std::exchange(least_delay_, {}));
    monitor_->changed.wait_until(lock, until, [this] { return aborting_; });
  }
}

std::optional<std::string> SessionExchange::talk(Lock& lock) {
  if (const auto failed = connect(lock)) return failed;
  return converse(lock);
}

std::optional<std::string> SessionExchange::connect(Lock& lock) {
  v1::StreamRequest first;
  *first.mutable_open() = opening();
  link_ = SessionLink::open(monitor_, std::move(first), [this](grpc::ClientContext* context, auto* reactor) {
    stub_->async()->Stream(context, reactor);
  });
  const auto deadline = Clock::now() + opening_timeout;
  while (!aborting_) {
    if (const auto arrival = link_->take()) {
      if (!arrival->response.has_opened()) {
        throw ProtocolError("the server answered before the session was opened; use a server and a client of the "
                            "same version");
      }
      on_opened(arrival->response.opened(), lock);
      return std::nullopt;
    }
    if (const grpc::Status* status = link_->ended()) return why_ended(*status);
    if (monitor_->changed.wait_until(lock, deadline) == std::cv_status::timeout) {
      return "it did not open the session within " + std::to_string(opening_timeout.count()) + " s";
    }
  }
  return "the session was given up";
}

std::optional<std::string> SessionExchange::converse(Lock& lock) {
  while (!aborting_) {
    while (const auto arrival = link_->take()) {
      on_response(arrival->response);
      // At once: whatever ends the session afterwards, these have their outcomes.
      deliver(lock);
    }
    if (const grpc::Status* status = link_->ended()) return why_ended(*status);
    if (release_at_ && window_.only_postponed_left() && Clock::now() >= *release_at_) {
      window_.release_postponed();
      release_at_.reset();
    }
    while (auto frame = window_.next_to_send()) link_->send(std::move(frame));
    if (deliver(lock)) continue;
    if (is_finished()) {
      link_->finish(lock, Clock::now() + closing_timeout);
      return std::nullopt;
    }
    if (release_at_ && window_.only_postponed_left()) {
      monitor_->changed.wait_until(lock, *release_at_);
    } else {
      monitor_->changed.wait(lock);
    }
  }
  return std::nullopt;
}

// Keeps the session's name for reopening it, and checks that the server has all that it acknowledged.
void SessionExchange::on_opened(const v1::SessionOpened& opened, Lock& lock) {
  const auto acknowledged = window_.last_acknowledged();
  // A localizing session stores nothing, so a restarted server has lost nothing of it.
  const bool durable = options_.mode == v1::SESSION_MODE_MAP;
  const bool known = opened.has_last_committed_sequence() && opened.last_committed_sequence() >= acknowledged;
  if (durable && acknowledged && !known) throw_rewound(*acknowledged, opened);
  const bool again = opened_.has_value();
  opened_ = opened;
  if (window_.size() == 0) backoff_.progress();
  monitor_->changed.notify_all();
  if (again) notice(lock, "back at the server; sending " + std::to_string(window_.size()) + " frames again");
}

void SessionExchange::on_response(const v1::StreamResponse& response) {
  std::optional<Window::Postponed> postponed;
  if (response.has_answer()) {
    postponed = window_.settle(FrameOutcome(response.answer()));
  } else if (response.has_refusal()) {
    const v1::FrameRefusal& refusal = response.refusal();
    postponed = window_.settle(FrameOutcome(FrameRefused{refusal.sequence(), error_of(refusal.status())}));
  } else {
    throw ProtocolError("the server sent no answer where one was due; use a server and a client of the same version");
  }
  if (postponed) {
    postpone(*postponed);
  } else {
    backoff_.progress();
  }
}

void SessionExchange::postpone(const Window::Postponed& postponed) {
  const auto now = Clock::now();
  if (!release_at_) {
    // The server reserves a turn at the time that it names; the patience counts in any case.
    const Clock::duration delay = delay_or_give_up(postponed.message);
    release_at_ = now + (postponed.delay.count() == 0 ? delay : postponed.delay);
  }
  release_at_ = std::max(*release_at_, now + postponed.delay);
}

bool SessionExchange::deliver(Lock& lock) {
  bool called = false;
  while (auto outcome = window_.take_outcome()) {
    if (options_.on_outcome) {
      const Unlocked unlocked(lock);
      options_.on_outcome(std::move(*outcome));
      called = true;
    } else {
      outcomes_.push_back(std::move(*outcome));
    }
    monitor_->changed.notify_all();
  }
  return called;
}

std::string SessionExchange::why_ended(const grpc::Status& status) {
  if (!is_passing(status)) throw_stream_end(status, connection_->address());
  least_delay_ = error_of(status).retry_after().value_or(std::chrono::nanoseconds{0});
  return reason_of(status);
}

Clock::duration SessionExchange::delay_or_give_up(const std::string& reason) {
  const auto now = Clock::now();
  if (const auto delay = backoff_.next_delay(now)) return *delay;
  throw SessionLost("lost the server at " + connection_->address() + " for " +
                    std::to_string(backoff_.waited(now).count()) + " s with " + std::to_string(window_.size()) +
                    " frames without an answer (" + reason +
                    "); once it is back, open the same session again and send them again");
}

void SessionExchange::notice(Lock& lock, const std::string& sentence) {
  if (!options_.on_notice) return;
  const Unlocked unlocked(lock);
  options_.on_notice(sentence);
}

v1::OpenSession SessionExchange::opening() const {
  v1::OpenSession opening;
  opening.set_map(map_name(options_.map));
  opening.set_session_id(opened_ ? last_part(opened_->session()) : options_.session_id);
  opening.set_mode(options_.mode);
  if (options_.camera) *opening.mutable_camera() = *options_.camera;
  opening.set_words_hash(options_.words_hash);
  opening.set_run_id(options_.run_id);
  return opening;
}

}  // namespace waypost
