"""The same for `asyncio`.

Calls run in threads of the client's own, and sessions and navigations have theirs as in the other flavour:
there is one implementation, and the event loop never waits. A call whose awaiting is cancelled goes on.
"""

from __future__ import annotations

import asyncio
import functools
from collections.abc import AsyncGenerator, AsyncIterable, AsyncIterator, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any, Callable, TypeVar

import waypost.client
from waypost.answers import Outcome
from waypost.client import Client
from waypost.errors import WaypostError
from waypost.frames import Frame
from waypost.guidance import Command, Guidance, NavigationEvent
from waypost.inbox import Inbox
from waypost.navigation import Navigation
from waypost.sender import Sender
from waypost.session import Session
from waypost.v1 import event_pb2, geometry_pb2, job_pb2

if TYPE_CHECKING:
    from collections.abc import Coroutine

    from typing_extensions import Concatenate, ParamSpec

    P = ParamSpec("P")

T = TypeVar("T")
#: At most so many calls run at once; more wait.
_CALLS_AT_ONCE = 16


def _awaited(
    method: Callable[Concatenate[Client, P], T],
) -> Callable[Concatenate[AsyncClient, P], Coroutine[Any, Any, T]]:
    """A method of `Client` that is awaited."""

    async def awaited(self: AsyncClient, /, *arguments: P.args, **options: P.kwargs) -> T:
        return await self._in_thread(functools.partial(method, self.client, *arguments, **options))

    functools.update_wrapper(awaited, method)
    return awaited


@asynccontextmanager
async def connect(address: str | None = None, **options: Any) -> AsyncGenerator[AsyncClient, None]:
    """As `waypost.connect`, with the same options: `async with waypost.aio.connect(…) as client`."""
    client = AsyncClient(waypost.client.lazy(address, **options))
    try:
        await client.greet()
        yield client
    finally:
        await client.close()


