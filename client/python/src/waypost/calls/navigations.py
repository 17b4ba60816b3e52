"""Navigations of robots, their goals, and routes."""

from __future__ import annotations

from waypost.connection import Connection, resource
from waypost.goals import GoalLike, goal_message
from waypost.v1 import navigation_pb2


class NavigationCalls:
    """What somebody who does not steer the robot sees of a navigation, and may change."""

    _connection: Connection

    def navigations(self, map_id: str) -> list[navigation_pb2.Navigation]:
        """All navigations in a map, by name.

        Raises:
            NotFound: If there is no such map.
        """
        request = navigation_pb2.ListNavigationsRequest(map=resource("maps", map_id))
        pages = self._connection.pages(
            self._connection.navigations.ListNavigations, request, lambda page: page.navigations
        )
        return list(pages)

    def navigation(self, name: str) -> navigation_pb2.Navigation:
        """A navigation (maps/{map}/navigations/{navigation}), at present or until a moment ago.

        Raises:
            NotFound: If there is no such navigation.
        """
        request = navigation_pb2.GetNavigationRequest(name=name)
        found: navigation_pb2.Navigation = self._connection.call(
            self._connection.navigations.GetNavigation, request
        )
        return found

    def set_goal(self, name: str, goal: GoalLike) -> navigation_pb2.Navigation:
        """Sends a navigating robot to a goal; see `Client.navigate` for goals.

        Raises:
            NotFound: If there is no such navigation.
            FailedPrecondition: If the goal does not suit the map.
        """
        request = navigation_pb2.SetGoalRequest(name=name, goal=goal_message(goal))
        return self._connection.call(self._connection.navigations.SetGoal, request).navigation  # type: ignore[no-any-return]

    def cancel_goal(self, name: str) -> navigation_pb2.Navigation:
        """Takes a robot's goal away: it stops.

        Raises:
            NotFound: If there is no such navigation.
        """
        request = navigation_pb2.CancelGoalRequest(name=name)
        return self._connection.call(self._connection.navigations.CancelGoal, request).navigation  # type: ignore[no-any-return]

    def plan_route(
        self,
        map_id: str,
        from_place_number: int,
        goal: GoalLike,
        reverse_travel: navigation_pb2.ReverseTravel = navigation_pb2.REVERSE_TRAVEL_FORBIDDEN,
    ) -> navigation_pb2.Route:
        """The route from a place to a place, a position or a label.

        Raises:
            NotFound: If there is no such map, or no such place.
            FailedPrecondition: If there is no route.
        """
        request = navigation_pb2.PlanRouteRequest(
            map=resource("maps", map_id),
            from_place_number=from_place_number,
            goal=goal_message(goal),
            reverse_travel=reverse_travel,
        )
        return self._connection.call(self._connection.navigations.PlanRoute, request).route  # type: ignore[no-any-return]
