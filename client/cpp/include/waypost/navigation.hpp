// Navigation: the server leads a robot along a map, by commands that lapse.
#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <variant>

#include "waypost/errors.hpp"
#include "waypost/frame.hpp"
#include "waypost/options.hpp"
#include "waypost/session.hpp"
#include "waypost/v1/navigation.pb.h"

namespace waypost {

// What to drive. `Command{}` is to stop.
struct Command {
  // Below 0 the robot backs up.
  double forward_m_s = 0.0;
  // To the left.
  double turn_rad_s = 0.0;

  bool is_stop() const noexcept;
};

// Where to go.
v1::Goal place_goal(std::uint32_t place_number);
v1::Goal label_goal(std::string label);
// The place nearest to a position, in the frame of a part of the map: usually 0. Any heading if it is left out.
v1::Goal position_goal(double x_m, double y_m, std::optional<double> heading_rad = std::nullopt,
                       std::uint32_t part = 0);
// By appearance alone: the place that looks most like this panorama.
v1::Goal image_goal(Image panorama);

// One reading of the wheels.
struct Reading {
  // By the robot's own steady clock: above 0, and rising.
  std::int64_t stamp_ns = 0;
  // None for a robot without odometry, which navigates by appearance.
  std::optional<v1::Odometry> odometry = std::nullopt;
  // Whether a reflex of the robot, such as an emergency stop, drives in place of the commands.
  bool reflex = false;
};

// A wheel report that was not taken. No command follows.
struct WheelsRefused {
  std::int64_t stamp_ns;
  ServerError error;
};

// A goal that was not taken.
struct GoalRefused {
  // Empty if it was an image.
  v1::Goal goal;
  ServerError error;
};

// The connection broke; it is being mended, and the robot stands.
struct Disconnected {
  std::string reason;
};

// The connection is back.
struct Reconnected {
  // Whether the navigation goes on where it was: not if the server was restarted. Its goal is kept in both cases.
  bool resumed;
};

// What the server says besides guidance.
using NavigationEvent =
    std::variant<v1::FrameSeen, FrameRefused, WheelsRefused, GoalRefused, Disconnected, Reconnected>;

// An event in a sentence, for a log.
std::string describe(const NavigationEvent& event);

// Which robot to lead, and how.
struct NavigationOptions {
  // `{map}` or `maps/{map}`.
  std::string map = {};
  // How the robot sees: its field of view, or a calibration, is needed. By appearance, a panorama or a mirror.
  v1::Camera camera = {};
  // Without one the robot stands.
  std::optional<v1::Goal> goal = std::nullopt;
  // Name of the robot within the map; the server makes one up if it is empty.
  std::string navigation_id = {};
  // As in SessionOptions.
  std::string words_hash = {};
  v1::DrivingSettings driving = {};
  Reconnection reconnection = {};
};

class NavigationExchange;

// A navigation in progress. Made by `Client::navigate`. Several threads may use it.
//
// When it is closed, or over, `command` is a stop. When it is over, every other call throws why: Aborted if the same
// run opened another stream, SessionLost if the server did not come back.
class Navigation {
 public:
  explicit Navigation(std::unique_ptr<NavigationExchange> exchange) noexcept;
  // Ends the navigation: the robot must stop.
  ~Navigation();
  Navigation(Navigation&&) noexcept;
  Navigation& operator=(Navigation&&) noexcept;

  // maps/{map}/navigations/{navigation}
  std::string name() const;

  // What to drive now: the last command while it is valid, by this machine's own clock since it arrived. A stop as soon
  // as it is not, and as soon as the stream broke. Call it in every cycle of the motor controller.
  Command command();
  // Reports odometry, 10 to 50 times a second; the server answers with the next command. False if it was dropped, for
  // want of a connection: it would come too late.
  bool report(const Reading& reading);
  // Sends a frame; a `FrameSeen` says what it showed. With odometry about twice a second; by appearance a panorama four
  // times a second, which the server answers with a command. False if it was dropped.
  bool see(Frame frame);

  // Sets another goal, also while the connection is being mended. One that is not taken is told by a GoalRefused.
  void go_to(v1::Goal goal);
  // Gives up the goal: the robot stops.
  void stop();

  // The latest guidance; none before the first report was answered. To drive by, ask `command`, which lapses.
  std::optional<v1::Guidance> guidance() const;
  // How the navigation goes, by the latest guidance. UNSPECIFIED before there was any.
  v1::NavigationStatus status() const;
  // Why the robot stands, is lost or searches, and how to mend that; empty while it is on its way.
  std::string detail() const;

  // Waits for guidance that comes after this call; none if it did not come in time.
  std::optional<v1::Guidance> next_guidance(std::chrono::nanoseconds timeout);
  // The next event; none if it did not come in time. At most 1024 wait to be taken, further ones are dropped.
  std::optional<NavigationEvent> next_event(std::chrono::nanoseconds timeout = std::chrono::nanoseconds{0});

  // Ends the navigation: the robot must stop.
  void close();

 private:
  std::unique_ptr<NavigationExchange> exchange_;
};

}  // namespace waypost
