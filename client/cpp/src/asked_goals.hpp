// What the application asked for, in order, until the server has it and did not refuse it.
#pragma once

#include <cstdint>
#include <deque>
#include <memory>
#include <optional>

#include "waypost/v1/navigation.pb.h"

namespace waypost {

// The server looks a goal up, which takes a moment. It says when it refuses one, and then goes on to the one before; it
// does not say when it takes one.
class AskedGoals {
 public:
  using Request = std::shared_ptr<const v1::NavigateRequest>;

  // Of a navigation that is opened with this goal.
  explicit AskedGoals(const std::optional<v1::Goal>& first);

  // A report or a frame of this stamp is sent, after all that was asked for so far.
  void stamped(std::int64_t stamp_ns);
  // Ask for a goal, or to stand; give the request.
  Request go_to(v1::Goal goal);
  Request stop();

  // The server answered a report or a frame.
  void guided(const v1::Guidance& guidance);
  // The server refused a goal; it names none if that is an image.
  void refused(const v1::GoalRefusal& refusal);

  // What a restarted server is told, which knows of no goal; null if it is to have none.
  const v1::Goal* for_opening() const;
  // Calls `send` with each request that the server may not have got, in order.
  template <class Send>
  void send_unsaid(Send send) const {
    for (const Unsaid& unsaid : unsaid_) send(unsaid.request);
  }
  // Whether the robot is to stand, and the server may not know it.
  bool is_stopping() const;

 private:
  struct Unsaid {
    Request request;
    // Of the last report or frame before it. Requests are taken in order: with an answer to a later one, it has
    // arrived.
    std::int64_t after_stamp_ns;
  };

  Request ask(v1::NavigateRequest request);

  // Goals that the server has got since it was stopped and has not refused. It goes by the last.
  std::deque<v1::Goal> said_;
  // What the server may not have got. A stop is the first: what was asked for before it no longer counts.
  std::deque<Unsaid> unsaid_;
  std::int64_t last_stamp_ns_ = 0;
  // With the next goal the server forgets the one that was reached.
  bool has_arrived_ = false;
};

}  // namespace waypost
