// Leads a robot to a label: navigate MAP LABEL. `robot.hpp` is yours.
// The server's address, token and certificates come from WAYPOST_SERVER and such, as for the command line.
#include <chrono>
#include <iostream>
#include <thread>

#include "robot.hpp"  // Yours: odometry(), image() and drive(forward_m_s, turn_rad_s).
#include "waypost/waypost.hpp"

namespace {

std::int64_t now_ns() { return std::chrono::nanoseconds(std::chrono::steady_clock::now().time_since_epoch()).count(); }

void lead(Robot& robot, const char* map, const char* label) {
  waypost::NavigationOptions options{map};
  options.camera.mutable_field_of_view()->set_horizontal_rad(1.2);
  options.goal = waypost::label_goal(label);
  waypost::Navigation navigation = waypost::Client::connect().navigate(options);
  for (std::uint64_t cycle = 0; navigation.status() != waypost::v1::NAVIGATION_STATUS_ARRIVED; ++cycle) {
    const auto stamp_ns = now_ns();
    const waypost::v1::Odometry odometry = robot.odometry();
    navigation.report({stamp_ns, odometry});
    // Twice a second.
    if (cycle % 10 == 0) navigation.see({cycle + 1, stamp_ns, robot.image(), odometry});
    // A stop, as soon as commands lapse.
    const waypost::Command command = navigation.command();
    robot.drive(command.forward_m_s, command.turn_rad_s);
    while (const auto event = navigation.next_event()) std::cout << waypost::describe(*event) << std::endl;
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
  }
}

}  // namespace

int main(int count, char** arguments) {
  Robot robot;
  int code = 0;
  try {
    if (count != 3) throw waypost::InvalidUse("usage: navigate MAP LABEL");
    lead(robot, arguments[1], arguments[2]);
    std::cout << "arrived" << std::endl;
  } catch (const std::exception& error) {
    std::cerr << error.what() << std::endl;
    code = 1;
  }
  // Whatever happened, it stands.
  robot.drive(0, 0);
  return code;
}
