#include "asked_goals.hpp"

#include <algorithm>
#include <cstddef>
#include <iterator>
#include <utility>

namespace waypost {
namespace {

// More goals than a server refuses in a row. Of more, the oldest are forgotten.
constexpr std::size_t most_goals = 4;

bool is_refused(const v1::Goal& asked, const v1::GoalRefusal& refusal) {
  if (!refusal.has_goal()) return asked.target_case() == v1::Goal::kImage;
  // By their bytes, since a number that is none does not equal itself.
  return asked.SerializeAsString() == refusal.goal().SerializeAsString();
}

// If no way leads to a label, the server names the place that has it.
bool may_stand_for(const v1::Goal& asked, const v1::GoalRefusal& refusal) {
  return asked.target_case() == v1::Goal::kLabel && refusal.goal().target_case() == v1::Goal::kPlaceNumber;
}

}  // namespace

AskedGoals::AskedGoals(const std::optional<v1::Goal>& first) {
  if (first) said_.push_back(*first);
}

void AskedGoals::stamped(std::int64_t stamp_ns) { last_stamp_ns_ = std::max(last_stamp_ns_, stamp_ns); }

AskedGoals::Request AskedGoals::go_to(v1::Goal goal) {
  if (has_arrived_) said_.clear();
  // A stop stays.
  if (unsaid_.size() == most_goals) unsaid_.erase(unsaid_.begin() + (is_stopping() ? 1 : 0));
  v1::NavigateRequest request;
  *request.mutable_goal() = std::move(goal);
  return ask(std::move(request));
}

AskedGoals::Request AskedGoals::stop() {
  unsaid_.clear();
  v1::NavigateRequest request;
  request.mutable_stop();
  return ask(std::move(request));
}

AskedGoals::Request AskedGoals::ask(v1::NavigateRequest request) {
  unsaid_.push_back({std::make_shared<const v1::NavigateRequest>(std::move(request)), last_stamp_ns_});
  return unsaid_.back().request;
}

void AskedGoals::guided(const v1::Guidance& guidance) {
  while (!unsaid_.empty() && unsaid_.front().after_stamp_ns < guidance.stamp_ns()) {
    if (unsaid_.front().request->has_goal()) {
      said_.push_back(unsaid_.front().request->goal());
    } else {
      said_.clear();
    }
    unsaid_.pop_front();
  }
  while (said_.size() > most_goals) said_.pop_front();
  has_arrived_ = guidance.status() == v1::NAVIGATION_STATUS_ARRIVED;
}

void AskedGoals::refused(const v1::GoalRefusal& refusal) {
  const auto unsaid = std::find_if(unsaid_.begin(), unsaid_.end(), [&](const Unsaid& asked) {
    return asked.request->has_goal() && is_refused(asked.request->goal(), refusal);
  });
  const auto said =
      std::find_if(said_.rbegin(), said_.rend(), [&](const v1::Goal& goal) { return is_refused(goal, refusal); });
  if (unsaid != unsaid_.end()) {
    unsaid_.erase(unsaid);
  } else if (said != said_.rend()) {
    said_.erase(std::next(said).base());
  } else if (!said_.empty() && may_stand_for(said_.back(), refusal)) {
    said_.pop_back();
  }
}

const v1::Goal* AskedGoals::for_opening() const { return said_.empty() || is_stopping() ? nullptr : &said_.back(); }

bool AskedGoals::is_stopping() const { return !unsaid_.empty() && unsaid_.front().request->has_stop(); }

}  // namespace waypost
