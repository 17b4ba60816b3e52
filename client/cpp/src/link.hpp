// One connection of a stream.
#pragma once

#include <grpcpp/client_context.h>
#include <grpcpp/support/client_callback.h>

#include <condition_variable>
#include <cstddef>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <utility>

#include "backoff.hpp"

namespace waypost {

// Guards all that belongs to one stream, of the library and of the application's threads. Notified at every change.
struct Monitor {
  std::mutex mutex;
  std::condition_variable changed;
};

// An open stream, driven by gRPC's own threads. All methods are called with the monitor's lock held. gRPC never calls
// back from within them, so that the lock is never taken twice. Whoever has it cancels it before dropping it. No thread
// of gRPC may drop it: with the last of a channel, that thread would wait for its own end.
template <class Request, class Response>
class Link final : public grpc::ClientBidiReactor<Request, Response> {
 public:
  struct Arrival {
    Response response;
    Clock::time_point at;
  };

  // Opens a stream by its first request: `start(context, reactor)` calls the stub.
  template <class Start>
  static std::unique_ptr<Link> open(std::shared_ptr<Monitor> monitor, Request first, Start start) {
    auto link = std::unique_ptr<Link>(new Link(std::move(monitor)));
    start(&link->context_, link.get());
    // What is sent from outside of gRPC's own calls needs the call to stay; `OnReadDone` lets go of it.
    link->AddHold();
    link->StartRead(&link->incoming_);
    link->send(std::make_shared<const Request>(std::move(first)));
    link->StartCall();
    return link;
  }

  // Queues a request.
  void send(std::shared_ptr<const Request> request) {
    if (reading_ended_ || finishing_) return;
    requests_.push_back(std::move(request));
    write_next();
  }

  // Whether nothing more comes, even if responses wait to be taken.
  bool is_over() const { return reading_ended_ || status_; }

  // Requests that wait to be sent.
  std::size_t waiting() const { return requests_.size(); }

  // The next response, if there is one.
  std::optional<Arrival> take() {
    if (arrivals_.empty()) return std::nullopt;
    Arrival arrival = std::move(arrivals_.front());
    arrivals_.pop_front();
    return arrival;
  }

  // How the stream ended; null before, and while responses wait to be taken.
  const grpc::Status* ended() const { return arrivals_.empty() && status_ ? &*status_ : nullptr; }

  // Ends the stream from this side, and lets the server end it from its own until then.
  void finish(std::unique_lock<std::mutex>& lock, Clock::time_point until) {
    finishing_ = true;
    write_next();
    monitor_->changed.wait_until(lock, until, [this] { return status_.has_value(); });
  }

  // Ends the stream at once; returns when gRPC has let go of it.
  void cancel(std::unique_lock<std::mutex>& lock) {
    if (!status_) context_.TryCancel();
    monitor_->changed.wait(lock, [this] { return status_.has_value(); });
  }

 private:
  explicit Link(std::shared_ptr<Monitor> monitor) : monitor_(std::move(monitor)) {}

  void write_next() {
    if (writing_ || reading_ended_ || half_closed_) return;
    if (!requests_.empty()) {
      writing_ = true;
      this->StartWrite(requests_.front().get());
    } else if (finishing_) {
      half_closed_ = true;
      this->StartWritesDone();
    }
  }

  void OnWriteDone(bool ok) override {
    const std::lock_guard lock(monitor_->mutex);
    writing_ = false;
    requests_.pop_front();
    // If it failed, the stream is over, and reading says so.
    if (ok) write_next();
  }

  void OnReadDone(bool ok) override {
    const std::lock_guard lock(monitor_->mutex);
    if (ok) {
      arrivals_.push_back({std::move(incoming_), Clock::now()});
      incoming_ = Response();
      this->StartRead(&incoming_);
      monitor_->changed.notify_all();
    } else {
      reading_ended_ = true;
      this->RemoveHold();
    }
  }

  void OnDone(const grpc::Status& status) override {
    // Whoever waits for the end drops the link as soon as the lock is free, and nothing of it is touched then.
    const std::shared_ptr<Monitor> monitor = monitor_;
    const std::lock_guard lock(monitor->mutex);
    status_ = status;
    monitor->changed.notify_all();
  }

  std::shared_ptr<Monitor> monitor_;
  grpc::ClientContext context_;
  Response incoming_;
  // The first one is being written while `writing_`.
  std::deque<std::shared_ptr<const Request>> requests_;
  std::deque<Arrival> arrivals_;
  bool writing_ = false;
  bool finishing_ = false;
  bool half_closed_ = false;
  bool reading_ended_ = false;
  std::optional<grpc::Status> status_;
};

}  // namespace waypost
