// What no real server does on demand: a peer that postpones frames, forgets them, or talks nonsense.
#include <grpcpp/server.h>
#include <grpcpp/server_builder.h>
#include <gtest/gtest.h>

#include <atomic>
#include <functional>
#include <mutex>

#include "support.hpp"
#include "waypost/v1/session.grpc.pb.h"

namespace {

using namespace support;
using namespace waypost;

using Wire = grpc::ServerReaderWriter<v1::StreamResponse, v1::StreamRequest>;

// Serves each connection by the next of its scripts, the last one for ever.
class Peer final : public v1::SessionService::Service {
 public:
  using Script = std::function<void(Peer&, Wire&)>;

  explicit Peer(std::vector<Script> scripts) : scripts_(std::move(scripts)) {
    int port = 0;
    grpc::ServerBuilder builder;
    builder.AddListeningPort("127.0.0.1:0", grpc::InsecureServerCredentials(), &port);
    builder.RegisterService(this);
    server_ = builder.BuildAndStart();
    address_ = "127.0.0.1:" + std::to_string(port);
  }
  ~Peer() override {
    server_->Shutdown(std::chrono::system_clock::now());
    // Whatever its last script wrote is seen here.
    const std::lock_guard lock(mutex_);
  }

  const std::string& address() const { return address_; }
  std::vector<std::vector<std::uint64_t>> sent() {
    const std::lock_guard lock(mutex_);
    return sent_;
  }
  std::vector<std::string> names() {
    const std::lock_guard lock(mutex_);
    return names_;
  }

  // The number of the next frame; 0 after the last.
  std::uint64_t read(Wire& stream) {
    v1::StreamRequest request;
    if (!stream.Read(&request)) return 0;
    const std::lock_guard lock(mutex_);
    sent_.back().push_back(request.frame().sequence());
    return request.frame().sequence();
  }
  static void open(Wire& stream, std::uint64_t last_committed = 0) {
    v1::StreamResponse response;
    response.mutable_opened()->set_session("maps/hall/sessions/made-up");
    if (last_committed > 0) response.mutable_opened()->set_last_committed_sequence(last_committed);
    stream.Write(response);
  }
  static void answer(Wire& stream, std::uint64_t sequence) {
    v1::StreamResponse response;
    response.mutable_answer()->set_sequence(sequence);
    stream.Write(response);
  }
  // The time is google.rpc.RetryInfo with a delay of so many nanoseconds, as it is on the wire.
  static void postpone(Wire& stream, std::uint64_t sequence, std::chrono::milliseconds delay) {
    v1::StreamResponse response;
    response.mutable_refusal()->set_sequence(sequence);
    google::rpc::Status& status = *response.mutable_refusal()->mutable_status();
    status.set_code(static_cast<int>(Code::resource_exhausted));
    status.set_message("there is much to do");
    std::string duration = "\x10";
    for (auto left = static_cast<std::uint64_t>(std::chrono::nanoseconds(delay).count()); left > 0; left >>= 7) {
      duration += static_cast<char>((left & 0x7f) | (left > 0x7f ? 0x80 : 0));
    }
    auto& detail = *status.add_details();
    detail.set_type_url("type.googleapis.com/google.rpc.RetryInfo");
    detail.set_value("\x0a" + std::string(1, static_cast<char>(duration.size())) + duration);
    stream.Write(response);
  }
  void answer_all(Wire& stream) {
    while (const std::uint64_t sequence = read(stream)) answer(stream, sequence);
  }

 private:
  grpc::Status Stream(grpc::ServerContext*, Wire* stream) override {
    v1::StreamRequest opening;
    stream->Read(&opening);
    std::size_t at = 0;
    {
      const std::lock_guard lock(mutex_);
      at = std::min(names_.size(), scripts_.size() - 1);
      names_.push_back(opening.open().session_id());
      sent_.emplace_back();
    }
    scripts_[at](*this, *stream);
    return grpc::Status::OK;
  }

