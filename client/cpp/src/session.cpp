// The application's side of a session.
#include "waypost/session.hpp"

#include <algorithm>
#include <utility>

#include "frame_message.hpp"
#include "session_exchange.hpp"

namespace waypost {
namespace {

// A robot that takes no outcomes would fill its memory with them, in the course of hours.
constexpr std::size_t most_outcomes = 10'000;

}  // namespace

std::uint64_t FrameOutcome::sequence() const {
  const FrameRefused* refused = refusal();
  return refused != nullptr ? refused->sequence : std::get<FrameAnswer>(what_).sequence();
}

const FrameAnswer& FrameOutcome::answer() const {
  if (const FrameRefused* refused = refusal()) refused->error.raise();
  return std::get<FrameAnswer>(what_);
}

SessionExchange::SessionExchange(std::shared_ptr<const Connection> connection, SessionOptions options)
    : connection_(std::move(connection)),
      options_(std::move(options)),
      stub_(v1::SessionService::NewStub(connection_->channel())),
      backoff_(options_.reconnection) {
  if (options_.window_frames == 0) throw InvalidUse("window_frames must be at least 1");
  worker_ = std::thread(&SessionExchange::run, this);
  Lock lock(monitor_->mutex);
  monitor_->changed.wait(lock, [this] { return opened_ || ended_; });
  if (opened_) return;
  // No destructor runs for what was not constructed.
  lock.unlock();
  worker_.join();
  std::rethrow_exception(error_);
}

SessionExchange::~SessionExchange() {
  {
    const std::lock_guard lock(monitor_->mutex);
    aborting_ = true;
    monitor_->changed.notify_all();
  }
  worker_.join();
}

v1::SessionOpened SessionExchange::opened() const {
  const std::lock_guard lock(monitor_->mutex);
  return *opened_;
}

std::optional<std::uint64_t> SessionExchange::last_committed_sequence() const {
  const std::lock_guard lock(monitor_->mutex);
  std::optional<std::uint64_t> committed = window_.last_acknowledged();
  if (!opened_->has_last_committed_sequence()) return committed;
  return std::max(committed.value_or(0), opened_->last_committed_sequence());
}

FrameAnswer SessionExchange::send(Frame frame) {
  const std::lock_guard one_at_a_time(sending_);
  {
    const std::lock_guard lock(monitor_->mutex);
    if (options_.on_outcome || window_.size() > 0 || !outcomes_.empty()) {
      throw InvalidUse("send waits for its own answer alone: take the outcomes of frames that were posted before, and "
                       "use post where there is a callback on_outcome");
    }
  }
  post(std::move(frame));
  const std::optional<FrameOutcome> outcome = receive(std::nullopt);
  if (!outcome) throw InvalidUse("the session was finished while its last frame was sent");
  return outcome->answer();
}

void SessionExchange::post(Frame frame) {
  Lock lock(monitor_->mutex);
  monitor_->changed.wait(lock, [this] { return has_room() || finished_ || ended_; });
  push(std::move(frame));
}

bool SessionExchange::try_post(Frame&& frame) {
  const std::lock_guard lock(monitor_->mutex);
  if (!has_room() && !finished_ && !ended_) return false;
  push(std::move(frame));
  return true;
}

void SessionExchange::push(Frame frame) {
  check_running();
  check_sequence(frame.sequence);
  if (outcomes_.size() >= most_outcomes) {
    throw InvalidUse("nobody takes the outcomes of this session, and " + std::to_string(most_outcomes) +
                     " wait: call receive, or give on_outcome");
  }
  last_sequence_ = frame.sequence;
  v1::StreamRequest request;
  *request.mutable_frame() = message_of(std::move(frame));
  window_.push(std::make_shared<const v1::StreamRequest>(std::move(request)));
  monitor_->changed.notify_all();
}

void SessionExchange::check_running() const {
  if (error_) std::rethrow_exception(error_);
  if (finished_ || ended_) {
    throw InvalidUse("this session is finished; open it again with Client::open_session to send more frames");
  }
}

void SessionExchange::check_sequence(std::uint64_t sequence) const {
  if (!last_sequence_ || sequence > *last_sequence_) return;
  throw InvalidUse("frame " + std::to_string(sequence) + " follows frame " + std::to_string(*last_sequence_) +
                   "; number frames so that every number is above the last");
}

std::optional<FrameOutcome> SessionExchange::receive(std::optional<Clock::time_point> until) {
  if (options_.on_outcome) throw InvalidUse("the outcomes of this session go to its callback on_outcome");
  Lock lock(monitor_->mutex);
  const auto ready = [this] { return !outcomes_.empty() || ended_; };
  if (until) {
    monitor_->changed.wait_until(lock, *until, ready);
  } else {
    monitor_->changed.wait(lock, ready);
  }
  if (outcomes_.empty()) {
    if (error_) std::rethrow_exception(error_);
    return std::nullopt;
  }
  FrameOutcome outcome = std::move(outcomes_.front());
  outcomes_.pop_front();
  return outcome;
}

void SessionExchange::finish() {
  const std::lock_guard lock(monitor_->mutex);
  finished_ = true;
  monitor_->changed.notify_all();
}

void SessionExchange::close() {
  finish();
  Lock lock(monitor_->mutex);
  monitor_->changed.wait(lock, [this] { return ended_; });
  if (error_) std::rethrow_exception(error_);
}

Session::Session(std::unique_ptr<SessionExchange> exchange) noexcept : exchange_(std::move(exchange)) {}
Session::~Session() = default;
Session::Session(Session&&) noexcept = default;
Session& Session::operator=(Session&&) noexcept = default;

std::string Session::name() const { return exchange_->opened().session(); }
v1::SessionOpened Session::opened() const { return exchange_->opened(); }
std::optional<std::uint64_t> Session::last_committed_sequence() const { return exchange_->last_committed_sequence(); }
FrameAnswer Session::send(Frame frame) { return exchange_->send(std::move(frame)); }
void Session::post(Frame frame) { exchange_->post(std::move(frame)); }
bool Session::try_post(Frame&& frame) { return exchange_->try_post(std::move(frame)); }
std::optional<FrameOutcome> Session::receive() { return exchange_->receive(std::nullopt); }
std::optional<FrameOutcome> Session::receive_for(std::chrono::nanoseconds timeout) {
  return exchange_->receive(Clock::now() + timeout);
}
void Session::finish() { exchange_->finish(); }
void Session::close() { exchange_->close(); }

}  // namespace waypost
