"""Calls of one request, by their nouns; `waypost.Client` has them all."""

from waypost.calls.cluster import ClusterCalls
from waypost.calls.corrections import CorrectionCalls
from waypost.calls.events import EventCalls, MapEvents
from waypost.calls.jobs import JobCalls, JobProgress
from waypost.calls.maps import MapCalls
from waypost.calls.merges import MergeCalls
from waypost.calls.models import ModelCalls
from waypost.calls.navigations import NavigationCalls
from waypost.calls.places import PlaceCalls
from waypost.calls.sessions import SessionCalls
from waypost.calls.tokens import TokenCalls

__all__ = [
    "ClusterCalls",
    "CorrectionCalls",
    "EventCalls",
    "JobCalls",
    "JobProgress",
    "MapCalls",
    "MapEvents",
    "MergeCalls",
    "ModelCalls",
    "NavigationCalls",
    "PlaceCalls",
    "SessionCalls",
    "TokenCalls",
]
