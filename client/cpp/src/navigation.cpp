// The application's side of a navigation.
#include "waypost/navigation.hpp"

#include <utility>

#include "frame_message.hpp"
#include "navigation_exchange.hpp"

namespace waypost {
namespace {

// Messages that wait to be sent. More would be too old to be of use to a moving robot.
constexpr std::size_t messages_ahead = 64;

std::string new_run_id() {
  constexpr const char* digits = "0123456789abcdef";
  std::string id = "run-";
  for (std::uint64_t left = random_seed(), digit = 0; digit < 16; ++digit, left >>= 4) id += digits[left & 0xf];
  return id;
}

}  // namespace

bool Command::is_stop() const noexcept {
  const bool drives = forward_m_s < 0 || forward_m_s > 0;
  const bool turns = turn_rad_s < 0 || turn_rad_s > 0;
  return !drives && !turns;
}

NavigationExchange::NavigationExchange(std::shared_ptr<const Connection> connection, NavigationOptions options)
    : connection_(std::move(connection)),
      options_(std::move(options)),
      stub_(v1::NavigationService::NewStub(connection_->channel())),
      run_id_(new_run_id()),
      backoff_(options_.reconnection),
      asked_(options_.goal) {
  worker_ = std::thread(&NavigationExchange::run, this);
  Lock lock(monitor_->mutex);
  monitor_->changed.wait(lock, [this] { return opened_ || ended_; });
  if (opened_) return;
  // No destructor runs for what was not constructed.
  lock.unlock();
  worker_.join();
  std::rethrow_exception(error_);
}

NavigationExchange::~NavigationExchange() {
  close();
  worker_.join();
}

void NavigationExchange::close() {
  Lock lock(monitor_->mutex);
  closing_ = true;
  last_command_.forget();
  monitor_->changed.notify_all();
  monitor_->changed.wait(lock, [this] { return ended_; });
}

std::string NavigationExchange::name() const {
  const std::lock_guard lock(monitor_->mutex);
  return opened_->navigation();
}

Command NavigationExchange::command() {
  const std::lock_guard lock(monitor_->mutex);
  // The stream may be over before the worker has seen it, and commands may arrive that the server gave before a stop.
  const bool is_led = is_open_ && !link_->is_over() && !closing_;
  return is_led && !asked_.is_stopping() ? last_command_.obey(Clock::now()) : Command{};
}

bool NavigationExchange::report(const Reading& reading) {
  v1::NavigateRequest request;
  v1::WheelReport& wheels = *request.mutable_wheels();
  wheels.set_stamp_ns(reading.stamp_ns);
  if (reading.odometry) *wheels.mutable_odometry() = *reading.odometry;
  wheels.set_reflex(reading.reflex);
  const std::lock_guard lock(monitor_->mutex);
  asked_.stamped(reading.stamp_ns);
  if (const auto obeyed = last_command_.obeyed()) wheels.set_obeyed_number(*obeyed);
  return offer(std::move(request));
}

bool NavigationExchange::see(Frame frame) {
  v1::NavigateRequest request;
  *request.mutable_frame() = message_of(std::move(frame));
  const std::size_t length_bytes = request.frame().image().size();
  if (length_bytes > max_image_bytes) {
    throw InvalidUse("the image has " + std::to_string(length_bytes) + " bytes, more than " +
                     std::to_string(max_image_bytes) + "; make it smaller or compress it harder");
  }
  const std::lock_guard lock(monitor_->mutex);
  asked_.stamped(request.frame().stamp_ns());
  return offer(std::move(request));
}

void NavigationExchange::go_to(v1::Goal goal) {
  const std::lock_guard lock(monitor_->mutex);
  check_running();
  const auto request = asked_.go_to(std::move(goal));
  if (is_open_) link_->send(request);
}

void NavigationExchange::stop() {
  const std::lock_guard lock(monitor_->mutex);
  check_running();
  const auto request = asked_.stop();
  if (is_open_) link_->send(request);
}

bool NavigationExchange::offer(v1::NavigateRequest request) {
  check_running();
  if (!is_open_ || link_->waiting() >= messages_ahead) return false;
  link_->send(std::make_shared<const v1::NavigateRequest>(std::move(request)));
  return true;
}

void NavigationExchange::check_running() const {
  if (error_) std::rethrow_exception(error_);
  if (closing_) throw InvalidUse("this navigation was closed; start another one with Client::navigate");
}

std::optional<v1::Guidance> NavigationExchange::guidance() const {
  const std::lock_guard lock(monitor_->mutex);
  return guidance_;
}

std::optional<v1::Guidance> NavigationExchange::next_guidance(std::chrono::nanoseconds timeout) {
  Lock lock(monitor_->mutex);
  const std::uint64_t before = guidances_;
  const bool came = monitor_->changed.wait_for(lock, timeout, [&] { return guidances_ > before || ended_; });
  check_running();
  return came ? guidance_ : std::nullopt;
}

std::optional<NavigationEvent> NavigationExchange::next_event(std::chrono::nanoseconds timeout) {
  Lock lock(monitor_->mutex);
  monitor_->changed.wait_for(lock, timeout, [this] { return !events_.empty() || ended_; });
  if (events_.empty()) {
    if (error_) std::rethrow_exception(error_);
    return std::nullopt;
  }
  NavigationEvent event = std::move(events_.front());
  events_.pop_front();
  return event;
}

Navigation::Navigation(std::unique_ptr<NavigationExchange> exchange) noexcept : exchange_(std::move(exchange)) {}
Navigation::~Navigation() = default;
Navigation::Navigation(Navigation&&) noexcept = default;
Navigation& Navigation::operator=(Navigation&&) noexcept = default;

std::string Navigation::name() const { return exchange_->name(); }
Command Navigation::command() { return exchange_->command(); }
bool Navigation::report(const Reading& reading) { return exchange_->report(reading); }
bool Navigation::see(Frame frame) { return exchange_->see(std::move(frame)); }
void Navigation::go_to(v1::Goal goal) { exchange_->go_to(std::move(goal)); }
void Navigation::stop() { exchange_->stop(); }
std::optional<v1::Guidance> Navigation::guidance() const { return exchange_->guidance(); }
std::optional<v1::Guidance> Navigation::next_guidance(std::chrono::nanoseconds timeout) {
  return exchange_->next_guidance(timeout);
}
std::optional<NavigationEvent> Navigation::next_event(std::chrono::nanoseconds timeout) {
  return exchange_->next_event(timeout);
}
void Navigation::close() { exchange_->close(); }

v1::NavigationStatus Navigation::status() const {
  const auto guidance = exchange_->guidance();
  return guidance ? guidance->status() : v1::NAVIGATION_STATUS_UNSPECIFIED;
}

std::string Navigation::detail() const {
  const auto guidance = exchange_->guidance();
  return guidance ? guidance->detail() : std::string();
}

}  // namespace waypost
