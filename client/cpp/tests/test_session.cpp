// Sessions on a real server: what is answered, what is refused, and how they end.
#include <gtest/gtest.h>

#include <memory>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <regex>

#include "support.hpp"
#include "waypost/v1/label.grpc.pb.h"
#include "waypost/v1/map.grpc.pb.h"

namespace {

using namespace support;
using namespace waypost;
using ::testing::Test;

class Sessions : public Test {
 protected:
  static void SetUpTestSuite() {
    folder = std::make_unique<TemporaryFolder>();
    server = std::make_unique<Server>(*folder / "data");
  }
  static void TearDownTestSuite() {
    server.reset();
    folder.reset();
  }

  // An empty map, named after the test.
  void SetUp() override {
    for (const char letter : std::string(::testing::UnitTest::GetInstance()->current_test_info()->name())) {
      hall += static_cast<char>(std::tolower(letter));
    }
    hall = hall.substr(0, 63);
    client.create_map(hall, "shipped");
  }

  static std::unique_ptr<TemporaryFolder> folder;
  static std::unique_ptr<Server> server;
  Client client = Client::connect(server->address());
  std::string hall;
};

std::unique_ptr<TemporaryFolder> Sessions::folder;
std::unique_ptr<Server> Sessions::server;

TEST_F(Sessions, SendGivesTheAnswerAndWhatIsSentAgainGetsTheStoredOne) {
  Session session = client.open_session({hall, "monday"});
  EXPECT_EQ(session.name(), "maps/" + hall + "/sessions/monday");
  EXPECT_EQ(session.last_committed_sequence(), std::nullopt);
  const FrameAnswer first = session.send(frame(1));
  EXPECT_EQ(first.sequence(), 1U);
  EXPECT_EQ(first.reason(), v1::REASON_NEW_PLACE);
  EXPECT_FALSE(first.resent());
  session.send(frame(2));
  EXPECT_EQ(session.last_committed_sequence(), 2U);
  session.close();

  Session again = client.open_session({hall, "monday"});
  EXPECT_EQ(again.last_committed_sequence(), 2U);
  const FrameAnswer stored = again.send(frame(1));
  EXPECT_TRUE(stored.resent());
  EXPECT_EQ(stored.place_number(), first.place_number());
  EXPECT_FALSE(again.send(frame(3)).resent());
  EXPECT_EQ(client.map(hall).frames(), 3U);
}

TEST_F(Sessions, ACallbackGetsEveryOutcomeInOrder) {
  std::vector<std::uint64_t> sequences;
  SessionOptions options{hall};
  options.on_outcome = [&](const FrameOutcome& outcome) { sequences.push_back(outcome.answer().sequence()); };
  Session session = client.open_session(options);
  for (std::uint64_t sequence = 1; sequence <= 12; ++sequence) session.post(frame(sequence));
  EXPECT_NE(thrown<InvalidUse>([&] { session.receive(); }).find("on_outcome"), std::string::npos);
  EXPECT_NE(thrown<InvalidUse>([&] { session.send(frame(13)); }).find("on_outcome"), std::string::npos);
  session.close();
  EXPECT_EQ(sequences, (std::vector<std::uint64_t>{1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12}));
  EXPECT_NE(thrown<InvalidUse>([&] { session.post(frame(13)); }).find("finished"), std::string::npos);
}

TEST_F(Sessions, WhatACallbackThrowsEndsTheSession) {
  SessionOptions options{hall};
  options.on_outcome = [](const FrameOutcome&) { throw std::runtime_error("the disk is full"); };
  Session session = client.open_session(options);
  session.post(frame(1));
  EXPECT_EQ(thrown<std::runtime_error>([&] { session.close(); }), "the disk is full");
}

TEST_F(Sessions, ARefusedFrameIsAnOutcomeAndTheStreamGoesOn) {
  Session session = client.open_session({hall});
  Frame backwards = frame(5);
  backwards.stamp_ns = second_ns;
  Frame off_the_map = frame(6);
  off_the_map.odometry = planar_odometry(std::nan(""), 0, 0);
  session.post(frame(1));
  session.post({2, 2 * second_ns, Image(std::string())});
  session.post({3, 3 * second_ns, Image(std::string("GIF89a"))});
  session.post({4, 4 * second_ns, Image(std::string(max_image_bytes + 1, 'x'))});
  session.post(backwards);
  session.post(off_the_map);
  session.post(frame(7));
  session.finish();

  std::vector<std::string> refusals;
  std::vector<std::uint64_t> answered;
  while (const auto outcome = session.receive()) {
    if (const FrameRefused* refused = outcome->refusal()) {
      refusals.push_back(std::string(name_of(refused->error.code())) + ": " + refused->error.what());
      thrown<ServerError>([&] { outcome->answer(); });
    } else {
      answered.push_back(outcome->sequence());
    }
  }
  EXPECT_EQ(answered, (std::vector<std::uint64_t>{1, 7}));
  ASSERT_EQ(refusals.size(), 5U);
  const char* said[] = {"INVALID_ARGUMENT.*empty", "INVALID_ARGUMENT.*JPEG", "INVALID_ARGUMENT.*make it smaller",
                        "FAILED_PRECONDITION.*stamp", "INVALID_ARGUMENT.*odometry"};
  for (std::size_t at = 0; at < refusals.size(); ++at) {
    EXPECT_TRUE(std::regex_search(refusals[at], std::regex(said[at]))) << refusals[at];
  }
  EXPECT_EQ(client.map(hall).frames(), 2U);
}

TEST_F(Sessions, SendThrowsTheRefusalAndGoesOn) {
  Session session = client.open_session({hall});
  const std::string said = thrown<InvalidArgument>([&] { session.send({1, second_ns, Image(std::string("GIF89a"))}); });
  EXPECT_NE(said.find("JPEG"), std::string::npos) << said;
  EXPECT_EQ(session.send(frame(2)).sequence(), 2U);
}

TEST_F(Sessions, NumbersHaveToRise) {
  Session session = client.open_session({hall});
  session.post(frame(2));
  const std::string said = thrown<InvalidUse>([&] { session.post(frame(2)); });
  EXPECT_NE(said.find("frame 2 follows frame 2"), std::string::npos) << said;
  // That was no error of the session.
  session.post(frame(3));
  session.finish();
  EXPECT_EQ(session.receive()->sequence(), 2U);
  EXPECT_EQ(session.receive()->sequence(), 3U);
  EXPECT_FALSE(session.receive());
}

TEST_F(Sessions, AFullWindowTakesNoMoreAndLeavesTheFrame) {
  SessionOptions options{hall};
  options.window_frames = 1;
  Session session = client.open_session(options);
  Frame second = frame(2);
  session.post(frame(1));
  // The first takes the server milliseconds.
  EXPECT_FALSE(session.try_post(std::move(second)));
  EXPECT_TRUE(eventually([&] { return session.try_post(std::move(second)); }));
  session.finish();
  EXPECT_EQ(session.receive()->answer().sequence(), 1U);
  EXPECT_EQ(session.receive()->answer().sequence(), 2U);
}

TEST_F(Sessions, PixelsAreTakenAsImages) {
  const cv::Mat colours = cv::imread(images()[0].string());
  cv::Mat grey;
  cv::cvtColor(colours, grey, cv::COLOR_BGR2GRAY);
  const auto packed = [](const cv::Mat& pixels, PixelFormat format) {
    return Image::of_pixels({pixels.data, static_cast<std::uint32_t>(pixels.cols),
                             static_cast<std::uint32_t>(pixels.rows), format, pixels.step});
  };
  Session session = client.open_session({hall});
  const double words = session.send(frame(1)).words();
  EXPECT_GT(words, 50);
  // Decoders of JPEG round differently.
  EXPECT_NEAR(session.send({2, 2 * second_ns, packed(colours, PixelFormat::bgr)}).words(), words, 0.1 * words);
  EXPECT_NEAR(session.send({3, 3 * second_ns, packed(grey, PixelFormat::grey)}).words(), words, 0.1 * words);
}

TEST_F(Sessions, LocalizingChangesNothing) {
  Session teaching = client.open_session({hall, "taught"});
  const std::uint32_t place = teaching.send(frame(1)).place_number();
  teaching.close();
  SessionOptions options{hall, "visitor", v1::SESSION_MODE_LOCALIZE};
  Session session = client.open_session(options);
  EXPECT_EQ(session.send(frame(1)).place_number(), place);
  EXPECT_EQ(client.map(hall).frames(), 1U);
}

TEST_F(Sessions, WrongNamesAreErrorsInTheWordsOfTheServer) {
  EXPECT_NE(thrown<NotFound>([&] { client.open_session({"cellar"}); }).find("cellar"), std::string::npos);
  EXPECT_NE(thrown<NotFound>([&] { client.map("cellar"); }).find("cellar"), std::string::npos);
  thrown<InvalidArgument>([&] { client.open_session({hall, "Not A Name"}); });
  thrown<NotFound>([&] { client.create_map("other", "models/000000"); });
  try {
    client.create_map(hall);
    FAIL() << "made twice";
  } catch (const ServerError& error) {
    EXPECT_EQ(error.code(), Code::already_exists);
    EXPECT_EQ(name_of(error.code()), "ALREADY_EXISTS");
  }
}

TEST_F(Sessions, WhatTheServerEndsSaysWhy) {
  Session older = client.open_session({hall, "robot"});
  Session newer = client.open_session({hall, "robot"});
  thrown<Aborted>([&] { older.send(frame(1)); });
  thrown<Aborted>([&] { older.post(frame(2)); });
  newer.send(frame(1));
  v1::DeleteMapRequest request;
  request.set_name("maps/" + hall);
  client.call(&v1::MapService::Stub::DeleteMap, request);
  thrown<NotFound>([&] { newer.send(frame(2)); });
  for (const v1::Map& map : client.maps()) EXPECT_NE(map.name(), "maps/" + hall);
}

TEST_F(Sessions, AllElseIsReachedByTheContract) {
  Session session = client.open_session({hall});
  const std::uint32_t place = session.send(frame(1)).place_number();
  v1::SetLabelRequest request;
  request.set_place("maps/" + hall + "/places/" + std::to_string(place));
  request.set_label("dock");
  EXPECT_EQ(client.call(&v1::LabelService::Stub::SetLabel, request).labels_size(), 1);
  request.set_label("");
  thrown<InvalidArgument>([&] { client.call(&v1::LabelService::Stub::SetLabel, request); });

  grpc::ClientContext context;
  v1::ListLabelsRequest list;
  list.set_map("maps/" + hall);
  v1::ListLabelsResponse labels;
  client.check(client.stub<v1::LabelService>()->ListLabels(&context, list, &labels), context);
  ASSERT_EQ(labels.labels_size(), 1);
  EXPECT_EQ(labels.labels(0).label(), "dock");
}

TEST_F(Sessions, OneThatIsGivenUpEndsAtOnce) {
  const auto begin = std::chrono::steady_clock::now();
  {
    Session session = client.open_session({hall});
    for (std::uint64_t sequence = 1; sequence <= 8; ++sequence) session.post(frame(sequence));
  }
  EXPECT_LT(std::chrono::steady_clock::now() - begin, 5s);
  // Whoever comes next is not confused by it.
  EXPECT_EQ(client.open_session({hall}).send(frame(1)).sequence(), 1U);
}

}  // namespace
