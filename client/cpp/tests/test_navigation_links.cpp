// Links that break on a robot: what it was asked to do outlives them. The server is played by the test.
#include <grpcpp/server.h>
#include <grpcpp/server_builder.h>
#include <gtest/gtest.h>

#include <condition_variable>
#include <deque>
#include <future>
#include <limits>
#include <memory>
#include <mutex>
#include <optional>
#include <stdexcept>
#include <thread>
#include <vector>

#include "support.hpp"
#include "waypost/v1/navigation.grpc.pb.h"

namespace {

using namespace support;
using namespace waypost;

// What one thread hands to another, in order.
template <class Value>
class Queue {
 public:
  void put(Value value) {
    const std::lock_guard lock(mutex_);
    values_.push_back(std::move(value));
    changed_.notify_all();
  }
  Value take(std::chrono::seconds timeout = patience) {
    std::unique_lock lock(mutex_);
    if (!changed_.wait_for(lock, timeout, [this] { return !values_.empty(); })) throw std::runtime_error("none came");
    Value value = std::move(values_.front());
    values_.pop_front();
    return value;
  }

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<Value> values_;
};

// What the robot finds behind the next connection.
enum class Found { same_server, restarted_server };

// The server's side of a stream, which the test answers.
struct Stream {
  v1::OpenNavigation opening;
  Queue<v1::NavigateRequest> requests;
  // None cuts the stream off.
  Queue<std::optional<v1::NavigateResponse>> responses;

  v1::NavigateRequest asked() { return requests.take(); }
  std::int64_t report() { return asked().wheels().stamp_ns(); }
  void cut() { responses.put(std::nullopt); }
  void open(Found found) {
    v1::NavigateResponse response;
    response.mutable_opened()->set_navigation("maps/hall/navigations/robot");
    response.mutable_opened()->set_resumed(found == Found::same_server);
    responses.put(std::move(response));
  }
  // Answers a report, or a frame, with a command to drive.
  void guide(std::int64_t stamp_ns) {
    v1::NavigateResponse response;
    v1::Guidance& guidance = *response.mutable_guidance();
    guidance.set_stamp_ns(stamp_ns);
    guidance.mutable_command()->set_forward_m_s(1.0);
    guidance.mutable_command()->set_valid_ns(std::numeric_limits<std::int64_t>::max());
    responses.put(std::move(response));
  }
  void refuse(const v1::Goal& goal) {
    v1::NavigateResponse response;
    // As the contract has it, an image is not sent back.
    if (goal.has_image()) {
      response.mutable_goal_refusal();
    } else {
      *response.mutable_goal_refusal()->mutable_goal() = goal;
    }
    responses.put(std::move(response));
  }
};

class Peer final : public v1::NavigationService::Service {
 public:
  Peer() {
    int port = 0;
    grpc::ServerBuilder builder;
    builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port);
    builder.RegisterService(this);
    server_ = builder.BuildAndStart();
    address_ = "127.0.0.1:" + std::to_string(port);
  }
  ~Peer() override { server_->Shutdown(std::chrono::system_clock::now()); }

  const std::string& address() const { return address_; }
  // The next stream of the robot, opened.
  std::shared_ptr<Stream> next(Found found) {
    std::shared_ptr<Stream> stream = streams_.take();
    stream->open(found);
    return stream;
  }

 private:
  grpc::Status Navigate(grpc::ServerContext* context,
                        grpc::ServerReaderWriter<v1::NavigateResponse, v1::NavigateRequest>* wire) override {
    const auto stream = std::make_shared<Stream>();
    v1::NavigateRequest first;
    wire->Read(&first);
    stream->opening = first.open();
    streams_.put(stream);
    std::thread reading([wire, stream] {
      for (v1::NavigateRequest request; wire->Read(&request);) stream->requests.put(request);
      // The robot ended it, if the test has not.
      stream->cut();
    });
    // The test gives up before.
    while (auto response = stream->responses.take(10 * patience)) wire->Write(*response);
    context->TryCancel();
    reading.join();
    return grpc::Status::CANCELLED;
  }

  std::unique_ptr<grpc::Server> server_;
  std::string address_;
  Queue<std::shared_ptr<Stream>> streams_;
};

// A robot that drives to place 1, and its stream.
struct Led {
  Peer peer;
  std::shared_ptr<Stream> stream;
  std::optional<Navigation> navigation;

