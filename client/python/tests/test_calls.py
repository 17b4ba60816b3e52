"""Every call of the contract, at a real server."""

from __future__ import annotations

import inspect
import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from conftest import IMAGES, MODEL, answers, eventually, frame
from robot import STEP_M, taught

import waypost
from waypost import aio
from waypost.v1 import (
    appearance_pb2,
    cluster_pb2,
    correction_pb2,
    event_pb2,
    job_pb2,
    label_pb2,
    map_pb2,
    merge_pb2,
    model_pb2,
    navigation_pb2,
    recognition_pb2,
    session_pb2,
    token_pb2,
)

CONTRACT = [
    appearance_pb2,
    cluster_pb2,
    correction_pb2,
    event_pb2,
    job_pb2,
    label_pb2,
    map_pb2,
    merge_pb2,
    model_pb2,
    navigation_pb2,
    recognition_pb2,
    session_pb2,
    token_pb2,
]
#: Methods of the contract that this client leaves to stubs of one's own, with the reason.
LEFT_OUT: dict[str, str] = {}


def test_every_method_of_the_contract_is_called() -> None:
    package = Path(waypost.__file__).parent
    source = "\n".join(file.read_text() for file in package.rglob("*.py") if file.parent.name != "v1")
    methods = [
        method.name
        for module in CONTRACT
        for service in module.DESCRIPTOR.services_by_name.values()
        for method in service.methods
    ]
    assert len(methods) >= 50
    uncalled = [name for name in methods if f".{name}" not in source and name not in LEFT_OUT]
    assert not uncalled, "add these to waypost/calls, or say in LEFT_OUT why not"


def test_the_client_for_asyncio_has_every_method() -> None:
    def public(kind: type) -> set[str]:
        return {name for name, _ in inspect.getmembers(kind, callable) if not name.startswith("_")}

    assert public(waypost.Client) == public(aio.AsyncClient)


@pytest.fixture(scope="module")
def drive() -> range:
    """The shipped drive closes a loop between its first frames and these."""
    return range(100, 112)


@pytest.fixture
def looped(client: waypost.Client, hall: str, drive: range) -> str:
    """A session that comes back to where it began."""
    with client.session(hall, "robot") as session:
        answers(session, range(1, 25))
        assert any(answer.loop_closure for answer in answers(session, drive))
        return session.name


def test_a_map_is_made_once(client: waypost.Client, hall: str) -> None:
    # One that is there stays, whatever would be made in its place.
    there = client.get_or_create_map(hall, "no such model", map_pb2.MapSettings(closure_threshold=0.5))
    assert there == client.map(hall)
    assert there.settings.closure_threshold == 0.99
    made = client.get_or_create_map(f"{hall}-2", "shipped")
    assert made == client.get_or_create_map(f"{hall}-2") == client.map(f"{hall}-2")
    with pytest.raises(waypost.NotFound, match="model"):
        client.get_or_create_map(f"{hall}-3", "no such model")


def test_a_frame_may_be_asked_about_by_what_its_robot_calls_it(client: waypost.Client, hall: str) -> None:
    notes = ["000001.jpg", "000002.jpg", "twice.jpg", "twice.jpg"]
    with client.session(hall, "noted") as session:
        list(session.stream(frame(number, note=note) for number, note in enumerate(notes, 1)))
        name = session.name
    second = client.frame(f"{name}/frames/2")
    assert client.frame(f"{name}/frames/000002.jpg") == second
    assert client.explain_frame(f"{name}/frames/000002.jpg").name == second.name
    assert client.frame_picture(f"{name}/frames/000002.jpg", 0) == client.frame_picture(second.name, 0)
    thumbnail = session_pb2.GetFrameImageRequest.SIZE_THUMBNAIL
    by_note = client.frame_image(f"{name}/frames/000002.jpg", thumbnail)
    assert by_note == client.frame_image(second.name, thumbnail)
    twice = r"2 frames of .* are called 'twice\.jpg', .* name one by its number"
    with pytest.raises(waypost.InvalidArgument, match=twice):
        client.explain_frame(f"{name}/frames/twice.jpg")


