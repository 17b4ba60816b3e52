#include "navigation_exchange.hpp"

#include <utility>

#include "status.hpp"

namespace waypost {
namespace {

// Events that wait for the application; later ones are dropped.
constexpr std::size_t events_ahead = 1024;

}  // namespace

void NavigationExchange::run() {
  Lock lock(monitor_->mutex);
  try {
    work(lock);
  } catch (...) {
    error_ = std::current_exception();
  }
  last_command_.forget();
  if (link_) link_->cancel(lock);
  link_.reset();
  ended_ = true;
  monitor_->changed.notify_all();
}

void NavigationExchange::work(Lock& lock) {
  while (!closing_) {
    const std::string reason = talk(lock);
    // A robot that nobody leads stands, even if its last command would be valid for a moment more.
    last_command_.forget();
    is_open_ = false;
    link_->cancel(lock);
    link_.reset();
    if (closing_) return;
    if (!backoff_.is_in_trouble() && opened_) tell(Disconnected{reason});
    const auto until = Clock::now() + delay_or_give_up(reason);
    monitor_->changed.wait_until(lock, until, [this] { return closing_; });
  }
}

std::string NavigationExchange::talk(Lock& lock) {
  v1::NavigateRequest first;
  *first.mutable_open() = opening();
  link_ = NavigationLink::open(monitor_, std::move(first), [this](grpc::ClientContext* context, auto* reactor) {
    stub_->async()->Navigate(context, reactor);
  });
  const auto deadline = Clock::now() + opening_timeout;
  while (!closing_) {
    while (auto arrival = link_->take()) on_response(std::move(*arrival));
    if (const grpc::Status* status = link_->ended()) {
      if (!is_passing(*status)) throw_stream_end(*status, connection_->address());
      return reason_of(*status);
    }
    if (is_open_) {
      monitor_->changed.wait(lock);
    } else if (monitor_->changed.wait_until(lock, deadline) == std::cv_status::timeout) {
      return "it did not open the navigation within " + std::to_string(opening_timeout.count()) + " s";
    }
  }
  return "it was closed";
}

void NavigationExchange::on_response(NavigationLink::Arrival arrival) {
  v1::NavigateResponse& response = arrival.response;
  if (response.has_opened() == is_open_) {
    throw ProtocolError("the server opened the navigation twice, or answered before it did; use a server and a client "
                        "of the same version");
  }
  switch (response.content_case()) {
    case v1::NavigateResponse::kOpened: return on_opened(response.opened());
    case v1::NavigateResponse::kGuidance: return on_guided(std::move(*response.mutable_guidance()), arrival.at);
    case v1::NavigateResponse::kSeen: return tell(std::move(*response.mutable_seen()));
    case v1::NavigateResponse::kRefusal:
      return tell(FrameRefused{response.refusal().sequence(), error_of(response.refusal().status())});
    case v1::NavigateResponse::kWheelRefusal:
      return tell(WheelsRefused{response.wheel_refusal().stamp_ns(), error_of(response.wheel_refusal().status())});
    case v1::NavigateResponse::kGoalRefusal:
      asked_.refused(response.goal_refusal());
      return tell(GoalRefused{response.goal_refusal().goal(), error_of(response.goal_refusal().status())});
    // What a newer server says besides is not for this client.
    case v1::NavigateResponse::CONTENT_NOT_SET: return;
  }
}

void NavigationExchange::on_opened(const v1::NavigationOpened& opened) {
  const bool again = opened_.has_value();
  backoff_.progress();
  opened_ = opened;
  is_open_ = true;
  asked_.send_unsaid([this](const AskedGoals::Request& request) { link_->send(request); });
  if (again) tell(Reconnected{opened.resumed()});
  monitor_->changed.notify_all();
}

void NavigationExchange::on_guided(v1::Guidance guidance, Clock::time_point arrived) {
  if (guidance.has_command()) last_command_.set(guidance.command(), arrived);
  asked_.guided(guidance);
  guidance_ = std::move(guidance);
  ++guidances_;
  monitor_->changed.notify_all();
}

void NavigationExchange::tell(NavigationEvent event) {
  if (events_.size() >= events_ahead) return;
  events_.push_back(std::move(event));
  monitor_->changed.notify_all();
}

Clock::duration NavigationExchange::delay_or_give_up(const std::string& reason) {
  const auto now = Clock::now();
  if (const auto delay = backoff_.next_delay(now)) return *delay;
  throw SessionLost("lost the server at " + connection_->address() + " for " +
                    std::to_string(backoff_.waited(now).count()) + " s (" + reason +
                    "); the robot stands: once the server is back, start the navigation again");
}

v1::OpenNavigation NavigationExchange::opening() const {
  v1::OpenNavigation opening;
  opening.set_map(map_name(options_.map));
  opening.set_navigation_id(opened_ ? last_part(opened_->navigation()) : options_.navigation_id);
  opening.set_run_id(run_id_);
  *opening.mutable_camera() = options_.camera;
  opening.set_words_hash(options_.words_hash);
  if (const v1::Goal* goal = asked_.for_opening()) *opening.mutable_goal() = *goal;
  *opening.mutable_driving() = options_.driving;
  return opening;
}

}  // namespace waypost
