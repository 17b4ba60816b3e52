#include "robot.hpp"

#include <algorithm>
#include <cmath>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "support.hpp"

namespace {

// What the camera sees once the robot has turned to the left: the scene moves to the right.
cv::Mat turned(const cv::Mat& seen, double heading_rad) {
  constexpr double whole_turn_rad = 2 * 3.14159265358979323846;
  const double shift_px = seen.cols * std::remainder(heading_rad, whole_turn_rad) / Robot::field_of_view_rad;
  const cv::Mat shift = (cv::Mat_<double>(2, 3) << 1, 0, std::round(shift_px), 0, 1, 0);
  cv::Mat out;
  cv::warpAffine(seen, out, shift, seen.size());
  return out;
}

}  // namespace

void Robot::drive(double forward_m_s, double turn_rad_s) {
  move();
  command_ = {forward_m_s, turn_rad_s};
}

waypost::v1::Odometry Robot::odometry() {
  move();
  return waypost::planar_odometry(x_m_, y_m_, heading_rad_);
}

waypost::Image Robot::image() {
  move();
  const auto last = static_cast<double>(support::images().size() - 1);
  const auto nearest = static_cast<std::size_t>(std::clamp(std::round(x_m_ / step_m), 0.0, last));
  const cv::Mat seen = turned(cv::imread(support::images()[nearest].string()), heading_rad_);
  return waypost::Image::of_pixels({seen.data, static_cast<std::uint32_t>(seen.cols),
                                    static_cast<std::uint32_t>(seen.rows), waypost::PixelFormat::bgr, seen.step});
}

double Robot::x_m() {
  move();
  return x_m_;
}

void Robot::move() {
  const auto now = Clock::now();
  const double passed_s = std::chrono::duration<double>(now - moved_at_).count();
  moved_at_ = now;
  heading_rad_ += command_.turn_rad_s * passed_s;
  x_m_ += command_.forward_m_s * passed_s * std::cos(heading_rad_);
  y_m_ += command_.forward_m_s * passed_s * std::sin(heading_rad_);
}

void teach(const waypost::Client& client, const std::string& map, std::uint64_t steps) {
  client.create_map(map, "shipped");
  waypost::Session session = client.open_session({map, "taught"});
  for (std::uint64_t step = 0; step < steps; ++step) {
    waypost::Frame frame = support::frame(step + 1);
    frame.odometry = waypost::planar_odometry(static_cast<double>(step) * Robot::step_m, 0, 0);
    session.send(std::move(frame));
  }
}