class AsyncClient:
    """A connection to a server; each method is that of `waypost.Client`, awaited."""

    def __init__(self, client: Client) -> None:
        #: What does the work; it may be used from other threads too.
        self.client = client
        self._threads = ThreadPoolExecutor(_CALLS_AT_ONCE, "waypost-call")

    greet = _awaited(Client.greet)
    # Jobs.
    jobs = _awaited(Client.jobs)
    refusals = _awaited(Client.refusals)
    cluster = _awaited(Client.cluster)
    metrics_history = _awaited(Client.metrics_history)
    job = _awaited(Client.job)
    wait_for_job = _awaited(Client.wait_for_job)
    cancel_job = _awaited(Client.cancel_job)
    # Maps.
    maps = _awaited(Client.maps)
    map = _awaited(Client.map)
    create_map = _awaited(Client.create_map)
    get_or_create_map = _awaited(Client.get_or_create_map)
    delete_map = _awaited(Client.delete_map)
    loop_closures = _awaited(Client.loop_closures)
    rebind_map = _awaited(Client.rebind_map)
    rebuild_map = _awaited(Client.rebuild_map)
    repair_map = _awaited(Client.repair_map)
    compact_map = _awaited(Client.compact_map)
    trim_map = _awaited(Client.trim_map)
    export_map = _awaited(Client.export_map)
    import_map = _awaited(Client.import_map)
    export_poses = _awaited(Client.export_poses)
    # Corrections.
    withdraw_loop_closure = _awaited(Client.withdraw_loop_closure)
    confirm_loop_closure = _awaited(Client.confirm_loop_closure)
    undo_correction = _awaited(Client.undo_correction)
    corrections = _awaited(Client.corrections)
    # Merges.
    merge_maps = _awaited(Client.merge_maps)
    merge = _awaited(Client.merge)
    merges = _awaited(Client.merges)
    merge_picture = _awaited(Client.merge_picture)
    commit_merge = _awaited(Client.commit_merge)
    discard_merge = _awaited(Client.discard_merge)
    undo_merge = _awaited(Client.undo_merge)
    # Models.
    train_model = _awaited(Client.train_model)
    models = _awaited(Client.models)
    model = _awaited(Client.model)
    export_model = _awaited(Client.export_model)
    import_model = _awaited(Client.import_model)
    rename_model = _awaited(Client.rename_model)
    delete_model = _awaited(Client.delete_model)
    # Navigations.
    navigations = _awaited(Client.navigations)
    navigation = _awaited(Client.navigation)
    set_goal = _awaited(Client.set_goal)
    cancel_goal = _awaited(Client.cancel_goal)
    plan_route = _awaited(Client.plan_route)
    # Places.
    places = _awaited(Client.places)
    place = _awaited(Client.place)
    word_places = _awaited(Client.word_places)
    match_matrix = _awaited(Client.match_matrix)
    match_matrix_tile = _awaited(Client.match_matrix_tile)
    appearance_graph = _awaited(Client.appearance_graph)
    labels = _awaited(Client.labels)
    set_label = _awaited(Client.set_label)
    delete_label = _awaited(Client.delete_label)
    # Sessions.
    query = _awaited(Client.query)
    sessions = _awaited(Client.sessions)
    open_streams = _awaited(Client.open_streams)
    session_record = _awaited(Client.session_record)
    delete_session = _awaited(Client.delete_session)
    frames = _awaited(Client.frames)
    frame = _awaited(Client.frame)
    frame_image = _awaited(Client.frame_image)
    explain_frame = _awaited(Client.explain_frame)
    frame_picture = _awaited(Client.frame_picture)
    add_relative_pose = _awaited(Client.add_relative_pose)
    # Tokens.
    create_token = _awaited(Client.create_token)
    rotate_token = _awaited(Client.rotate_token)
    update_token = _awaited(Client.update_token)
    tokens = _awaited(Client.tokens)
    delete_token = _awaited(Client.delete_token)
    caller = _awaited(Client.caller)

    async def watch_job(self, name: str) -> AsyncGenerator[job_pb2.Job, None]:
        """The job now and after every progress, until it has ended."""
        progress = self.client.watch_job(name)
        try:
            while (state := await self._in_thread(functools.partial(next, progress, None))) is not None:
                yield state
        finally:
            progress.close()

    async def watch(
        self, map_id: str, from_position: int | None = None, *, patience_s: float = 60.0
    ) -> AsyncGenerator[event_pb2.MapEvent, None]:
        """What happens in a map, as `Client.watch` has it."""
        events = self.client.watch(map_id, from_position, patience_s=patience_s)
        try:
            while (event := await self._in_thread(functools.partial(next, events, None))) is not None:
                yield event
        finally:
            events.close()

    @asynccontextmanager
    async def session(
        self, map_id: str, session_id: str = "", *, window_frames: int = 8, **options: Any
    ) -> AsyncGenerator[AsyncSession, None]:
        """As `Client.session`, with the same options: `async with client.session(…) as session`."""
        open_session = functools.partial(
            self.client.session, map_id, session_id, window_frames=window_frames, **options
        )
        session = await self._in_thread(open_session)
        try:
            yield AsyncSession(session, window_frames)
        finally:
            await self._in_thread(session.close)

    @asynccontextmanager
    async def navigate(
        self, map_id: str, camera: geometry_pb2.Camera, **options: Any
    ) -> AsyncGenerator[AsyncNavigation, None]:
        """As `Client.navigate`, with the same options: `async with client.navigate(…) as navigation`."""
        navigation = await self._in_thread(functools.partial(self.client.navigate, map_id, camera, **options))
        try:
            yield AsyncNavigation(navigation)
        finally:
            await self._in_thread(navigation.close)

    async def close(self) -> None:
        """Closes the connection, and ends the sessions and navigations that use it."""
        # Ends the calls that still run, so that their threads end too.
        self.client.close()
        await asyncio.get_running_loop().run_in_executor(None, self._threads.shutdown)

    async def _in_thread(self, call: Callable[[], T]) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._threads, call)


