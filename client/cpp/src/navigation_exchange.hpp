// What keeps a navigation going: connect, send, receive, and again.
#pragma once

#include <deque>
#include <exception>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

#include "asked_goals.hpp"
#include "backoff.hpp"
#include "connection.hpp"
#include "last_command.hpp"
#include "link.hpp"
#include "waypost/navigation.hpp"
#include "waypost/v1/navigation.grpc.pb.h"

namespace waypost {

// This side of a navigation. Its worker, a thread of its own, talks to the server. The monitor guards all but
// constants.
class NavigationExchange {
 public:
  // Returns once the navigation is open; throws why it is not.
  NavigationExchange(std::shared_ptr<const Connection> connection, NavigationOptions options);
  ~NavigationExchange();
  NavigationExchange(const NavigationExchange&) = delete;
  NavigationExchange& operator=(const NavigationExchange&) = delete;

  std::string name() const;
  Command command();
  bool report(const Reading& reading);
  bool see(Frame frame);
  void go_to(v1::Goal goal);
  void stop();
  std::optional<v1::Guidance> guidance() const;
  std::optional<v1::Guidance> next_guidance(std::chrono::nanoseconds timeout);
  std::optional<NavigationEvent> next_event(std::chrono::nanoseconds timeout);
  void close();

 private:
  using Lock = std::unique_lock<std::mutex>;
  using NavigationLink = Link<v1::NavigateRequest, v1::NavigateResponse>;

  // The worker, with the lock held but for waits.
  void run();
  void work(Lock& lock);
  // Why the link ended if another attempt may help.
  std::string talk(Lock& lock);
  void on_response(NavigationLink::Arrival arrival);
  void on_opened(const v1::NavigationOpened& opened);
  void on_guided(v1::Guidance guidance, Clock::time_point arrived);
  void tell(NavigationEvent event);
  Clock::duration delay_or_give_up(const std::string& reason);
  v1::OpenNavigation opening() const;

  // The application's side, with the lock held.
  void check_running() const;
  bool offer(v1::NavigateRequest request);

  const std::shared_ptr<const Connection> connection_;
  const NavigationOptions options_;
  const std::unique_ptr<v1::NavigationService::Stub> stub_;
  // By this the server tells a robot that reconnects from another one of the same name.
  const std::string run_id_;
  const std::shared_ptr<Monitor> monitor_ = std::make_shared<Monitor>();

  Backoff backoff_;
  std::unique_ptr<NavigationLink> link_;
  // Whether the server has opened the navigation over the present link.
  bool is_open_ = false;
  std::optional<v1::NavigationOpened> opened_;
  AskedGoals asked_;
  LastCommand last_command_;
  std::optional<v1::Guidance> guidance_;
  std::uint64_t guidances_ = 0;
  std::deque<NavigationEvent> events_;
  bool closing_ = false;
  bool ended_ = false;
  // Why it ended, if it was not closed.
  std::exception_ptr error_;
  std::thread worker_;
};

}  // namespace waypost
