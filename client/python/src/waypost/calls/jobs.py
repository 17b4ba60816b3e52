"""Jobs: long work of the server."""

from __future__ import annotations

import time
from collections.abc import Iterator
from types import TracebackType
from typing import Any

import grpc

from waypost import errors
from waypost.connection import Connection, resource
from waypost.reconnection import Patience
from waypost.v1 import job_pb2, merge_pb2

#: A server that may be back in a moment. UNKNOWN stands for a stream that was cut off without a status.
_AWAY = frozenset({grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.UNKNOWN})


class JobCalls:
    """Trainings, imports, merges and other work that takes longer than a call."""

    _connection: Connection

    def jobs(self) -> list[job_pb2.Job]:
        """All jobs, newest first, but for those that ended more than 30 days ago."""
        request = job_pb2.ListJobsRequest()
        return list(self._connection.pages(self._connection.jobs.ListJobs, request, lambda page: page.jobs))

    def job(self, name: str) -> job_pb2.Job:
        """A job (`jobs/{number}`, or its number alone) as it is now.

        Raises:
            NotFound: If there is no such job.
        """
        request = job_pb2.GetJobRequest(name=resource("jobs", name))
        found: job_pb2.Job = self._connection.call(self._connection.jobs.GetJob, request)
        return found

    def watch_job(self, name: str) -> JobProgress:
        """The job now and after every progress, until it has ended. Close it, or iterate it to its end.

        Raises:
            NotFound: While iterating, if there is no such job.
        """
        request = job_pb2.WatchJobRequest(name=resource("jobs", name))
        return JobProgress(self._connection.jobs.WatchJob(request), self._connection.address)

    def wait_for_job(
        self, job: str | job_pb2.Job | merge_pb2.Merge, *, patience_s: float = 60.0
    ) -> job_pb2.Job:
        """Waits until a job, or that of a merge, has ended, and gives it.

        A server that is restarted is waited for: it goes on with many kinds of jobs.

        Args:
            job: A job by itself or by its name, or a merge.
            patience_s: Time without a connection after which it is given up.

        Raises:
            ServerError: The job's own error, if it failed.
            Cancelled: If somebody cancelled it.
            ServerUnreachable: If the server stays away.
        """
        name = job if isinstance(job, str) else job.job if isinstance(job, merge_pb2.Merge) else job.name
        patience = Patience(patience_s)
        ended = None
        while ended is None:
            try:
                ended = self._last_state(name, patience)
            except (errors.ServerUnreachable, errors.ServerError) as error:
                if isinstance(error, errors.ServerError) and error.code not in _AWAY:
                    raise
                delay_s = patience.next_delay_s()
                if delay_s is None:
                    raise
                time.sleep(delay_s)
        if ended.state == job_pb2.Job.STATE_FAILED:
            raise errors.from_status(ended.error)
        if ended.state == job_pb2.Job.STATE_CANCELLED:
            raise errors.Cancelled(grpc.StatusCode.CANCELLED, f"{ended.name} was cancelled; request it again")
        return ended

    def _last_state(self, name: str, patience: Patience) -> job_pb2.Job:
        last = None
        with self.watch_job(name) as progress:
            for state in progress:
                last = state
                patience.progress()
        return last or self.job(name)

    def cancel_job(self, name: str) -> job_pb2.Job:
        """Cancels a job; it stops at its next step.

        Raises:
            NotFound: If there is no such job.
        """
        request = job_pb2.CancelJobRequest(name=resource("jobs", name))
        cancelled: job_pb2.Job = self._connection.call(self._connection.jobs.CancelJob, request)
        return cancelled


class JobProgress(Iterator[job_pb2.Job]):
    """The states of a job, the last one when it has ended."""

    def __init__(self, call: Any, address: str) -> None:
        self._call = call
        self._address = address

    def __next__(self) -> job_pb2.Job:
        try:
            state: job_pb2.Job = next(self._call)
        except grpc.RpcError as error:
            raise errors.from_call(error, self._address) from None
        return state

    def close(self) -> None:
        """Stops watching; the job goes on."""
        self._call.cancel()

    def __enter__(self) -> JobProgress:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
