// Goals, and events in words.
#include <utility>

#include "waypost/navigation.hpp"

namespace waypost {
namespace {

std::string in_words(const v1::FrameSeen& seen) {
  const std::string outcome = v1::FrameSeen::Outcome_Name(seen.outcome());
  const std::string place = seen.has_place_number() ? " at place " + std::to_string(seen.place_number()) : "";
  return "frame " + std::to_string(seen.sequence()) + ": " + outcome + place;
}

std::string in_words(const FrameRefused& refused) {
  return "frame " + std::to_string(refused.sequence) + " refused: " + refused.error.what();
}

std::string in_words(const WheelsRefused& refused) {
  return "wheel report of " + std::to_string(refused.stamp_ns) + " ns refused: " + refused.error.what();
}

std::string in_words(const GoalRefused& refused) { return std::string("goal refused: ") + refused.error.what(); }

std::string in_words(const Disconnected& disconnected) {
  return "lost the server (" + disconnected.reason + "); the robot stands until it is back";
}

std::string in_words(const Reconnected& reconnected) {
  return reconnected.resumed ? "back at the server" : "back at the server, which has to find the robot anew";
}

}  // namespace

std::string describe(const NavigationEvent& event) {
  return std::visit([](const auto& what) { return in_words(what); }, event);
}

v1::Goal place_goal(std::uint32_t place_number) {
  v1::Goal goal;
  goal.set_place_number(place_number);
  return goal;
}

v1::Goal label_goal(std::string label) {
  v1::Goal goal;
  goal.set_label(std::move(label));
  return goal;
}

v1::Goal position_goal(double x_m, double y_m, std::optional<double> heading_rad, std::uint32_t part) {
  v1::Goal goal;
  v1::PositionGoal& position = *goal.mutable_position();
  position.set_x_m(x_m);
  position.set_y_m(y_m);
  position.set_part(part);
  if (heading_rad) position.set_heading_rad(*heading_rad);
  return goal;
}

v1::Goal image_goal(Image panorama) {
  v1::Goal goal;
  goal.set_image(std::move(panorama).take());
  return goal;
}

}  // namespace waypost
