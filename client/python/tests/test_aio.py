"""The flavour for asyncio, which shares the other one's work."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from conftest import IMAGES, Server, answers, decided, eventually, frame, our_threads
from robot import DRIVE_S, Robot, taught

import waypost
import waypost.aio
from waypost.v1 import job_pb2
from waypost.v1.geometry_pb2 import Camera, FieldOfView


async def camera(last: int, first: int = 1) -> AsyncIterator[waypost.Frame]:
    for sequence in range(first, last + 1):
        await asyncio.sleep(0)
        yield frame(sequence)


def test_a_session_is_decided_as_in_the_other_flavour(
    client: waypost.Client, server: Server, hall: str
) -> None:
    with client.session(hall, "robot") as session:
        expected = [decided(answer) for answer in answers(session, range(1, 13))]
    client.delete_map(hall)

    async def streamed() -> list[waypost.Outcome]:
        async with waypost.aio.connect(server.address) as asynchronous:
            made = await asynchronous.create_map(hall, "shipped")
            assert made.name == f"maps/{hall}"
            async with asynchronous.session(hall, "robot", window_frames=3) as session:
                outcomes = [outcome async for outcome in session.stream(camera(8))]
                # The same session takes more, also from what is there already.
                outcomes += [outcome async for outcome in session.stream(map(frame, range(9, 13)))]
                assert session.last_committed_sequence == 12
            return outcomes

    outcomes = asyncio.run(streamed())
    assert [decided(outcome) for outcome in outcomes if isinstance(outcome, waypost.Answer)] == expected
    eventually(lambda: not our_threads())


def test_calls_run_side_by_side_and_raise_the_same(server: Server, tmp_path: Path) -> None:
    async def called() -> None:
        async with waypost.aio.connect(server.address) as client:
            maps, models, jobs = await asyncio.gather(client.maps(), client.models(), client.jobs())
            assert isinstance(maps, list)
            assert isinstance(jobs, list)
            assert models[0].words > 0
            with pytest.raises(waypost.NotFound, match="cellar"):
                await client.map("cellar")
            with pytest.raises(waypost.NotFound, match="cellar"):
                async with client.session("cellar"):
                    pass
            assert await client.export_model("shipped", tmp_path / "model") > 0
            job = await client.train_model(IMAGES[:20], 40)
            states = [state async for state in client.watch_job(job.name)]
            assert states[-1].state == job_pb2.Job.STATE_SUCCEEDED

    asyncio.run(called())
    eventually(lambda: not our_threads())


def test_a_session_outlives_a_kill_and_says_when_it_is_lost(mortal: Server) -> None:
    async def streamed() -> None:
        async with waypost.aio.connect(mortal.address) as client:
            await client.create_map("hall", "shipped")
            async with client.session("hall", "robot", patience_s=30.0) as session:
                seen = []
                async for outcome in session.stream(camera(8)):
                    seen.append(outcome.sequence)
                    if outcome.sequence == 3:
                        mortal.kill()
                        mortal.start()
                assert seen == list(range(1, 9))
            async with client.session("hall", "robot", patience_s=0.3) as session:
                mortal.kill()
                with pytest.raises(waypost.SessionLost):
                    async for _ in session.stream(camera(12, first=9)):
                        pass

    asyncio.run(streamed())
    eventually(lambda: not our_threads())


def test_what_frames_raise_and_leaving_early(server: Server, client: waypost.Client, hall: str) -> None:
    async def unplugged() -> AsyncIterator[waypost.Frame]:
        yield frame(1)
        raise OSError("the camera is unplugged")

    async def streamed() -> None:
        async with waypost.aio.connect(server.address) as asynchronous:  # noqa: SIM117
            async with asynchronous.session(hall, "robot") as session:
                broken = session.stream(unplugged())
                assert (await broken.__anext__()).sequence == 1
                with pytest.raises(OSError, match="unplugged"):
                    await broken.__anext__()
                stream = session.stream(camera(100, first=2))
                async for outcome in stream:
                    if outcome.sequence == 4:
                        break
                await stream.aclose()
                # Left early, it does not confuse the next.
                again = [outcome.sequence async for outcome in session.stream(camera(15, first=13))]
                assert again == [13, 14, 15]

    asyncio.run(streamed())
    assert client.map(hall).frames >= 6
    eventually(lambda: not our_threads())


def test_a_robot_is_led(client: waypost.Client, server: Server) -> None:
    taught(client, "way", 12)
    view = Camera(field_of_view=FieldOfView(horizontal_rad=1.2))

    async def led() -> list[waypost.NavigationEvent]:
        robot, events = Robot(), []
        async with waypost.aio.connect(server.address) as asynchronous:
            async with asynchronous.navigate("way", view, goal=3) as navigation:
                assert navigation.name.startswith("maps/way/navigations/")

                async def listen() -> None:
                    async for event in navigation:
                        events.append(event)

                listening = asyncio.ensure_future(listen())
                status, cycle = None, 0
                while status != waypost.NavigationStatus.ARRIVED:
                    now_ns, odometry = time.monotonic_ns(), robot.odometry()
                    coming = asyncio.ensure_future(navigation.next_guidance())
                    await asyncio.sleep(0)
                    navigation.report(now_ns, odometry)
                    if cycle % 10 == 0:
                        seen = waypost.Frame(cycle + 1, now_ns, robot.image(), odometry=odometry)
                        navigation.see(seen)
                    status = (await asyncio.wait_for(coming, 30)).status
                    robot.drive(*navigation.command())
                    cycle += 1
                    await asyncio.sleep(0.04)
            await asyncio.wait_for(listening, 30)
            with pytest.raises(waypost.WaypostError, match="closed"):
                await navigation.next_guidance()
        return events

    events = asyncio.run(asyncio.wait_for(led(), DRIVE_S))
    assert any(isinstance(event, waypost.FrameSeen) and event.outcome == "FOUND" for event in events)
    eventually(lambda: not our_threads())
