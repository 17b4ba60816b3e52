"""`waypost map recording`: what Foxglove and ROS 2 read, by their own packages."""

from __future__ import annotations

from math import atan2, cos, sin
from pathlib import Path
from typing import Any

import pytest
from conftest import IMAGES, Server
from test_bags import refused, run, streamed

import waypost
from waypost.v1 import map_pb2, session_pb2

#: They need Python 3.10.
mcap_reader = pytest.importorskip("mcap.reader")
mcap_ros2 = pytest.importorskip("mcap_ros2.decoder")
typesys = pytest.importorskip("rosbags.typesys")

KINDS = {
    "/camera/image_raw/compressed": "sensor_msgs/msg/CompressedImage",
    "/odom": "nav_msgs/msg/Odometry",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/waypost/closures": "visualization_msgs/msg/MarkerArray",
    "/waypost/markers": "visualization_msgs/msg/MarkerArray",
    "/waypost/match": "std_msgs/msg/Float64",
    "/waypost/most_probable_place": "std_msgs/msg/Float64",
    "/waypost/new_place": "std_msgs/msg/Float64",
    "/waypost/path": "nav_msgs/msg/Path",
    "/waypost/pose": "geometry_msgs/msg/PoseWithCovarianceStamped",
}


def decoded(path: Path) -> dict[str, list[tuple[int, Any]]]:
    """All messages by topic, with their times: by Foxglove's package, and each once more by rosbags'."""
    store = typesys.get_typestore(typesys.Stores.EMPTY)
    told: dict[str, list[tuple[int, Any]]] = {}
    with path.open("rb") as file:
        factories = [mcap_ros2.DecoderFactory()]
        reader = mcap_reader.make_reader(file, decoder_factories=factories, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        for schema, channel, message, ros in reader.iter_decoded_messages():
            assert (schema.encoding, channel.message_encoding) == ("ros2msg", "cdr")
            if schema.name not in store.types:
                types = typesys.get_types_from_msg(schema.data.decode(), schema.name)
                store.register({name: kind for name, kind in types.items() if name not in store.types})
            other = store.deserialize_cdr(message.data, schema.name)
            assert stamp_of(other) == stamp_of(ros)
            assert store.serialize_cdr(other, schema.name) == message.data
            told.setdefault(channel.topic, []).append((message.log_time, ros))
        statistics = reader.get_summary().statistics
        assert statistics.message_count == sum(map(len, told.values()))
        kinds = {channel.topic: channel.schema_id for channel in reader.get_summary().channels.values()}
        schemas = reader.get_summary().schemas
        assert {topic: schemas[schema].name for topic, schema in kinds.items()} == {
            topic: KINDS[topic] for topic in kinds
        }
    return told


def stamp_of(message: Any) -> tuple[int, int] | None:
    header = getattr(message, "header", None)
    return None if header is None else (header.stamp.sec, header.stamp.nanosec)


def place(pose: Any) -> tuple[float, float, float]:
    """Of ROS or of the contract."""
    position = pose.position if hasattr(pose, "position") else pose.position_m
    return position.x, position.y, position.z


def planar(transform: Any) -> tuple[float, float, float]:
    at, turned = transform.translation, transform.rotation
    return at.x, at.y, 2 * atan2(turned.z, turned.w)


def test_a_drive_in_metres_is_recorded_whole(tmp_path: Path, server: Server, client: waypost.Client) -> None:
    client.create_map("office", "shipped")
    at = f"http://{server.address}"
    run("simulate", "--map", "office", "--world", "office", "--session", "drive", server=at)
    session = "maps/office/sessions/drive"
    client.set_label("office", 3, "the door")
    file = tmp_path / "office.mcap"
    told = run("map", "recording", "office", "drive", "--out", file, server=at)
    frames = client.frames(session)
    closures = client.loop_closures("office")
    counts = {"frames": len(frames), "poses": len(frames), "loop_closures": len(closures)}
    assert closures
    assert {name: told[name] for name in counts} == counts
    assert told["size_bytes"] == file.stat().st_size

    messages = decoded(file)
    assert set(messages) == set(KINDS)
    stamps = [frame.stamp_ns for frame in frames]
    for topic in ("/camera/image_raw/compressed", "/odom", "/tf", "/waypost/pose", "/waypost/new_place"):
        assert [time_ns for time_ns, _ in messages[topic]] == stamps, topic
    trajectory = tmp_path / "map.tum"
    with trajectory.open("wb") as sink:
        client.export_poses(
            session,
            sink,
            map_pb2.ExportPosesRequest.FORMAT_TUM,
            frame=map_pb2.ExportPosesRequest.FRAME_MAP,
            body=map_pb2.ExportPosesRequest.BODY_BASE,
        )
    lines = trajectory.read_text().splitlines()
    rows = [tuple(float(number) for number in line.split()[1:4]) for line in lines]
    for frame, row, (_, image), (_, odometry), (_, tf), (_, pose), (_, new) in zip(
        frames,
        rows,
        messages["/camera/image_raw/compressed"],
        messages["/odom"],
        messages["/tf"],
        messages["/waypost/pose"],
        messages["/waypost/new_place"],
        strict=True,
    ):
        assert bytes(image.data) == client.frame_image(frame.name)
        assert image.format == "jpeg"
        assert place(odometry.pose.pose) == place(frame.odometry.pose)
        to_odom, to_base = tf.transforms
        assert (to_odom.header.frame_id, to_odom.child_frame_id) == ("map", "odom")
        assert (to_base.header.frame_id, to_base.child_frame_id) == ("odom", "base_link")
        # One after the other they lead to where the map has the robot.
        x, y, angle = planar(to_odom.transform)
        moved_x, moved_y, _ = planar(to_base.transform)
        x += cos(angle) * moved_x - sin(angle) * moved_y
        y += sin(angle) * moved_x + cos(angle) * moved_y
        assert (x, y) == pytest.approx(row[:2], abs=1e-6)
        assert place(pose.pose.pose) == row
        assert new.data == frame.answer.new_place_posterior

    [(first_ns, path)] = messages["/waypost/path"]
    assert first_ns == stamps[0]
    assert [place(stamped.pose) for stamped in path.poses] == rows
    [(_, markers)] = messages["/waypost/markers"]
    by_name = {marker.ns: marker for marker in markers.markers}
    assert len(by_name["places"].points) == len(client.places("office"))
    assert by_name["labels"].text == "the door"
    drawn = messages["/waypost/closures"]
    assert [time_ns for time_ns, _ in drawn] == [
        frame.stamp_ns for frame in frames if frame.answer.reason == session_pb2.REASON_LOOP_CLOSURE
    ]
    for _, told_closure in drawn:
        line, text = told_closure.markers
        assert len(line.points) == 2
        assert text.text.startswith("place ")

    # Nothing is replaced unasked, and nothing half-written stays.
    assert "--force" in refused("map", "recording", "office", "drive", "--out", file, server=at)
    run("map", "recording", "office", "drive", "--out", file, "--force", "--images", "none", server=at)
    assert set(decoded(file)) == set(KINDS) - {"/camera/image_raw/compressed"}
    assert sorted(path.name for path in tmp_path.iterdir()) == ["map.tum", "office.mcap"]


def test_a_recording_is_streamed_as_its_images_were(
    tmp_path: Path, server: Server, client: waypost.Client
) -> None:
    """Without metres there are images and numbers; kept images are decided alike elsewhere."""
    client.create_map("kept", "shipped", map_pb2.MapSettings(keep=map_pb2.MapSettings.KEEP_IMAGES))
    at = f"http://{server.address}"
    run("stream", IMAGES[0].parent, "--map", "kept", "--session", "drive", server=at)
    file = tmp_path / "kept.mcap"
    told = run("map", "recording", "kept", "drive", "--out", file, server=at)
    assert (told["frames"], told["poses"]) == (len(IMAGES), 0)
    messages = decoded(file)
    assert set(messages) == {
        "/camera/image_raw/compressed",
        "/waypost/match",
        "/waypost/most_probable_place",
        "/waypost/new_place",
    }
    images = [bytes(image.data) for _, image in messages["/camera/image_raw/compressed"]]
    assert images == [image.read_bytes() for image in IMAGES]
    again = streamed(server, client, "again", file)
    assert [row["reason"] for row in again] == [
        session_pb2.Reason.Name(frame.answer.reason).removeprefix("REASON_").lower()
        for frame in client.frames("maps/kept/sessions/drive")
    ]


def test_what_is_not_there_is_said(tmp_path: Path, server: Server, client: waypost.Client) -> None:
    client.create_map("bare", "shipped")
    at = f"http://{server.address}"
    with pytest.raises(AssertionError, match="has no session drive"):
        run("map", "recording", "bare", "drive", "--out", tmp_path / "bare.mcap", server=at)
    nowhere = tmp_path / "no/a.mcap"
    said = refused("map", "recording", "bare", "drive", "--out", nowhere, server=at)
    assert "there is no folder" in said
    assert list(tmp_path.iterdir()) == []