def test_sessions_and_frames_are_read_back(
    client: waypost.Client, hall: str, looped: str, drive: range
) -> None:
    [session] = client.sessions(hall)
    assert session == client.session_record(looped)
    assert (session.frames, session.last_sequence) == (24 + len(drive), drive[-1])
    frames = client.frames(looped)
    assert [int(kept.name.rpartition("/")[2]) for kept in frames] == [*range(1, 25), *drive]
    closed = next(kept for kept in frames if kept.answer.reason == session_pb2.REASON_LOOP_CLOSURE)
    kept = client.frame(closed.name)
    assert kept.answer == closed.answer
    assert len(kept.histogram.words) == closed.answer.words
    assert client.frame_image(closed.name, session_pb2.GetFrameImageRequest.SIZE_THUMBNAIL)[:2] == b"\xff\xd8"

    explained = client.explain_frame(closed.name, max_words=3)
    assert explained.reproduced
    assert all(gate.passed for gate in explained.gates if gate.name == "words")
    assert b"<svg" in client.frame_picture(closed.name)
    with pytest.raises(waypost.NotFound):
        client.explain_frame(f"{looped}/frames/99")
    with pytest.raises(waypost.NotFound, match=r"no frame of .* is called '99\.jpg'"):
        client.explain_frame(f"{looped}/frames/99.jpg")

    place = client.place(hall, 0)
    assert place.word_hits
    matrix = client.match_matrix(hall)
    assert list(matrix.rows.place_numbers) == list(range(len(client.places(hall))))
    assert matrix == client.match_matrix(hall, against=hall)
    assert matrix.levels == 1
    tile = client.match_matrix_tile(hall, 0, 0, 0)
    assert tile.startswith(b"\x89PNG")
    assert tile == client.match_matrix_tile(hall, 0, 0, 0, against=hall)
    with pytest.raises(waypost.NotFound, match="1 x 1 tiles"):
        client.match_matrix_tile(hall, 0, 0, 1)
    found = client.word_places(hall, place.word_hits[0].word)
    assert 0 in [of_word.place_number for of_word in found]
    assert len(client.places(hall)) == client.map(hall).places

    job = client.delete_session(looped)
    assert client.wait_for_job(job).state == job_pb2.Job.STATE_SUCCEEDED
    assert client.sessions(hall) == []


def test_loop_closures_are_withdrawn_and_that_is_undone(
    client: waypost.Client, hall: str, looped: str
) -> None:
    before = client.map(hall, full=True)
    closure = client.loop_closures(hall)[-1]
    assert closure.correction is None
    frame = f"{looped}/frames/{closure.frame.sequence}"
    withdrawn = client.withdraw_loop_closure(frame)
    assert withdrawn.verdict == map_pb2.Correction.VERDICT_WITHDRAWN
    assert withdrawn.place_number == closure.place_number
    assert client.corrections(hall) == [withdrawn]
    assert [told.correction for told in client.loop_closures(hall) if told.correction] == [withdrawn]
    assert list(client.frame(frame).corrections) == [withdrawn]
    assert list(client.explain_frame(frame).corrections) == [withdrawn]
    assert client.map(hall).withdrawn_loop_closures == 1
    with pytest.raises(waypost.FailedPrecondition, match="undo that to have it back"):
        client.withdraw_loop_closure(frame)
    with pytest.raises(waypost.InvalidArgument, match="did not come in before"):
        client.confirm_loop_closure(f"{looped}/frames/1", f"{looped}/frames/24")
    undone = client.undo_correction(withdrawn.name)
    assert undone.HasField("undone")
    assert client.map(hall, full=True).state_hash == before.state_hash
    with pytest.raises(waypost.NotFound):
        client.undo_correction(withdrawn.name)


def test_two_frames_are_said_to_be_of_one_place(client: waypost.Client, hall: str, looped: str) -> None:
    before = client.map(hall, full=True)
    confirmed = client.confirm_loop_closure(f"{looped}/frames/24", f"{looped}/frames/1")
    assert confirmed.verdict == map_pb2.Correction.VERDICT_CONFIRMED
    assert client.map(hall).links == before.links + 1
    assert client.map(hall).confirmed_loop_closures == 1
    client.undo_correction(confirmed.name)
    assert client.map(hall, full=True).state_hash == before.state_hash