  const std::vector<Script> scripts_;
  std::unique_ptr<grpc::Server> server_;
  std::string address_;
  std::mutex mutex_;
  std::vector<std::vector<std::uint64_t>> sent_;
  std::vector<std::string> names_;
};

Frame small(std::uint64_t sequence) {
  return {sequence, static_cast<std::int64_t>(sequence), Image(std::string("image"))};
}

std::vector<std::uint64_t> outcomes(Session& session) {
  session.finish();
  std::vector<std::uint64_t> sequences;
  while (const auto outcome = session.receive()) sequences.push_back(outcome->answer().sequence());
  return sequences;
}

TEST(Peers, PostponedFramesAreSentAgainInOrderAfterTheTimeThatIsNamed) {
  Peer peer({[](Peer& self, Wire& stream) {
    Peer::open(stream);
    Peer::postpone(stream, self.read(stream), 300ms);
    std::uint64_t wanted = 1;
    while (const std::uint64_t sequence = self.read(stream)) {
      if (sequence == wanted) {
        Peer::answer(stream, wanted++);
      } else {
        Peer::postpone(stream, sequence, 20ms);
      }
    }
  }});
  SessionOptions options{"hall"};
  options.window_frames = 4;
  Session session = Client::lazy(peer.address()).open_session(options);
  const auto begin = std::chrono::steady_clock::now();
  for (std::uint64_t sequence = 1; sequence <= 7; ++sequence) session.post(small(sequence));
  EXPECT_EQ(outcomes(session), (std::vector<std::uint64_t>{1, 2, 3, 4, 5, 6, 7}));
  EXPECT_GE(std::chrono::steady_clock::now() - begin, 300ms);
  const auto sent = peer.sent();
  ASSERT_EQ(sent.size(), 1U);
  const std::vector<std::uint64_t> last(sent[0].end() - 6, sent[0].end());
  EXPECT_EQ(last, (std::vector<std::uint64_t>{2, 3, 4, 5, 6, 7}));
}

TEST(Peers, OneThatKeepsPostponingIsGivenUp) {
  Peer peer({[](Peer& self, Wire& stream) {
    Peer::open(stream);
    while (const std::uint64_t sequence = self.read(stream)) Peer::postpone(stream, sequence, 1ms);
  }});
  SessionOptions options{"hall"};
  options.reconnection.give_up_after = 300ms;
  Session session = Client::lazy(peer.address()).open_session(options);
  const std::string said = thrown<SessionLost>([&] { session.send(small(1)); });
  EXPECT_NE(said.find("1 frames without an answer (there is much to do)"), std::string::npos) << said;
}

TEST(Peers, WhatWasNotAnsweredGoesOverTheNextConnectionUnderItsNumber) {
  Peer peer({[](Peer& self, Wire& stream) {
               Peer::open(stream);
               Peer::answer(stream, self.read(stream));
               self.read(stream);
             },
             [](Peer& self, Wire& stream) {
               Peer::open(stream, 1);
               self.answer_all(stream);
             }});
  Session session = Client::lazy(peer.address()).open_session({"hall"});
  for (std::uint64_t sequence = 1; sequence <= 5; ++sequence) session.post(small(sequence));
  EXPECT_EQ(outcomes(session), (std::vector<std::uint64_t>{1, 2, 3, 4, 5}));
  // The name that the server made up is what the session is opened again by.
  EXPECT_EQ(peer.names(), (std::vector<std::string>{"", "made-up"}));
  EXPECT_EQ(peer.sent().at(1), (std::vector<std::uint64_t>{2, 3, 4, 5}));
}

TEST(Peers, OneWithOlderDataIsNoticed) {
  Peer peer({[](Peer& self, Wire& stream) {
               Peer::open(stream);
               Peer::answer(stream, self.read(stream));
             },
             [](Peer& self, Wire& stream) {
               Peer::open(stream);
               self.answer_all(stream);
             }});
  Session session = Client::lazy(peer.address()).open_session({"hall"});
  session.post(small(1));
  session.post(small(2));
  EXPECT_EQ(session.receive()->sequence(), 1U);
  const std::string said = thrown<SessionRewound>([&] { session.receive(); });
  EXPECT_NE(said.find("frame 1 of this session, but now knows it only up to no frame at all"), std::string::npos) << said;
}

TEST(Peers, NonsenseIsAProtocolError) {
  Peer peer({[](Peer& self, Wire& stream) {
    Peer::open(stream);
    self.read(stream);
    Peer::answer(stream, 77);
    self.read(stream);
  }});
  Session session = Client::lazy(peer.address()).open_session({"hall"});
  EXPECT_NE(thrown<ProtocolError>([&] { session.send(small(1)); }).find("frame 77"), std::string::npos);
}

TEST(Peers, NoMoreFramesAreUnderWayThanTheWindowHolds) {
  std::atomic<bool> answering = false;
  Peer peer({[&](Peer& self, Wire& stream) {
    Peer::open(stream);
    while (!answering) std::this_thread::sleep_for(5ms);
    self.answer_all(stream);
  }});
  SessionOptions options{"hall"};
  options.window_frames = 3;
  Session session = Client::lazy(peer.address()).open_session(options);
  for (std::uint64_t sequence = 1; sequence <= 3; ++sequence) session.post(small(sequence));
  EXPECT_FALSE(session.try_post(small(4)));
  EXPECT_FALSE(session.receive_for(50ms));
  answering = true;
  session.post(small(4));
  EXPECT_EQ(outcomes(session), (std::vector<std::uint64_t>{1, 2, 3, 4}));
}

TEST(Peers, OutcomesThatNobodyTakesAreSaidAtLast) {
  Peer peer({[](Peer& self, Wire& stream) {
    Peer::open(stream);
    self.answer_all(stream);
  }});
  Session session = Client::lazy(peer.address()).open_session({"hall"});
  const std::string said = thrown<InvalidUse>([&] {
    for (std::uint64_t sequence = 1; sequence <= 11'000; ++sequence) session.post(small(sequence));
  });
  EXPECT_NE(said.find("call receive"), std::string::npos) << said;
}

}  // namespace