  Led() {
    NavigationOptions options{"hall"};
    options.goal = place_goal(1);
    options.reconnection.first_delay = 2ms;
    auto opening =
        std::async(std::launch::async, [&] { return Client::lazy(peer.address()).navigate(options); });
    stream = peer.next(Found::restarted_server);
    navigation = opening.get();
    navigation->report({1});
    EXPECT_EQ(stream->report(), 1);
    guide(1);
    EXPECT_TRUE(drives());
  }

  bool drives() { return !navigation->command().is_stop(); }
  // Returns once the robot has the answer.
  void guide(std::int64_t stamp_ns) {
    stream->guide(stamp_ns);
    EXPECT_TRUE(eventually([&] {
      const auto guidance = navigation->guidance();
      return guidance && guidance->stamp_ns() == stamp_ns;
    }));
  }
  void refuse(const v1::Goal& goal) {
    stream->refuse(goal);
    while (const auto event = navigation->next_event(patience)) {
      if (std::holds_alternative<GoalRefused>(*event)) return;
    }
    ADD_FAILURE() << "no refusal came";
  }
  // The stream breaks, and the robot opens the next.
  void reconnect(Found found) {
    stream->cut();
    stream = peer.next(found);
  }
  // Reports as soon as there is a connection.
  void report(std::int64_t stamp_ns) {
    EXPECT_TRUE(eventually([&] { return navigation->report({stamp_ns}); }));
    EXPECT_EQ(stream->report(), stamp_ns);
  }
};

TEST(NavigationLinks, AStopThatADeadLinkSwallowedIsSentAgain) {
  Led led;
  // By appearance frames are answered, too; this one not by a server that knows of the stop.
  led.navigation->see({1, 2, Image(std::string("image"))});
  led.navigation->stop();
  EXPECT_FALSE(led.drives());
  led.navigation->report({3});
  led.guide(2);
  EXPECT_FALSE(led.drives());

  led.reconnect(Found::same_server);
  EXPECT_FALSE(led.stream->opening.has_goal());
  EXPECT_TRUE(led.stream->asked().has_stop());
  led.report(4);
  led.guide(4);
  // What it says now it says in the knowledge of the stop.
  EXPECT_TRUE(led.drives());

  led.reconnect(Found::same_server);
  led.report(5);
}

TEST(NavigationLinks, GoalsThatADeadLinkSwallowedAreSentAgainInOrder) {
  Led led;
  led.navigation->go_to(place_goal(2));
  led.navigation->go_to(place_goal(3));
  led.stream->cut();
  // While it is away, too.
  led.navigation->go_to(place_goal(4));

  led.stream = led.peer.next(Found::same_server);
  // Any of the others may yet be refused.
  EXPECT_EQ(led.stream->opening.goal().place_number(), 1U);
  for (const std::uint32_t number : {2U, 3U, 4U}) EXPECT_EQ(led.stream->asked().goal().place_number(), number);
  led.report(2);
  led.guide(2);
  led.reconnect(Found::restarted_server);
  EXPECT_EQ(led.stream->opening.goal().place_number(), 4U);
}

TEST(NavigationLinks, ARestartedServerIsToldTheGoalThatWasNotRefused) {
  for (const bool is_answered_first : {false, true}) {
    Led led;
    const std::vector<v1::Goal> wrong = {label_goal("nowhere"), image_goal(Image(std::string("image"))),
                                         position_goal(std::numeric_limits<double>::quiet_NaN(), 0.0)};
    for (const v1::Goal& goal : wrong) {
      led.navigation->go_to(goal);
      EXPECT_TRUE(led.stream->asked().has_goal());
    }
    if (is_answered_first) {
      led.report(2);
      led.guide(2);
    }
    for (const v1::Goal& goal : wrong) led.refuse(goal);
    led.reconnect(Found::restarted_server);
    EXPECT_EQ(led.stream->opening.goal().place_number(), 1U);
    // Nothing is sent again.
    led.report(3);
  }
}

TEST(NavigationLinks, ARefusalDoesNotTakeALaterStopAway) {
  Led led;
  led.navigation->go_to(label_goal("nowhere"));
  led.navigation->stop();
  led.refuse(label_goal("nowhere"));
  led.reconnect(Found::same_server);
  EXPECT_FALSE(led.stream->opening.has_goal());
  EXPECT_TRUE(led.stream->asked().has_stop());
}

}  // namespace
