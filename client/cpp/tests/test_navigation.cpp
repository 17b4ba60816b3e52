// A robot that is led along a taught way, by a real server, through what can go wrong.
#include <gtest/gtest.h>

#include <chrono>
#include <functional>
#include <memory>
#include <thread>

#include "robot.hpp"
#include "support.hpp"
#include "waypost/v1/label.grpc.pb.h"
#include "waypost/v1/navigation.grpc.pb.h"

namespace {

using namespace support;
using namespace waypost;

// A place of the taught way, and how far along it is.
constexpr std::uint32_t goal = 4;
constexpr double goal_m = 4.5;
// What the server gives a command.
constexpr auto validity = 500ms;
// For a machine that does other things meanwhile.
constexpr auto slack = 150ms;
// Longer than a drive takes, even if the robot looks all around once.
constexpr auto drive_time = 120s;

std::int64_t now_ns() { return std::chrono::nanoseconds(std::chrono::steady_clock::now().time_since_epoch()).count(); }

class Led : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder = std::make_unique<TemporaryFolder>();
    server = std::make_unique<Server>(*folder / "data");
    const Client client = Client::connect(server->address());
    teach(client, "hall", 20);
    v1::SetLabelRequest request;
    request.set_place("maps/hall/places/" + std::to_string(goal));
    request.set_label("dock");
    client.call(&v1::LabelService::Stub::SetLabel, request);
  }
  static void TearDownTestSuite() {
    server.reset();
    folder.reset();
  }

  NavigationOptions options(double speed_m_s) const {
    NavigationOptions options{"hall"};
    options.camera.mutable_field_of_view()->set_horizontal_rad(Robot::field_of_view_rad);
    options.goal = label_goal("dock");
    options.driving.set_speed_m_s(speed_m_s);
    return options;
  }
  v1::Navigation shown(const Navigation& navigation) const {
    v1::GetNavigationRequest request;
    request.set_name(navigation.name());
    return client.call(&v1::NavigationService::Stub::GetNavigation, request);
  }

  static std::unique_ptr<TemporaryFolder> folder;
  static std::unique_ptr<Server> server;
  Client client = Client::connect(server->address());
};

std::unique_ptr<TemporaryFolder> Led::folder;
std::unique_ptr<Server> Led::server;

// A robot with its navigation, one step at a time.
class Drive {
 public:
  explicit Drive(Navigation& navigation) : navigation_(navigation) {}

  // Drives until something is so; false if it never became so.
  bool until(const std::function<bool()>& is_so) {
    const auto deadline = std::chrono::steady_clock::now() + drive_time;
    while (!is_so()) {
      if (std::chrono::steady_clock::now() > deadline) return false;
      step();
      std::this_thread::sleep_for(30ms);
    }
    return true;
  }
  bool drives() { return navigation_.command().forward_m_s > 0; }
  template <class Event>
  const Event* told() const {
    for (const NavigationEvent& event : events_) {
      if (const auto* found = std::get_if<Event>(&event)) return found;
    }
    return nullptr;
  }
  // All events in words.
  std::string log() const {
    std::string lines;
    for (const NavigationEvent& event : events_) lines += describe(event) + '\n';
    return lines;
  }
  Robot& robot() { return robot_; }

 private:
  void step() {
    const std::int64_t stamp_ns = now_ns();
    const v1::Odometry odometry = robot_.odometry();
    navigation_.report({stamp_ns, odometry});
    if (cycle_ % 8 == 0) navigation_.see({cycle_ + 1, stamp_ns, robot_.image(), odometry});
    ++cycle_;
    const Command command = navigation_.command();
    robot_.drive(command.forward_m_s, command.turn_rad_s);
    while (auto event = navigation_.next_event()) events_.push_back(std::move(*event));
  }

  Navigation& navigation_;
  Robot robot_;
  std::uint64_t cycle_ = 0;
  std::vector<NavigationEvent> events_;
};

