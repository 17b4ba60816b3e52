// A robot that drives along the shipped drive, laid out as a straight way: what the example leads.
#pragma once

#include <chrono>

#include "waypost/waypost.hpp"

// Wheels that do as commanded, and a camera that sees the image of the nearest step.
class Robot {
 public:
  static constexpr double field_of_view_rad = 1.2;
  // From one image of the drive to the next.
  static constexpr double step_m = 0.5;

  void drive(double forward_m_s, double turn_rad_s);
  waypost::v1::Odometry odometry();
  waypost::Image image();
  double x_m();

 private:
  using Clock = std::chrono::steady_clock;

  void move();

  double x_m_ = 2 * step_m;
  double y_m_ = 0.0;
  double heading_rad_ = 0.0;
  waypost::Command command_;
  Clock::time_point moved_at_ = Clock::now();
};

// Makes a map of the first steps of the way.
void teach(const waypost::Client& client, const std::string& map, std::uint64_t steps);
