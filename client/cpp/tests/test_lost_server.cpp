// Servers that die, and come back or do not.
#include <gtest/gtest.h>

#include <future>

#include "support.hpp"

namespace {

using namespace support;
using namespace waypost;

constexpr std::uint64_t frames = 24;

struct MortalServer {
  TemporaryFolder folder;
  Server server{folder / "data"};
};

// An answer but for what is of the moment, with the name of its map made the same.
std::string decided(FrameAnswer answer) {
  answer.clear_timings();
  answer.clear_resent();
  answer.clear_last_committed_sequence();
  answer.clear_map_pose();
  if (answer.has_match()) answer.mutable_match()->mutable_frame()->clear_session();
  if (answer.has_best_candidate()) answer.mutable_best_candidate()->mutable_frame()->clear_session();
  return answer.DebugString();
}

std::vector<std::string> undisturbed(const Client& client) {
  std::vector<std::string> answers;
  Session session = client.open_session({"undisturbed", "robot"});
  for (std::uint64_t sequence = 1; sequence <= frames; ++sequence) {
    answers.push_back(decided(session.send(frame(sequence))));
  }
  return answers;
}

TEST(LostServer, ASessionOutlivesKillsAndEveryFrameIsAnsweredOnce) {
  MortalServer mortal;
  const Client client = Client::connect(mortal.server.address());
  client.create_map("hall", "shipped");
  client.create_map("undisturbed", "shipped");
  const std::vector<std::string> expected = undisturbed(client);

  std::vector<std::string> notices;
  SessionOptions options{"hall", "robot"};
  options.on_notice = [&](const std::string& sentence) { notices.push_back(sentence); };
  Session session = client.open_session(options);
  std::vector<std::uint64_t> sequences;
  std::vector<std::string> answers;
  std::uint64_t next = 1;
  while (answers.size() < frames) {
    // The window is full whenever the server dies.
    while (next <= frames) {
      Frame coming = frame(next);
      if (!session.try_post(std::move(coming))) break;
      ++next;
    }
    const auto outcome = session.receive();
    ASSERT_TRUE(outcome);
    sequences.push_back(outcome->sequence());
    answers.push_back(decided(outcome->answer()));
    if (const std::uint64_t at = sequences.back(); at == 1 || at == 7 || at == 18) {
      mortal.server.kill();
      mortal.server.start();
    }
  }
  session.close();

  for (std::uint64_t at = 0; at < frames; ++at) {
    EXPECT_EQ(sequences[at], at + 1);
    EXPECT_EQ(answers[at], expected[at]);
  }
  const v1::Map hall = client.map("hall", v1::MAP_VIEW_FULL);
  EXPECT_EQ(hall.frames(), frames);
  EXPECT_EQ(hall.state_hash(), client.map("undisturbed", v1::MAP_VIEW_FULL).state_hash());
  ASSERT_GE(notices.size(), 2U);
  EXPECT_EQ(notices[0].rfind("lost the server", 0), 0U) << notices[0];
  EXPECT_EQ(notices[1].rfind("back at the server", 0), 0U) << notices[1];
}

TEST(LostServer, OneThatStaysAwayIsSaidSo) {
  MortalServer mortal;
  const Client client = Client::connect(mortal.server.address());
  client.create_map("hall", "shipped");
  SessionOptions options{"hall", "robot"};
  options.reconnection.give_up_after = 1s;
  Session session = client.open_session(options);
  session.send(frame(1));
  mortal.server.kill();
  session.post(frame(2));
  session.post(frame(3));
  const std::string said = thrown<SessionLost>([&] { session.receive(); });
  EXPECT_NE(said.find("2 frames without an answer"), std::string::npos) << said;
  EXPECT_NE(said.find("open the same session"), std::string::npos) << said;
  thrown<SessionLost>([&] { session.post(frame(4)); });
  thrown<SessionLost>([&] { session.close(); });
  thrown<SessionLost>([&] { client.open_session(options); });
  const std::string unreachable = thrown<ServerUnreachable>([&] { client.maps(); });
  EXPECT_NE(unreachable.find("check that waypost-server runs"), std::string::npos) << unreachable;

  mortal.server.start();
  Session again = client.open_session(options);
  EXPECT_EQ(again.last_committed_sequence(), 1U);
  EXPECT_EQ(again.send(frame(2)).sequence(), 2U);
}

TEST(LostServer, ASessionThatIsClosedWhileTheServerIsAwayWaitsForIt) {
  MortalServer mortal;
  const Client client = Client::connect(mortal.server.address());
  client.create_map("hall", "shipped");
  std::vector<std::uint64_t> sequences;
  SessionOptions options{"hall"};
  options.on_outcome = [&](const FrameOutcome& outcome) { sequences.push_back(outcome.answer().sequence()); };
  Session session = client.open_session(options);
  mortal.server.kill();
  session.post(frame(1));
  session.post(frame(2));
  mortal.server.start();
  session.close();
  EXPECT_EQ(sequences, (std::vector<std::uint64_t>{1, 2}));
  EXPECT_EQ(client.map("hall").frames(), 2U);
}

TEST(LostServer, ARobotMayStartBeforeItsServer) {
  MortalServer mortal;
  mortal.server.kill();
  thrown<ServerUnreachable>([&] { Client::connect(mortal.server.address()); });
  const Client client = Client::lazy(mortal.server.address());
  // A server that does not know the map is waited for, and refuses.
  auto opening = std::async(std::launch::async, [&] {
    return thrown<NotFound>([&] { client.open_session({"hall"}); });
  });
  EXPECT_EQ(opening.wait_for(300ms), std::future_status::timeout);
  mortal.server.start();
  EXPECT_NE(opening.get().find("hall"), std::string::npos);
  client.create_map("hall");
  EXPECT_EQ(client.open_session({"hall"}).send(frame(1)).sequence(), 1U);
}

}  // namespace