TEST_F(Led, ARobotArrivesAtALabel) {
  Navigation navigation = client.navigate(options(1.0));
  EXPECT_EQ(navigation.status(), v1::NAVIGATION_STATUS_UNSPECIFIED);
  Drive drive(navigation);
  ASSERT_TRUE(drive.until([&] { return navigation.status() == v1::NAVIGATION_STATUS_ARRIVED; })) << navigation.detail();
  EXPECT_NEAR(drive.robot().x_m(), goal_m, 1.0);
  EXPECT_NE(drive.log().find("OUTCOME_FOUND at place"), std::string::npos) << drive.log();
  EXPECT_TRUE(navigation.command().is_stop());
}

TEST_F(Led, CommandsLapseWhenTheServerFallsSilent) {
  Navigation navigation = client.navigate(options(0.5));
  Drive drive(navigation);
  ASSERT_TRUE(drive.until([&] { return drive.drives(); }));
  server->freeze();
  const auto frozen = std::chrono::steady_clock::now();
  // The connection stands, and nobody says anything: nothing but the clock can stop the robot.
  const bool stopped = eventually([&] { return navigation.command().is_stop(); }, 5s);
  const auto took = std::chrono::steady_clock::now() - frozen;
  const auto later = navigation.next_guidance(100ms);
  const bool stays = navigation.command().is_stop();
  server->thaw();
  EXPECT_TRUE(stopped);
  EXPECT_LE(took, validity + slack);
  EXPECT_FALSE(later);
  EXPECT_TRUE(stays);
  EXPECT_EQ(std::chrono::nanoseconds(navigation.guidance()->command().valid_ns()), validity);
  EXPECT_TRUE(drive.until([&] { return drive.drives(); }));
  EXPECT_EQ(drive.told<Disconnected>(), nullptr);
  navigation.close();
  EXPECT_TRUE(navigation.command().is_stop());
  const std::string said = thrown<InvalidUse>([&] { navigation.report({now_ns()}); });
  EXPECT_NE(said.find("was closed"), std::string::npos) << said;
}

TEST_F(Led, ARobotStopsWhenTheStreamBreaksAndGoesOnAtARestartedServer) {
  // So slow that it stands where it was found, and is found there again.
  NavigationOptions slow = options(0.2);
  slow.goal = place_goal(8);
  Navigation navigation = client.navigate(slow);
  const std::string name = navigation.name();
  Drive drive(navigation);
  ASSERT_TRUE(drive.until([&] { return drive.drives(); }));
  server->kill();
  const auto killed = std::chrono::steady_clock::now();
  EXPECT_TRUE(eventually([&] { return navigation.command().is_stop(); }, 5s));
  // Before the command lapses: a stream that broke is known at once.
  EXPECT_LT(std::chrono::steady_clock::now() - killed, 250ms);
  EXPECT_TRUE(drive.until([&] { return drive.told<Disconnected>() != nullptr; }));
  // What is asked for meanwhile is what it goes for afterwards.
  navigation.go_to(label_goal("dock"));
  EXPECT_FALSE(navigation.report({now_ns()}));
  server->start();
  ASSERT_TRUE(drive.until([&] { return drive.told<Reconnected>() != nullptr; }));
  EXPECT_FALSE(drive.told<Reconnected>()->resumed);
  EXPECT_EQ(navigation.name(), name);
  EXPECT_TRUE(drive.until([&] { return drive.drives(); }));
  const v1::Goal kept = shown(navigation).goal();
  EXPECT_TRUE(kept.label() == "dock" || kept.place_number() == goal) << kept.DebugString();
}

TEST_F(Led, ARestartedServerLeadsToTheGoalThatWasNotRefused) {
  Navigation navigation = client.navigate(options(1.0));
  navigation.go_to(label_goal("nowhere"));
  ASSERT_TRUE(std::holds_alternative<GoalRefused>(navigation.next_event(patience).value()));
  server->kill();
  server->start();
  ASSERT_TRUE(std::holds_alternative<Disconnected>(navigation.next_event(patience).value()));
  const NavigationEvent back = navigation.next_event(patience).value();
  ASSERT_TRUE(std::holds_alternative<Reconnected>(back)) << describe(back);
  EXPECT_FALSE(std::get<Reconnected>(back).resumed);
  const v1::Goal kept = shown(navigation).goal();
  EXPECT_TRUE(kept.label() == "dock" || kept.place_number() == goal) << kept.DebugString();
}