def test_frames_keep_their_notes(client: waypost.Client, hall: str) -> None:
    with client.session(hall, "robot") as session:
        frames = [waypost.Frame(n, n, IMAGES[n - 1].read_bytes(), note=f"{n}.jpg") for n in (1, 2)]
        assert len(list(session.stream(frames))) == 2
        assert [kept.note for kept in client.frames(session.name)] == ["1.jpg", "2.jpg"]
        [called] = client.frames(session.name, note="2.jpg")
        assert called.name == f"{session.name}/frames/2"
    answer = client.query(hall, IMAGES[0].read_bytes())
    assert answer.match is not None
    assert answer.match.frame.note == f"{answer.match.frame.sequence}.jpg"
    with client.session(hall, "wrong") as session:
        [refusal] = session.stream([waypost.Frame(1, 1, IMAGES[0].read_bytes(), note="two\nlines")])
        assert isinstance(refusal, waypost.Refusal)
        assert "control character" in str(refusal.error)


def test_maps_are_watched(client: waypost.Client, hall: str) -> None:
    with client.session(hall, "robot") as session:
        answers(session, range(1, 4))
        with client.watch(hall, 0) as events:
            told = [next(events).frame for _ in range(3)]
            assert [kept.frame.answer.sequence for kept in told] == [1, 2, 3]
            answers(session, range(4, 5))
            last = next(events).frame
            assert last.frame.name == f"{session.name}/frames/4"
            assert last.position > told[-1].position
        assert list(events) == []
    with pytest.raises(waypost.NotFound), client.watch("cellar") as events:
        next(events)


def test_labels_are_put_and_taken_away(client: waypost.Client, hall: str) -> None:
    with client.session(hall, "robot") as session:
        answers(session, range(1, 4))
    assert client.set_label(hall, 0, "kitchen") == [0]
    assert client.labels(f"maps/{hall}") == {0: "kitchen"}
    client.delete_label(hall, 0)
    with pytest.raises(waypost.NotFound):
        client.delete_label(hall, 0)
    with pytest.raises(waypost.InvalidArgument):
        client.set_label(hall, 0, " kitchen ")
    with pytest.raises(waypost.FailedPrecondition):
        client.set_label(hall, 0, "kitchen", label_pb2.LABEL_SCOPE_SPACE)
    with pytest.raises(waypost.FailedPrecondition):
        client.appearance_graph(hall)


def test_poses_are_measured_and_exported(client: waypost.Client, tmp_path: Path) -> None:
    taught(client, "measured", 8)
    session = "maps/measured/sessions/taught"
    poses = io.BytesIO()
    length_bytes = client.export_poses(session, poses, map_pb2.ExportPosesRequest.FORMAT_TUM)
    rows = np.loadtxt(io.BytesIO(poses.getvalue()))
    # A frame whose place has no position yet is left out.
    assert len(rows) >= 6
    assert rows.shape[1] == 8
    assert length_bytes == len(poses.getvalue())
    np.testing.assert_allclose(rows[:, 1], (rows[:, 0] - 1) * STEP_M, atol=1e-6)
    before = client.map("measured", full=True).state_hash
    measured = f"{session}/frames/8", f"{session}/frames/1", (3.4, 0.0, 0.0), np.eye(6) * 1e-4
    moved = client.add_relative_pose(*measured)
    assert isinstance(moved, waypost.MapPose)
    after = client.map("measured", full=True).state_hash
    assert after != before
    # Sent again, as after a lost answer, it changes nothing.
    assert client.add_relative_pose(*measured) == moved
    assert client.map("measured", full=True).state_hash == after
    with pytest.raises(ValueError, match="6 x 6"):
        client.add_relative_pose(f"{session}/frames/8", f"{session}/frames/1", (3.0, 0.0, 0.0), [1.0])
    by_name = io.BytesIO()
    client.export_poses(session, by_name, "tum", frame="map", body="base")
    frames = [row[1:] for row in np.loadtxt(io.BytesIO(by_name.getvalue()))]
    assert len(frames) == len(rows)
    for wrong in ({"format": "tmu"}, {"format": "tum", "frame": "world"}, {"format": "tum", "body": "wheel"}):
        with pytest.raises(ValueError, match="; give one of "):
            client.export_poses(session, io.BytesIO(), **wrong)
    graph = tmp_path / "map.g2o"
    client.export_poses("maps/measured", graph, map_pb2.ExportPosesRequest.FORMAT_G2O)
    assert "EDGE_SE2" in graph.read_text()
    with pytest.raises(FileExistsError):
        client.export_poses("maps/measured", graph, map_pb2.ExportPosesRequest.FORMAT_G2O)
    with pytest.raises(waypost.NotFound):
        client.export_poses("maps/nowhere", tmp_path / "none.g2o", map_pb2.ExportPosesRequest.FORMAT_G2O)
    assert [file.name for file in tmp_path.iterdir()] == ["map.g2o"]


