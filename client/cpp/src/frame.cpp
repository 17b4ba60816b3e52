#include "waypost/frame.hpp"

#include <cmath>
#include <fstream>
#include <iterator>

#include "frame_message.hpp"
#include "waypost/errors.hpp"

namespace waypost {
namespace {

void put(v1::Frame& message, Image image) { message.set_image(std::move(image).take()); }
void put(v1::Frame& message, v1::WordHistogram histogram) { *message.mutable_histogram() = std::move(histogram); }
void put(v1::Frame& message, v1::WordList words) { *message.mutable_words() = std::move(words); }

}  // namespace

Image Image::read(const std::filesystem::path& file) {
  std::ifstream in(file, std::ios::binary);
  std::string bytes{std::istreambuf_iterator<char>(in), std::istreambuf_iterator<char>()};
  if (!in) throw InvalidUse("cannot read " + file.string() + "; give a JPEG or PNG that this user may read");
  return Image(std::move(bytes));
}

v1::Odometry planar_odometry(double x_m, double y_m, double heading_rad) {
  v1::Odometry odometry;
  v1::Pose& pose = *odometry.mutable_pose();
  pose.mutable_position_m()->set_x(x_m);
  pose.mutable_position_m()->set_y(y_m);
  pose.mutable_orientation()->set_z(std::sin(heading_rad / 2));
  pose.mutable_orientation()->set_w(std::cos(heading_rad / 2));
  return odometry;
}

v1::Frame message_of(Frame frame) {
  v1::Frame message;
  message.set_sequence(frame.sequence);
  message.set_stamp_ns(frame.stamp_ns);
  message.set_note(std::move(frame.note));
  std::visit([&message](auto&& content) { put(message, std::forward<decltype(content)>(content)); },
             std::move(frame.content));
  if (frame.odometry) *message.mutable_odometry() = std::move(*frame.odometry);
  return message;
}

}  // namespace waypost
