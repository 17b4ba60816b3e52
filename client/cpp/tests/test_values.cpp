// What needs no server: addresses, delays, goals, commands, pixels.
#include <gtest/gtest.h>

#include <opencv2/imgcodecs.hpp>

#include "../src/address.hpp"
#include "../src/asked_goals.hpp"
#include "../src/backoff.hpp"
#include "../src/last_command.hpp"
#include "support.hpp"

namespace {

using namespace support;
using namespace waypost;

TEST(Addresses, AreReadAsTheOtherClientsReadThem) {
  EXPECT_EQ(parse_address("robot.local:7600").target, "robot.local:7600");
  EXPECT_EQ(parse_address("http://127.0.0.1").target, "127.0.0.1:80");
  EXPECT_EQ(parse_address("https://[::1]:7600/").target, "[::1]:7600");
  EXPECT_EQ(parse_address("https://host").target, "host:443");
  EXPECT_EQ(parse_address("https://host").scheme, Scheme::https);
}

TEST(Addresses, ThatAreNoneAreRefused) {
  const std::pair<const char*, const char*> wrong[] = {
      {"", "no host"},
      {"localhost", "lacks a port"},
      {"127.0.0.1:port", "port is no number"},
      {"127.0.0.1:70000", "port is no number"},
      {"ftp://127.0.0.1:7600", "the scheme `ftp` is not served"},
      {"http://127.0.0.1:7600/v1", "more than a host and a port"},
      {"http://user@127.0.0.1:7600", "more than a host and a port"},
      {"a b:7600", "no host"},
      {"::1:7600", "in brackets"},
  };
  for (const auto& [address, reason] : wrong) {
    const std::string said = thrown<InvalidUse>([text = address] { Client::lazy(text); });
    EXPECT_NE(said.find(reason), std::string::npos) << said;
    EXPECT_NE(said.find("write it as HOST:PORT"), std::string::npos) << said;
  }
}

TEST(Delays, DoubleUpToTheLongestAndAddUpToTheTimeOfGivingUp) {
  const Reconnection settings;
  Backoff backoff(settings, 1);
  waypost::Clock::time_point now{};
  std::vector<waypost::Clock::duration> delays;
  while (const auto delay = backoff.next_delay(now)) {
    delays.push_back(*delay);
    now += *delay;
  }
  waypost::Clock::duration full = settings.first_delay;
  waypost::Clock::duration sum{0};
  for (std::size_t at = 0; at < delays.size(); ++at) {
    sum += delays[at];
    EXPECT_LE(delays[at], full);
    if (at + 1 < delays.size()) {
      EXPECT_GE(delays[at], full / 2);
    }
    full = std::min<waypost::Clock::duration>(2 * full, settings.longest_delay);
  }
  EXPECT_EQ(full, settings.longest_delay);
  EXPECT_EQ(sum, settings.give_up_after);
  backoff.progress();
  EXPECT_LE(*backoff.next_delay(now), settings.first_delay);
  thrown<InvalidUse>([] { Backoff({0ms, 1ms, 1ms}); });
}

v1::GoalRefusal refusal_of(const v1::Goal& goal) {
  v1::GoalRefusal refusal;
  *refusal.mutable_goal() = goal;
  return refusal;
}

TEST(Goals, AStopOutlivesTheGoalsAfterIt) {
  AskedGoals goals(place_goal(1));
  goals.go_to(label_goal("nowhere"));
  goals.stop();
  for (std::uint32_t number = 0; number < 100; ++number) goals.go_to(place_goal(number));
  goals.refused(refusal_of(label_goal("nowhere")));
  std::vector<v1::NavigateRequest> unsaid;
  goals.send_unsaid([&](const AskedGoals::Request& request) { unsaid.push_back(*request); });
  ASSERT_EQ(unsaid.size(), 4U);
  EXPECT_TRUE(unsaid.front().has_stop());
  EXPECT_EQ(unsaid.back().goal().place_number(), 99U);
  EXPECT_TRUE(goals.is_stopping());
  EXPECT_EQ(goals.for_opening(), nullptr);
}

TEST(Goals, ALabelIsRefusedByItsPlaceOnceTheServerLookedItUp) {
  AskedGoals goals(label_goal("dock"));
  goals.refused(refusal_of(place_goal(4)));
  EXPECT_EQ(goals.for_opening(), nullptr);
}

TEST(Goals, OneThatWasReachedIsNotReturnedTo) {
  AskedGoals goals(place_goal(1));
  v1::Guidance arrived;
  arrived.set_stamp_ns(1);
  arrived.set_status(v1::NAVIGATION_STATUS_ARRIVED);
  goals.guided(arrived);
  ASSERT_NE(goals.for_opening(), nullptr);
  goals.go_to(place_goal(2));
  goals.refused(refusal_of(place_goal(2)));
  EXPECT_EQ(goals.for_opening(), nullptr);
}

TEST(Commands, LapseByTheTimeOfTheirArrival) {
  const waypost::Clock::time_point arrived{1'000s};
  v1::VelocityCommand command;
  command.set_number(7);
  command.set_forward_m_s(0.4);
  command.set_valid_ns(500'000'000);
  LastCommand last;
  EXPECT_TRUE(last.obey(arrived).is_stop());
  EXPECT_FALSE(last.obeyed());
  last.set(command, arrived);
  EXPECT_TRUE(last.obey(arrived + 500ms).is_stop());
  EXPECT_FALSE(last.obeyed()) << "a stop of its own is not the command";
  EXPECT_FALSE(last.obey(arrived + 499ms).is_stop());
  EXPECT_EQ(last.obeyed(), 7U);
  last.forget();
  EXPECT_TRUE(last.obey(arrived).is_stop());
}

TEST(Pixels, ComeOutOfAPngAsTheyWentIn) {
  constexpr std::uint32_t width_px = 5;
  constexpr std::uint32_t height_px = 3;
  // Rows with a gap behind them.
  constexpr std::size_t row_bytes = 20;
  std::vector<std::uint8_t> pixels(row_bytes * height_px);
  for (std::size_t at = 0; at < pixels.size(); ++at) pixels[at] = static_cast<std::uint8_t>(at * 37);
  for (const PixelFormat format : {PixelFormat::grey, PixelFormat::rgb, PixelFormat::bgr}) {
    const Image image = Image::of_pixels({pixels.data(), width_px, height_px, format, row_bytes});
    const std::vector<std::uint8_t> png(image.bytes().begin(), image.bytes().end());
    const cv::Mat read = cv::imdecode(png, cv::IMREAD_UNCHANGED);
    const int channels = format == PixelFormat::grey ? 1 : 3;
    ASSERT_EQ(read.channels(), channels);
    for (int y = 0; y < 3; ++y) {
      for (int x = 0; x < 5 * channels; ++x) {
        // OpenCV has blue first.
        const int stored = format == PixelFormat::rgb ? x - x % 3 + 2 - x % 3 : x;
        const std::size_t given = static_cast<std::size_t>(y) * row_bytes + static_cast<std::size_t>(stored);
        ASSERT_EQ(read.ptr(y)[x], pixels[given]) << x << ' ' << y;
      }
    }
  }
  thrown<InvalidUse>([] { Image::of_pixels({}); });
  thrown<InvalidUse>([&] { Image::of_pixels({pixels.data(), 5, 3, PixelFormat::rgb, 14}); });
  thrown<InvalidUse>([] { Image::read("absent.jpg"); });
}

TEST(Options, ThatCannotWorkAreRefused) {
  const Client client = Client::lazy("127.0.0.1:1");
  SessionOptions options{"hall"};
  options.window_frames = 0;
  EXPECT_NE(thrown<InvalidUse>([&] { client.open_session(options); }).find("window_frames"), std::string::npos);
}

}  // namespace