TEST_F(Led, AServerThatStaysAwayEndsIt) {
  NavigationOptions impatient = options(1.0);
  impatient.reconnection.give_up_after = 500ms;
  Navigation navigation = client.navigate(impatient);
  server->kill();
  const std::string said = thrown<SessionLost>([&] {
    while (navigation.next_event(patience)) continue;
  });
  EXPECT_NE(said.find("the robot stands"), std::string::npos) << said;
  EXPECT_TRUE(navigation.command().is_stop());
  thrown<SessionLost>([&] { navigation.report({now_ns()}); });
  thrown<SessionLost>([&] { navigation.go_to(place_goal(1)); });
  thrown<SessionLost>([&] { client.navigate(impatient); });
  server->start();
}

TEST_F(Led, GoalsAreSetTakenAwayAndRefused) {
  NavigationOptions idle = options(1.0);
  idle.goal.reset();
  idle.navigation_id = "robot";
  Navigation navigation = client.navigate(idle);
  EXPECT_EQ(navigation.name(), "maps/hall/navigations/robot");
  navigation.report({now_ns(), planar_odometry(0, 0, 0)});
  ASSERT_TRUE(eventually([&] { return navigation.guidance().has_value(); }));
  EXPECT_EQ(navigation.status(), v1::NAVIGATION_STATUS_IDLE);
  EXPECT_FALSE(navigation.detail().empty());
  navigation.go_to(position_goal(2.0, 0.0));
  EXPECT_TRUE(eventually([&] { return shown(navigation).goal().position().x_m() > 1.9; }));
  navigation.go_to(place_goal(3));
  EXPECT_TRUE(eventually([&] { return shown(navigation).goal().place_number() == 3; }));
  navigation.stop();
  EXPECT_TRUE(eventually([&] { return !shown(navigation).has_goal(); }));
  navigation.go_to(label_goal("nowhere"));
  const auto refused = navigation.next_event(patience);
  ASSERT_TRUE(refused);
  ASSERT_TRUE(std::holds_alternative<GoalRefused>(*refused)) << describe(*refused);
  EXPECT_NE(describe(*refused).find("nowhere"), std::string::npos) << describe(*refused);
  navigation.report({now_ns(), planar_odometry(std::nan(""), 0, 0)});
  const auto wheels = navigation.next_event(patience);
  ASSERT_TRUE(wheels);
  EXPECT_TRUE(std::holds_alternative<WheelsRefused>(*wheels)) << describe(*wheels);
  // Another run of the same name is another robot.
  thrown<FailedPrecondition>([&] { client.navigate(idle); });
}

TEST_F(Led, WhatCannotBeLedIsRefused) {
  NavigationOptions unknown = options(1.0);
  unknown.map = "cellar";
  EXPECT_NE(thrown<NotFound>([&] { client.navigate(unknown); }).find("cellar"), std::string::npos);
  NavigationOptions blind = options(1.0);
  blind.camera.Clear();
  EXPECT_NE(thrown<InvalidArgument>([&] { client.navigate(blind); }).find("camera"), std::string::npos);
  Navigation navigation = client.navigate(options(1.0));
  const std::string huge(max_image_bytes + 1, 'x');
  EXPECT_NE(thrown<InvalidUse>([&] { navigation.see({1, 1, Image(huge)}); }).find("smaller"), std::string::npos);
  navigation.see(frame(1));
  const auto refused = navigation.next_event(patience);
  ASSERT_TRUE(refused);
  EXPECT_NE(describe(*refused).find("odometry"), std::string::npos) << describe(*refused);
}

}  // namespace
