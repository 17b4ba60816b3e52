"""Queries, and what maps keep of sessions and frames."""

from __future__ import annotations

from collections.abc import Sequence

import grpc
import numpy.typing as npt

from waypost import answers
from waypost.answers import MapPose, QueryAnswer
from waypost.connection import Connection, resource
from waypost.errors import InvalidArgument, NotFound
from waypost.frames import Image, WordHistogram, WordList, put_content
from waypost.poses import Pose2, Pose3, odometry
from waypost.v1 import job_pb2, recognition_pb2, session_pb2


class SessionCalls:
    """Sessions as maps/{map}/sessions/{session}, and frames as that and /frames/{sequence}.

    Where a frame is asked about, what its robot calls it may stand in place of the number: the name of its
    image file, if `waypost stream` sent it.
    """

    _connection: Connection

    def query(
        self,
        map_id: str,
        content: Image | WordHistogram | WordList,
        *,
        words_hash: str = "",
        explained_words: int | None = None,
    ) -> QueryAnswer:
        """Where one image, or one bag of words, was taken, without a session: nothing is remembered.

        Args:
            map_id: `{map}` or `maps/{map}`.
            content: As in `Frame.image` and `Frame.words`.
            words_hash: As in `session`.
            explained_words: Explains the most probable place, with this many words for it and as many against
                it, at most 100. No explanation if left out.

        Raises:
            ServerError: If the server refuses.
        """
        request = recognition_pb2.QueryRequest(
            map=resource("maps", map_id), words_hash=words_hash, explained_words=explained_words
        )
        put_content(request, content)
        response: recognition_pb2.QueryResponse = self._connection.call(
            self._connection.recognition.Query, request
        )
        return answers.query_answer(response)

    def sessions(self, map_id: str) -> list[session_pb2.Session]:
        """The sessions that a map has grown by, oldest first.

        Raises:
            NotFound: If there is no such map.
        """
        request = session_pb2.ListSessionsRequest(map=resource("maps", map_id))
        return list(
            self._connection.pages(
                self._connection.sessions.ListSessions, request, lambda page: page.sessions
            )
        )

    def open_streams(self, map_id: str = "") -> list[session_pb2.OpenStream]:
        """The streams of robots that are open now, by when they were opened.

        Robots that are led are in `navigations`.

        Args:
            map_id: Those into this map alone; into all that the token reaches if left out.

        Raises:
            NotFound: If there is no such map.
        """
        request = session_pb2.ListOpenStreamsRequest(map=resource("maps", map_id) if map_id else "")
        listed = self._connection.call(self._connection.sessions.ListOpenStreams, request)
        return list(listed.streams)

    def session_record(self, name: str) -> session_pb2.Session:
        """What a map keeps of a session; `session` opens one.

        Raises:
            NotFound: If there is no such session.
        """
        request = session_pb2.GetSessionRequest(name=name)
        found: session_pb2.Session = self._connection.call(self._connection.sessions.GetSession, request)
        return found

    def delete_session(self, name: str) -> job_pb2.Job:
        """Deletes a session with everything that only it had shown; gives the job that does so. No way back.

        Raises:
            NotFound: If there is no such session.
            FailedPrecondition: While a robot navigates in the map.
        """
        request = session_pb2.DeleteSessionRequest(name=name)
        job: job_pb2.Job = self._connection.call(self._connection.sessions.DeleteSession, request)
        return job

    def frames(self, session: str, note: str = "") -> list[session_pb2.FrameRecord]:
        """The frames of a session with the decisions about them, without their words.

        Args:
            session: The session.
            note: Only the frames that their robot calls so; all if left out.

        Raises:
            NotFound: If there is no such session.
        """
        request = session_pb2.ListFramesRequest(session=session, note=note)
        return list(
            self._connection.pages(self._connection.sessions.ListFrames, request, lambda page: page.frames)
        )

    def frame(self, name: str) -> session_pb2.FrameRecord:
        """A frame with its words, and the decision about it.

        Raises:
            NotFound: If there is no such frame.
        """
        request = session_pb2.GetFrameRequest(name=self._numbered_frame(name))
        found: session_pb2.FrameRecord = self._connection.call(self._connection.sessions.GetFrame, request)
        return found

    def frame_image(
        self,
        name: str,
        size: session_pb2.GetFrameImageRequest.Size = session_pb2.GetFrameImageRequest.SIZE_LARGEST,
    ) -> bytes:
        """The image of a frame, or its thumbnail, as JPEG or PNG.

        Raises:
            NotFound: If there is no such frame, or the map does not keep it in that size.
        """
        request = session_pb2.GetFrameImageRequest(name=self._numbered_frame(name), size=size)
        image: bytes = self._connection.call(self._connection.sessions.GetFrameImage, request).image
        return image

    def explain_frame(
        self, name: str, place_number: int | None = None, max_words: int | None = None
    ) -> session_pb2.FrameExplanation:
        """Why a frame was decided as it was: all conditions for a loop closure, the words for and against.

        Args:
            name: The frame, by its number or by what its robot calls it.
            place_number: The place to explain; the one that was, or could have been, matched if left out.
            max_words: How many words for it, and how many against it, at most 100; 10 if left out.

        Raises:
            NotFound: If there is no such frame, or was no such place at that time.
            InvalidArgument: If several frames of the session are called so.
        """
        request = session_pb2.ExplainFrameRequest(
            name=self._numbered_frame(name), place_number=place_number, max_words=max_words
        )
        explained: session_pb2.FrameExplanation = self._connection.call(
            self._connection.sessions.ExplainFrame, request
        )
        return explained

    def frame_picture(
        self,
        name: str,
        place_number: int | None = None,
        *,
        beside_frame: str = "",
        expected_words: Sequence[int] = (),
    ) -> bytes:
        """A frame beside an earlier one of a place, as SVG, with common features in green.

        Args:
            name: The frame, as maps/MAP/sessions/SESSION/frames/NUMBER.
            place_number: The place; the one that was, or could have been, matched if left out.
            beside_frame: Any other frame, in the same form, in place of one of a place. It may be of another
                map with the same model.
            expected_words: Words that were expected and not seen, as `words_against` of an explanation has
                them: squares mark where the frame beside shows them.

        Raises:
            NotFound: If there is no such frame or place.
            FailedPrecondition: If the two frames are of maps with different models.
        """
        request = session_pb2.GetFramePictureRequest(
            name=self._numbered_frame(name),
            place_number=place_number,
            beside_frame=beside_frame and self._numbered_frame(beside_frame),
            expected_words=expected_words,
        )
        picture: bytes = self._connection.call(self._connection.sessions.GetFramePicture, request).picture
        return picture

    def _numbered_frame(self, name: str) -> str:
        """The name of a frame that may be given by its note: no note that is a number is looked for."""
        session, _, called = name.partition("/frames/")
        if not called or called.isdecimal():
            return name
        found = self.frames(session, note=called)
        if len(found) > 1:
            raise InvalidArgument(
                grpc.StatusCode.INVALID_ARGUMENT,
                f"{len(found)} frames of {session} are called {called!r}, from {found[0].name} to "
                f"{found[-1].name}; name one by its number",
            )
        if not found:
            raise NotFound(
                grpc.StatusCode.NOT_FOUND,
                f"no frame of {session} is called {called!r}; `frames` lists what there is",
            )
        return found[0].name

    def add_relative_pose(
        self,
        frame: str,
        earlier_frame: str,
        pose: Pose2 | Pose3 | npt.ArrayLike,
        covariance: npt.ArrayLike,
    ) -> MapPose | None:
        """Adds what a robot measured by stereo, depth or a marker; gives its pose on the map afterwards.

        Args:
            frame: The frame; it has odometry, and is the latest of its session if it closed a loop with the
                earlier one.
            earlier_frame: A frame of the same map, with odometry.
            pose: base_link at `frame` in base_link at `earlier_frame`, as in `Frame.odometry`.
            covariance: 6 x 6, of (x, y, z, rotation about x, y, z), in m^2 and rad^2.

        Raises:
            NotFound: If there is no such frame.
            InvalidArgument: If the measurement is invalid.
            FailedPrecondition: If it would change nothing.
        """
        measured = odometry(pose, covariance)
        request = session_pb2.AddRelativePoseRequest(
            frame=frame, earlier_frame=earlier_frame, pose=measured.pose, covariance=measured.covariance
        )
        response = self._connection.call(self._connection.sessions.AddRelativePose, request)
        return answers.map_pose(response.map_pose) if response.HasField("map_pose") else None