def test_snapshots_go_out_and_in_again(client: waypost.Client, hall: str, tmp_path: Path) -> None:
    with client.session(hall, "robot") as session:
        answers(session, range(1, 6))
    snapshot = tmp_path / "hall.waypost"
    assert client.export_map(hall, snapshot) == snapshot.stat().st_size
    job = client.wait_for_job(client.import_map(snapshot, "copy"))
    assert job.result == "maps/copy"
    assert client.map("copy", full=True).state_hash == client.map(hall, full=True).state_hash
    with pytest.raises(waypost.AlreadyExists):
        client.wait_for_job(client.import_map(snapshot))
    damaged = io.BytesIO(snapshot.read_bytes()[:-5])
    with pytest.raises(waypost.InvalidArgument):
        client.wait_for_job(client.import_map(damaged, "damaged"))
    for name in (str(tmp_path / "absent"), tmp_path / "absent"):
        with pytest.raises(FileNotFoundError):
            client.import_map(name, "absent")
    client.delete_map("copy")
    assert {found.name for found in client.maps()} & {"maps/copy", "maps/damaged", "maps/absent"} == set()


def test_models_are_trained_followed_and_copied(client: waypost.Client, tmp_path: Path) -> None:
    images: list[bytes | Path] = [*IMAGES[:10], *(file.read_bytes() for file in IMAGES[10:20])]
    with pytest.warns(UserWarning, match="trained on 20 images"):
        job = client.train_model(images, 40, seed=7)
    assert job.kind == job_pb2.Job.KIND_TRAIN_MODEL
    with client.watch_job(job.name) as progress:
        states = list(progress)
    assert states[-1].state == job_pb2.Job.STATE_SUCCEEDED
    assert client.job(job.name) == states[-1]
    assert job.name in [known.name for known in client.jobs()]
    model = client.model(states[-1].result.partition("/")[2])
    assert model.words <= 40
    assert model in client.models()
    file = tmp_path / "model"
    client.export_model(model.name, file)
    client.delete_model(model.name)
    with pytest.raises(waypost.NotFound):
        client.model(model.name)
    assert client.import_model(file, "again").name == model.name
    # The same words: the map goes on with it, and is made anew with other words.
    client.create_map("old", "shipped")
    with client.session("old", "robot") as session:
        answers(session, range(1, 6))
    with pytest.raises(waypost.FailedPrecondition):
        client.rebind_map("old", model.name)
    assert client.rebind_map("old", "shipped").name == "maps/old"
    rebuilt = client.wait_for_job(client.rebuild_map("old", model.name, "maps/new"))
    assert client.map("new").frames == 5
    assert rebuilt.result == "maps/new"
    with pytest.raises(waypost.FailedPrecondition):
        client.delete_model(model.name)
    client.wait_for_job(client.compact_map("old"))
    preview = client.trim_map("old", 2)
    assert client.map("old").places == preview.remaining_places + len(preview.dropped)
    client.trim_map("old", 2, map_pb2.TrimMapRequest.MODE_APPLY)
    assert client.map("old").places == preview.remaining_places