class AsyncSession:
    """A session, made by `AsyncClient.session`."""

    def __init__(self, session: Session, window_frames: int) -> None:
        #: What does the work: its name, model, `words_hash` and `last_committed_sequence`.
        self.session = session
        self._window_frames = window_frames

    @property
    def name(self) -> str:
        """maps/{map}/sessions/{session}."""
        return self.session.name

    @property
    def last_committed_sequence(self) -> int | None:
        """Last frame that is known to be durable; None in a new session."""
        return self.session.last_committed_sequence

    async def stream(self, frames: Iterable[Frame] | AsyncIterable[Frame]) -> AsyncGenerator[Outcome, None]:
        """Streams frames and yields what became of each, as `Session.stream` does.

        `frames` is iterated by a task, at most `window_frames` ahead of the outcomes that were taken.
        """
        sender = self.session.sender(queue_frames=self._window_frames)
        room = asyncio.Semaphore(self._window_frames)
        changes = _Changes(sender.outcomes)
        feeding = asyncio.ensure_future(_feed(sender, frames, room))
        try:
            while True:
                await changes.until(lambda: sender.outcomes.ready)
                outcome = sender.next_outcome(0.0)
                if outcome is None:
                    break
                room.release()
                yield outcome
            await feeding
        finally:
            feeding.cancel()
            await asyncio.get_running_loop().run_in_executor(None, sender.abort)


class AsyncNavigation:
    """A navigation, made by `AsyncClient.navigate`. What does not wait is that of `Navigation`."""

    def __init__(self, navigation: Navigation) -> None:
        #: What does the work.
        self.navigation = navigation
        self._changes = _Changes(navigation.events)
        self.command: Callable[[], Command] = navigation.command
        self.report = navigation.report
        self.see = navigation.see
        self.go_to = navigation.go_to
        self.stop = navigation.stop

    @property
    def name(self) -> str:
        """maps/{map}/navigations/{navigation}."""
        return self.navigation.name

    @property
    def guidance(self) -> Guidance | None:
        """The latest guidance; None before the first report was answered."""
        return self.navigation.guidance

    async def next_guidance(self) -> Guidance:
        """Waits for guidance that comes after this call.

        Raises:
            WaypostError: If the navigation is over, why.
        """
        before = self.guidance
        await self._changes.until(lambda: self.guidance is not before or self.navigation.events.ended)
        latest = self.navigation.next_guidance(0.0) if self.guidance is before else self.guidance
        if latest is None:
            raise WaypostError("this navigation was closed; start another one with AsyncClient.navigate")
        return latest

    async def __aiter__(self) -> AsyncGenerator[NavigationEvent, None]:
        """Events until the navigation is closed; raises why it is over, if it is."""
        while True:
            await self._changes.until(lambda: self.navigation.events.ready)
            event = self.navigation.next_event(0.0)
            if event is None:
                return
            yield event


class _Changes:
    """Wakes tasks of the loop when another thread has put something into an inbox."""

    def __init__(self, inbox: Inbox[Any]) -> None:
        self._loop = asyncio.get_running_loop()
        self._changed = asyncio.Event()
        inbox.on_change = self._wake

    async def until(self, is_so: Callable[[], bool]) -> None:
        """Waits until it is so; asked again after every change."""
        while not is_so():
            self._changed.clear()
            await self._changed.wait()

    def _wake(self) -> None:
        try:
            self._loop.call_soon_threadsafe(self._changed.set)
        except RuntimeError:
            # The loop is closed: there is nobody to wake.
            return


async def _feed(
    sender: Sender, frames: Iterable[Frame] | AsyncIterable[Frame], room: asyncio.Semaphore
) -> None:
    """Sends all frames."""
    loop = asyncio.get_running_loop()
    try:
        async for frame in _each(frames, room):
            # In a thread: pixels are compressed there.
            await loop.run_in_executor(None, sender.send, frame)
    finally:
        sender.finish()


async def _each(
    frames: Iterable[Frame] | AsyncIterable[Frame], room: asyncio.Semaphore
) -> AsyncIterator[Frame]:
    """Each frame; it is asked for once there is room for it."""
    await room.acquire()
    if isinstance(frames, AsyncIterable):
        async for frame in frames:
            yield frame
            await room.acquire()
    else:
        for frame in frames:
            yield frame
            await room.acquire()