def test_open_streams_and_refusals_are_listed(client: waypost.Client) -> None:
    client.create_map("watched", "shipped")
    with client.session("watched", "robot") as session:
        answers(session, range(1, 4))
        (stream,) = client.open_streams("watched")
        assert (stream.session, stream.answered_frames) == ("maps/watched/sessions/robot", 3)
        assert stream.last_delay_ns > 0
        assert stream in client.open_streams()
        cluster = client.cluster()
        assert (len(cluster.servers), cluster.load.open_streams) == (1, 1)
        assert cluster.database == cluster_pb2.Cluster.DATABASE_SQLITE
    with pytest.raises(waypost.NotFound):
        client.open_streams("nowhere")
    newest = client.refusals()[0]
    assert (newest.request, newest.code) == ("/waypost.v1.SessionService/ListOpenStreams", "not_found")
    assert "there is no map nowhere" in newest.message


def test_an_upload_that_breaks_trains_nothing(client: waypost.Client) -> None:
    def unplugged() -> Iterator[bytes]:
        for file in IMAGES[:12]:
            yield file.read_bytes()
        raise OSError("the disk is unplugged")

    before = len(client.jobs())
    with pytest.raises(OSError, match="unplugged"):
        client.train_model(unplugged(), 20, display_name="half")
    with pytest.raises(waypost.InvalidArgument):
        client.train_model([b"GIF89a"], 20, display_name="half")
    with pytest.raises(waypost.NotFound):
        client.model("half")
    assert len(client.jobs()) == before


def test_a_job_that_is_cancelled_says_so(client: waypost.Client) -> None:
    job = client.train_model(IMAGES[:60], 2000, display_name="never")
    client.cancel_job(job.name)
    with pytest.raises(waypost.Cancelled, match=job.name):
        client.wait_for_job(job.name)
    with pytest.raises(waypost.NotFound):
        client.wait_for_job("jobs/999999")


def test_maps_are_merged_and_taken_apart_again(client: waypost.Client) -> None:
    for name, sequences in (("east", range(1, 31)), ("west", range(11, 41))):
        client.create_map(name, "shipped")
        with client.session(name, "robot") as session:
            answers(session, sequences)
    merge = client.merge_maps(["west"], "east", min_support=3)
    client.wait_for_job(merge)
    proposed = client.merge(merge.name)
    assert proposed.state == merge_pb2.Merge.STATE_PROPOSED, proposed
    assert b"<svg" in client.merge_picture(merge.name)
    assert client.discard_merge(merge.name).state == merge_pb2.Merge.STATE_DISCARDED
    with pytest.raises(waypost.FailedPrecondition):
        client.commit_merge(merge.name)

    merge = client.merge_maps(["maps/west"], "maps/east", min_support=3)
    client.wait_for_job(merge.job)
    client.wait_for_job(client.commit_merge(merge.name).job)
    assert client.merge(merge.name).state == merge_pb2.Merge.STATE_COMMITTED
    assert client.map("east").frames == 60
    assert client.merges()[0].name == merge.name
    client.wait_for_job(client.undo_merge(merge.name).job)
    assert client.map("east").frames == 30
    # Several at once, without asking.
    merge = client.merge_maps(["east", "west"], "both", auto_commit=True, min_support=3)
    client.wait_for_job(merge.job)
    assert eventually(lambda: client.merge(merge.name).state == merge_pb2.Merge.STATE_COMMITTED)
    assert client.map("both").frames == 60


def test_a_session_that_localizes_starts_anew_with_another_run(client: waypost.Client, hall: str) -> None:
    with client.session(hall, "teacher") as session:
        answers(session, range(1, 6))
    mode = waypost.Mode.LOCALIZE
    with client.session(hall, "robot", run_id="first", mode=mode) as session:
        answers(session, range(1, 4))
    with client.session(hall, "robot", run_id="first", mode=mode) as session:
        assert session.last_committed_sequence == 3
    with client.session(hall, "robot", run_id="second", mode=mode) as session:
        assert session.last_committed_sequence is None


def test_a_model_by_its_file(client: waypost.Client) -> None:
    with MODEL.open("rb") as opened:
        assert client.import_model(opened).name == client.model("shipped").name
    with pytest.raises(waypost.InvalidArgument):
        client.import_model(io.BytesIO())
